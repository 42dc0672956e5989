"""Clock offset: by how much the wrench's stamps are late against the motion's, from what both show of one motion.

A rigid tool's wrench is linear in the specific force, the angular acceleration and the products of the angular
velocity, all in the sensor frame. A drag would look like a delay, so that it is a regressor too, along the velocity of
a point of the tool, v + omega x d, linear and quadratic; and so are a tilted gravity and a tether's spring, as forces
that are constant in the world or grow with the position. In the force channels the coefficients on the specific force
are free (gains, mounting, signs), all others shared, as one vector turned by the mounting; in the torque channels all
are free. A lag or delay inside the sensor shifts the wrench like its clock does, and is a part of the offset. With all
these regressors Phi(t),

    y(t_i) = Phi(t_i - offset) b + e,      dy/d(offset) = -Phi'(t_i - offset) b.

A scan over the offset minimises the sum of ln RSS of the channels, and Gauss-Newton on (b, offset) refines it. The
standard deviation is a sandwich over blocks of the record, so that what the model does not explain widens it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Self

import numpy as np

from estimation.reading.log_reader import Array
from estimation.recordings.reading_report import OffsetCurves, OffsetReading
from estimation.recordings.weight_fit import RANK_TOLERANCE, SMALLEST_DIVISOR

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline


MOST_ROWS = 5000
"""Rows from which the coefficients of the picture are taken."""
SHIFTS, SHORTEST_SHOWN, LONGEST = 20.0, 0.6, 4.0
"""Length of the part that is shown: in offsets, so that a shift can be seen, and its limits in s."""
POINTS = 600
"""Of a curve in the picture, about: a panel has fewer pixels across."""


@dataclass(frozen=True, kw_only=True, eq=False)
class AlignmentCurves:
    """One channel of the force (m,), the part of the record where it follows the motion fastest; see OffsetCurves."""

    channel: int
    instants: Array
    measured: Array
    as_stamped: Array
    aligned: Array

    @classmethod
    def of(
        cls, regressors: Callable[[Array], Array], stamps: Array, forces: Array, offset: float, as_read: float
    ) -> Self:
        """Of forces (n, d) at stamps (n,), with the motion's regressors (n, k) at any instants (n,).

        The coefficients are those of the motion at stamps less `offset`; `as_read` is the offset before estimation.
        """
        every = slice(None, None, max(len(stamps) // MOST_ROWS, 1))
        rows, times = forces[every], stamps[every] - offset
        motion = regressors(times)
        coefficients = np.linalg.lstsq(motion, rows, rcond=RANK_TOLERANCE)[0]
        explained = motion @ coefficients
        share = explained.var(axis=0) / np.maximum(rows.var(axis=0), SMALLEST_DIVISOR)
        channel = int(np.argmax(share))
        length = float(np.clip(SHIFTS * abs(offset - as_read), SHORTEST_SHOWN, LONGEST))
        begin = _liveliest(times, explained[:, channel], length)
        inside = np.flatnonzero((stamps - offset >= begin) & (stamps - offset <= begin + length))
        inside = inside[:: max(len(inside) // POINTS, 1)]
        shown = stamps[inside]
        by_stamps, by_offset = (regressors(shown - late) @ coefficients[:, channel] for late in (as_read, offset))
        return cls(
            channel=channel, instants=shown - offset, measured=forces[inside, channel],
            as_stamped=by_stamps, aligned=by_offset,
        )  # fmt: skip


def _liveliest(times: Array, series: Array, length: float) -> float:
    """Start of the interval in which a series (n,) changes fastest: where the mean square of its steps is largest."""
    total = np.concatenate([[0.0], np.cumsum(np.diff(series) ** 2)])
    ends = np.searchsorted(times, times + length) - 1
    starts = np.flatnonzero(times <= max(times[-1] - length, times[0]))
    return float(times[starts[np.argmax(total[ends[starts]] - total[starts])]])


LARGEST_OFFSET = 2.0
"""Seconds to either side that are searched."""
SHORTEST = 2.0
"""Seconds of overlap, inside the range that is searched, below which as many coefficients fit anything."""
SCAN_STEP = 0.02
"""Seconds between offsets that are tried, and the longest step of the refinement from the best of them."""
SCAN_ROWS = 2500
"""Rows to which the wrench is averaged for the scan, at least: its 200 fits are quick then."""
REFINE_ROWS = 20_000
"""First rows in common that the refinement fits: a longer record would take more memory and time."""
BLOCKS = 20
"""Contiguous parts of the record whose scores give the variance of the estimate: long against the residual's memory."""
ITERATIONS = 25
"""Of the refinement, at most: the weights of the rows change with it, so that it converges linearly."""
WEIGHT_WINDOW = 0.2
"""Seconds over which a row's residual is averaged for its weight."""
USUAL_VARIANCE = 3.0
"""Times the median variance of the residual, up to which a row has its full weight."""
LEAST_CORRELATION = 0.3
"""Share of the wrench that the motion explains, below which most of it is something else, as may be the minimum."""
LARGEST_STD = 0.02
"""Seconds; an offset that is known no better is not applied."""
NEAR = np.linspace(-5, 5, 13)
"""Offsets about the estimate, in its std, of which the picture shows chi-square."""
NEAR_ROWS = 2000
"""Of which the picture shows chi-square, at least; it is of some rows only, as each offset takes a fit."""
QUARTER_TURN_TOLERANCE = 0.35
"""Radians, 20 degrees, within which an axis is a whole quarter turn: less than half of the way to 45 degrees."""
TINY = 1e-12
"""In place of a divisor of zero, of quantities of the size of 1."""
SEARCHED_SHARE = 0.25
"""Of the shorter record, to either side, that is searched at most: half of it stays common to both."""
FEWEST_ROWS = 100
"""Rows in common, several times as many as there are coefficients."""
AVERAGED_TIME = 0.01
"""Seconds over which the wrench is averaged for the scan, half of its step."""
SHORTEST_STEP = 1e-6
"""Seconds: stamps that stand still would have steps of zero."""
CONVERGED = 1e-7
"""Seconds of a last step of the refinement, far below any std of an offset."""
OTHER_OFFSET = 0.1
"""Seconds from the best offset, from which a minimum is another one."""
AS_DEEP = 0.1
"""Of the depth of the deepest minimum, by which another one may be less deep and fit as well."""
KNOWN_STEP = 0.02
"""Of the coarser step, for a motion known at instants, and stamps on a fitted clock: an offset is known no better."""


