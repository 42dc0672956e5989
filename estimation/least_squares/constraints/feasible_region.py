"""Feasible region of the parameters: bounds and a pseudo-inertia that is positive by a margin."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from math import inf, isfinite

import numpy as np
from numpy.typing import NDArray

from estimation.least_squares.constraints.log_det_divergence import LogDetDivergence
from modeling.chain.pseudo_inertia import PseudoInertia
from modeling.parameter import Parameter

Array = NDArray[np.float64]


@dataclass(frozen=True)
class BoundSide:
    """One-sided bound: parameter `index` is at least (`lower`) or at most `value`; `own` if its effect sets it."""

    index: int
    lower: bool
    value: float
    text: str
    own: bool = False


@dataclass(frozen=True, eq=False)
class FeasibleRegion:
    """Parameters (k,) with low <= theta <= high and J(theta) >= 0 by `CONSISTENCY_MARGIN`, and a prior inside.

    stated   stated intervals by index; the parameters' own bounds hold as well
    inertia  J over all parameters; None where physical consistency is not required, or implied by a prior
    prior    keeps J positive definite by itself
    where    source of the intervals, for an InputError
    """

    parameters: tuple[Parameter, ...]
    stated: dict[int, tuple[float, float]]
    inertia: PseudoInertia | None = None
    prior: LogDetDivergence | None = None
    where: str = "bounds"

    @cached_property
    def sides(self) -> tuple[BoundSide, ...]:
        """Every finite bound, stated or from an effect."""
        return tuple(self._sides())

    def _sides(self) -> Iterator[BoundSide]:
        for index, parameter in enumerate(self.parameters):
            for own, ends in ((True, parameter.bounds), (False, self.stated.get(index, (-inf, inf)))):
                for lower, value in zip((True, False), ends, strict=True):
                    if isfinite(value):
                        text = f"{parameter.name} {'>=' if lower else '<='} {value:g} {_unit(parameter)}".rstrip()
                        yield BoundSide(index, lower, value, f"{text} (its effect's range)" if own else text, own)

    @cached_property
    def low(self) -> Array:
        """(k,) lower bounds."""
        return self._ends(lower=True)

    @cached_property
    def high(self) -> Array:
        """(k,) upper bounds."""
        return self._ends(lower=False)

    def _ends(self, *, lower: bool) -> Array:
        ends = np.full(len(self.parameters), -inf if lower else inf)
        for side in self.sides:
            if side.lower is lower:
                ends[side.index] = (max if lower else min)(ends[side.index], side.value)
        return ends

    @property
    def fixed(self) -> NDArray[np.bool_]:
        """(k,) parameters with equal bounds."""
        return np.asarray(self.low == self.high)

    def text(self, index: int, *, lower: bool) -> str:
        """The tightest bound of parameter `index` on one side, as text."""
        end = (self.low if lower else self.high)[index]
        if self.fixed[index]:
            return f"{self.parameters[index].name} = {end:g} {_unit(self.parameters[index])}".rstrip()
        sides = [s for s in self.sides if s.index == index and s.lower is lower and s.value == end]
        return min(sides, key=lambda s: s.own).text

    @cached_property
    def cone(self) -> PseudoInertia | None:
        """J less its margin, which is to be positive semidefinite; None without physical consistency."""
        return None if self.inertia is None else self.inertia.with_margin()

    def matrix(self, theta: Array) -> Array:
        """J (n, n) less its margin at theta, 0 x 0 without physical consistency."""
        return np.zeros((0, 0)) if self.cone is None else self.cone.at(theta)

    @property
    def slopes(self) -> Array:
        """Derivative of `matrix` in each parameter, (k, n, n)."""
        return np.zeros((len(self.parameters), 0, 0)) if self.cone is None else self.cone.slopes

    def contains(self, theta: Array) -> bool:
        """Whether theta is within the bounds, inclusive, and J positive definite by more than its margin."""
        within = bool(np.all((theta >= self.low) & (theta <= self.high)))
        return within and bool(np.all(np.linalg.eigvalsh(self.matrix(theta)) > 0))

    def added(self, theta: Array) -> float:
        """Contribution of the prior to the chi-square at theta."""
        return 0.0 if self.prior is None else self.prior.value(theta)


def _unit(parameter: Parameter) -> str:
    return "" if parameter.unit == "1" else parameter.unit
