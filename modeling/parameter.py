"""A parameter of a wrench model: its name, unit, nominal value and physical bounds."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import inf

from modeling import symbolic as sp


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One unknown of a model.

    `nominal` is the value at which an effect's parameter leaves the model unchanged; a fit starts there, or at `start`
    where no fit can (a stiffness without end, a push of no duration);
    `bounds` are the physical ones (inclusive), in the same `unit`. A `nuisance`
    parameter means nothing while the effect's amplitudes vanish (an anchor, a time): it is searched, not tested.
    """

    name: str
    unit: str
    nominal: float = 0.0
    bounds: tuple[float, float] = (-inf, inf)
    nuisance: bool = False
    start: float | None = None

    @cached_property
    def symbol(self) -> sp.Symbol:
        """The SymPy symbol that stands for this parameter in every derivation."""
        return sp.Symbol(self.name, real=True)
