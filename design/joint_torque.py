"""Torques of a spatial arm's joints along a motion, with their derivatives, and bounds on them at every instant."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import comb

import numpy as np

from design.clearance import ArmPlaces
from design.trajectories.trajectory import Array, Trajectory, grid_bound
from modeling.errors import InputError
from modeling.kinematics.arm import Arm, SpatialArm
from modeling.kinematics.placement import JointKind
from modeling.rig import Limits, TorqueLimits

TORQUE_MARGIN = 1e-3
"""Of half the range that is allowed: what may be lost of it to a bound between instants."""
PIECES = 64
"""Pieces of a period in which the joints' rates are bounded each by themselves."""
POINTS_PER_PIECE = 16
"""Instants of a piece at which they are evaluated."""
HIGHEST = 4
"""Order of the highest derivative of a position on which the second one of a torque depends."""


@dataclass(frozen=True, eq=False)
class JointTorques:
    """Torques of an arm's joints, but for Coulomb's friction, by d'Alembert's principle. N m; N of prismatic joints.

    With the velocity of a point p of body k as V_k p, V_k = sum over j <= k of screw_j dq_j, 4 x 4 matrices that act on
    (p, 1), a mass element at p is accelerated by K_k p, K_k = dV_k/dt + V_k² plus gravity's part. Joint j moves it by
    screw_j p, and does the work of all forces along that: with P_k = sum of p p' dm

        tau_j = <screw_j, W_j>,    W_j = sum over k >= j of K_k P_k,    <A, B> = tr A'B,

    all in the axes of the world. Differentiated by the position of joint i, screws and bodies beyond i turn about it:
    with C_i = [dV_i/dt + gravity, screw_i] + [V_i, dscrew_i/dt], m = max(i, j), P and Y = sum of V P from m on,

        d tau_j / d q_i = <screw_j, C_i P_m + 2 dscrew_i/dt Y_m + (i > j) (screw_i W_i + W_i screw_i')>.
    """

    arm: SpatialArm
    limits: TorqueLimits

    @property
    def names(self) -> list[str]:
        """Of the joints."""
        return [f"q{j + 1}" for j in range(self.arm.joints)]

    @property
    def units(self) -> list[str]:
        """N m; N of a prismatic joint."""
        return ["N" if joint.kind is JointKind.PRISMATIC else "N m" for joint in self.arm.chain]

    @property
    def room(self) -> Array:
        """(n, 2): what is allowed of the torques without Coulomb's friction, which may act either way."""
        return np.asarray(self.limits.allowed + np.multiply.outer(self.limits.coulomb, [1.0, -1.0]))

    def values(self, q: Array, dq: Array, ddq: Array) -> Array:
        """(N, n) at positions, velocities and accelerations (N, n)."""
        return _Motion(self, q, dq, ddq).torques + self.limits.viscous * dq

    def slopes(self, q: Array, dq: Array, ddq: Array) -> Array:
        """(N, n, 3 n): the derivatives by positions, by velocities and by accelerations."""
        by_position, by_velocity, by_acceleration = _Motion(self, q, dq, ddq).slopes
        by_velocity += np.diag(self.limits.viscous)
        return np.concatenate([by_position, by_velocity, by_acceleration], axis=2)

    @cached_property
    def spreads(self) -> Array:
        """(n, 4, 4): of what each joint moves and the next does not, sum of p p' dm in the frame that it moves."""
        total = np.zeros((self.arm.joints, 4, 4))
        for body in self.limits.bodies:
            xx, xy, xz, yy, yz, zz = body.inertia
            second = (xx + yy + zz) / 2 * np.eye(3) - np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            place = np.array([*body.centre, 1.0])
            total[body.joint - 1] += body.mass * np.outer(place, place)
            total[body.joint - 1, :3, :3] += second
        return total

    # ------------------------------------------------------------------------------ at every instant

    def enclosure(self, motion: Trajectory) -> tuple[Array, Array]:
        """Bounds low and high (n,) of the torques at every instant, Coulomb's friction either way included."""
        breaks = np.unique([*np.linspace(0.0, motion.period, PIECES + 1), *motion.series.breaks])
        bend = self._bend(_rates(motion, breaks)).T
        margin = TORQUE_MARGIN * np.ptp(self.room, axis=1) / 2
        low, high = grid_bound(lambda time: self.values(*motion.evaluate(time)), bend, breaks, margin)
        return low - self.limits.coulomb, high + self.limits.coulomb

    def _bend(self, rates: Array) -> Array:
        """(n, P): bounds on the second derivative of the torques, from those (n, 5, P) on the positions' derivatives.

        A vector that turns with a frame of angular velocity w has the derivative w x v, and so on by the product rule;
        norms of products are at most products of norms. Every quantity here is a bound on its norm and on that of its
        derivatives, (orders, P).
        """
        spin = np.zeros((HIGHEST, rates.shape[2]))
        axes, levers, spins = list[Array](), list[Array](), list[Array]()
        for joint, q in zip(self.arm.chain, rates, strict=True):
            axis = _turned(1.0, spin)
            lever = _turned(float(np.linalg.norm(joint.placement.position)), spin)
            if joint.kind is JointKind.PRISMATIC:
                lever = lever + _product(axis, q, HIGHEST)
            else:
                spin = spin + _product(axis[:-1], q[1:], HIGHEST - 1)
            axes.append(axis)
            levers.append(lever)
            spins.append(spin)
        bend = self.limits.viscous[:, None] * rates[:, 3]
        for k, (body, offset) in enumerate(zip(self._bodies, np.cumsum(levers, axis=0), strict=True)):
            reach = _turned(body.reach, spins[k])
            force = body.mass * (offset + reach)[2:]
            force[0] += body.mass * self.limits.gravity
            inertia = np.zeros_like(spins[k])
            inertia[0] = body.moment
            for order in range(HIGHEST - 1):
                inertia[order + 1] = 2 * _product(spins[k], inertia, order)[order]
            turning = _product(inertia, spins[k], HIGHEST - 1)[1:]
            for j in range(k, -1, -1):
                axis = axes[j][:3]
                if self.arm.chain[j].kind is JointKind.PRISMATIC:
                    bend[j] += _product(axis, force, 2)[2]
                else:
                    bend[j] += _product(axis, turning + _product(reach[:3], force, 2), 2)[2]
                reach = reach + levers[j]
        return bend

    @cached_property
    def _bodies(self) -> list[_Norms]:
        """Of what each joint moves: mass, distance of its centre from the frame, moment about the centre."""
        norms = list[_Norms]()
        for spread in self.spreads:
            mass, first = spread[3, 3], spread[:3, 3]
            centre = first / mass if mass > 0 else np.zeros(3)
            second = spread[:3, :3] - mass * np.outer(centre, centre)
            moments = np.trace(second) * np.eye(3) - second
            norms.append(_Norms(float(mass), float(np.linalg.norm(centre)), float(np.linalg.norm(moments, 2))))
        return norms


