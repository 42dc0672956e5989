"""Limits as constraints at chosen instants."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Protocol, Self

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from design.clearance import clearances
from design.joint_torque import joint_torques
from design.limits import workspace_sides
from design.optimiser.objective import SampledFunction
from design.trajectories.trajectory import TrajectorySeries
from modeling.kinematics.arm import Arm
from modeling.rig import Limits, Workspace

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class JointBlock:
    """Limits of one joint, -1 <= A z[moving] - middle <= 1: indices (c,) of the coefficients that move it, A (R, c),
    middle (R,), and the place of its rows among those of all joints."""

    moving: NDArray[np.intp]
    matrix: Array
    middle: Array
    place: slice

    @cached_property
    def square(self) -> tuple[NDArray[np.intp], ...]:
        """The indices of a joint's coefficients by themselves."""
        return np.ix_(self.moving, self.moving)


@dataclass(frozen=True, eq=False)
class Polytope:
    """-1 <= A z - middle <= 1 for `size` coefficients z: one dense block of A for each joint."""

    blocks: tuple[JointBlock, ...]
    size: int

    def __len__(self) -> int:
        return int(self.blocks[-1].place.stop)

    def change(self, step: Array) -> Array:
        """A step (R,): the change of the rows by a step (k,) of the coefficients."""
        return np.concatenate([block.matrix @ step[block.moving] for block in self.blocks])

    def slack(self, z: Array) -> Array:
        """(2, R): the slacks to the high and to the low limits at z (k,); positive inside."""
        value = self.change(z) - np.concatenate([block.middle for block in self.blocks])
        return np.stack([1 - value, 1 + value])

    def pushed(self, multipliers: Array) -> Array:
        """A' (high - low) (k,) of multipliers (2, R)."""
        net, total = multipliers[0] - multipliers[1], np.zeros(self.size)
        for block in self.blocks:
            total[block.moving] += net[block.place] @ block.matrix
        return total

    def gram(self, weights: Array) -> Array:
        """A' diag(high + low) A (k, k) of weights (2, R) that are not negative."""
        root, total = np.sqrt(weights.sum(axis=0)), np.zeros((self.size, self.size))
        for block in self.blocks:
            scaled = block.matrix * root[block.place, None]
            total[block.square] += scaled.T @ scaled
        return total


class Measure(Protocol):
    """Functions c (S) of the joints' positions, or of these, velocities and accelerations, that are limited."""

    @property
    def values(self) -> Callable[..., Array]:
        """(N, S) of positions and what else they depend on, each (N, n)."""
        ...

    @property
    def slopes(self) -> Callable[..., Array]:
        """Of the same their derivatives by each of these, (N, S, n) beside one another."""
        ...


@dataclass(frozen=True)
class TipCoordinates:
    """Coordinates of the tip by index in the world, m."""

    arm: Arm
    tip_length: float
    index: tuple[int, ...]

    def values(self, q: Array) -> Array:
        """(N, S) at positions (N, n)."""
        return _tip_functions(self, len(q))[0](q.T)[:, 0].T

    def slopes(self, q: Array) -> Array:
        """(N, S, n) at positions (N, n)."""
        return _tip_functions(self, len(q))[1](q.T).transpose(2, 0, 1)


@lru_cache(maxsize=16)
def _tip_functions(tip: TipCoordinates, count: int) -> tuple[SampledFunction, SampledFunction]:
    """Functions of q (n,) at so many instants: the coordinates (S,), and their slopes (S, n)."""
    q = ca.SX.sym("q", tip.arm.joints)
    place = ca.densify(tip.arm.tip(tip.tip_length)(q)[list(tip.index)])
    slopes = ca.densify(ca.jacobian(place, q))
    functions = ca.Function("tip", [q], [place]), ca.Function("slopes", [q], [slopes])
    return SampledFunction(functions[0], count), SampledFunction(functions[1], count)


