"""Descent to a least-squares minimum within bounds, by what the rows say at each point and nothing else."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.linear.least_squares import Sight, Solution
from estimation.linear.square_root import EPS, SquareRoot
from modeling.errors import InputError

Array = NDArray[np.float64]

STEP_TOLERANCE = 1e-6
"""Drop of chi-square below which a refit has converged: a thousandth of a standard deviation away from its minimum."""
MOST_STEPS = 40
REFINED = 1e-6
"""Of an unknown: what a step moves that is taken without a look at what it brings."""
LITTLE = 0.1
"""Share of the chi-square that a step has to gain where there is a long way to go."""
UNSHOWN = 1e-9
"""Singular value, of columns of unit length, below which a direction is only rounding of smoothed signals."""

FAINT = 1e-6
"""Length of a whitened column that is only rounding: a million of its SI unit would not move the readings by a std."""


@dataclass(frozen=True, eq=False)
class Minimum:
    """Unknowns (k,) at a minimum, their covariance (k, k), which of them the data show (k,), and the chi-square.

    `converged` is False when the steps ran out before the chi-square stood still. `information` is that of the rows
    there, for the unknowns themselves.
    """

    theta: Array
    covariance: Array
    shown: NDArray[np.bool_]
    cost: float
    converged: bool
    information: SquareRoot

    @classmethod
    def at(cls, theta: Array, steps: SquareRoot, converged: bool) -> Minimum:
        """At theta, given the information on a step from there."""
        sight = Sight.of(steps.root, UNSHOWN, FAINT)
        return cls(theta, sight.covariance, sight.shown, steps.cost, converged, steps.moved(-theta))


def minimise(
    information: Callable[[Array], SquareRoot], start: Array, bounds: tuple[Array, Array], far: float = np.inf
) -> Minimum:
    """The least-squares minimum within bounds; `information` of theta is that of the rows there, for a step from it.

    Gauss-Newton steps with Levenberg's damping on columns of unit length; a step that would leave the bounds is
    cut at them. A linear model takes one step, and a second one that refines it with the residual in the data. A step
    that gains nothing by the linear model of the rows (the relative offset: Bates and Watts, Technometrics 23, 1981),
    and only refines digits that nobody reads, is the last, and the rows there are not asked for.
    Where a trial has no prediction (a spring too soft to carry its tool) the step is taken for one that gains nothing.
    Who only needs to know whether the chi-square falls below some value says what is `far` above it: there the steps
    end with the first that gains less than `LITTLE` of it.
    """
    theta, damping = np.clip(start, *bounds), 0.0
    here = information(theta)
    for _ in range(MOST_STEPS):
        trial = np.clip(theta + damped_step(here, theta, bounds, damping), *bounds)
        foreseen = here.moved(trial - theta)
        if not damping and abs(here.cost - foreseen.cost) < STEP_TOLERANCE and _refines(theta, trial):
            return Minimum.at(trial, foreseen, True)
        there = _informed(information, trial)
        gain = -np.inf if there is None else here.cost - there.cost
        if there is not None and gain > 0:
            theta, here = trial, there
            if here.cost > far and gain < LITTLE * here.cost:
                return Minimum.at(theta, here, False)
            damping = damping / 10 if damping > 1e-9 else 0.0
        else:
            damping = max(10 * damping, 1e-6)
        # Of very many rows the chi-square itself is rounded to more than the tolerance.
        if abs(gain) < STEP_TOLERANCE + 4 * EPS * here.cost or damping > 1e6:
            return Minimum.at(theta, here, True)
    return Minimum.at(theta, here, False)


def _refines(theta: Array, trial: Array) -> bool:
    """Whether a step moves no unknown by more than its last digits: so short that no model does anything else there."""
    return bool(np.all(np.abs(trial - theta) <= REFINED * np.abs(trial)))


def _informed(information: Callable[[Array], SquareRoot], trial: Array) -> SquareRoot | None:
    """The information at a trial, None where the model predicts nothing."""
    try:
        return information(trial)
    except InputError:
        return None


def damped_step(here: SquareRoot, theta: Array, bounds: tuple[Array, Array], damping: float) -> Array:
    """A Levenberg step, with unknowns that press against a bound held, and none along what the rows do not show."""
    gradient = here.root.T @ here.target
    free = ~(((theta <= bounds[0]) & (gradient < 0)) | ((theta >= bounds[1]) & (gradient > 0)))
    part = here.only(free)
    step = np.zeros_like(theta)
    damped = part.held(np.sqrt(damping)) if damping else part
    step[free] = Solution.of(damped, rounding=UNSHOWN, faint=FAINT).theta
    return step
