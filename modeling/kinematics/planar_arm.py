"""Planar arm of revolute joints: pose, velocity and acceleration of the force sensor from the joint angles.

Equation numbers are those of chapter 22, "Characterization of the Dynamical Model of a Force Sensor for Robot
Manipulators" (Bassi et al.).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from modeling import symbolic as sp
from modeling.evaluation.cache import cached, canonical_data
from modeling.evaluation.tape import Tape
from modeling.evaluation.tape_evaluation import TapeEvaluation
from modeling.expressions.intermediate_variables import IntermediateVariables
from modeling.kinematics.arm import Arm, ArmFrames, MathBackend
from modeling.space import Space

POSE_SIGNALS = ("phi", "dphi", "ddphi", "px", "py", "vx", "vy", "ax", "ay")


def joint_symbols(joints: int, prefix: str) -> tuple[sp.Symbol, ...]:
    """Symbols `<prefix>1 .. <prefix>n`, the joint signals of a recording (rad, rad/s, rad/s²)."""
    return tuple(sp.Symbol(f"{prefix}{j}", real=True) for j in range(1, joints + 1))


@dataclass(frozen=True)
class PlanarArm(Arm):
    """Planar arm of n revolute joints, lengths in m from joint to joint, the last one to the sensor origin.

    Angles are clockwise positive, the first from world +y, the others relative; x points right, y up.
    """

    link_lengths: tuple[float, ...]

    space: ClassVar[Space] = Space.PLANE
    names: ClassVar[tuple[str, ...]] = POSE_SIGNALS

    @property
    def joints(self) -> int:
        """The number of joints n."""
        return len(self.link_lengths)

    @cached_property
    def kinematics(self) -> Mapping[str, sp.Expr]:
        """Pose signals as expressions in `q1.., dq1.., ddq1..`: 22.2 and its time derivatives by SymPy."""
        return forward_kinematics(tuple(sp.Float(length) for length in self.link_lengths))

    def frames(self, q: Sequence[Any], errors: Sequence[Any], calculus: MathBackend) -> ArmFrames:
        """The sensor origin Ps = sum_k l_k (sin, cos)(q1 + .. + qk) (22.2), the tip's angle phi = q1 + .. + qn."""
        lengths = [length + error for length, error in zip(self.link_lengths, errors, strict=True)]
        return link_frames(lengths, q, calculus)

    def derived(self, pose: Sequence[sp.Expr], steps: IntermediateVariables) -> dict[str, sp.Expr]:
        """phi, px, py with their velocities and accelerations (the Ps'' of 22.4)."""
        return pose_signals(pose, steps)

    @cached_property
    def tape(self) -> Tape:
        """Tape of the pose signals in their order, over q, dq, ddq (3 n), cached on disk."""
        what = {"part": "pose", "arm": canonical_data(self)}
        return cached(what, lambda: self._derived_tape().to_data(), Tape.from_data)

    def _derived_tape(self) -> Tape:
        symbols = [symbol for prefix in ("q", "dq", "ddq") for symbol in joint_symbols(self.joints, prefix)]
        return Tape.of_expressions(symbols, [self.kinematics[name] for name in self.names])

    def graph(self, q: Any, dq: Any, ddq: Any) -> dict[str, Any]:
        """The pose signals as CasADi expressions of q, dq, ddq (n,)."""
        import casadi as ca

        signals = self.tape.graph(ca.vertcat(q, dq, ddq), ca.SX(0, 1))
        return {name: signals[i] for i, name in enumerate(self.names)}

    def pose(
        self, q: NDArray[np.float64], dq: NDArray[np.float64], ddq: NDArray[np.float64]
    ) -> dict[str, NDArray[np.float64]]:
        """Pose signals of joint motions (N, n): phi, dphi, ddphi (rad), px .. ay (m, world), each (N,)."""
        values = TapeEvaluation(self.tape).values([*q.T, *dq.T, *ddq.T])
        return dict(zip(self.names, values, strict=True))


def link_frames(lengths: Sequence[Any], q: Sequence[Any], calculus: MathBackend) -> ArmFrames:
    """Serial chain of links from the origin, each rotated clockwise relative to the preceding one."""
    angle, x, y = 0, 0, 0
    origins = []
    for length, turn in zip(lengths, q, strict=True):
        origins.append((x, y, 0))
        angle = calculus.let(angle + turn)
        x, y = (calculus.let(at + length * part(angle)) for at, part in ((x, calculus.sin), (y, calculus.cos)))
    return ArmFrames(tuple(origins), ((0, 0, -1),) * len(origins), (angle, x, y))


def pose_signals(pose: Sequence[sp.Expr], steps: IntermediateVariables) -> dict[str, sp.Expr]:
    """phi, px, py and their first and second time derivatives, by the names of POSE_SIGNALS."""
    first = [steps.rate(part) for part in pose]
    second = [steps.rate(part) for part in first]
    (phi, x, y), (dphi, vx, vy), (ddphi, ax, ay) = pose, first, second
    return dict(zip(POSE_SIGNALS, (phi, dphi, ddphi, x, y, vx, vy, ax, ay), strict=True))


def joint_rates(joints: int) -> dict[sp.Symbol, sp.Symbol]:
    """The time derivative of each joint signal: q1 -> dq1, dq1 -> ddq1 and so on."""
    q, dq, ddq = (joint_symbols(joints, prefix) for prefix in ("q", "dq", "ddq"))
    return dict(zip((*q, *dq), (*dq, *ddq), strict=True))


def forward_kinematics(lengths: tuple[sp.Expr, ...]) -> dict[str, sp.Expr]:
    """Pose signals of an arm with symbolic or numeric link lengths (22.2 and its time derivatives)."""
    steps = IntermediateVariables(joint_rates(len(lengths)), named=False)
    frames = link_frames(lengths, joint_symbols(len(lengths), "q"), MathBackend(sin=sp.sin, cos=sp.cos))
    return pose_signals(frames.pose, steps)