@dataclass(frozen=True, eq=False)
class MotionRegressors:
    """Regressors of a rigid tool's wrench at uniform instants (n,), s on the motion's clock.

    force    (n, d) the specific force in the sensor frame, d = 2 in the plane, else 3
    shared   (n, r, d) further forces in the sensor frame, of unknown amounts
    turning  (n, k) what torques follow besides: angular acceleration and products of the angular velocity
    """

    instants: Array
    force: Array
    shared: Array
    turning: Array

    @classmethod
    def of(cls, signals: Mapping[str, Array], instants: Array, gravity: float) -> MotionRegressors:
        """From a recording's signals (`Recording.signals`), planar or spatial."""
        return cls(instants, *(_planar(signals, gravity) if "phi" in signals else _spatial(signals, gravity)))

    @cached_property
    def spline(self) -> CubicSpline:
        """The cubic spline through all regressors, each of a largest value of 1."""
        from scipy.interpolate import CubicSpline  # slow to import

        parts = (self.force, self.shared.reshape(len(self.shared), -1), self.turning)
        sizes = [np.abs(self.force).max(), np.repeat(np.abs(self.shared).max(axis=(0, 2)), self.dimension)]
        sizes.append(np.abs(self.turning).max(axis=0))  # a force's directions share one size
        return CubicSpline(
            self.instants, np.hstack([p / np.maximum(s, TINY) for p, s in zip(parts, sizes, strict=True)])
        )

    @cached_property
    def force_spline(self) -> CubicSpline:
        """The part of the spline for the specific force."""
        return type(self.spline).construct_fast(self.spline.c[:, :, : self.dimension].copy(), self.spline.x)

    @property
    def dimension(self) -> int:
        """2 in the plane, 3 in space."""
        return int(self.force.shape[1])

    def at(self, instants: Array, order: int = 0) -> tuple[Array, Array, Array]:
        """At other instants (m,), or as derivatives by time: free regressors of the forces (m, d + 1) with a constant,
        shared ones (m, r, d), and free ones of the torques (m, k).
        """
        values, d = self.spline(instants, order), self.dimension
        constant = np.full((len(instants), 1), 1.0 if order == 0 else 0.0)
        vectors = values[:, d : d + self.shared[0].size].reshape(len(instants), -1, d)
        return np.hstack([values[:, :d], constant]), vectors, np.hstack([values, constant])

    def of_forces(self, instants: Array) -> Array:
        """Free regressors (m, d + 1) of the forces alone at other instants (m,)."""
        return np.hstack([self.force_spline(instants), np.ones((len(instants), 1))])


