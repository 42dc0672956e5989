"""Local model: the chi-square about a point, in unknowns in which it is a plain sum of squares."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from estimation.constrained.divergence import Divergence
from estimation.layout import Layout
from estimation.linear.descent import UNSHOWN, Minimum
from estimation.linear.least_squares import Sight
from estimation.linear.square_root import SquareRoot

Array = NDArray[np.float64]


class LeastSquares(Protocol):
    """A least-squares problem that can be constrained; `estimation.fit.Problem` is one."""

    @property
    def layout(self) -> Layout:
        """Its unknowns."""

    def information(self, theta: Array, /) -> SquareRoot:
        """What the whitened rows say of a step from theta (k,)."""

    def minimise(self, start: Array, /) -> Minimum:
        """The minimum within the parameters' own bounds alone."""


@dataclass(frozen=True, eq=False)
class LocalModel:
    """chi-square and prior of theta + d, |R d - z|² + power to second order, as long as the prediction is straight.

    theta  (k,)
    data   the rows of the recordings about theta
    whole  with those of the prior, where there is one and the tool is possible
    """

    theta: Array
    data: SquareRoot
    whole: SquareRoot

    @classmethod
    def at(cls, problem: LeastSquares, theta: Array, prior: Divergence | None) -> Self:
        """The problem about theta."""
        data = problem.information(theta)
        if prior is None or not np.isfinite(prior.value(theta)):
            return cls(theta, data, data)
        return cls(theta, data, data + SquareRoot.of(*prior.rows(theta)))

    @property
    def cost(self) -> float:
        """The chi-square of the data at theta."""
        return self.data.cost

    @cached_property
    def sight(self) -> Sight:
        """What data and prior show of the unknowns."""
        return Sight.of(self.whole.root, UNSHOWN)

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(k,) which of the whitened unknowns y they show."""
        return self.sight.seen

    @cached_property
    def basis(self) -> Array:
        """B (k, k) of d = B y, with |R d - z|² = |y - reach|² + constant over the y that are seen."""
        sight = self.sight
        return np.asarray(sight.right.T / np.where(sight.seen, sight.singular, 1.0) / sight.scale[:, None])

    @cached_property
    def reach(self) -> Array:
        """(k,) y of the local model's own minimum, 0 where it has none."""
        return np.where(self.seen, self.sight.left.T @ self.whole.target, 0.0)

    @cached_property
    def spread(self) -> Array:
        """(k,) size of each unknown in y: its std, where it is shown."""
        return np.asarray(np.linalg.norm(self.basis, axis=1))
