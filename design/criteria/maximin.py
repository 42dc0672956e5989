"""Maximin criterion: smooth minimum of several criteria."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from design.criteria.criterion import Criterion, diagonal_blocks
from modeling.errors import InputError


@dataclass(frozen=True)
class MaximinCriterion(Criterion):
    """-(1/p) ln sum_i exp(-p criterion_i(M_ii)), p = `power`, M_ii the diagonal blocks of M: a smooth minimum.

    Block i has sizes[i] rows. From max <= sum of m <= m max: value <= smallest <= value + ln(m) / p, so that the value
    is a lower bound (0.09 less at most for 4 blocks and p = 16: a lambda 8 % smaller). It is concave and
    monotone in M as its members are, because the logarithm of a sum of exponentials is convex and monotone (Boyd and
    Vandenberghe 2004, section 3.1.5), and grows with ln M as they do when they all have one degree.
    """

    criteria: tuple[Criterion, ...]
    sizes: tuple[int, ...]
    power: float = 16.0

    name = "maximin"

    def __post_init__(self) -> None:
        if not self.criteria or len(self.criteria) != len(self.sizes) or min(self.sizes) < 1 or self.power <= 0:
            raise InputError(
                what=f"{len(self.criteria)} criteria of blocks of {self.sizes} rows, power {self.power}",
                where="maximin criterion",
                remedy="give each criterion the number of rows of its block, and a power above zero",
            )

    def blocks(self, information: Any) -> list[Any]:
        """A block for each criterion; ValueError when M is not of their rows."""
        return diagonal_blocks(information, self.sizes)

    def expression(self, information: Any) -> Any:
        """The smooth minimum, with the smallest factored out of the sum so that nothing overflows."""
        import casadi as ca

        members = zip(self.criteria, self.blocks(information), strict=True)
        values = ca.vertcat(*[criterion.expression(block) for criterion, block in members])
        least = ca.mmin(values)
        return least - ca.log(ca.sum1(ca.exp(-self.power * (values - least)))) / self.power

    def degree(self, size: int) -> float:
        """The degree of the members; ValueError unless they agree."""
        degrees = {c.degree(rows) for c, rows in zip(self.criteria, self.sizes, strict=True)}
        if len(degrees) > 1:
            raise ValueError(f"members of one degree were expected, and {sorted(degrees)} came")
        return degrees.pop()

    def __str__(self) -> str:
        return f"maximin of {len(self.criteria)} x {self.criteria[0]}"
