"""The planar arm: where the force sensor is, and how it moves, from the joint angles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from modeling import symbolic as sp
from modeling.description import described
from modeling.emission import casadi_expressions
from modeling.evaluation import Evaluation
from modeling.kinematics import Arm, Calculus, Frames
from modeling.space import Space
from modeling.steps import Steps
from modeling.store import stored
from modeling.tape import Tape

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
        """Pose signals as expressions in `q1.., dq1.., ddq1..`: 22.2 and its time derivatives, taken by SymPy."""
        return forward_kinematics(tuple(sp.Float(length) for length in self.link_lengths))

    def frames(self, q: Sequence[Any], errors: Sequence[Any], calculus: Calculus) -> Frames:
        """The sensor origin Ps = sum_k l_k (sin, cos)(q1 + .. + qk) (22.2), the tip's angle phi = q1 + .. + qn."""
        lengths = [length + error for length, error in zip(self.link_lengths, errors, strict=True)]
        return chained(lengths, q, calculus)

    def derived(self, pose: Sequence[sp.Expr], steps: Steps) -> dict[str, sp.Expr]:
        """phi, px, py with their velocities and accelerations (the Ps'' of 22.4)."""
        return pose_signals(pose, steps)

    @cached_property
    def tape(self) -> Tape:
        """The pose signals in their order, over q, dq, ddq (3 n), derived once for all processes."""
        what = {"part": "pose", "arm": described(self)}
        return stored(what, lambda: self._derived_tape().to_data(), Tape.from_data)

    def _derived_tape(self) -> Tape:
        import casadi as ca

        u = ca.SX.sym("u", 3 * self.joints)
        symbols = (symbol for prefix in ("q", "dq", "ddq") for symbol in joint_symbols(self.joints, prefix))
        known = {symbol: u[i] for i, symbol in enumerate(symbols)}
        expressions = casadi_expressions(known, [self.kinematics[name] for name in self.names])
        return Tape.of(u, ca.SX.sym("theta", 0), ca.vertcat(*expressions))

    def graph(self, q: Any, dq: Any, ddq: Any) -> dict[str, Any]:
        """The pose signals as CasADi expressions of q, dq, ddq (n,)."""
        import casadi as ca

        signals = self.tape.graph(ca.vertcat(q, dq, ddq), ca.SX(0, 1))
        return {name: signals[i] for i, name in enumerate(self.names)}

    def pose(
        self, q: NDArray[np.float64], dq: NDArray[np.float64], ddq: NDArray[np.float64]
    ) -> dict[str, NDArray[np.float64]]:
        """Pose signals of joint motions (N, n): phi, dphi, ddphi (rad), px .. ay (m, world), each (N,)."""
        found = np.zeros((len(self.names), len(q), 1))
        Evaluation(self.tape).run([*q.T, *dq.T, *ddq.T], np.zeros((1, 0)), list(found))
        return dict(zip(self.names, found[:, :, 0], strict=True))


def chained(lengths: Sequence[Any], q: Sequence[Any], calculus: Calculus) -> Frames:
    """Links of these lengths one after the other from the origin, each turned clockwise against the one before."""
    angle, x, y = 0, 0, 0
    origins = []
    for length, turn in zip(lengths, q, strict=True):
        origins.append((x, y, 0))
        angle = calculus.let(angle + turn)
        x, y = (calculus.let(at + length * part(angle)) for at, part in ((x, calculus.sin), (y, calculus.cos)))
    return Frames(tuple(origins), ((0, 0, -1),) * len(origins), (angle, x, y))


def pose_signals(pose: Sequence[sp.Expr], steps: Steps) -> dict[str, sp.Expr]:
    """phi, px, py and their first and second rates, under the names of POSE_SIGNALS."""
    first = [steps.rate(part) for part in pose]
    second = [steps.rate(part) for part in first]
    (phi, x, y), (dphi, vx, vy), (ddphi, ax, ay) = pose, first, second
    return dict(zip(POSE_SIGNALS, (phi, dphi, ddphi, x, y, vx, vy, ax, ay), strict=True))


def joint_rates(joints: int) -> dict[sp.Symbol, sp.Symbol]:
    """The rate of each joint signal: q1 -> dq1, dq1 -> ddq1 and so on."""
    q, dq, ddq = (joint_symbols(joints, prefix) for prefix in ("q", "dq", "ddq"))
    return dict(zip((*q, *dq), (*dq, *ddq), strict=True))


def forward_kinematics(lengths: tuple[sp.Expr, ...]) -> dict[str, sp.Expr]:
    """Pose signals of an arm with symbolic or numeric link lengths (22.2 and its time derivatives)."""
    steps = Steps(joint_rates(len(lengths)), named=False)
    frames = chained(lengths, joint_symbols(len(lengths), "q"), Calculus(sin=sp.sin, cos=sp.cos))
    return pose_signals(frames.pose, steps)