@dataclass(frozen=True)
class _Norms:
    mass: float
    reach: float
    moment: float


class _Motion:
    """What the torques at positions, velocities and accelerations (N, n) are made of: each (N, n, 4, 4), by joint."""

    def __init__(self, of: JointTorques, q: Array, dq: Array, ddq: Array) -> None:
        places, n = ArmPlaces.of(of.arm, q), of.arm.joints
        along, at = places.directions, places.origins[:, 1:]
        frame = np.zeros((len(q), n, 4, 4))
        frame[..., :3, :3], frame[..., :3, 3], frame[..., 3, 3] = places.axes[:, 1:], at, 1.0
        self.spreads = frame @ of.spreads @ np.swapaxes(frame, 2, 3)
        self.screws = np.zeros((len(q), n, 4, 4))
        turning = places.revolute[:, None]
        for row, column, component in ((1, 0, 2), (2, 1, 0), (0, 2, 1)):
            part = np.where(places.revolute, along[..., component], 0.0)
            self.screws[..., row, column], self.screws[..., column, row] = part, -part
        self.screws[..., :3, 3] = np.where(turning, np.cross(at, along), along)
        self.velocity = np.cumsum(self.screws * dq[..., None, None], axis=1)
        self.rates = _bracket(self.velocity, self.screws)
        self.lifted = np.cumsum(self.screws * ddq[..., None, None] + self.rates * dq[..., None, None], axis=1)
        self.lifted[..., 2, 3] += of.limits.gravity
        self.work = _outward((self.lifted + self.velocity @ self.velocity) @ self.spreads)

    @property
    def torques(self) -> Array:
        """(N, n)"""
        return np.asarray((self.screws * self.work).sum(axis=(2, 3)))

    @property
    def slopes(self) -> tuple[Array, Array, Array]:
        """(N, n, n) each: by position, velocity, acceleration; the second index is the joint's that moves."""
        n = self.screws.shape[1]
        outer = np.maximum.outer(np.arange(n), np.arange(n))
        held = _outward(self.spreads)[:, outer].reshape(-1, n, n, 16)
        carried = _outward(self.velocity @ self.spreads)[:, outer].reshape(-1, n, n, 16)

        def along(moving: Array, with_: Array) -> Array:
            """<screw_j, moving_i X_m> as (N, j, i)."""
            pairs = np.swapaxes(moving, 2, 3)[:, None] @ self.screws[:, :, None]
            return np.asarray(np.einsum("njip,njip->nji", pairs.reshape(with_.shape), with_))

        bent = _bracket(self.lifted, self.screws) + _bracket(self.velocity, self.rates)
        turned = self.screws @ self.work
        turned = turned + self.work @ np.swapaxes(self.screws, 2, 3)
        inward = np.einsum("njab,niab->nji", self.screws, turned) * np.triu(np.ones((n, n)), 1)
        return (
            along(bent, held) + 2 * along(self.rates, carried) + inward,
            2 * (along(self.rates, held) + along(self.screws, carried)),
            along(self.screws, held),
        )


