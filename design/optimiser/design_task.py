"""Design task: an objective with its limits, its random starts, and contraction of a trajectory into the limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from design.limits import LIMITED_DERIVATIVES, LimitedQuantity, LimitUse
from design.optimiser.limit_constraints import LimitConstraints
from design.optimiser.objective import (
    AdjointDerivatives,
    GraphDerivatives,
    Objective,
    ObjectiveDerivatives,
    SecondOrderDerivatives,
)
from design.random_feasible import random_feasible_trajectory
from design.trajectories.fourier import FreeSeries
from design.trajectories.spline import RestToRest
from design.trajectories.trajectory import Trajectory, TrajectorySeries
from modeling.kinematics.arm import Arm
from modeling.rig import Limits, Workspace
from modeling.space import Space

Array = NDArray[np.float64]

LOW_HARMONICS = (1, 2, 3, 4)
"""Harmonics of random starts: large motions. Starts with the highest frequencies lead to poor optima (measured: half a
nat less), and six harmonics take ten times as long as four to an optimum of the same value."""
START_LIMIT_USE = 0.9
"""Share of its limits that a random start uses: less than all, so that the interior point starts inside."""
VARIED_LIMIT_USE = 0.5
"""The same of a varied start, as free to grow as to shrink (measured: more of them lead to the highest optima)."""
FEWEST_SAMPLES = 48
"""Samples at least in a search, which replace more."""
SAMPLES_PER_FUNCTION = 4
"""Samples for each basis function in a search: four give the mean over time to 1e-6."""
CONTRACTION_ACCURACY = 1e-7
"""Relative accuracy of a contraction: its error in the criterion is far below the optimiser's accuracy."""
ROUNDING_CONTRACTION = 1 - 1e-9
"""Factor by which a contracted trajectory stays inside its limits, so that rounding does not carry it beyond."""


@dataclass(frozen=True, eq=False, kw_only=True)
class DesignTask:
    """Objective and limits of an optimisation."""

    objective: Objective
    limits: Limits
    arm: Arm | None = None
    workspace: Workspace | None = None
    tip_length: float | None = None
    iterations: int = 500

    def use(self, motion: Trajectory) -> LimitUse:
        """Use of the limits by a trajectory, at every instant."""
        return LimitUse.of(motion, self.limits, self.workspace, self.arm, self.tip_length)

    def random(self, seed: Sequence[int]) -> Trajectory:
        """A random trajectory of few harmonics that uses nine tenths of its limits, projected on the series."""
        series = self.objective.series
        drawn: TrajectorySeries = FreeSeries(joints=series.joints, harmonics=LOW_HARMONICS, period=series.duration)
        if isinstance(series, RestToRest) and series.start is not None:
            drawn = replace(series, inner=drawn)
        motion = random_feasible_trajectory(
            drawn,
            self.limits,
            workspace=self.workspace,
            arm=self.arm,
            tip_length=self.tip_length,
            seed=seed,
        )
        return self.towards_rest(motion.projected(series), START_LIMIT_USE)

    def varied(self, seed: Sequence[int], *, odd: bool) -> Trajectory:
        """A random trajectory that uses half its limits; odd in time about its mean posture with `odd`.

        The information of many arms is invariant under time reversal combined with mirroring, so that optima among
        the odd trajectories are optima among all, and they are found more often there (measured: five times).
        """
        motion = self.random(seed)
        return self.towards_rest(motion.odd() if odd else motion, VARIED_LIMIT_USE)

    def towards_rest(self, motion: Trajectory, factor: float | Array) -> Trajectory:
        """The trajectory scaled by a factor, or by one for each coefficient (k,), about its mean posture."""
        static = self.still(motion)
        return replace(motion, coefficients=static + factor * (motion.coefficients - static))

    def still(self, motion: Trajectory) -> Array:
        """Coefficients (k,) of the trajectory's mean posture, static."""
        series = motion.series
        return series.rest(motion.derivative(series.instants(self.objective.samples), 0).mean(axis=0))

    @property
    def second_order(self) -> bool:
        """Whether exact second derivatives are used: of the planar models' few parameters they cost four gradients."""
        arm = self.objective.experiment.arm
        return self.objective.exact and arm is not None and arm.space is Space.PLANE

    @cached_property
    def derivatives(self) -> ObjectiveDerivatives:
        """Numerical derivatives of the objective, over all samples."""
        return self._derivatives_of(self.objective)

    @cached_property
    def thinned(self) -> ObjectiveDerivatives:
        """The same over as few samples as represent all of them."""
        enough = max(FEWEST_SAMPLES, SAMPLES_PER_FUNCTION * self.objective.series.mixing.shape[1])
        if enough >= self.objective.samples or not self.objective.exact:
            return self.derivatives
        return self._derivatives_of(self.objective.thinned(enough))

    def _derivatives_of(self, objective: Objective) -> ObjectiveDerivatives:
        if not objective.exact:
            return GraphDerivatives(objective)
        return SecondOrderDerivatives(objective) if self.second_order else AdjointDerivatives(objective)

    @cached_property
    def ranking_limits(self) -> LimitConstraints:
        """The limits at enough instants to rank optima."""
        return LimitConstraints.medium(
            self.objective.series, self.limits, arm=self.arm, workspace=self.workspace, tip_length=self.tip_length
        )

    def __getstate__(self) -> dict[str, Any]:
        # Compiled functions are not pickled: they are soon compiled again.
        return {field.name: getattr(self, field.name) for field in fields(self)}


def contracted_into_limits(task: DesignTask, motion: Trajectory) -> Trajectory | None:
    """The trajectory contracted about its mean posture until it keeps all limits; None where that posture does not."""
    if not np.isfinite(motion.coefficients).all():
        return None
    use = task.use(motion)
    if use.worst.use <= 1:
        return motion
    static = task.use(task.towards_rest(motion, 0.0))
    factors = np.ones(motion.joints)
    for moving, posture in zip(use.limited_quantities, static.limited_quantities, strict=True):
        if moving.quantity in LIMITED_DERIVATIVES:
            if posture.use > 1:
                return None
            joint = int(moving.name[1:]) - 1
            factors[joint] = min(factors[joint], _linear_factor(moving, posture))
    contracted = task.towards_rest(motion, motion.series.by_coefficient(factors))
    if task.use(contracted).worst.use <= 1:
        return contracted
    return None if static.worst.use > 1 else _largest_inside(task, contracted)


def _linear_factor(moving: LimitedQuantity, static: LimitedQuantity) -> float:
    """The largest contraction factor about the mean posture for a limit that is linear in the trajectory."""
    factors = [
        slack / excursion
        for excursion, slack in (
            (moving.high - static.high, moving.limit[1] - static.high),
            (static.low - moving.low, static.low - moving.limit[0]),
        )
        if excursion > slack
    ]
    return ROUNDING_CONTRACTION * min(factors) if factors else 1.0


def _largest_inside(task: DesignTask, motion: Trajectory) -> Trajectory:
    """The contraction by the factor at which the worst limit is just reached, for nonlinear limits."""

    def beyond(factor: float) -> float:
        return task.use(task.towards_rest(motion, factor)).worst.use - 1

    factor = brentq(beyond, 0.0, 1.0, xtol=CONTRACTION_ACCURACY / 4) - CONTRACTION_ACCURACY / 2
    while factor > 0 and beyond(factor) > 0:  # where the worst limit is reached more than once, or it jumps
        factor = max(0.0, factor - (1 - factor))
    return task.towards_rest(motion, max(factor, 0.0))
