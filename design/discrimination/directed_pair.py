"""One model taken as true and its rival; noncentrality linearised in the rival's parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from design.criteria import MaximinCriterion, Subset
from design.discrimination.hypothesis import Hypothesis, distinguishing_effects, effects_only_in
from design.discrimination.rival_along_trajectories import (
    RivalAlongTrajectories,
    parameter_bounds,
    rival_starts,
    whitened_predictions,
)
from design.discrimination.whitened_prediction import WhitenedPrediction
from design.information.experiment import Experiment
from design.information.sensitivity_term import SensitivityTerm, prediction_terms, sensitivity_terms
from modeling.chain.model import WrenchModel
from modeling.kinematics.arm import Arm
from modeling.noise.stationary_noise import StationaryNoise
from modeling.parameter import Parameter
from modeling.rival_fit import RivalFit, fit_rival

Array = NDArray[np.float64]

COLLINEAR = 1e-6
"""Share of a sensitivity's norm below which it is collinear with others: squared, as information, 1e-12 is above the
rounding of 1e-15."""
BOUND_TOLERANCE = 1e-6
"""Distance of a parameter from its bound, as a share of its size, at which the bound is active."""
DIFFERENCE = Parameter(name="difference", unit="1")


@dataclass(frozen=True, eq=False)
class DirectedPair:
    """`truth` is the model taken as true, at its values; `rival` the model that is fitted to its prediction."""

    truth: Hypothesis
    rival: WrenchModel

    @property
    def names(self) -> tuple[str, str]:
        """Names of the two by their distinguishing effects."""
        return distinguishing_effects(self.truth.model, self.rival), distinguishing_effects(
            self.rival, self.truth.model
        )

    @property
    def nested_in_rival(self) -> bool:
        """Whether the rival has all effects of the truth, so that the truth is nested in it."""
        return not effects_only_in(self.truth.model, self.rival)

    @property
    def without_own_effects(self) -> DirectedPair:
        """The same truth, and as its rival the truth's model without the effects that distinguish it."""
        without = self.truth.model
        for effect_id in effects_only_in(self.truth.model, self.rival):
            without = without.without(effect_id)
        return DirectedPair(self.truth, without)

    def power(self, views: Sequence[WhitenedPrediction]) -> float:
        """Whitened power of the contribution of the truth's distinguishing effects to its prediction."""
        without = self.truth.without_effects(effects_only_in(self.truth.model, self.rival))
        full, reduced = (whitened_predictions(views, h.model, h.theta)[0] for h in (self.truth, without))
        return float(((full - reduced) ** 2).sum())

    def rival_fit(self, views: Sequence[WhitenedPrediction], reach: float, known: Sequence[Array] = ()) -> RivalFit:
        """The rival's fit, along one trajectory or several together; `known` are values (k,) of further starts."""
        target, _ = whitened_predictions(views, self.truth.model, self.truth.theta)
        common = Hypothesis.of(self.rival, self.truth.values).theta
        first = target[: len(target) // len(views)]
        own = effects_only_in(self.rival, self.truth.model)
        starts = rival_starts(first, self.rival, own, common, views[0], reach)
        return fit_rival(RivalAlongTrajectories(target, self.rival, views), [*known, *starts])


@dataclass(frozen=True, eq=False)
class LinearisedRival:
    """The noncentrality lambda of a directed pair, linearised at the rival's theta (k,).

    With delta = y_truth - y_rival(theta) and S the rival's sensitivities there,
    lambda = min over d of |delta - S d|² is the Schur complement of delta' delta in the information of the columns
    [S, delta]: `Subset` of the last one. `columns` are the indices of the identifiable columns of S.
    """

    direction: DirectedPair
    theta: Array
    columns: tuple[int, ...]

    @classmethod
    def of(cls, direction: DirectedPair, theta: Array, views: Sequence[WhitenedPrediction]) -> LinearisedRival:
        """With the columns that are free and not collinear with others along some trajectories.

        Leaving out a collinear column changes no Schur complement. A parameter with an active bound is fixed.
        """
        _, slopes = whitened_predictions(views, direction.rival, theta)
        norm = np.linalg.norm(slopes, axis=0)
        low, high = parameter_bounds(direction.rival)
        tolerance = BOUND_TOLERANCE * np.maximum(np.abs(theta), BOUND_TOLERANCE)
        free = np.flatnonzero((norm > 0) & (theta - low > tolerance) & (high - theta > tolerance))
        factor, order = qr(slopes[:, free] / norm[free], mode="r", pivoting=True)
        independent = order[: int((np.abs(np.diag(factor)) > COLLINEAR).sum())]
        return cls(direction, theta, tuple(sorted(int(i) for i in free[independent])))

    @property
    def size(self) -> int:
        """Number of columns, the difference included."""
        return len(self.columns) + 1

    def terms(self, first: int) -> tuple[SensitivityTerm, ...]:
        """The terms of its columns, the first one in column `first` of an experiment."""
        position = {old: first + new for new, old in enumerate(self.columns)}
        moved = [_moved(term, position) for term in sensitivity_terms(self.direction.rival, self.theta)]
        last, truth = first + self.size - 1, self.direction.truth
        return (
            *(term for term in moved if term.columns),
            *prediction_terms(truth.model, truth.theta, last),
            *prediction_terms(self.direction.rival, self.theta, last, -1.0),
        )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters of its columns, and the difference."""
        return (*(self.direction.rival.parameters[i] for i in self.columns), DIFFERENCE)


def maximin_experiment(
    blocks: Sequence[LinearisedRival], arm: Arm, noise: StationaryNoise
) -> tuple[Experiment, MaximinCriterion]:
    """The experiment of several blocks, and the maximin criterion of their ln lambda."""
    sizes = [block.size for block in blocks]
    firsts = np.cumsum([0, *sizes[:-1]])
    experiment = Experiment(
        terms=tuple(t for block, first in zip(blocks, firsts, strict=True) for t in block.terms(int(first))),
        parameters=tuple(p for block in blocks for p in block.parameters),
        channels=blocks[0].direction.rival.channels,
        arm=arm,
        noise=noise,
    )
    return experiment, MaximinCriterion(tuple(Subset((size - 1,)) for size in sizes), tuple(sizes))


def _moved(term: SensitivityTerm, position: dict[int, int]) -> SensitivityTerm:
    """A term reduced to the columns that have a position, moved there."""
    columns = [i for i, column in enumerate(term.columns) if column in position]
    by = None if term.by is None else tuple(term.by[i] for i in columns)
    return replace(term, by=by, columns=tuple(position[term.columns[i]] for i in columns))