def _stack(signals: Mapping[str, Array], prefix: str) -> Array:
    return np.stack([signals[prefix + axis] for axis in "xyz"], axis=1)


def _spatial(signals: Mapping[str, Array], gravity: float) -> tuple[Array, Array, Array]:
    from scipy.spatial.transform import Rotation  # slow to import

    turn = Rotation.from_quat(np.stack([signals[n] for n in ("qx", "qy", "qz", "qw")], axis=1))
    force = turn.apply(_stack(signals, "ap") + np.array([0.0, 0.0, gravity]), inverse=True)
    omega, alpha = _stack(signals, "w"), _stack(signals, "al")
    first, second = np.triu_indices(3)
    levers = [np.cross(omega, axis) for axis in np.eye(3)]
    levers += [np.cross(alpha, axis) + np.cross(omega, np.cross(omega, axis)) for axis in np.eye(3)]
    levers += [turn.apply(axis, inverse=True) for axis in np.eye(3)[:2]]
    levers += [turn.apply(_stack(signals, "p"), inverse=True)] if "px" in signals else []
    velocity = turn.apply(_stack(signals, "vp"), inverse=True) if "vpx" in signals else np.zeros_like(omega)
    return force, _forces(velocity, levers), np.hstack([alpha, omega[:, first] * omega[:, second]])


def _planar(signals: Mapping[str, Array], gravity: float) -> tuple[Array, Array, Array]:
    c, s = np.cos(signals["phi"]), np.sin(signals["phi"])

    def in_sensor(x: Array, y: Array) -> Array:
        return np.stack([c * x - s * y, s * x + c * y], axis=1)  # phi is clockwise

    rate, turning = signals["dphi"], np.stack([signals["ddphi"], signals["dphi"] ** 2], axis=1)
    levers = [np.outer(rate, axis) for axis in np.eye(2)]
    # Accelerations of points along y' and x': y'' = ddphi x' - dphi² y', x'' = -ddphi y' - dphi² x'.
    levers += [turning * [1.0, -1.0], -turning[:, ::-1]]
    levers += [in_sensor(np.ones_like(c), np.zeros_like(c))]
    levers += [in_sensor(signals["px"], signals["py"])] if "px" in signals else []
    velocity = in_sensor(signals["vx"], signals["vy"]) if "vx" in signals else np.zeros((len(c), 2))
    return in_sensor(signals["ax"], signals["ay"] + gravity), _forces(velocity, levers), turning


def _forces(velocity: Array, levers: list[Array]) -> Array:
    """Drags along the velocity (n, d), linear and quadratic, and further forces, (n, r, d), but none of zeros."""
    speed = np.linalg.norm(velocity, axis=1, keepdims=True)
    return np.stack([drag for drag in (velocity, speed * velocity, *levers) if drag.any()] or [velocity], axis=1)


