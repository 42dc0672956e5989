"""Tables of the equations and errata of chapter 22 (Bassi et al.), as text and HTML."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from modeling.reference.equation import Equation, EquationVerdict
from modeling.reference.erratum import Erratum
from modeling.table import Column, Table, Tabular


@dataclass(frozen=True, eq=False)
class Equations(Tabular):
    """Equations of the chapter, each with its verdict."""

    members: tuple[Equation, ...]

    def __iter__(self) -> Iterator[Equation]:
        return iter(self.members)

    def __getitem__(self, name: str) -> Equation:
        """The equation of that number, or of that number and left-hand side."""
        return next(e for e in self.members if name in (e.number, f"{e.number} {e.states}"))

    def of(self, verdict: EquationVerdict) -> tuple[Equation, ...]:
        """Those with that verdict."""
        return tuple(e for e in self.members if e.verdict is verdict)

    @property
    def table(self) -> Table:
        """Number, printed, derived and verdict of each equation."""
        widths = {"equation": 18, "printed": 41, "derived": 41, "verdict": 14}
        return Table.of((Column(name, width=width) for name, width in widths.items()), [e.row for e in self.members])

    def remarks(self) -> list[str]:
        """How many equations have each verdict."""
        return [", ".join(f"{len(self.of(v))} {v.value}" for v in EquationVerdict)]


@dataclass(frozen=True, eq=False)
class Errata(Tabular):
    """The errata, each with its proofs."""

    members: tuple[Erratum, ...]

    @property
    def proven(self) -> bool:
        """Whether all errata are proven."""
        return all(e.proven for e in self.members)

    def __iter__(self) -> Iterator[Erratum]:
        return iter(self.members)

    def __getitem__(self, number: int) -> Erratum:
        """The erratum of that number in PHYSICS.md."""
        return next(e for e in self.members if e.number == number)

    @property
    def table(self) -> Table:
        """Number and claim of each erratum, and how many of its differences are proved."""
        widths = {"erratum": 7, "claim": 88, "proved by": 20}
        return Table.of((Column(name, width=width) for name, width in widths.items()), [e.row for e in self.members])