@dataclass(frozen=True, eq=False)
class MeasureRows:
    """Limits -1 <= (c - middle) / half <= 1 of S functions of the joints' motion, at T instants.

    basis  (D, T, n, k): the D derivatives of positions, from them on, of which the functions are, by coefficient
    """

    measure: Measure
    basis: Array
    middle: Array
    half: Array

    def __len__(self) -> int:
        return int(self.basis.shape[1]) * len(self.half)

    def value(self, z: Array) -> Array:
        """The rows (T S,) at z (k,)."""
        return np.asarray(((self.measure.values(*(self.basis @ z)) - self.middle) / self.half).ravel())

    def about(self, z: Array, value: Array, place: slice) -> JointBlock:
        """Their linear expansion about z (k,), where they are `value` (T S,)."""
        slopes = self.measure.slopes(*(self.basis @ z)) / self.half[:, None]
        by_derivative = np.split(slopes, len(self.basis), axis=2)
        matrix = sum(slope @ basis for slope, basis in zip(by_derivative, self.basis, strict=True))
        matrix = np.asarray(matrix).reshape(-1, len(z))
        return JointBlock(np.arange(len(z)), matrix, matrix @ z - value, place)


@dataclass(frozen=True, eq=False)
class LimitRows:
    """-1 <= c(z) <= 1: the joints' limits, a polytope, and those that are not linear, of places and torques."""

    joints: Polytope
    bent: tuple[MeasureRows, ...] = ()

    def __len__(self) -> int:
        return len(self.joints) + sum(map(len, self.bent))

    def slack(self, z: Array) -> Array:
        """(2, R): the slacks to the high and to the low limits at z (k,); positive inside."""
        values = [rows.value(z) for rows in self.bent]
        return np.hstack([self.joints.slack(z), *(np.stack([1 - value, 1 + value]) for value in values)])

    def about(self, z: Array, slack: Array) -> Polytope:
        """The limits expanded linearly about z (k,), with their slacks (2, R) there."""
        blocks, at = list(self.joints.blocks), len(self.joints)
        for rows in self.bent:
            place = slice(at, at + len(rows))
            blocks.append(rows.about(z, 1 - slack[0, place], place))
            at += len(rows)
        return Polytope(tuple(blocks), self.joints.size) if self.bent else self.joints

    def reach(self, static: Array, z: Array, margin: float) -> float | None:
        """A large f up to 1 for which static + f (z - static) leaves a share `margin` of the slacks of `static`.

        The largest where all limits are linear. None where `static` (k,) is not inside itself.
        """
        slack = self.slack(static)
        if slack.min() <= 0:
            return None
        linear = slack[:, : len(self.joints)]
        used = float(((linear - self.joints.slack(z)) / linear).max())
        share = min(1.0, (1 - margin) / max(used, 1 - margin))
        while self.bent and (self.slack(static + share * (z - static)) < margin * slack).any():
            share *= SHRINKING
        return share


SHRINKING = 0.9
"""Factor by which a start is shrunk until it is inside limits that are not linear."""

Instants = dict[tuple[int, int], Array]

MEDIUM_INSTANTS = 8
"""Instants per basis function of a smooth series, for ranking optima: 16 to the shortest wave, between which a limit is
exceeded by up to 1 / cos(pi / 16) - 1 = 2 %."""
FINE_INSTANTS = 16
"""The same where a limit is nearly reached: 0.5 % at most."""
MEDIUM_PER_PIECE = 2
"""Medium instants per piece of a spline: its highest derivative has its extremes at the knots."""
FINE_PER_PIECE = 4
"""Fine instants per piece of a spline."""
TIP_MARGIN = 0.01
"""Margin of the tip inside the workspace, m: contracting a trajectory by the thousandths by which its joints exceed
their limits moves the tip by millimetres, not always inwards."""
CLEARANCE_MARGIN = 0.003
"""The same of clearances, m, which are often a few centimetres: more of it is lost than a contraction moves."""
TORQUE_MARGIN = 0.003
"""The same of torques, as a share of half their range: gravity's part is not contracted."""
LARGEST_MARGIN_SHARE = 0.01
"""The margin is no more than this share of the workspace's half width, so that a narrow one stays."""
RAMP_FUNCTIONS = 2
"""Basis functions for which a ramp counts: with those of the series alone six joints' jerk in ramps of a tenth of the
period was passed by 12 %, and five rounds of more instants did not end it."""
MOST_FINER = 4
"""Times as many instants as the series has by itself, at most: a ramp of a hundredth of the period would ask for 20."""
NEAR_LIMIT = 0.8
"""Share of a limit above which it is imposed at the fine instants; elsewhere at the medium ones."""


