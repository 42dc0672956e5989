"""Candidate: a dual, and the bound that it gives as far as the largest F is known."""

from __future__ import annotations

from dataclasses import dataclass

from design.bound.dual_function import Dual
from design.bound.largest import Largest


@dataclass(frozen=True, eq=False)
class Candidate:
    """A dual, the bound of one sample that it gives, and the search for its largest F; None where none was made yet."""

    dual: Dual
    upper: float
    largest: Largest | None = None

    @classmethod
    def of(cls, dual: Dual, value: float, found: Largest | None = None) -> Candidate:
        """The dual scaled so that the largest F, `value`, becomes k: then -ln det D is the bound."""
        scaled = dual.scaled(len(dual.D) / value)
        return cls(scaled, scaled.value, found)

    @property
    def starts(self) -> int:
        """From how many starts the largest F was looked for."""
        return 0 if self.largest is None else self.largest.starts
