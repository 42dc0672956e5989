"""The planar arm: where the force sensor is, and how it moves, from the joint angles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from modeling.emission import casadi_expressions, numpy_function
from modeling.kinematics import Arm
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
        """Pose signals as expressions in `q1.., dq1.., ddq1..`.

        The sensor origin is Ps = sum_k l_k (sin, cos)(q1 + .. + qk) (equation 22.2) and the tip's angle
        phi = q1 + .. + qn. Velocity and acceleration (the Ps'' of 22.4) are its time derivatives, taken by SymPy.
        """
        lengths = tuple(sp.Float(length) for length in self.link_lengths)
        return forward_kinematics(lengths)

    def graph(self, q: Any, dq: Any, ddq: Any) -> dict[str, Any]:
        """The pose signals as CasADi expressions of q, dq, ddq (n,)."""
        symbols = (joint_symbols(self.joints, prefix) for prefix in ("q", "dq", "ddq"))
        moving = zip(symbols, (q, dq, ddq), strict=True)
        known = {symbol: values[j] for own, values in moving for j, symbol in enumerate(own)}
        expressions = casadi_expressions(known, [self.kinematics[name] for name in self.names])
        return dict(zip(self.names, expressions, strict=True))

    @cached_property
    def _pose_function(self):  # type: ignore[no-untyped-def]
        inputs = [s for p in ("q", "dq", "ddq") for s in joint_symbols(self.joints, p)]
        return numpy_function(inputs, [self.kinematics[name] for name in POSE_SIGNALS])

    def pose(
        self, q: NDArray[np.float64], dq: NDArray[np.float64], ddq: NDArray[np.float64]
    ) -> dict[str, NDArray[np.float64]]:
        """Pose signals of joint motions (N, n): phi, dphi, ddphi (rad), px .. ay (m, world), each (N,)."""
        values = self._pose_function(*q.T, *dq.T, *ddq.T)
        return {name: np.broadcast_to(v, (len(q),)).astype(float) for name, v in zip(POSE_SIGNALS, values, strict=True)}


def forward_kinematics(lengths: tuple[sp.Expr, ...]) -> dict[str, sp.Expr]:
    """Pose signals of an arm with symbolic or numeric link lengths (22.2 and its time derivatives)."""
    time = sp.Symbol("t")
    n = len(lengths)
    angles = [sp.Function(f"q{j}")(time) for j in range(1, n + 1)]
    absolute = [sum(angles[: k + 1], sp.S.Zero) for k in range(n)]
    x = sum((length * sp.sin(a) for length, a in zip(lengths, absolute, strict=True)), sp.S.Zero)
    y = sum((length * sp.cos(a) for length, a in zip(lengths, absolute, strict=True)), sp.S.Zero)
    phi = absolute[-1]
    moving = {"phi": phi, "dphi": phi.diff(time), "ddphi": phi.diff(time, 2), "px": x, "py": y}
    moving |= {"vx": x.diff(time), "vy": y.diff(time), "ax": x.diff(time, 2), "ay": y.diff(time, 2)}
    q, dq, ddq = (joint_symbols(n, prefix) for prefix in ("q", "dq", "ddq"))
    frozen: dict[sp.Expr, sp.Symbol] = {}
    for angle, q_j, dq_j, ddq_j in zip(angles, q, dq, ddq, strict=True):
        frozen |= {angle.diff(time, 2): ddq_j, angle.diff(time): dq_j, angle: q_j}
    return {name: expression.subs(frozen) for name, expression in moving.items()}
