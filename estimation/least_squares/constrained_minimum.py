"""Constrained least-squares minimum, its covariance, and the increase of chi-square due to the constraints."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space

from estimation.least_squares.constraints import Constraints, FeasibleRegion
from estimation.least_squares.kkt_conditions import (
    KKT_TOLERANCE,
    ActiveSet,
    ConeProgram,
    KKTConditions,
    LeastSquaresProblem,
    QuadraticModel,
    sum_of_squares,
    svec_size,
)
from estimation.least_squares.levenberg_marquardt import MAX_STEPS, LeastSquaresMinimum
from estimation.multiplicity import chi2_sf
from modeling.chain.pseudo_inertia import PseudoInertia
from modeling.errors import TruewrenchError
from modeling.identifiability import SINGULAR_VALUE_TOLERANCE, UNIDENTIFIABLE_SHARE
from modeling.number_format import P_VALUE, p_value_text
from modeling.significance import LEVELS
from modeling.table import Column, Table, Tabular, Value

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class NullSpaceStep:
    """Minimise |F d - e|² subject to C d = -c, by the null-space method in the whitened parameters.

    rows, targets    F (m, k) and e (m,)
    normals, values  C (c, k) and c (c,)
    """

    local: QuadraticModel
    rows: Array
    targets: Array
    normals: Array
    values: Array

    @cached_property
    def _space(self) -> tuple[Array, Array]:
        """A particular step y that satisfies the constraints, and a basis N of their null space."""
        C = self.normals @ self.local.basis
        size = np.linalg.norm(C, axis=1)
        size[size == 0] = 1.0
        unit = C / size[:, None]
        particular = np.linalg.lstsq(unit, -self.values / size, rcond=SINGULAR_VALUE_TOLERANCE)[0]
        return np.asarray(particular), np.asarray(null_space(unit, rcond=SINGULAR_VALUE_TOLERANCE))

    @cached_property
    def _decomposed(self) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
        """SVD of F N: left vectors, singular values, right vectors, and which of them are identifiable."""
        left, singular, right = np.linalg.svd(self.rows @ self.local.basis @ self._space[1], full_matrices=False)
        return (
            left,
            singular,
            right,
            singular > SINGULAR_VALUE_TOLERANCE * max(float(singular.max(initial=0.0)), 1e-300),
        )

    @property
    def step(self) -> Array:
        """d (k,), of minimum norm along unidentifiable directions."""
        particular, free = self._space
        left, singular, right, regular = self._decomposed
        target = left.T @ (self.targets - self.rows @ (self.local.basis @ particular))
        y = particular + free @ (right[regular].T @ (target[regular] / singular[regular]))
        return np.asarray(self.local.basis @ y)

    @property
    def cost(self) -> float:
        """|F d - e|² after the step."""
        residual = self.rows @ self.step - self.targets
        return float(residual @ residual)

    @property
    def gain(self) -> float:
        """Decrease of |e|² by the step."""
        return max(float(self.targets @ self.targets) - self.cost, 0.0)

    @property
    def covariance(self) -> Array:
        """(k, k) inverse of F'F on the null space of C; unidentifiable directions get no variance."""
        _, singular, right, regular = self._decomposed
        root = self.local.basis @ self._space[1] @ (right[regular].T / singular[regular])
        return np.asarray(root @ root.T)

    @property
    def identifiable(self) -> NDArray[np.bool_]:
        """(k,) whether a parameter is identifiable with the constraints held."""
        _, _, right, regular = self._decomposed
        lost = self.local.basis @ self._space[1] @ null_space(right[regular])
        return np.asarray(np.linalg.norm(self.local.scaled_svd.scale[:, None] * lost, axis=1) < UNIDENTIFIABLE_SHARE)


# Constrained minimum by sequential cone programs, polished by Newton steps on the active set.


MAX_NEWTON_STEPS = 20
"""Most steps on an active set: far more than quadratic convergence takes."""
LEAST_DECREASE = 1e-6
"""Of chi-square: where steps gain less, the point is as near to the conditions as they bring it."""
DAMPING_FACTOR = 10.0
"""By which Levenberg's damping rises after a step without gain, and falls after one with it."""
FIRST_DAMPING = 1e-6
"""Damping after a first step without gain, small beside the curvature of the chi-square, which is 1."""
NEGLIGIBLE_DAMPING = 1e-9
"""Damping that is dropped after a step with gain: it changes a step by less than the solver's tolerance."""
HOPELESS_DAMPING = 1e6
"""Damping at which the search ends: a step a millionth as long as Newton's that gains nothing is rounding."""