def _bracket(a: Array, b: Array) -> Array:
    return np.asarray(a @ b - b @ a)


def _outward(values: Array) -> Array:
    """The sums from each joint to the last (N, n, ..)."""
    return np.asarray(np.cumsum(values[:, ::-1], axis=1)[:, ::-1])


def _product(a: Array, b: Array, highest: int) -> Array:
    """(highest + 1, P): bounds on the derivatives of a product, by the product rule."""
    return np.array([sum(comb(p, r) * a[r] * b[p - r] for r in range(p + 1)) for p in range(highest + 1)])


def _turned(length: float, spin: Array) -> Array:
    """(orders + 1, P): bounds on the derivatives of a vector of a length that turns with bounds `spin` (orders, P)."""
    bounds = [np.full(spin.shape[1], length)]
    for order in range(len(spin)):
        bounds.append(_product(spin, np.array(bounds), order)[order])
    return np.array(bounds)


def _rates(motion: Trajectory, breaks: Array) -> Array:
    """(n, 5, P): bounds on the absolute positions and their derivatives to the fourth, in each piece between breaks.

    Between instants h apart a function with the derivative at most d in size is at most d h / 2 above both.
    """
    whole = [np.abs(motion.enclosure(order)).max(axis=0) for order in range(HIGHEST + 2)]
    share = np.linspace(0.0, 1.0, POINTS_PER_PIECE + 1)
    step = np.diff(breaks)
    time = (breaks[:-1, None] + step[:, None] * share).ravel()
    bounds = []
    for order in range(HIGHEST + 1):
        bound = np.broadcast_to(whole[order][:, None], (motion.joints, len(step)))
        if order < motion.series.smoothness:
            values = np.abs(motion.derivative(time, order)).reshape(len(step), -1, motion.joints).max(axis=1)
            bound = np.minimum(bound, values.T + whole[order + 1][:, None] * step / (2 * POINTS_PER_PIECE))
        bounds.append(bound)
    return np.stack(bounds, axis=1)


def joint_torques(limits: Limits, arm: Arm | None) -> JointTorques | None:
    """The torques of an arm with limits of them; None where there are none.

    Raises InputError for an arm that is not from a URDF, and friction that takes all of a limit.
    """
    if limits.torque is None:
        return None
    if not isinstance(arm, SpatialArm):
        what = "torque limits were given, and the arm is not from a URDF"
        raise InputError(what=what, where="limits", remedy="state robot.urdf, or leave out limits.torque")
    torques = JointTorques(arm, limits.torque)
    low, high = torques.room.T
    if not (low < high).all():
        joint = int(np.argmin(high - low))
        what = f"Coulomb's friction of q{joint + 1}, {limits.torque.coulomb[joint]:g} {torques.units[joint]},"
        what += " is all that its torque limit allows"
        raise InputError(what=what, where="limits", remedy="widen limits.torque, or correct friction.coulomb")
    return torques