def clock_offset(motion: MotionRegressors, stamps: Array, wrench: Array, around: float = 0.0) -> OffsetReading | None:
    """The offset of the wrench (n, p) at its stamps (n,), searched about `around`; None where too little overlaps."""
    reach = min(LARGEST_OFFSET, SEARCHED_SHARE * float(min(np.ptp(stamps), np.ptp(motion.instants))))
    inside = (stamps - around > motion.instants[0] + reach) & (stamps - around < motion.instants[-1] - reach)
    if inside.sum() < FEWEST_ROWS or np.ptp(stamps[inside]) < SHORTEST:
        return None
    readings, size = wrench, wrench[inside].std(axis=0)
    size[: motion.dimension] = size[: motion.dimension].max()  # forces share coefficients
    wrench = wrench / np.maximum(size, TINY)
    coarse = _averaged(stamps[inside], wrench[inside])
    scan = around + np.arange(-reach, reach + SCAN_STEP, SCAN_STEP)
    costs = np.array([_cost(motion, *coarse, offset) for offset in scan])
    best = _nearest_minimum(scan - around, costs)
    overlapping = np.abs(stamps - scan[best] - motion.instants.mean()) < 0.5 * np.ptp(motion.instants) - SCAN_STEP
    refined = stamps[overlapping][:REFINE_ROWS], wrench[overlapping][:REFINE_ROWS]
    offset, std, weights = _refined(motion, *refined, float(scan[best]))
    share = 1 - float(np.exp(_cost(motion, *coarse, offset) - _cost(motion, *coarse, None)))
    sure = std < LARGEST_STD and share > LEAST_CORRELATION and 0 < best < len(scan) - 1
    others = tuple(float(scan[i]) for i in _deep_minima(costs) if abs(i - best) * SCAN_STEP > OTHER_OFFSET)
    shares = 1 - np.exp(costs - _cost(motion, *coarse, None))
    forces = readings[overlapping, : motion.dimension]
    aligned = AlignmentCurves.of(motion.of_forces, stamps[overlapping], forces, offset, around)
    near = offset + std * NEAR if np.isfinite(std) else np.zeros(0)
    chi_square = _chi_square(motion, *refined, near, weights)
    curves = OffsetCurves(offsets=scan, share=shares, near=near, chi_square=chi_square, **vars(aligned))
    return OffsetReading(offset=offset, std=std, applied=sure, correlation=share, alternatives=others, curves=curves)


