"""An equation of chapter 22 (Bassi et al.) as printed, its derivation, and the verdict by SymPy."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from textwrap import wrap

import sympy as sp

from modeling.reference.notation import as_latex, as_text, latex_lines, latex_words


class EquationVerdict(Enum):
    """Result of comparing a printed equation with the derived one."""

    AGREES = "agrees"
    ERRATUM = "erratum"
    NOT_DERIVABLE = "not derivable"
    OPEN = "open"


def simplified_entries(expressions: sp.Matrix) -> sp.Matrix:
    """Each entry expanded, or factored where that is shorter; 0 where it vanishes when rewritten in exponentials."""
    return expressions.applyfunc(_reduced)


def _reduced(expression: sp.Expr) -> sp.Expr:
    expanded = sp.expand(expression)
    if expanded == 0 or sp.expand(sp.numer(sp.together(expanded.rewrite(sp.exp)))) == 0:
        return sp.S.Zero
    factored = sp.factor(expanded)
    return factored if factored.count_ops() <= expanded.count_ops() else expanded


def vanishes(expression: sp.Expr | sp.Matrix) -> bool:
    """Whether an expression, or every entry of a matrix, is identically zero."""
    matrix = expression if isinstance(expression, sp.MatrixBase) else sp.Matrix([expression])
    return bool(simplified_entries(matrix).is_zero_matrix)


@dataclass(frozen=True, eq=False, kw_only=True)
class Equation:
    """One equation of the chapter, or one row of it.

    states    its left-hand side
    readings  the printed right-hand side, in every possible reading; () where it is not quoted
    derived   the derived right-hand side
    constants symbols in a reading with free values: it agrees if any value makes it correct
    erratum   its number in PHYSICS.md, if any
    quoted    whether PHYSICS.md quotes the equation; else it is typed from its description there
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
        """Printed minus derived, for each reading."""
        return tuple(simplified_entries(reading - self.derived) for reading in self.readings)

    @cached_property
    def agrees(self) -> bool:
        """Whether the difference vanishes for some reading."""
        return any(difference.is_zero_matrix for difference in self.differences)

    @cached_property
    def verdict(self) -> EquationVerdict:
        """The verdict from the differences alone: a listed erratum whose difference vanishes agrees."""
        if self.agrees:
            return EquationVerdict.AGREES
        if self.constants:
            return EquationVerdict.NOT_DERIVABLE if all(map(self.unmatched, self.differences)) else EquationVerdict.OPEN
        return EquationVerdict.OPEN if self.erratum is None else EquationVerdict.ERRATUM

    def unmatched(self, difference: sp.Matrix) -> dict[sp.Expr, sp.Expr]:
        """Nonzero coefficients at phi = 0 without free constants, by monomial of the motion: no value cancels them.

        At one angle the difference is a polynomial in the other signals. It vanishes for every motion only if all its
        coefficients do; a nonzero one without free constants refutes every choice of them.
        """
        signals = sp.symbols("dphi ddphi ax ay", real=True)
        polynomial = sp.Poly(sp.expand(difference[0].subs(sp.Symbol("phi", real=True), 0)), *signals)
        terms = {sp.prod(s**p for s, p in zip(signals, powers, strict=True)): c for powers, c in polynomial.terms()}
        return {term: c for term, c in terms.items() if c != 0 and not c.free_symbols & set(self.constants)}

    @property
    def mark(self) -> str:
        """The verdict as text, with the erratum's number."""
        number = "" if self.erratum is None or self.verdict is EquationVerdict.AGREES else f"erratum {self.erratum}"
        marks = {
            EquationVerdict.ERRATUM: number,
            EquationVerdict.NOT_DERIVABLE: ", ".join(filter(None, (self.verdict.value, number))),
            EquationVerdict.OPEN: "open" if self.readings else "open, not quoted",
        }
        return marks.get(self.verdict, self.verdict.value)

    @property
    def row(self) -> tuple[str, str, str, str]:
        """Number, printed, derived and verdict, as a table row."""
        return f"{self.number} {self.states}", self.printed_text, as_text(self.derived), self.mark

    @property
    def printed_text(self) -> str:
        """The readings as text."""
        return "\nor\n".join(map(as_text, self.readings)) or "-"

    def __str__(self) -> str:
        lines = [f"{self.number}  {self.states}: {self.mark}"]
        for reading, difference in zip(self.readings, self.differences, strict=True):
            lines += [*_labelled(self._printed, reading), *_labelled("printed - derived", difference)]
        return "\n".join([*lines, *_labelled("derived", self.derived)])

    def _repr_latex_(self) -> str:
        lines = [latex_words(f"{self.number}  {self.states}: {self.mark}")]
        for reading, difference in zip(self.readings, self.differences, strict=True):
            lines += [latex_words(self._printed) + rf"\quad {as_latex(reading)}"]
            lines += [latex_words("printed - derived") + rf"\quad {as_latex(difference)}"]
        return latex_lines([*lines, latex_words("derived") + rf"\quad {as_latex(self.derived)}"])

    @property
    def _printed(self) -> str:
        return "printed" if self.quoted else "printed, typed"


def _labelled(label: str, matrix: sp.Matrix) -> Iterable[str]:
    first, *others = (part for row in as_text(matrix).splitlines() for part in wrap(row, 96, subsequent_indent="  "))
    return [f"    {label:17}  {first}", *(" " * 23 + line for line in others)]