def sequential_cone_programs(problem: LeastSquaresProblem, region: FeasibleRegion, start: Array) -> KKTConditions:
    """The minimum of chi-square and prior over the region, from any initial value, with its multipliers.

    Each step minimises the quadratic model over the whole region, so that every iterate after the first is feasible and
    the sum of squares is the merit function; Levenberg damping handles nonlinear predictions. The active set of a step
    is then polished, and the result is the first point that meets the KKT conditions.
    Raises TruewrenchError when the solver finds no point at all.
    """
    local, merit, damping = QuadraticModel.at(problem, start, region.prior), np.inf, 0.0
    conditions = None
    for _ in range(MAX_STEPS):
        solution = ConeProgram(local, region, damping).solve()
        if solution is not None:
            active_set = ActiveSet.of_solution(region, local, solution).at(
                QuadraticModel.at(problem, solution.theta, region.prior)
            )
            cost = active_set.local.cost + region.added(solution.theta)
            if cost < merit:
                conditions = newton_polished(problem, active_set)
                if conditions.met or merit - cost < LEAST_DECREASE:
                    break
                damping = damping / DAMPING_FACTOR if damping > NEGLIGIBLE_DAMPING else 0.0
                local, merit = active_set.local, cost
                continue
        damping = max(DAMPING_FACTOR * damping, FIRST_DAMPING)
        if damping > HOPELESS_DAMPING:
            break
    if conditions is None:
        raise TruewrenchError(
            "constraints: the solver found no solution of the cone program; widen or remove some of them"
        )
    return conditions


def newton_polished(problem: LeastSquaresProblem, active_set: ActiveSet) -> KKTConditions:
    """Newton steps on the KKT conditions with the active set held, as long as they halve the residual.

    A step that corrects the curvature of the boundary can increase the residual before the next one reduces it: one
    such step is allowed.
    """
    best, region, failures = KKTConditions(active_set), active_set.region, 0
    latest = best
    for _ in range(MAX_NEWTON_STEPS):
        if failures > 1 or best.exact:
            break
        latest = KKTConditions(active_set.at(QuadraticModel.at(problem, _tangent_step(latest), region.prior)))
        failures = 0 if latest.residual < best.residual / 2 else failures + 1
        best = latest if latest.residual < best.residual else best
    return best


def _tangent_step(conditions: KKTConditions) -> Array:
    """The point after one step on the active set, active bounds met exactly; halved until the prior is finite."""
    active_set, region = conditions.active_set, conditions.active_set.region
    step = NullSpaceStep(
        active_set.local, *sum_of_squares(active_set, conditions.inner), active_set.normals, active_set.values
    ).step
    theta = _with_active_bounds(active_set, step)
    for _ in range(MAX_STEPS - 1):
        if np.isfinite(region.added(theta)):
            break
        step = step / 2
        theta = _with_active_bounds(active_set, step)
    return theta


def _with_active_bounds(active_set: ActiveSet, step: Array) -> Array:
    """The point a step away from the active set's, its active bounds met exactly."""
    region, theta = active_set.region, active_set.local.theta + step
    return np.asarray(np.where(active_set.low, region.low, np.where(active_set.high, region.high, theta)))


# Active constraints: Lagrange multiplier test (chi-bar-squared) and its interpretation.


class ConstraintInterpretation(Enum):
    """Interpretation of an active constraint."""

    CONTRADICTED = "rejected by the data: the constraint is wrong, or the model lacks an effect"
    NEGATIVE_MASS = "the readings have the sign convention opposite to the stated one, or the model lacks an effect"
    IMPOSSIBLE = "no mass distribution has these moments: the model lacks an effect, or the noise is larger than stated"
    OUTSIDE = "no mass inside has these moments: the volume is wrong, the model lacks an effect, or the noise is larger"
    WITHIN_NOISE = "not significant: the data agree with it"
    UNDETERMINED = "not significant: the data alone hardly determine this quantity, with a std above the bound itself"
    IDLE = "zero multiplier: not determined by the data, or already implied by another constraint"


