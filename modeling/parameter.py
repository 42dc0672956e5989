"""A parameter of a wrench model: its name, unit, nominal value and physical bounds."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from math import inf

from modeling import symbolic as sp


class Role(Enum):
    """What a parameter is to the effect or model that has it."""

    AMPLITUDE = "the effect vanishes with it, or the model is linear in it"
    ONSET = "a time at which a transient begins or ends"
    FREQUENCY = "of a sinusoid that is not locked to the motion"
    SHAPE = "another nonlinear parameter: a place, a natural length, a damping"


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One parameter of a model.

    `meaning` says in words what it is. `nominal` is the value at which an effect's parameter leaves the model
    unchanged. It is the initial value of a fit, unless `start` gives another because a fit cannot start there (an
    infinite stiffness, a push of zero duration). `bounds` are the physical ones (inclusive), in the same `unit`. `role`
    decides how it is searched for.
    """

    name: str
    unit: str
    meaning: str = ""
    nominal: float = 0.0
    bounds: tuple[float, float] = (-inf, inf)
    role: Role = Role.AMPLITUDE
    start: float | None = None

    @property
    def nuisance(self) -> bool:
        """Whether it is not identifiable while the amplitudes vanish: found by grid search, not by a score test."""
        return self.role is not Role.AMPLITUDE

    @property
    def fixed(self) -> bool:
        """Whether its bounds coincide: it is held at its nominal value, and no expression has its symbol."""
        return self.bounds[0] == self.bounds[1]

    @cached_property
    def symbol(self) -> sp.Symbol:
        """The SymPy symbol of this parameter in all derivations."""
        return sp.Symbol(self.name, real=True)
