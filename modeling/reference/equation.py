"""An equation of chapter 22 (Bassi et al.) as printed, its derivation, and the verdict by SymPy."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from textwrap import wrap

import sympy as sp

from modeling.table import Column, Table, Tabular

# Symbols of chapter 22 (Bassi et al.) in plain text and in LaTeX.


LATEX = {
    "dphi": r"\dot\varphi", "ddphi": r"\ddot\varphi", "phi": r"\varphi", "ax": "a_x", "ay": "a_y", "vx": "v_x",
    "vy": "v_y", "mlg": "m l_g", "bias_fx": "b_x", "bias_fy": "b_y", "bias_tau": r"b_\tau", "fcx": "f_{cx}",
    "fcy": "f_{cy}", "tauc": r"\tau_c", "fx": "f_x", "fy": "f_y", "tau": r"\tau",
}  # fmt: skip
"""LaTeX of signals and parameters, by name."""


def as_text(matrix: sp.Matrix) -> str:
    """A matrix as text, row by row, entries separated by two spaces."""
    return "\n".join("  ".join(sp.sstr(e, full_prec=False) for e in matrix.row(i)) for i in range(matrix.rows))


def as_latex(matrix: sp.Matrix) -> str:
    """A matrix, or its single entry, as LaTeX without $."""
    names = {s: LATEX[s.name] for s in matrix.free_symbols if isinstance(s, sp.Symbol) and s.name in LATEX}
    return str(sp.latex(matrix[0] if matrix.shape == (1, 1) else matrix, symbol_names=names))


def latex_words(text: str) -> str:
    """Text within LaTeX, underscores escaped."""
    return rf"\text{{{text}}}".replace("_", r"\_")


def latex_lines(lines: list[str]) -> str:
    """Aligned lines of LaTeX, for a notebook."""
    return "$\\displaystyle \\begin{aligned}" + r" \\ ".join(f"&{line}" for line in lines) + r"\end{aligned}$"


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
    readings  the printed right-hand side, in every possible reading
    derived   the derived right-hand side
    constants symbols in a reading with free values: it agrees if any value makes it correct
    erratum   its number in PHYSICS.md, if any
    """

    number: str
    states: str
    derived: sp.Matrix
    readings: tuple[sp.Matrix, ...]
    constants: tuple[sp.Symbol, ...] = ()
    erratum: int | None = None

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
        }
        return marks.get(self.verdict, self.verdict.value)

    @property
    def row(self) -> tuple[str, str, str, str]:
        """Number, printed, derived and verdict, as a table row."""
        return f"{self.number} {self.states}", self.printed_text, as_text(self.derived), self.mark

    @property
    def printed_text(self) -> str:
        """The readings as text."""
        return "\nor\n".join(map(as_text, self.readings))

    def __str__(self) -> str:
        lines = [f"{self.number}  {self.states}: {self.mark}"]
        for reading, difference in zip(self.readings, self.differences, strict=True):
            lines += [*_labelled("printed", reading), *_labelled("printed - derived", difference)]
        return "\n".join([*lines, *_labelled("derived", self.derived)])

    def _repr_latex_(self) -> str:
        lines = [latex_words(f"{self.number}  {self.states}: {self.mark}")]
        for reading, difference in zip(self.readings, self.differences, strict=True):
            lines += [latex_words("printed") + rf"\quad {as_latex(reading)}"]
            lines += [latex_words("printed - derived") + rf"\quad {as_latex(difference)}"]
        return latex_lines([*lines, latex_words("derived") + rf"\quad {as_latex(self.derived)}"])


def _labelled(label: str, matrix: sp.Matrix) -> Iterable[str]:
    first, *others = (piece for row in as_text(matrix).splitlines() for piece in wrap(row, 96, subsequent_indent="  "))
    return [f"    {label:17}  {first}", *(" " * 23 + line for line in others)]


# An erratum of chapter 22 (Bassi et al.), proved by differences that must vanish or must not.


@dataclass(frozen=True, eq=False)
class ErratumProof:
    """A difference of two expressions; `equal` is whether it must vanish for the claim to hold."""

    claim: str
    difference: sp.Matrix
    equal: bool

    @classmethod
    def same(cls, claim: str, left: sp.Expr | sp.Matrix, right: sp.Expr | sp.Matrix) -> ErratumProof:
        """The claim that left and right are equal."""
        return cls(claim, _difference(left, right), equal=True)

    @classmethod
    def other(cls, claim: str, left: sp.Expr | sp.Matrix, right: sp.Expr | sp.Matrix) -> ErratumProof:
        """The claim that left and right differ."""
        return cls(claim, _difference(left, right), equal=False)

    @cached_property
    def holds(self) -> bool:
        """Whether the difference vanishes or not, as claimed."""
        return bool(self.difference.is_zero_matrix) is self.equal

    @property
    def mark(self) -> str:
        """Whether it is proved, as text."""
        return "proved" if self.holds else "NOT PROVED"

    def __str__(self) -> str:
        text = "0" if self.difference.is_zero_matrix else as_text(self.difference)
        return "\n".join([f"  {self.mark}: {self.claim}", *(f"      {line}" for line in text.splitlines())])

    def latex(self) -> str:
        """The claim and its difference."""
        latex = "0" if self.difference.is_zero_matrix else as_latex(self.difference)
        return latex_words(f"{self.mark}: {self.claim}") + rf"\quad {latex}"


@dataclass(frozen=True, eq=False)
class Erratum:
    """One erratum of PHYSICS.md, by its number there."""

    number: int
    says: str
    proofs: tuple[ErratumProof, ...]

    @property
    def proven(self) -> bool:
        """Whether every difference is as claimed."""
        return bool(self.proofs) and all(proof.holds for proof in self.proofs)

    @property
    def row(self) -> tuple[str, str, str]:
        """Number, claim and how many of its differences hold."""
        proved = sum(proof.holds for proof in self.proofs)
        return str(self.number), self.says, f"{proved} of {len(self.proofs)} differences"

    def __str__(self) -> str:
        return "\n".join([f"erratum {self.number}: {self.says}", *map(str, self.proofs)])

    def _repr_latex_(self) -> str:
        return latex_lines(
            [latex_words(f"erratum {self.number}: {self.says}"), *(proof.latex() for proof in self.proofs)]
        )


def _difference(left: sp.Expr | sp.Matrix, right: sp.Expr | sp.Matrix) -> sp.Matrix:
    difference = left - right
    return simplified_entries(difference if isinstance(difference, sp.MatrixBase) else sp.Matrix([difference]))


# Tables of the equations and errata of chapter 22 (Bassi et al.), as text and HTML.


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