@dataclass(frozen=True, kw_only=True)
class ActiveConstraint:
    """An active constraint of an estimate, with its test.

    constraint  as text
    quantity    the constrained quantity, at the value `held`, in `unit`
    wanted      its estimate ± `std` without this constraint, the others held; None where the multiplier is zero
    chi_square  increase of the chi-square due to the constraint
    p_value     chance of such an increase if the truth lay on the constraint, from the mixture (chi-bar-squared)
                P(c) = (P(chi²_q-1 > c) + P(chi²_q > c)) / 2: q = 1 for a bound or a simple zero eigenvalue of the
                pseudo-inertia; an upper limit for a cone of q = r (r + 1)/2 dimensions, r zeros (Perlman 1969; Shapiro
                1985). An equality (a fixed parameter) is tested on both sides, chi²_1.
    """

    constraint: str
    quantity: str
    unit: str
    held: float
    wanted: float | None = None
    std: float | None = None
    chi_square: float = 0.0
    p_value: float = 1.0
    pressure: ConstraintInterpretation = ConstraintInterpretation.IDLE

    @property
    def distance(self) -> float:
        """Distance of the constraint from the unconstrained estimate, in std: the root of its chi-square."""
        return float(np.sqrt(self.chi_square))

    @property
    def sentence(self) -> str:
        """The finding in one sentence."""
        start = f"{self.quantity} is held at {self.held:.6g} {self.unit} by {self.constraint}"
        if self.wanted is None:
            return f"{start}: {self.pressure.value}"
        return f"{start}: unconstrained estimate {self._wanted} ({self.distance:.3g} std away): {self.pressure.value}"

    @property
    def _wanted(self) -> str:
        return "-" if self.wanted is None else f"{self.wanted:.6g} ± {self.std:.2g} {self.unit}"

    def row(self) -> tuple[Value, ...]:
        """A row of `ACTIVE_CONSTRAINT_COLUMNS`."""
        numbers = (self.distance, self.chi_square, self.p_value)
        return (self.constraint, self.quantity, self._wanted, *numbers, self.pressure.value)


ACTIVE_CONSTRAINT_COLUMNS = (
    Column("constraint"),
    Column("quantity"),
    Column("unconstrained estimate"),
    Column("std away", format=".3g"),
    Column("chi²", format=".4g"),
    Column("p", format=P_VALUE),
    Column("interpretation"),
)


def active_constraints(conditions: KKTConditions) -> tuple[ActiveConstraint, ...]:
    """Every active constraint of a minimum, by decreasing chi-square."""
    return tuple(sorted(_active_constraints(conditions), key=lambda active: -active.chi_square))


def strictly_active(conditions: KKTConditions) -> NDArray[np.bool_]:
    """(c,) which of the active set's normals belong to a strictly active constraint (nonzero multiplier)."""
    ends = len(conditions.active_set.ends)
    strong = np.abs(conditions.unit_multipliers) > KKT_TOLERANCE
    strong[ends:] = strong[ends:].any()
    return strong


def _active_constraints(conditions: KKTConditions) -> Iterator[ActiveConstraint]:
    active_set, strong = conditions.active_set, strictly_active(conditions)
    alone = np.eye(len(strong), dtype=bool)
    for place, (index, lower) in enumerate(active_set.ends):
        tangent = constraints_lifted(conditions, alone[place]) if strong[place] else None
        yield _active_bound(conditions, index, lower=lower, lifted=tangent)
    if active_set.rank:
        of_inertia = np.arange(len(strong)) >= len(active_set.ends)
        yield _active_inertia(
            conditions, constraints_lifted(conditions, of_inertia) if strong[of_inertia].any() else None
        )


def constraints_lifted(conditions: KKTConditions, spared: NDArray[np.bool_]) -> NullSpaceStep:
    """Quadratic problem with the strictly active and fixed constraints held, except those in `spared` (c,).

    With none spared its covariance is that along the active set, the curvature of the cone included; times the
    derivative's transpose it is the sensitivity of the estimate to the readings.
    """
    active_set = conditions.active_set
    held = (strictly_active(conditions) | active_set.sign_free) & ~spared
    curved = conditions.inner if held[len(active_set.ends) :].any() else None
    return NullSpaceStep(
        active_set.local, *sum_of_squares(active_set, curved), active_set.normals[held], np.zeros(int(held.sum()))
    )


def _active_bound(
    conditions: KKTConditions, index: int, *, lower: bool, lifted: NullSpaceStep | None
) -> ActiveConstraint:
    region, local = conditions.active_set.region, conditions.active_set.local
    parameter, held = region.parameters[index], float(local.theta[index])
    idle = ActiveConstraint(
        constraint=region.text(index, lower=lower), quantity=parameter.name, unit=parameter.unit, held=held
    )
    if lifted is None:
        return idle
    wanted, std = held + float(lifted.step[index]), float(np.sqrt(lifted.covariance[index, index]))
    cost = lifted.gain
    p_value = float(chi2_sf(cost, 1)) if region.fixed[index] else chi_bar_squared_sf(cost, 1)
    against = (
        ConstraintInterpretation.NEGATIVE_MASS
        if parameter.name == "m" and wanted < 0
        else ConstraintInterpretation.CONTRADICTED
    )
    return _tested(idle, wanted, std, cost, p_value, against)


