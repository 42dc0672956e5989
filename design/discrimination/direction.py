"""Direction: one model taken for true and another one that imitates it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from design.criterion import Smallest, Subset
from design.discrimination.hypothesis import Hypothesis, label, own_effects
from design.discrimination.imitation import Imitation, bounds, imitate, readings, starts
from design.discrimination.view import View
from design.information.experiment import Experiment
from design.information.noise import SensorNoise
from design.information.term import Term, prediction_terms, sensitivity_terms
from modeling.kinematics import Arm
from modeling.model import WrenchModel
from modeling.parameter import Parameter

Array = NDArray[np.float64]

SAME = 1e-6
"""Share of a column's length below which it is a combination of others: squared, as information, 1e-12 is still above
the rounding of 1e-15."""
AT_BOUND = 1e-6
"""Distance of a parameter from its bound, as a share of its size, at which it is held by it."""
DIFFERENCE = Parameter(name="difference", unit="1")


@dataclass(frozen=True, eq=False)
class Direction:
    """`truth` is what goes on, `rival` the model that a reader of the data might hold instead."""

    truth: Hypothesis
    rival: WrenchModel

    @property
    def names(self) -> tuple[str, str]:
        """What the two are called beside one another."""
        return label(self.truth.model, self.rival), label(self.rival, self.truth.model)

    @property
    def contained(self) -> bool:
        """Whether the rival has all effects of the truth, and so can always do as well."""
        return not own_effects(self.truth.model, self.rival)

    @property
    def alone(self) -> Direction:
        """The same truth, and as its rival the model without the truth's own effects."""
        without = self.truth.model
        for effect_id in own_effects(self.truth.model, self.rival):
            without = without.without(effect_id)
        return Direction(self.truth, without)

    def power(self, views: Sequence[View]) -> float:
        """Whitened power of the truth's own effects: of what its readings change by when these are taken away."""
        without = self.truth.less(own_effects(self.truth.model, self.rival))
        whole, rest = (readings(views, h.model, h.theta)[0] for h in (self.truth, without))
        return float(((whole - rest) ** 2).sum())

    def imitation(self, views: Sequence[View], reach: float, known: Sequence[Array] = ()) -> Imitation:
        """The rival's best, along one motion or several together; `known` are values (k,) to start from besides."""
        target, _ = readings(views, self.truth.model, self.truth.theta)
        near = Hypothesis.of(self.rival, self.truth.values).theta
        first = target[: len(target) // len(views)]
        own = own_effects(self.rival, self.truth.model)
        begin = starts(first, self.rival, own, near, views[0], reach)
        return imitate(target, self.rival, views, [*known, *begin])


@dataclass(frozen=True, eq=False)
class Block:
    """A direction with the rival held at theta (k,), lambda made linear about it.

    With delta = y_truth - y_rival(theta) and S the rival's sensitivities there,
    lambda = min over d of |delta - S d|² is the Schur complement of delta' delta in the information of the columns
    [S, delta]: `Subset` of the last one. `columns` are those of S that are kept.
    """

    direction: Direction
    theta: Array
    columns: tuple[int, ...]

    @classmethod
    def of(cls, direction: Direction, theta: Array, views: Sequence[View]) -> Block:
        """With the columns that are free and no combination of others along some motions.

        Leaving out a column that is a combination of the others changes no Schur complement. A parameter at its bound
        is held there.
        """
        _, slopes = readings(views, direction.rival, theta)
        length = np.linalg.norm(slopes, axis=0)
        low, high = bounds(direction.rival)
        near = AT_BOUND * np.maximum(np.abs(theta), AT_BOUND)
        free = np.flatnonzero((length > 0) & (theta - low > near) & (high - theta > near))
        triangle, order = qr(slopes[:, free] / length[free], mode="r", pivoting=True)
        kept = order[: int((np.abs(np.diag(triangle)) > SAME).sum())]
        return cls(direction, theta, tuple(sorted(int(i) for i in free[kept])))

    @property
    def size(self) -> int:
        """Its columns, the difference among them."""
        return len(self.columns) + 1

    def terms(self, first: int) -> tuple[Term, ...]:
        """What its columns are made of, the first one in column `first` of an experiment."""
        place = {old: first + new for new, old in enumerate(self.columns)}
        own = [_moved(term, place) for term in sensitivity_terms(self.direction.rival, self.theta)]
        last, truth = first + self.size - 1, self.direction.truth
        return (
            *(term for term in own if term.columns),
            *prediction_terms(truth.model, truth.theta, last),
            *prediction_terms(self.direction.rival, self.theta, last, -1.0),
        )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """What its columns are derivatives by."""
        return (*(self.direction.rival.parameters[i] for i in self.columns), DIFFERENCE)


def side_by_side(blocks: Sequence[Block], arm: Arm, noise: SensorNoise) -> tuple[Experiment, Smallest]:
    """The experiment of several blocks, and the smallest of their ln lambda."""
    sizes = [block.size for block in blocks]
    firsts = np.cumsum([0, *sizes[:-1]])
    experiment = Experiment(
        terms=tuple(t for block, first in zip(blocks, firsts, strict=True) for t in block.terms(int(first))),
        parameters=tuple(p for block in blocks for p in block.parameters),
        channels=blocks[0].direction.rival.channels,
        arm=arm,
        noise=noise,
    )
    return experiment, Smallest(tuple(Subset((size - 1,)) for size in sizes), tuple(sizes))


def _moved(term: Term, place: dict[int, int]) -> Term:
    """A term with those of its columns that have a place, there."""
    kept = [i for i, column in enumerate(term.columns) if column in place]
    by = None if term.by is None else tuple(term.by[i] for i in kept)
    return replace(term, by=by, columns=tuple(place[term.columns[i]] for i in kept))
