"""Planar arm of revolute joints: pose, velocity and acceleration of the force sensor from the joint angles.

Equation numbers are those of chapter 22, "Characterization of the Dynamical Model of a Force Sensor for Robot
Manipulators" (Bassi et al.).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Self

from modeling import symbolic as sp
from modeling.evaluation.tape import Tape
from modeling.expressions.intermediate_variables import IntermediateVariables
from modeling.kinematics.arm import Arm, ArmFrames, MathBackend
from modeling.kinematics.base_mounting import Direction, base_angle
from modeling.space import Space

POSE_SIGNALS = ("phi", "dphi", "ddphi", "px", "py", "vx", "vy", "ax", "ay")


def joint_symbols(joints: int, prefix: str) -> tuple[sp.Symbol, ...]:
    """Symbols `<prefix>1 .. <prefix>n`, the joint signals of a recording (rad, rad/s, rad/s²)."""
    return tuple(sp.Symbol(f"{prefix}{j}", real=True) for j in range(1, joints + 1))


@dataclass(frozen=True)
class PlanarArm(Arm):
    """Planar arm of n revolute joints, lengths in m from joint to joint, the last one to the sensor origin.

    Angles are clockwise positive, the first from the base's y, the others relative; x points right, y up. The base is
    turned by `base` (rad, clockwise) in the world.
    """

    link_lengths: tuple[float, ...]
    base: float = 0.0

    space: ClassVar[Space] = Space.PLANE
    names: ClassVar[tuple[str, ...]] = POSE_SIGNALS

    @property
    def joints(self) -> int:
        """The number of joints n."""
        return len(self.link_lengths)

    @cached_property
    def kinematics(self) -> Mapping[str, sp.Expr]:
        """Pose signals as expressions in `q1.., dq1.., ddq1..`: 22.2 and its time derivatives by SymPy."""
        return forward_kinematics(tuple(sp.Float(length) for length in self.link_lengths), self.base)

    def mounted(self, direction: Direction) -> Self:
        """The base turned."""
        return replace(self, base=base_angle(direction))

    def frames(self, q: Sequence[Any], errors: Sequence[Any], calculus: MathBackend) -> ArmFrames:
        """The sensor origin Ps = sum_k l_k (sin, cos)(q1 + .. + qk) (22.2), the tip's angle phi = q1 + .. + qn."""
        angle, x, y = self.base or 0, 0, 0
        origins = []
        for length, error, turn in zip(self.link_lengths, errors, q, strict=True):
            origins.append((x, y, 0))
            angle = calculus.let(angle + turn)
            along = ((x, calculus.sin), (y, calculus.cos))
            x, y = (calculus.let(at + (length + error) * part(angle)) for at, part in along)
        return ArmFrames(tuple(origins), ((0, 0, -1),) * len(origins), (angle, x, y))

    def graph(self, q: Any, dq: Any, ddq: Any) -> dict[str, Any]:
        """The signals as CasADi expressions of any q, dq, ddq (n,)."""
        import casadi as ca

        values = self.tape.graph(ca.vertcat(q, dq, ddq), ca.SX(0, 1))
        return {name: values[i] for i, name in enumerate(self.names)}

    def _derived(self) -> Tape:
        symbols = [symbol for prefix in ("q", "dq", "ddq") for symbol in joint_symbols(self.joints, prefix)]
        return Tape.of_expressions(symbols, [self.kinematics[name] for name in self.names])

    def signals(self, pose: Sequence[Any], first: Sequence[Any], second: Sequence[Any]) -> dict[str, Any]:
        """phi (rad), px, py (m, world) with their velocities and accelerations (the Ps'' of 22.4)."""
        (phi, x, y), (dphi, vx, vy), (ddphi, ax, ay) = pose, first, second
        return dict(zip(self.names, (phi, dphi, ddphi, x, y, vx, vy, ax, ay), strict=True))


def joint_rates(joints: int) -> dict[sp.Symbol, sp.Symbol]:
    """The time derivative of each joint signal: q1 -> dq1, dq1 -> ddq1 and so on."""
    q, dq, ddq = (joint_symbols(joints, prefix) for prefix in ("q", "dq", "ddq"))
    return dict(zip((*q, *dq), (*dq, *ddq), strict=True))


def forward_kinematics(lengths: tuple[sp.Expr, ...], base: float = 0.0) -> dict[str, sp.Expr]:
    """Pose signals of an arm with symbolic or numeric link lengths (22.2 and its time derivatives)."""
    arm, joints = PlanarArm(lengths, base), len(lengths)
    frames = arm.frames(joint_symbols(joints, "q"), [sp.S.Zero] * joints, MathBackend(sin=sp.sin, cos=sp.cos))
    return arm.derived(frames.pose, IntermediateVariables(joint_rates(joints), named=False))