def _active_inertia(conditions: KKTConditions, lifted: NullSpaceStep | None) -> ActiveConstraint:
    active_set, inertia, cone = (
        conditions.active_set,
        conditions.active_set.region.inertia,
        conditions.active_set.region.cone,
    )
    assert inertia is not None
    assert cone is not None
    theta = active_set.local.theta if lifted is None else active_set.local.theta + lifted.step
    quantity, unit, vector = most_negative_moment(inertia, theta)
    first, at_minimum = inertia.mass[0], inertia.at(active_set.local.theta)
    if unit == "kg":
        held = float(at_minimum[first, first])
    else:  # the margin
        least = most_negative_moment(inertia, active_set.local.theta)[2]
        held = float(least @ at_minimum @ least)
    idle = ActiveConstraint(constraint=cone.condition, quantity=quantity, unit=unit, held=held)
    if lifted is None:
        return idle
    form = np.einsum("n,knm,m->k", vector, inertia.slopes, vector)
    wanted = float(vector @ inertia.at(theta) @ vector)
    std = float(np.sqrt(form @ lifted.covariance @ form))
    p_value = chi_bar_squared_sf(lifted.gain, svec_size(active_set.rank))
    against = ConstraintInterpretation.OUTSIDE if inertia.room else ConstraintInterpretation.IMPOSSIBLE
    against = ConstraintInterpretation.NEGATIVE_MASS if unit == "kg" else against
    return _tested(idle, wanted, std, lifted.gain, p_value, against)


def _tested(
    idle: ActiveConstraint, wanted: float, std: float, cost: float, p_value: float, against: ConstraintInterpretation
) -> ActiveConstraint:
    pressure = against
    if p_value >= LEVELS.constraint:
        # The margin of the pseudo-inertia is no bound that a std compares with.
        of_shape = (ConstraintInterpretation.IMPOSSIBLE, ConstraintInterpretation.OUTSIDE)
        vague = against not in of_shape and std > abs(idle.held) > 0
        pressure = ConstraintInterpretation.UNDETERMINED if vague else ConstraintInterpretation.WITHIN_NOISE
    return replace(idle, wanted=wanted, std=std, chi_square=cost, p_value=p_value, pressure=pressure)


def chi_bar_squared_sf(cost: float, q: int) -> float:
    """(P(chi²_q-1 > cost) + P(chi²_q > cost)) / 2."""
    lower = chi2_sf(cost, q - 1) if q > 1 else float(cost <= 0)
    return float(lower + chi2_sf(cost, q)) / 2


def most_negative_moment(inertia: PseudoInertia, theta: Array) -> tuple[str, str, Array]:
    """The most negative moment of J(theta): its name, unit and the vector w with value w' J w in that unit.

    It is the mass where that is negative. Otherwise the second moments about the centre of mass, the Schur complement
    S = J_oo - J_om J_mm^-1 J_mo of the mass's rows: u' S u = w' J w with w = (-J_mm^-1 J_mo u, u).
    """
    J, mass = inertia.at(theta), list(inertia.mass)
    others = [i for i in range(inertia.size) if i not in mass]
    vector = np.zeros(inertia.size)
    if J[mass[0], mass[0]] <= 0:
        vector[mass[0]] = 1.0
        return "mass", "kg", vector
    share = np.linalg.solve(J[np.ix_(mass, mass)], J[np.ix_(mass, others)])
    about_centre = J[np.ix_(others, others)] - J[np.ix_(others, mass)] @ share
    u = np.linalg.eigh(about_centre)[1][:, 0]
    vector[others], vector[mass] = u, -share @ u
    farthest = others[int(np.abs(u).argmax())] - (inertia.size - len(inertia.room))
    if inertia.room and farthest >= 0:
        return inertia.room[farthest], "kg m²", vector
    if len(others) == 1:
        return "inertia about the centre of mass", "kg m²", vector
    along = ", ".join(f"{x:.2f}" for x in u)
    return f"second moment about the centre of mass along ({along})", "kg m²", vector


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
        conditions = KKTConditions(ActiveSet.touched(region, QuadraticModel.at(problem, free.theta, None)))
    else:
        conditions = sequential_cone_programs(problem, region, free.theta)
    relaxed = free if feasible else constraints_lifted(conditions, ~conditions.active_set.sign_free)
    return ConstrainedMinimum(
        theta=conditions.active_set.local.theta,
        covariance=relaxed.covariance * np.outer(~region.fixed, ~region.fixed),
        identifiable=relaxed.identifiable,
        cost=free.cost if feasible else conditions.active_set.local.cost,
        converged=free.converged if feasible else conditions.met,
        free=free,
        region=region,
        optimality=conditions,
    )