@dataclass(frozen=True, eq=False)
class LimitedMeasures:
    """Limits that are not linear: of a workspace (the tip's box, clearances), or of torques.

    derivatives   of which they are functions: 1, of the positions alone, or 3
    middle, half  (S,): of each within a margin, m, or N m (N)
    """

    measures: tuple[Measure, ...]
    derivatives: int
    middle: Array
    half: Array

    @classmethod
    def of(
        cls, limits: Limits, workspace: Workspace | None, arm: Arm | None, tip_length: float | None
    ) -> tuple[LimitedMeasures, ...]:
        """Those of the workspace and those of the torques, where there are any."""
        sides, apart = workspace_sides(workspace, arm), clearances(workspace, arm, limits.position)
        measures, ends = list[Measure](), [side for _, side in sides.values()]
        margins = [min(TIP_MARGIN, LARGEST_MARGIN_SHARE * (high - low) / 2) for low, high in ends]
        if sides and arm is not None:
            measures.append(TipCoordinates(arm, tip_length or 0.0, tuple(index for index, _ in sides.values())))
        if apart is not None:
            measures.append(apart)
            ends += [(0.0, apart.largest)] * len(apart.names)
            margins += [CLEARANCE_MARGIN] * len(apart.names)
        limited = list[LimitedMeasures]()
        if measures:
            low, high = np.array(ends, dtype=float).T
            limited.append(cls(tuple(measures), 1, (low + high) / 2, (high - low) / 2 - np.array(margins)))
        torques = joint_torques(limits, arm)
        if torques is not None:
            low, high = torques.room.T
            limited.append(cls((torques,), 3, (low + high) / 2, (1 - TORQUE_MARGIN) * (high - low) / 2))
        return tuple(limited)

    def values(self, *motion: Array) -> Array:
        """(N, S) at positions (N, n) and what else they depend on."""
        return np.hstack([measure.values(*motion) for measure in self.measures])

    def slopes(self, *motion: Array) -> Array:
        """(N, S, n) by each of these, beside one another."""
        return np.concatenate([measure.slopes(*motion) for measure in self.measures], axis=1)


