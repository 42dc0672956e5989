"""Erratum: a claim that something is wrong in the chapter, with differences that have to vanish or must not."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import sympy as sp

from modeling.chapter.equation import reduced
from modeling.chapter.notation import as_latex, as_text, lines, words


@dataclass(frozen=True, eq=False)
class Proof:
    """A difference of two expressions; `equal` says whether it has to be zero for the claim to hold."""

    claim: str
    difference: sp.Matrix
    equal: bool

    @classmethod
    def same(cls, claim: str, left: sp.Expr | sp.Matrix, right: sp.Expr | sp.Matrix) -> Proof:
        """left and right are one."""
        return cls(claim, _difference(left, right), equal=True)

    @classmethod
    def other(cls, claim: str, left: sp.Expr | sp.Matrix, right: sp.Expr | sp.Matrix) -> Proof:
        """left and right are not the same."""
        return cls(claim, _difference(left, right), equal=False)

    @cached_property
    def holds(self) -> bool:
        """Whether the difference is as claimed."""
        return bool(self.difference.is_zero_matrix) is self.equal

    @property
    def mark(self) -> str:
        """Shown or not."""
        return "shown" if self.holds else "NOT SHOWN"

    def __str__(self) -> str:
        shown = "0" if self.difference.is_zero_matrix else as_text(self.difference)
        return "\n".join([f"  {self.mark}: {self.claim}", *(f"      {line}" for line in shown.splitlines())])

    def latex(self) -> str:
        """The claim and its difference."""
        shown = "0" if self.difference.is_zero_matrix else as_latex(self.difference)
        return words(f"{self.mark}: {self.claim}") + rf"\quad {shown}"


@dataclass(frozen=True, eq=False)
class Erratum:
    """One erratum of PHYSICS.md, by its number there."""

    number: int
    says: str
    proofs: tuple[Proof, ...]

    @property
    def proven(self) -> bool:
        """Whether every difference is as claimed."""
        return bool(self.proofs) and all(proof.holds for proof in self.proofs)

    @property
    def row(self) -> tuple[str, str, str]:
        """Number, claim and how many differences show it."""
        shown = sum(proof.holds for proof in self.proofs)
        return str(self.number), self.says, f"{shown} of {len(self.proofs)} differences"

    def __str__(self) -> str:
        return "\n".join([f"erratum {self.number}: {self.says}", *map(str, self.proofs)])

    def _repr_latex_(self) -> str:
        return lines([words(f"erratum {self.number}: {self.says}"), *(proof.latex() for proof in self.proofs)])


def _difference(left: sp.Expr | sp.Matrix, right: sp.Expr | sp.Matrix) -> sp.Matrix:
    difference = left - right
    return reduced(difference if isinstance(difference, sp.MatrixBase) else sp.Matrix([difference]))
