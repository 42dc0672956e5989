"""A parameter of a wrench model: its name, unit, nominal value and physical bounds."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import inf

from modeling import symbolic as sp


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One parameter of a model.

    `nominal` is the value at which an effect's parameter leaves the model unchanged. It is the initial value of a fit,
    unless `start` gives another because a fit cannot start there (an infinite stiffness, a push of zero duration).
    `bounds` are the physical ones (inclusive), in the same `unit`. A nuisance parameter (`nuisance`: an anchor, a time)
    is not identifiable while the effect's amplitudes vanish: it is found by grid search, not by a score test.
    """

    name: str
    unit: str
    nominal: float = 0.0
    bounds: tuple[float, float] = (-inf, inf)
    nuisance: bool = False
    start: float | None = None

    @cached_property
    def symbol(self) -> sp.Symbol:
        """The SymPy symbol of this parameter in all derivations."""
        return sp.Symbol(self.name, real=True)