def _averaged(stamps: Array, wrench: Array) -> tuple[Array, Array]:
    """Wrench averaged over a few samples, at the mean of their stamps."""
    group = max(int(AVERAGED_TIME / max(float(np.median(np.diff(stamps))), SHORTEST_STEP)), len(stamps) // SCAN_ROWS, 1)
    count = len(stamps) // group * group
    return stamps[:count].reshape(-1, group).mean(axis=1), wrench[:count].reshape(-1, group, wrench.shape[1]).mean(
        axis=1
    )


def _cost(motion: MotionRegressors, stamps: Array, wrench: Array, offset: float | None) -> float:
    """Mean over channels of ln RSS on the specific force, which determines the scan's minimum;

    with no offset that of a constant."""
    regressors = np.ones((len(stamps), 1))
    if offset is not None:
        regressors = motion.of_forces(stamps - offset)
    residual = wrench - regressors @ np.linalg.lstsq(regressors, wrench, rcond=RANK_TOLERANCE)[0]
    return float(np.mean(np.log(np.maximum((residual**2).sum(axis=0), TINY))))


def _deep_minima(costs: Array) -> list[int]:
    """Indices of minima as deep as the deepest within a tenth of its depth, as a periodic motion has them."""
    depth = float(np.median(costs) - costs.min())
    inner = [i for i in range(1, len(costs) - 1) if costs[i] <= min(costs[i - 1], costs[i + 1])]
    return [i for i in inner if costs[i] < costs.min() + AS_DEEP * depth]


def _nearest_minimum(scan: Array, costs: Array) -> int:
    """Of minima that are equally deep the smallest offset; without an inner minimum the deepest point."""
    minima = _deep_minima(costs)
    return min(minima, key=lambda i: abs(float(scan[i]))) if minima else int(np.argmin(costs))


def _refined(motion: MotionRegressors, stamps: Array, wrench: Array, offset: float) -> tuple[float, float, Array]:
    """Gauss-Newton on the coefficients and the offset, the offset's std by a sandwich over blocks, rows' weights (n,).

    Rows are weighted anew in each iteration, so that a push or a tether that is taut at times counts little.
    """
    std, weights = np.inf, np.ones(len(stamps))
    window = max(int(WEIGHT_WINDOW / max(float(np.median(np.diff(stamps))), SHORTEST_STEP)), 1)
    for _ in range(ITERATIONS):
        aligned = _AlignedFit(motion, stamps - offset, wrench, np.sqrt(weights))
        late, residual = aligned.late, aligned.residual
        weights = _row_weights(residual / np.sqrt(weights)[:, None], window)
        weight = 1 / np.maximum((residual**2).mean(axis=0), TINY)
        information = float(((late**2) * weight).sum())
        if information <= 0:
            return offset, np.inf, weights
        change = float(np.clip((late * residual * weight).sum() / information, -SCAN_STEP, SCAN_STEP))
        scores = (late * (residual - late * change) * weight).sum(axis=1)
        blocks = np.array([block.sum() for block in np.array_split(scores, BLOCKS)])
        std = float(np.sqrt((blocks**2).sum()) / information) * _misfit(residual)
        offset += change
        if abs(change) < CONVERGED:
            break
    floor = KNOWN_STEP * max(float(np.median(np.diff(motion.instants))), float(np.median(np.diff(stamps))))
    return offset, float(np.hypot(std, floor)), weights


def _row_weights(residual: Array, window: int) -> Array:
    """Weights (n,) of rows, 1 at most: the usual variance over that of the residual (n, p) near the row.

    The variance is a mean over a window, so that noise alone leaves the weights near 1.
    """
    from scipy.ndimage import uniform_filter1d  # slow to import

    near = uniform_filter1d(residual**2, window, axis=0)
    size = (near / np.maximum(np.median(near, axis=0), TINY)).max(axis=1)
    return np.asarray(np.minimum(1.0, USUAL_VARIANCE / np.maximum(size, TINY)))


def _chi_square(motion: MotionRegressors, stamps: Array, wrench: Array, offsets: Array, weights: Array) -> Array:
    """Chi-square of the whole model at these offsets (k,) above its smallest, all else fitted, of some of the rows.

    Rows count by the weights (n,) that they have at the estimate.
    """
    if not len(offsets):
        return np.zeros(0)
    every = slice(None, None, max(len(stamps) // NEAR_ROWS, 1))
    roots = np.sqrt(weights[every])
    fits = [_AlignedFit(motion, stamps[every] - float(offset), wrench[every], roots) for offset in offsets]
    sums = np.array([(fit.residual**2).sum(axis=0) for fit in fits])
    chi_squares = (sums / np.maximum(sums.min(axis=0) / len(stamps), TINY)).sum(axis=1)
    return np.asarray(chi_squares - chi_squares.min())


@dataclass(frozen=True, eq=False)
class _AlignedFit:
    """The fit of the whole model to the wrench (n, p) with the motion at instants (n,), s.

    Rows are multiplied by the roots (n,) of their weights, as are derivative and residual.
    """

    motion: MotionRegressors
    instants: Array
    wrench: Array
    roots: Array

    @property
    def residual(self) -> Array:
        """(n, p), without what coefficients explain."""
        target = self.free.cleared(self.forces).reshape(-1)
        of_forces = self.design.cleared(target).reshape(self.forces.shape)
        return np.hstack([of_forces, self.every.cleared(self.torques)])

    @property
    def late(self) -> Array:
        """Derivative (n, p) of the prediction by the offset, without what coefficients explain."""
        free_rate, vectors_rate, every_rate = self._regressors(1)
        amounts = self.design.coefficients(self.free.cleared(self.forces).reshape(-1))
        coefficients = self.free.coefficients(self.forces - np.einsum("nrd,r->nd", self.shared, amounts))
        turned = np.einsum("nrd,r->nd", vectors_rate @ self.mounting.T, amounts)
        slope = self.free.cleared(-free_rate @ coefficients - turned).reshape(-1)
        of_torques = self.every.cleared(-every_rate @ self.every.coefficients(self.torques))
        return np.hstack([self.design.cleared(slope).reshape(self.forces.shape), of_torques])

    @property
    def forces(self) -> Array:
        """The forces (n, d)."""
        return self.roots[:, None] * self.wrench[:, : self.motion.dimension]

    @property
    def torques(self) -> Array:
        """The torques (n, p - d)."""
        return self.roots[:, None] * self.wrench[:, self.motion.dimension :]

    @cached_property
    def free(self) -> _Span:
        """Free regressors of the forces."""
        return _Span(self._now[0])

    @cached_property
    def every(self) -> _Span:
        """Free regressors of the torques."""
        return _Span(self._now[2])

    @cached_property
    def mounting(self) -> Array:
        """Rotation (d, d) from the motion's to the readings' axes."""
        return _mounting(self.free.coefficients(self.forces)[: self.motion.dimension].T)

    @cached_property
    def shared(self) -> Array:
        """Forces (n, r, d) whose amounts all directions share, along the readings' axes."""
        return np.asarray(self._now[1] @ self.mounting.T)

    @cached_property
    def design(self) -> _Span:
        """The shared forces (n d, r) without their part in the free ones."""
        count, amounts, directions = self.shared.shape
        cleared = self.free.cleared(self.shared.reshape(count, -1)).reshape(count, amounts, directions)
        return _Span(cleared.transpose(0, 2, 1).reshape(-1, amounts))

    @cached_property
    def _now(self) -> tuple[Array, Array, Array]:
        return self._regressors(0)

    def _regressors(self, order: int) -> tuple[Array, Array, Array]:
        """Those of `MotionRegressors.at`, weighted."""
        free, vectors, every = self.motion.at(self.instants, order)
        root = self.roots[:, None]
        return root * free, root[:, :, None] * vectors, root * every


def _misfit(residual: Array) -> float:
    """At least 1, by the root r of the residual's variance over that of its white part: missing physics errs one way.

    2 r - 1, as the blocks of the sandwich are not independent then: simulated tethers err by about twice their std.
    """
    white = np.var(np.diff(residual, axis=0), axis=0) / 2
    ratio = np.sqrt(np.maximum(np.var(residual, axis=0) / np.maximum(white, TINY), 1.0)).max()
    return float(2 * ratio - 1)


def _mounting(force: Array) -> Array:
    """Rotation (d, d) from the motion's to the readings' axes, with their sign, by the coefficients of the force.

    Their polar factor; whole quarter turns where it is near them, as it is uncertain by what else acts.
    """
    from scipy.linalg import polar  # slow to import

    turned = np.asarray(polar(force)[0])
    quarter = np.where(np.abs(turned) > np.cos(QUARTER_TURN_TOLERANCE), np.sign(turned), 0.0)
    return quarter if np.array_equal(np.abs(quarter).sum(axis=0), np.ones(len(force))) else turned


@dataclass(frozen=True, eq=False)
class _Span:
    """The span of regressors (n, k), of which some may be collinear."""

    regressors: Array

    def coefficients(self, series: Array) -> Array:
        """The smallest coefficients (k, ..) of least squares for series (n, ..)."""
        left, values, right = self._parts
        return np.asarray(right.T @ ((left.T @ series).T / values).T)

    def cleared(self, columns: Array) -> Array:
        """Columns (n, ..) without their part in the span."""
        left = self._parts[0]
        return np.asarray(columns - left @ (left.T @ columns))

    @cached_property
    def _parts(self) -> tuple[Array, Array, Array]:
        """Singular vectors (n, r) and (r, k), and values (r,)."""
        left, values, right = np.linalg.svd(self.regressors, full_matrices=False)
        kept = values > RANK_TOLERANCE * values[0]
        return left[:, kept], values[kept], right[kept]
