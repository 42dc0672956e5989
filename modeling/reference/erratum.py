"""An erratum of chapter 22 (Bassi et al.), proved by differences that must vanish or must not."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import sympy as sp

from modeling.reference.equation import simplified_entries
from modeling.reference.notation import as_latex, as_text, latex_lines, latex_words


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