@dataclass(frozen=True, eq=False, kw_only=True)
class LimitConstraints:
    """(x - middle) / half width within [-1, 1] for position, velocity, acceleration (and jerk) at some instants.

    instants   by derivative and joint, s
    bent       limits that are not linear, and the instants at which each are imposed, s
    """

    series: TrajectorySeries
    limits: Limits
    instants: Instants
    bent: tuple[tuple[LimitedMeasures, Array], ...] = ()

    @classmethod
    def medium(
        cls,
        series: TrajectorySeries,
        limits: Limits,
        *,
        arm: Arm | None = None,
        workspace: Workspace | None = None,
        tip_length: float | None = None,
    ) -> Self:
        """All limits at equally spaced instants that are enough to rank optima."""
        some = _instants(series)[0]
        return cls(
            series=series,
            limits=limits,
            instants={(order, j): some for order in limited_orders(limits) for j in range(series.joints)},
            bent=tuple((measures, some) for measures in LimitedMeasures.of(limits, workspace, arm, tip_length)),
        )

    def refined(self, coefficients: Array) -> Self:
        """With all fine instants at which the trajectory is near a limit, and those of its extremes beyond it."""
        fine = _instants(self.series)[1]
        instants = {key: _more(times, fine, self._use(coefficients, key, fine)) for key, times in self.instants.items()}
        bent = [(of, _more(times, fine, self._bent_use(of, coefficients, fine))) for of, times in self.bent]
        return replace(self, instants=instants, bent=tuple(bent))

    @cached_property
    def rows(self) -> LimitRows:
        """The limits at the instants."""
        return LimitRows(self.polytope, tuple(self._bent_rows(of, times) for of, times in self.bent))

    def _bent_rows(self, of: LimitedMeasures, times: Array) -> MeasureRows:
        basis = np.stack([self.series.basis(times, order) for order in range(of.derivatives)])
        return MeasureRows(of, basis, of.middle, of.half)

    @cached_property
    def polytope(self) -> Polytope:
        """The joint limits at the instants."""
        blocks, at = list[JointBlock](), 0
        for joint in range(self.series.joints):
            moving = np.flatnonzero(self.series.mixing[joint].any(axis=0))
            matrix, middle = self._rows_of(joint, moving)
            blocks.append(JointBlock(moving, matrix, middle, slice(at, at + len(middle))))
            at += len(middle)
        return Polytope(tuple(blocks), self.series.size)

    def _rows_of(self, joint: int, moving: NDArray[np.intp]) -> tuple[Array, Array]:
        mixing = self.series.mixing[joint][:, moving]
        matrices, middles = list[Array](), list[Array]()
        for (order, j), times in self.instants.items():
            if j == joint:
                middle, half = middle_and_half(self.limits, order)
                matrices.append(self.series.functions(times, order) @ mixing / half[j])
                middles.append(np.full(len(times), middle[j] / half[j]))
        return np.vstack(matrices), np.concatenate(middles)

    def _use(self, coefficients: Array, key: tuple[int, int], times: Array) -> Array:
        order, joint = key
        middle, half = middle_and_half(self.limits, order)
        value = self.series.evaluate(coefficients, times, order)[:, joint]
        return np.asarray(np.abs(value - middle[joint]) / half[joint])

    def _bent_use(self, of: LimitedMeasures, coefficients: Array, times: Array) -> Array:
        value = self._bent_rows(of, times).value(coefficients)
        return np.asarray(np.abs(value).reshape(len(times), -1).max(axis=1))


def limited_orders(limits: Limits) -> tuple[int, ...]:
    """Orders of the limited derivatives."""
    return (0, 1, 2) if limits.jerk is None else (0, 1, 2, 3)


def middle_and_half(limits: Limits, order: int) -> tuple[Array, Array]:
    """Middle and half width (n,) of the limits of a derivative."""
    pairs = (limits.position, limits.velocity, limits.acceleration, limits.jerk)[order]
    assert pairs is not None
    return pairs.mean(axis=1), (pairs[:, 1] - pairs[:, 0]) / 2


def _instants(series: TrajectorySeries) -> tuple[Array, Array]:
    """Medium and fine instants, s."""
    functions, pieces = series.mixing.shape[1], len(series.breaks) - 1
    if pieces > functions / 2:
        return series.instants(MEDIUM_PER_PIECE * pieces), series.instants(FINE_PER_PIECE * pieces)
    shortest = float(np.diff(series.breaks).min())
    functions = int(np.clip(RAMP_FUNCTIONS * series.duration / shortest, functions, MOST_FINER * functions))
    return series.instants(MEDIUM_INSTANTS * functions), series.instants(FINE_INSTANTS * functions)


def _more(times: Array, fine: Array, use: Array) -> Array:
    """The times, the fine ones with a use near 1, and the maxima of parabolas through them that are beyond 1."""
    before, after = np.roll(use, 1), np.roll(use, -1)
    curvature = 2 * use - before - after
    shift = np.divide(after - before, 2 * curvature, out=np.zeros_like(use), where=curvature > 0)
    beyond = (use >= before) & (use >= after) & (use + (after - before) * shift / 4 > 1)
    maxima = np.clip(fine[beyond] + shift[beyond] * (fine[1] - fine[0]), fine[0], fine[-1])
    return np.asarray(np.unique(np.concatenate([times, fine[use > NEAR_LIMIT], maxima])), dtype=float)
