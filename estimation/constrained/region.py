"""Region: where the unknowns of a fit may be, in numbers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from math import inf, isfinite

import numpy as np
from numpy.typing import NDArray

from estimation.constrained.divergence import Divergence
from modeling.parameter import Parameter
from modeling.pseudo_inertia import PseudoInertia

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Side:
    """One end of an interval: unknown `index` is at least (`lower`) or at most `value`; `own` if its effect says so."""

    index: int
    lower: bool
    value: float
    text: str
    own: bool = False


@dataclass(frozen=True, eq=False)
class Region:
    """Unknowns (k,) with low <= theta <= high and J(theta) >= 0, and a prior that acts inside.

    stated   intervals that somebody stated, by index; the parameters' own physical ones hold besides
    inertia  J over all unknowns; None where physical consistency is not asked for, or a prior sees to it
    prior    keeps J positive definite by itself
    where    what stated the intervals, for an InputError
    """

    parameters: tuple[Parameter, ...]
    stated: dict[int, tuple[float, float]]
    inertia: PseudoInertia | None = None
    prior: Divergence | None = None
    where: str = "bounds"

    @cached_property
    def sides(self) -> tuple[Side, ...]:
        """Every finite end, stated and the effects' own."""
        return tuple(self._sides())

    def _sides(self) -> Iterator[Side]:
        for index, parameter in enumerate(self.parameters):
            for own, ends in ((True, parameter.bounds), (False, self.stated.get(index, (-inf, inf)))):
                for lower, value in zip((True, False), ends, strict=True):
                    if isfinite(value):
                        text = f"{parameter.name} {'>=' if lower else '<='} {value:g} {_unit(parameter)}".rstrip()
                        yield Side(index, lower, value, f"{text} (its effect's range)" if own else text, own)

    @cached_property
    def low(self) -> Array:
        """(k,) lowest values."""
        return self._ends(lower=True)

    @cached_property
    def high(self) -> Array:
        """(k,) highest values."""
        return self._ends(lower=False)

    def _ends(self, *, lower: bool) -> Array:
        ends = np.full(len(self.parameters), -inf if lower else inf)
        for side in self.sides:
            if side.lower is lower:
                ends[side.index] = (max if lower else min)(ends[side.index], side.value)
        return ends

    @property
    def fixed(self) -> NDArray[np.bool_]:
        """(k,) unknowns whose ends meet."""
        return np.asarray(self.low == self.high)

    def text(self, index: int, *, lower: bool) -> str:
        """The end that holds unknown `index`, in words."""
        end = (self.low if lower else self.high)[index]
        if self.fixed[index]:
            return f"{self.parameters[index].name} = {end:g} {_unit(self.parameters[index])}".rstrip()
        sides = [s for s in self.sides if s.index == index and s.lower is lower and s.value == end]
        return min(sides, key=lambda s: s.own).text

    def matrix(self, theta: Array) -> Array:
        """J (n, n) at theta, 0 x 0 without physical consistency."""
        return np.zeros((0, 0)) if self.inertia is None else self.inertia.at(theta)

    @property
    def slopes(self) -> Array:
        """Derivative of J in each unknown, (k, n, n)."""
        return np.zeros((len(self.parameters), 0, 0)) if self.inertia is None else self.inertia.slopes

    def contains(self, theta: Array) -> bool:
        """Whether theta is within the intervals, ends included, and J positive definite."""
        within = bool(np.all((theta >= self.low) & (theta <= self.high)))
        return within and bool(np.all(np.linalg.eigvalsh(self.matrix(theta)) > 0))

    def added(self, theta: Array) -> float:
        """What the prior adds to the chi-square at theta."""
        return 0.0 if self.prior is None else self.prior.value(theta)


def _unit(parameter: Parameter) -> str:
    return "" if parameter.unit == "1" else parameter.unit
