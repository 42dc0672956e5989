"""Estimates: unknowns with value, standard deviation and unit, and what the data do not say of them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from estimation.linear.descent import FAINT, MOST_STEPS, UNSHOWN
from estimation.linear.least_squares import Sight
from estimation.linear.square_root import SquareRoot
from estimation.linear.unseen import UnseenDirection, WeakestDirection, unseen_directions, weakest_direction
from estimation.text_table import table as table
from modeling.parameter import Parameter

Array = NDArray[np.float64]

ILL = 1e3
"""Condition from which on a table says so: one direction is a thousand times less certain than another."""


@dataclass(frozen=True)
class Estimate:
    """One estimated parameter: value and standard deviation in `unit`."""

    name: str
    value: float
    std: float
    unit: str


class Estimates(ABC):
    """Unknowns that were estimated, whatever from.

    theta        (k,), its covariance (k, k), and `shown` (k,), whether the data tell an unknown apart from all others
    converged    whether the steps came to rest
    """

    theta: Array
    covariance: Array
    shown: NDArray[np.bool_]
    converged: bool

    @property
    @abstractmethod
    def information(self) -> SquareRoot:
        """All that the whitened rows say of theta, in one triangle."""

    @property
    @abstractmethod
    def unknowns(self) -> tuple[Parameter, ...]:
        """What was estimated, in the order of theta."""

    @cached_property
    def parameters(self) -> Mapping[str, Estimate]:
        """Every unknown by name, with std and unit; the std is infinite where the data do not show it."""
        std = np.where(self.shown, np.sqrt(np.maximum(np.diag(self.covariance), 0.0)), np.inf)
        return {
            p.name: Estimate(p.name, float(value), float(s), p.unit)
            for p, value, s in zip(self.unknowns, self.theta, std, strict=True)
        }

    @property
    def values(self) -> dict[str, float]:
        """The value of every unknown by name."""
        return {name: estimate.value for name, estimate in self.parameters.items()}

    @cached_property
    def sight(self) -> Sight:
        """What the data show of the unknowns."""
        return Sight.of(self.information.root, UNSHOWN, FAINT)

    @property
    def condition(self) -> float:
        """Condition number of the whitened columns scaled to unit length, of what is seen."""
        return self.sight.condition

    @cached_property
    def unseen(self) -> tuple[UnseenDirection, ...]:
        """What the data do not show, one sentence each."""
        return unseen_directions(self.sight, self.unknowns)

    @cached_property
    def weakest(self) -> WeakestDirection | None:
        """The direction that is seen worst of those that are."""
        return weakest_direction(self.sight, self.unknowns)

    def rows(self) -> list[tuple[str, ...]]:
        """Name, value, std and unit of every unknown, as text."""
        return [
            (e.name, f"{e.value:.6g}", f"{e.std:.2g}", e.unit)
            if np.isfinite(e.std)
            else (e.name, "-", "not shown", e.unit)
            for e in self.parameters.values()
        ]

    def remarks(self) -> list[str]:
        """What has to be said of the numbers: a poor condition, what is not seen, steps that ran out."""
        said = [f"condition {self.condition:.2g}; {self.weakest}"] if self.condition > ILL else []
        alone = [d.names[0] for d in self.unseen if len(d.names) == 1]
        if len(alone) > 1:
            said.append(f"{', '.join(alone[:-1])} and {alone[-1]} are not seen by this motion")
        said += [str(d) for d in self.unseen if len(d.names) > 1 or len(alone) == 1]
        return said if self.converged else [*said, f"not converged after {MOST_STEPS} steps: the values may move on"]

    def __str__(self) -> str:
        return "\n".join([table(("parameter", "value", "std", "unit"), self.rows()), *self.remarks()])
