"""The spatial arm: where the force sensor is in space, and how it moves, from the joint coordinates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from modeling.joint import UNMOVED, Joint, JointKind, Placement, moved
from modeling.kinematics import Arm
from modeling.quaternion import COMPONENTS, conjugate, product, rotated
from modeling.space import Space

Array = NDArray[np.float64]

VECTORS = tuple(prefix + axis for prefix in ("w", "al", "p", "vp", "ap") for axis in "xyz")


@dataclass(frozen=True)
class SpatialArm(Arm):
    """Revolute and prismatic joints one after the other from the world, z up, to the frame of the sensor.

    `sensor` is the placement of the sensor on the frame that the last joint moves.
    """

    chain: tuple[Joint, ...]
    sensor: Placement = UNMOVED

    space: ClassVar[Space] = Space.SPACE
    names: ClassVar[tuple[str, ...]] = COMPONENTS + VECTORS

    @property
    def joints(self) -> int:
        """The number of joints n."""
        return len(self.chain)

    @property
    def units(self) -> tuple[str, ...]:
        """rad for joints that turn, m for joints that slide."""
        return tuple("m" if joint.kind is JointKind.PRISMATIC else "rad" for joint in self.chain)

    def graph(self, q: Any, dq: Any, ddq: Any) -> dict[str, Any]:
        """The signals as CasADi expressions of symbols q and of any dq, ddq (n,).

        With x(q) = (s, p) the unit quaternion and the origin of the sensor, J = dx/dq and v = J dq:
        dx/dt = v and d²x/dt² = J ddq + (dv/dq) dq, both by CasADi's differentiation of x alone. From s, in the sensor
        frame, omega = 2 vec(conj(s) ⊗ ds/dt); its derivative in time is alpha = 2 vec(conj(s) ⊗ d²s/dt²), since
        conj(ds/dt) ⊗ ds/dt is a scalar. Neither s nor any signal jumps anywhere: s is a product of half angles' sines.
        """
        import casadi as ca

        x = ca.vertcat(*self._pose([q[j] for j in range(self.joints)]))
        v = ca.jtimes(x, q, dq)
        a = ca.jtimes(x, q, ddq) + ca.jtimes(v, q, dq)
        (s, p), (ds, dp), (dds, ddp) = ((ca.vertsplit(y)[:4], ca.vertsplit(y)[4:]) for y in (x, v, a))
        omega, alpha = ([2 * c for c in product(conjugate(s), rate)[:3]] for rate in (ds, dds))
        return dict(zip(self.names, (*s, *omega, *alpha, *p, *dp, *ddp), strict=True))

    def _pose(self, q: list[Any]) -> tuple[Any, ...]:
        """s and p (7,): the placements of the joints and their motions, one after the other."""
        import casadi as ca

        s, p = UNMOVED.quaternion, UNMOVED.position
        for joint, angle in zip(self.chain, q, strict=True):
            p = moved(p, rotated(s, joint.placement.position))
            s = product(s, joint.placement.quaternion)
            if joint.kind is JointKind.PRISMATIC:
                p = moved(p, [angle * c for c in rotated(s, joint.axis)])
            else:
                s = product(s, (*(c * ca.sin(angle / 2) for c in joint.axis), ca.cos(angle / 2)))
        p = moved(p, rotated(s, self.sensor.position))
        return (*product(s, self.sensor.quaternion), *p)

    @property
    def position_limits(self) -> Array:
        """Lowest and highest coordinate of each joint (n, 2), rad or m; infinite where nothing bounds it."""
        return np.array([j.position or (-np.inf, np.inf) for j in self.chain])

    def pose(self, q: Array, dq: Array, ddq: Array) -> dict[str, Array]:
        """Signals of joint motions (N, n), each (N,).

        qx .. qw (sensor in the world, continuous in q), wx .. and alx .. (rad/s, rad/s², sensor frame), px .., vpx ..,
        apx .. of the sensor origin in the world (m, m/s, m/s², kinematic).
        """
        values = np.array(self.function(q.T, dq.T, ddq.T))
        return dict(zip(self.names, values, strict=True))
