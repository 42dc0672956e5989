"""Levenberg-Marquardt minimisation within bounds, from square-root information."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.least_squares.square_root_information import EPS, SquareRootInformation, least_squares_solution
from modeling.errors import InputError
from modeling.identifiability import SINGULAR_VALUE_TOLERANCE, ScaledSVD

Array = NDArray[np.float64]

STEP_TOLERANCE = 1e-4
"""Decrease of chi-square by an undamped step below which a refit has converged: a hundredth of a std, or less, from its
minimum, as the next such step would gain less."""
MAX_STEPS = 40
"""At most: far more than convergence takes near a minimum; a fit that takes more is marked as not converged."""
FIRST_DAMPING, LEAST_DAMPING, GREATEST_DAMPING = 1e-6, 1e-9, 1e6
"""After the first step without gain; below which there is none; above which no step gains."""
DAMPING_DECREASE = 0.1
"""Factor of the damping after a step that gained what the linear model predicts."""
NEGLIGIBLE_CHANGE = 1e-6
"""Of chi-square: predicted of a step that need not be evaluated, or found after one that was."""
STALLED_TRIALS, STALL_TOLERANCE = 8, 0.01
"""Damped trials in a row, and what they lower chi-square by together, from which on a minimum is looked for: it is one
if an undamped step is not predicted to lower it by more either (a tenth of a std), or if a small part of that step
gains nothing (a kink, `MOST_AT_A_KINK`). Where the slope of a model jumps (a cable that goes taut between two samples),
no undamped step ends at a minimum."""
KINK_PROBE = 1e-3
"""That part: a smooth model gains twice this share of what an undamped step is predicted to gain, less than half of it
is taken for nothing."""
MOST_AT_A_KINK = 0.01
"""Share of chi-square that an undamped step from a kink may be predicted to gain. A jump of the slope at a few samples
keeps the iteration from no more (measured: 0.3 % of 400 rows); where a model predicts that a tenth or all of the
chi-square can go, nothing of a step being gained is strong curvature far from any minimum."""
MAX_ACTIVE_SETS = 20
"""Sets of parameters at their bounds that are tried: a minimum takes two or three."""
UNSEEN_WEIGHT = 1e-3
"""Of a direction without information, over the least of those that have some: it is kept near zero, and where a bound
presses it gives way, at a millionth of the chi-square that it would cost otherwise."""
NEGLIGIBLE_STEP = 1e-6
"""Relative change of every parameter below which a step is accepted without evaluating it."""
SLOW_PROGRESS_SHARE = 0.1
"""Share of the excess of chi-square over `far` that an undamped step must be predicted to gain: ten such would not
do."""
NEGLIGIBLE_COLUMN_LENGTH = 1e-6
"""Norm of a whitened column that is only rounding: a million SI units would not move the readings by a std."""


@dataclass(frozen=True, eq=False)
class LeastSquaresMinimum:
    """Parameters (k,) at a minimum, their covariance (k, k), which are identifiable (k,), and the chi-square.

    `converged` is False when the steps ran out before the chi-square settled, when no step has a prediction, and when a
    limit ended them far above it. `information` is that of the rows at theta, for theta itself.
    """

    theta: Array
    covariance: Array
    identifiable: NDArray[np.bool_]
    cost: float
    converged: bool
    information: SquareRootInformation

    @classmethod
    def at(cls, theta: Array, steps: SquareRootInformation, converged: bool) -> LeastSquaresMinimum:
        """At theta, from the information on a step from theta."""
        scaled_svd = ScaledSVD.of(steps.root, SINGULAR_VALUE_TOLERANCE, NEGLIGIBLE_COLUMN_LENGTH)
        return cls(theta, scaled_svd.covariance, scaled_svd.identifiable, steps.cost, converged, steps.shifted(-theta))


def levenberg_marquardt(
    information: Callable[[Array], SquareRootInformation],
    start: Array,
    bounds: tuple[Array, Array],
    far: float = np.inf,
    chi_square: Callable[[Array], float] | None = None,
) -> LeastSquaresMinimum:
    """The least-squares minimum within bounds; `information(theta)` is that of the rows at theta, for a step from it.

    Gauss-Newton steps with Levenberg's damping on columns of unit norm, each the minimiser of the damped linear model
    within the bounds. The damping follows the ratio of the gain in chi-square to the gain that the linear model
    predicts (`_Damping`). A linear model takes one step, and a second one that refines it with the residual in the
    data. A step that gains nothing by the linear model of the rows (relative offset: Bates and Watts, Technometrics 23,
    1981) and moves no parameter by more than `NEGLIGIBLE_STEP` is the last, without evaluating the rows there.
    A trial without a prediction (a spring too soft to carry its tool) counts as a step without gain. Half of
    all damped steps gain nothing: with `chi_square(theta)`, which needs no derivative of the rows, they end there.
    A caller that only tests whether the chi-square falls below some value gives a limit `far` at it or above: the
    iteration ends where an undamped step is predicted to gain less than `SLOW_PROGRESS_SHARE` of the excess over it.
    That is a forecast by the linear model, no bound: a valley that turns downhill further on is missed.
    A minimum where the model has kinks is one in which damped and small steps gain nothing (`_nothing_to_gain`).
    """
    theta, damping = np.clip(start, *bounds), _Damping()
    here, gains = information(theta), [np.inf]
    for _ in range(MAX_STEPS):
        if here.cost > far and (left := _undamped_gain(theta, here, bounds)) < SLOW_PROGRESS_SHARE * (here.cost - far):
            return LeastSquaresMinimum.at(theta, here, left < STEP_TOLERANCE)
        damped = damping.strength > 0
        trial = np.clip(theta + levenberg_marquardt_step(here, theta, bounds, damping.strength), *bounds)
        predicted = here.shifted(trial - theta)
        expected = here.cost - predicted.cost
        if not damped and abs(expected) < NEGLIGIBLE_CHANGE and _is_negligible_step(theta, trial):
            return LeastSquaresMinimum.at(trial, predicted, True)
        gain, there = _tried(trial, here.cost, information, chi_square if damped else None)
        if there is not None and gain > 0:
            theta, here = trial, there
        damping = damping.after(gain, expected)
        gains = [*gains, max(gain, 0.0)][-STALLED_TRIALS:] if damped else [np.inf]
        # With very many rows the rounding of the chi-square itself exceeds the tolerance.
        settled = abs(gain) < NEGLIGIBLE_CHANGE + 4 * EPS * here.cost or (0 < gain < STEP_TOLERANCE and not damped)
        stalled = len(gains) == STALLED_TRIALS and sum(gains) < STALL_TOLERANCE
        exhausted = damping.strength > GREATEST_DAMPING
        doubtful = damped or expected > STALL_TOLERANCE
        if doubtful and (settled or stalled or exhausted):
            settled = _nothing_to_gain(theta, here, bounds, information, chi_square)
        if settled or exhausted:
            return LeastSquaresMinimum.at(theta, here, settled)
    return LeastSquaresMinimum.at(theta, here, False)


@dataclass(frozen=True)
class _Damping:
    """Levenberg's damping by the gain ratio (Nielsen, report IMM-REP-1999-05, Technical University of Denmark).

    A step that gained what was predicted lowers it by `DAMPING_DECREASE`, one that gained half of it leaves it, and
    failures in a row raise it by 2, 4, 8, ..: with a fixed factor up and down, up to every second step along a curved
    valley fails.
    """

    strength: float = 0.0
    growth: float = 2.0

    def after(self, gain: float, expected: float) -> _Damping:
        """After a step of this gain in chi-square, where the linear model predicted another."""
        if not gain > 0:
            return _Damping(self.growth * self.strength or FIRST_DAMPING, 2 * self.growth)
        ratio = gain / expected if expected > 0 else 1.0
        lowered = self.strength * max(DAMPING_DECREASE, 1 - (2 * ratio - 1) ** 3)
        return _Damping(lowered if lowered > LEAST_DAMPING else 0.0)


def _is_negligible_step(theta: Array, trial: Array) -> bool:
    """Whether a step moves no parameter by more than its last digits, where every model is linear."""
    return bool(np.all(np.abs(trial - theta) <= NEGLIGIBLE_STEP * np.abs(trial)))


def _tried(
    trial: Array,
    cost: float,
    information: Callable[[Array], SquareRootInformation],
    chi_square: Callable[[Array], float] | None,
) -> tuple[float, SquareRootInformation | None]:
    """Gain of a trial over a chi-square, and the information there; none (-inf) where the model has no prediction.

    With `chi_square` the information is left out where there is no gain.
    """
    try:
        gain = np.inf if chi_square is None else cost - chi_square(trial)
        there = information(trial) if gain > 0 else None
    except (InputError, np.linalg.LinAlgError):
        return -np.inf, None
    gain = gain if there is None else cost - there.cost
    return (gain, there) if np.isfinite(gain) else (-np.inf, None)


def _nothing_to_gain(
    theta: Array,
    here: SquareRootInformation,
    bounds: tuple[Array, Array],
    information: Callable[[Array], SquareRootInformation],
    chi_square: Callable[[Array], float] | None,
) -> bool:
    """Whether an undamped step is predicted to gain next to nothing, or little and a small part of it next to none."""
    predicted = _undamped_gain(theta, here, bounds)
    if predicted < STALL_TOLERANCE:
        return True
    if predicted > MOST_AT_A_KINK * here.cost:
        return False
    probe = np.clip(theta + KINK_PROBE * levenberg_marquardt_step(here, theta, bounds, 0.0), *bounds)
    try:
        cost = information(probe).cost if chi_square is None else chi_square(probe)
    except (InputError, np.linalg.LinAlgError):
        return False
    return bool(here.cost - cost < KINK_PROBE * predicted)


def _undamped_gain(theta: Array, here: SquareRootInformation, bounds: tuple[Array, Array]) -> float:
    """What an undamped step from theta is predicted to lower the chi-square by."""
    return here.cost - here.shifted(levenberg_marquardt_step(here, theta, bounds, 0.0)).cost


def levenberg_marquardt_step(
    here: SquareRootInformation, theta: Array, bounds: tuple[Array, Array], damping: float
) -> Array:
    """The minimiser (k,) of the damped linear model within bounds, zero along unidentifiable directions."""
    gradient = here.root.T @ here.target
    free = ~(((theta <= bounds[0]) & (gradient < 0)) | ((theta >= bounds[1]) & (gradient > 0)))
    reduced = here.restricted(free)
    step = np.zeros_like(theta)
    damped = reduced.damped(np.sqrt(damping)) if damping else reduced
    step[free] = least_squares_solution(damped, rounding=SINGULAR_VALUE_TOLERANCE, faint=NEGLIGIBLE_COLUMN_LENGTH)
    low, high = (np.where(theta == bound, 0.0, bound - theta) for bound in bounds)
    if np.all((low <= step) & (step <= high)):
        return step
    lengths = np.linalg.norm(here.root, axis=0)
    moved = np.flatnonzero((lengths > NEGLIGIBLE_COLUMN_LENGTH) & (high > low))
    step = np.zeros_like(theta)
    damped = here.damped(np.sqrt(damping)) if damping else here
    unit = lengths[moved]
    step[moved] = _bounded_minimum(damped.root[:, moved] / unit, damped.target, low[moved] * unit, high[moved] * unit)
    step[moved] /= unit
    return np.clip(step, low, high)


def _bounded_minimum(rows: Array, target: Array, low: Array, high: Array) -> Array:
    """The minimiser (k,) of |R x - z| within low <= x <= high; columns of unit norm.

    A step to the minimum without bounds that is then clipped to them may go uphill where parameters are correlated.
    Of all minimisers it is the one closest to zero along directions without information (to `UNSEEN_WEIGHT` squared).
    """
    if not len(low):
        return low
    left, sizes, right = np.linalg.svd(rows, full_matrices=False)
    seen = sizes > SINGULAR_VALUE_TOLERANCE * sizes[0]
    weights = np.where(seen, sizes, UNSEEN_WEIGHT * sizes[seen][-1])
    scaled, target = weights[:, None] * right, np.where(seen, left.T @ target, 0.0)
    solution = _by_active_set(scaled, target, low, high)
    if solution is not None:
        return solution
    from scipy.optimize import lsq_linear  # slow to import and rarely needed

    # Should its steps run out, what it has is within the bounds: a trial like any other.
    return np.asarray(lsq_linear(scaled, target, (low, high), method="bvls").x)


def _by_active_set(rows: Array, target: Array, low: Array, high: Array) -> Array | None:
    """The minimiser (k,) of |A x - b| within bounds by the primal-dual active set method; None where that cycles.

    All parameters beyond a bound are fixed there at once, all whose gradient points inside are freed at once, until
    none changes: that is the minimum (Hintermüller, Ito, Kunisch, SIAM Journal on Optimization 13, 2002).
    """
    at_low, at_high = np.zeros(len(low), dtype=bool), np.zeros(len(low), dtype=bool)
    for _ in range(MAX_ACTIVE_SETS):
        free = ~(at_low | at_high)
        solution = np.where(at_low, low, np.where(at_high, high, 0.0))
        solution[free] = np.linalg.lstsq(rows[:, free], target - rows[:, ~free] @ solution[~free])[0]
        gradient = rows.T @ (rows @ solution - target)
        below = np.where(free, solution < low, at_low & (gradient > 0))
        above = np.where(free, solution > high, at_high & (gradient < 0))
        if np.array_equal(below, at_low) and np.array_equal(above, at_high):
            return np.asarray(solution)
        at_low, at_high = below, above
    return None
