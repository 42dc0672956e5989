"""Constrained least-squares minimum, its covariance, and the increase of chi-square due to the constraints."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from estimation.least_squares.constrained.active_constraint import (
    ACTIVE_CONSTRAINT_COLUMNS,
    ActiveConstraint,
    active_constraints,
    chi_bar_squared_sf,
    constraints_lifted,
    strictly_active,
)
from estimation.least_squares.constrained.active_set import ActiveSet
from estimation.least_squares.constrained.kkt_conditions import KKTConditions
from estimation.least_squares.constrained.quadratic_model import LeastSquaresProblem, QuadraticModel
from estimation.least_squares.constrained.sequential_cone_programs import sequential_cone_programs
from estimation.least_squares.constraints.constraints import Constraints
from estimation.least_squares.constraints.feasible_region import FeasibleRegion
from estimation.least_squares.levenberg_marquardt import LeastSquaresMinimum
from modeling.number_format import p_value_text
from modeling.table import Table, Tabular

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ConstrainedMinimum(Tabular):
    """Parameters at the minimum of chi-square and prior within a region; extends `LeastSquaresMinimum`.

    theta       (k,)
    covariance  (k, k) of data and prior, zero for a fixed parameter. Active inequalities are not treated as equalities:
                the region is convex, so that the constrained estimate is nearer to any truth inside than the
                unconstrained one, in the metric of the data, and the unconstrained covariance is conservative; that on
                the tangent (`constraints_lifted` of none) would be far too small where the truth lies off the boundary
    identifiable  (k,) whether data and prior identify a parameter
    cost        chi-square of the data alone
    converged   whether the KKT conditions are met
    free        the unconstrained minimum (parameters' own bounds only)
    optimality  multipliers and residual of the KKT conditions
    """

    theta: Array
    covariance: Array
    identifiable: NDArray[np.bool_]
    cost: float
    converged: bool
    free: LeastSquaresMinimum
    region: FeasibleRegion
    optimality: KKTConditions

    @cached_property
    def active(self) -> tuple[ActiveConstraint, ...]:
        """The active constraints, by decreasing chi-square."""
        return active_constraints(self.optimality)

    @property
    def rise(self) -> float:
        """Increase of the data's chi-square above the unconstrained minimum."""
        return max(self.cost - self.free.cost, 0.0)

    @property
    def pulled(self) -> float:
        """Contribution of the prior's divergence to the chi-square."""
        return self.region.added(self.theta)

    @property
    def p_value(self) -> float | None:
        """p-value of the rise if the truth satisfies all constraints: an upper limit, as in `ActiveConstraint`.

        None with a prior, which biases the estimate in any case.
        """
        count = int(strictly_active(self.optimality).sum())
        return None if self.region.prior is not None else chi_bar_squared_sf(self.rise, count) if count else 1.0

    @property
    def table(self) -> Table:
        """Each active constraint with its test."""
        return Table.of(ACTIVE_CONSTRAINT_COLUMNS, [active.row() for active in self.active])

    def printed(self) -> list[Table | str]:
        """Active constraints, and what they and the prior add to the chi-square."""
        inactive = "no constraint is active" + (
            ": this is the unconstrained minimum" if self.region.prior is None else ""
        )
        lines: list[Table | str] = [self.table if self.active else inactive]
        if self.rise:
            chance = "" if self.p_value is None else f" ({p_value_text(self.p_value, '<=')})"
            lines.append(f"chi-square {self.cost:.6g}, {self.rise:.4g} above the unconstrained minimum{chance}")
        if self.region.prior is not None:
            lines.append(f"the prior adds {self.pulled:.4g} to the chi-square")
        if not self.converged:
            lines.append("not converged: the KKT conditions are not met, the estimates are not final")
        return lines


def minimise_constrained(problem: LeastSquaresProblem, start: Array, constraints: Constraints) -> ConstrainedMinimum:
    """The minimum of chi-square and prior under constraints.

    The unconstrained minimum where it is feasible. Otherwise by `sequential_cone_programs` from there.
    Raises InputError when the constraints have unknown names, are infeasible together or fit no tool.
    """
    region = constraints.region(problem.layout)
    free = problem.minimise(start)
    feasible = region.prior is None and region.contains(free.theta)
    if feasible:  # a bound of an effect may be active
        found = KKTConditions(ActiveSet.touched(region, QuadraticModel.at(problem, free.theta, None)))
    else:
        found = sequential_cone_programs(problem, region, free.theta)
    relaxed = free if feasible else constraints_lifted(found, ~found.active_set.sign_free)
    return ConstrainedMinimum(
        theta=found.active_set.local.theta,
        covariance=relaxed.covariance * np.outer(~region.fixed, ~region.fixed),
        identifiable=relaxed.identifiable,
        cost=free.cost if feasible else found.active_set.local.cost,
        converged=free.converged if feasible else found.met,
        free=free,
        region=region,
        optimality=found,
    )
