"""ConstrainedMinimum: the unknowns that fit best within the constraints, and what the constraints cost."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from estimation.constrained.active import HEADER, Active, chi_bar, findings, lifted, pressing, probability
from estimation.constrained.cone_descent import descend
from estimation.constrained.constraints import Constraints
from estimation.constrained.edge import Edge
from estimation.constrained.local_model import LeastSquares, LocalModel
from estimation.constrained.optimality import Optimality
from estimation.constrained.region import Region
from estimation.linear.descent import Minimum
from estimation.linear.estimate import table

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ConstrainedMinimum:
    """Unknowns at the minimum of chi-square and prior within a region, with what `estimation.descent.Minimum` has.

    theta       (k,)
    covariance  (k, k) of data and prior, without an unknown that is fixed. Ends and the cone are not taken for exact:
                the region is convex, so that an estimate inside is nearer to any truth inside than the free one, in
                the metric of the data, and the free doubt about it is enough; along the edge alone (`along_edge`)
                would be far too little where the truth lies off it
    shown       (k,) whether data and prior tell an unknown apart
    cost        chi-square of the data alone
    converged   whether the conditions of optimality are met
    free        the minimum without stated constraints
    optimality  multipliers, and what is left of the conditions
    """

    theta: Array
    covariance: Array
    shown: NDArray[np.bool_]
    cost: float
    converged: bool
    free: Minimum
    region: Region
    optimality: Optimality

    @cached_property
    def active(self) -> tuple[Active, ...]:
        """The constraints that the estimate rests on, the costliest first."""
        return findings(self.optimality)

    @cached_property
    def along_edge(self) -> Array:
        """Covariance (k, k) with the constraints that press taken for exact: on their tangent, the cone's curve kept.

        Its product with the derivative's transpose is how the estimate follows the readings as long as they press.
        """
        return lifted(self.optimality, np.zeros(len(self.optimality.strengths), dtype=bool)).covariance

    @property
    def rise(self) -> float:
        """Chi-square of the data above the free minimum."""
        return max(self.cost - self.free.cost, 0.0)

    @property
    def pulled(self) -> float:
        """What the prior's divergence adds to the chi-square."""
        return self.region.added(self.theta)

    @property
    def p_value(self) -> float | None:
        """Chance of such a rise if the truth keeps the constraints: an upper limit, as in `Active`, for all of them.

        None with a prior, which moves the estimate whatever the data say.
        """
        count = int(pressing(self.optimality).sum())
        return None if self.region.prior is not None else chi_bar(self.rise, count) if count else 1.0

    def rows(self) -> list[tuple[str, ...]]:
        """Each active constraint as text, under `active.HEADER`."""
        return [row for active in self.active for row in active.rows()]

    def __str__(self) -> str:
        untouched = "no constraint is active" + (": this is the free minimum" if self.region.prior is None else "")
        lines = [table(HEADER, self.rows()) if self.active else untouched]
        if self.rise:
            chance = "" if self.p_value is None else f" (p <= {probability(self.p_value)})"
            lines.append(f"chi-square {self.cost:.6g}, {self.rise:.4g} above the free minimum{chance}")
        if self.region.prior is not None:
            lines.append(f"the prior adds {self.pulled:.4g} to the chi-square")
        if not self.converged:
            lines.append("not converged: the conditions of optimality are not met, the values may move on")
        return "\n".join(lines)


def minimise(problem: LeastSquares, start: Array, constraints: Constraints) -> ConstrainedMinimum:
    """The minimum of chi-square and prior under constraints.

    The free minimum, untouched, where it keeps them. Otherwise by `descend` from there.
    Raises InputError when the constraints name what is unknown, contradict each other or suit no tool.
    """
    region = constraints.region(problem.layout)
    free = problem.minimise(start)
    if region.prior is None and region.contains(free.theta):
        return _kept(problem, region, free)
    found = descend(problem, region, free.theta)
    doubt = lifted(found, ~found.edge.either_way)
    loose = ~region.fixed
    return ConstrainedMinimum(
        theta=found.edge.local.theta,
        covariance=doubt.covariance * np.outer(loose, loose),
        shown=doubt.shown,
        cost=found.edge.local.cost,
        converged=found.met,
        free=free,
        region=region,
        optimality=found,
    )


def _kept(problem: LeastSquares, region: Region, free: Minimum) -> ConstrainedMinimum:
    """The free minimum, as it is; it may rest on an effect's own range."""
    return ConstrainedMinimum(
        theta=free.theta,
        covariance=free.covariance,
        shown=free.shown,
        cost=free.cost,
        converged=free.converged,
        free=free,
        region=region,
        optimality=Optimality(Edge.touched(region, LocalModel.at(problem, free.theta, None))),
    )
