"""Equation: one equation of the chapter as printed, next to what the project derives, and the verdict of SymPy."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from textwrap import wrap

import sympy as sp

from modeling.chapter.notation import as_latex, as_text, lines, words


class Verdict(Enum):
    """What comes of comparing a printed equation with the derived one."""

    AGREES = "agrees"
    ERRATUM = "erratum"
    NOT_DERIVABLE = "not derivable"
    OPEN = "open"


def reduced(expressions: sp.Matrix) -> sp.Matrix:
    """Each entry multiplied out, or factored where that is shorter; zero, by exponentials, comes out as 0."""
    return expressions.applyfunc(_reduced)


def _reduced(expression: sp.Expr) -> sp.Expr:
    plain = sp.expand(expression)
    if plain == 0 or sp.expand(sp.numer(sp.together(plain.rewrite(sp.exp)))) == 0:
        return sp.S.Zero
    short = sp.factor(plain)
    return short if short.count_ops() <= plain.count_ops() else plain


def vanishes(expression: sp.Expr | sp.Matrix) -> bool:
    """Whether an expression is zero, or every entry of a matrix."""
    matrix = expression if isinstance(expression, sp.MatrixBase) else sp.Matrix([expression])
    return bool(reduced(matrix).is_zero_matrix)


@dataclass(frozen=True, eq=False, kw_only=True)
class Equation:
    """One equation of the chapter, or one row of it.

    states    the left side: what the equation gives
    readings  what is printed, in every reading that is open; () where its wording is not known here
    derived   the same by derivation
    constants symbols in a reading that may have any value: then the question is whether any value makes it right
    erratum   its number in PHYSICS.md, where it has one
    quoted    whether PHYSICS.md gives the equation itself; else it is typed from what is said about it there
    """

    number: str
    states: str
    derived: sp.Matrix
    readings: tuple[sp.Matrix, ...] = ()
    constants: tuple[sp.Symbol, ...] = ()
    erratum: int | None = None
    quoted: bool = True

    @cached_property
    def differences(self) -> tuple[sp.Matrix, ...]:
        """Printed less derived, of each reading."""
        return tuple(reduced(reading - self.derived) for reading in self.readings)

    @cached_property
    def agrees(self) -> bool:
        """Whether the difference of some reading is zero."""
        return any(difference.is_zero_matrix for difference in self.differences)

    @cached_property
    def verdict(self) -> Verdict:
        """Of the differences, not of a list: an erratum whose difference is zero would be said to agree."""
        if self.agrees:
            return Verdict.AGREES
        if self.constants:
            return Verdict.NOT_DERIVABLE if all(map(self.unmatched, self.differences)) else Verdict.OPEN
        return Verdict.OPEN if self.erratum is None else Verdict.ERRATUM

    def unmatched(self, difference: sp.Matrix) -> dict[sp.Expr, sp.Expr]:
        """What no value of the constants takes away at phi = 0: by powers of the motion, coefficients free of them.

        At one angle the difference is a polynomial in the other signals. Were it zero for every motion, each of its
        coefficients would be; one that is not zero and holds no constant refutes them all.
        """
        signals = sp.symbols("dphi ddphi ax ay", real=True)
        still = sp.Poly(sp.expand(difference[0].subs(sp.Symbol("phi", real=True), 0)), *signals)
        terms = {sp.prod(s**p for s, p in zip(signals, powers, strict=True)): c for powers, c in still.terms()}
        return {term: c for term, c in terms.items() if c != 0 and not c.free_symbols & set(self.constants)}

    @property
    def mark(self) -> str:
        """The verdict in words, with the erratum's number."""
        number = "" if self.erratum is None or self.verdict is Verdict.AGREES else f"erratum {self.erratum}"
        marks = {
            Verdict.ERRATUM: number,
            Verdict.NOT_DERIVABLE: ", ".join(filter(None, (self.verdict.value, number))),
            Verdict.OPEN: "open" if self.readings else "open, not quoted",
        }
        return marks.get(self.verdict, self.verdict.value)

    @property
    def row(self) -> tuple[str, str, str, str]:
        """Number, printed, derived and verdict, for a table."""
        return f"{self.number} {self.states}", self.printed_text, as_text(self.derived), self.mark

    @property
    def printed_text(self) -> str:
        """The readings as text, one after the other."""
        return "\nor\n".join(map(as_text, self.readings)) or "-"

    def __str__(self) -> str:
        shown = [f"{self.number}  {self.states}: {self.mark}"]
        for reading, difference in zip(self.readings, self.differences, strict=True):
            shown += [*_labelled(self._printed, reading), *_labelled("printed - derived", difference)]
        return "\n".join([*shown, *_labelled("derived", self.derived)])

    def _repr_latex_(self) -> str:
        shown = [words(f"{self.number}  {self.states}: {self.mark}")]
        for reading, difference in zip(self.readings, self.differences, strict=True):
            shown += [words(self._printed) + rf"\quad {as_latex(reading)}"]
            shown += [words("printed - derived") + rf"\quad {as_latex(difference)}"]
        return lines([*shown, words("derived") + rf"\quad {as_latex(self.derived)}"])

    @property
    def _printed(self) -> str:
        return "printed" if self.quoted else "printed, typed"


def _labelled(label: str, matrix: sp.Matrix) -> Iterable[str]:
    first, *others = (part for row in as_text(matrix).splitlines() for part in wrap(row, 96, subsequent_indent="  "))
    return [f"    {label:17}  {first}", *(" " * 23 + line for line in others)]
