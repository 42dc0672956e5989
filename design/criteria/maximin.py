"""Maximin criterion: smooth minimum of several criteria."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import block_diag
from scipy.special import logsumexp, softmax

from design.criteria.criterion import Array, Criterion
from modeling.errors import InputError


@dataclass(frozen=True)
class MaximinCriterion(Criterion):
    """-(1/p) ln sum_i exp(-p criterion_i(M_ii)), p = `power`, M_ii the diagonal blocks of M: a smooth minimum.

    Block i has sizes[i] rows. From max <= sum of m <= m max: value <= smallest <= value + ln(m) / p, so that the value
    is a lower bound (0.09 less at most for 4 blocks and p = 16: a lambda 8 % smaller). It is concave and
    monotone in M as its members are, because the logarithm of a sum of exponentials is convex and monotone (Boyd and
    Vandenberghe 2004, section 3.1.5), and grows with ln M as they do when they all have one degree.
    The gradient weighs those of the members by w_i ~ exp(-p criterion_i).
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

    @property
    def gap(self) -> float:
        """The largest excess of the smallest criterion over the value."""
        return float(np.log(len(self.criteria)) / self.power)

    def value(self, information: Array) -> float:
        """The smooth minimum of the blocks' values."""
        values = self._values(information)
        return -float(logsumexp(-self.power * values) / self.power) if np.isfinite(values).all() else -np.inf

    def gradient(self, information: Array) -> Array:
        """Block diagonal: the members' gradients with their softmax weights."""
        gradients = [c.gradient(block) for c, block in self._pairs(information)]
        weights = softmax(-self.power * self._values(information))
        return np.asarray(block_diag(*[w * gradient for w, gradient in zip(weights, gradients, strict=True)]))

    def expression(self, information: Any) -> Any:
        """The same, with the smallest factored out of the sum so that nothing overflows."""
        import casadi as ca

        values = ca.vertcat(*[c.expression(block) for c, block in self._pairs(information)])
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

    def _values(self, information: Array) -> Array:
        return np.array([c.value(block) for c, block in self._pairs(information)])

    def _pairs(self, information: Any) -> list[tuple[Criterion, Any]]:
        if information.shape[0] != sum(self.sizes):
            raise ValueError(f"{sum(self.sizes)} rows were expected, and {information.shape[0]} came")
        ends = np.cumsum(self.sizes)
        places = [slice(int(end - size), int(end)) for end, size in zip(ends, self.sizes, strict=True)]
        return [(c, information[place, place]) for c, place in zip(self.criteria, places, strict=True)]
