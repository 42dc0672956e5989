"""Bayesian criterion: expectation of a criterion over a discrete prior."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from design.criteria.criterion import Criterion, diagonal_blocks
from modeling.errors import InputError


@dataclass(frozen=True)
class BayesianCriterion(Criterion):
    """sum_i w_i criterion(M_ii), M_ii the i-th of the m diagonal blocks of M: the expectation over a prior.

    The information of a model that is not linear depends on the parameters. With rows [S(theta_1) .. S(theta_m)] of
    sensitivities (`Experiment.prior`) the blocks are M(theta_i), and this is E[criterion(M(theta))] for a prior with
    weights w_i (Chaloner and Verdinelli 1995, section 4.2): concave and monotone in M, as the criterion is in a block.
    """

    criterion: Criterion
    weights: tuple[float, ...]

    name = "Bayesian"

    def __post_init__(self) -> None:
        if not self.weights or min(self.weights) <= 0 or abs(sum(self.weights) - 1) > 1e-9:  # rounding of decimals
            raise InputError(
                what=f"the weights {self.weights} are not positive numbers that add up to 1",
                where="prior",
                remedy="leave out sets of no weight and divide the others by their sum",
            )

    def blocks(self, information: Any) -> list[Any]:
        """The m blocks; ValueError when M has not as many."""
        return diagonal_blocks(information, [information.shape[0] // len(self.weights)] * len(self.weights))

    def expression(self, information: Any) -> Any:
        """The mean of the blocks' expressions."""
        blocks = zip(self.weights, self.blocks(information), strict=True)
        return sum(w * self.criterion.expression(block) for w, block in blocks)

    def degree(self, size: int) -> float:
        """The degree of the criterion of one block."""
        return self.criterion.degree(size // len(self.weights))

    def __str__(self) -> str:
        return f"Bayesian {self.criterion} over {len(self.weights)} sets of parameter values"
