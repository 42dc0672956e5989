"""Active constraints: Lagrange multiplier test (chi-bar-squared) and its interpretation."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from estimation.distributions import chi2_sf
from estimation.least_squares.constrained.active_set import svec_size
from estimation.least_squares.constrained.kkt_conditions import KKT_TOLERANCE, KKTConditions, sum_of_squares
from estimation.least_squares.constrained.null_space_step import NullSpaceStep
from modeling.chain.pseudo_inertia import PseudoInertia
from modeling.number_format import P_VALUE
from modeling.significance import LEVELS
from modeling.table import Column, Value

Array = NDArray[np.float64]


class ConstraintInterpretation(Enum):
    """Interpretation of an active constraint."""

    CONTRADICTED = "rejected by the data: the constraint is wrong, or the model lacks an effect"
    NEGATIVE_MASS = "the readings have the sign convention opposite to the stated one, or the model lacks an effect"
    IMPOSSIBLE = "no mass distribution has these moments: the model lacks an effect, or the noise is larger than stated"
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


def active_constraints(found: KKTConditions) -> tuple[ActiveConstraint, ...]:
    """Every active constraint of a minimum, by decreasing chi-square."""
    return tuple(sorted(_active_constraints(found), key=lambda active: -active.chi_square))


def strictly_active(found: KKTConditions) -> NDArray[np.bool_]:
    """(c,) which of the active set's normals belong to a strictly active constraint (nonzero multiplier)."""
    ends = len(found.active_set.ends)
    strong = np.abs(found.unit_multipliers) > KKT_TOLERANCE
    strong[ends:] = strong[ends:].any()
    return strong


def _active_constraints(found: KKTConditions) -> Iterator[ActiveConstraint]:
    active_set, strong = found.active_set, strictly_active(found)
    alone = np.eye(len(strong), dtype=bool)
    for place, (index, lower) in enumerate(active_set.ends):
        tangent = constraints_lifted(found, alone[place]) if strong[place] else None
        yield _active_bound(found, index, lower=lower, lifted=tangent)
    if active_set.rank:
        of_inertia = np.arange(len(strong)) >= len(active_set.ends)
        yield _active_inertia(found, constraints_lifted(found, of_inertia) if strong[of_inertia].any() else None)


def constraints_lifted(found: KKTConditions, spared: NDArray[np.bool_]) -> NullSpaceStep:
    """Quadratic problem with the strictly active and fixed constraints held, except those in `spared` (c,).

    With none spared its covariance is that along the active set, the curvature of the cone included; times the
    derivative's transpose it is the sensitivity of the estimate to the readings.
    """
    active_set = found.active_set
    held = (strictly_active(found) | active_set.sign_free) & ~spared
    curved = found.inner if held[len(active_set.ends) :].any() else None
    return NullSpaceStep(
        active_set.local, *sum_of_squares(active_set, curved), active_set.normals[held], np.zeros(int(held.sum()))
    )


def _active_bound(found: KKTConditions, index: int, *, lower: bool, lifted: NullSpaceStep | None) -> ActiveConstraint:
    region, local = found.active_set.region, found.active_set.local
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


def _active_inertia(found: KKTConditions, lifted: NullSpaceStep | None) -> ActiveConstraint:
    active_set, inertia, cone = found.active_set, found.active_set.region.inertia, found.active_set.region.cone
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
    against = ConstraintInterpretation.NEGATIVE_MASS if unit == "kg" else ConstraintInterpretation.IMPOSSIBLE
    return _tested(idle, wanted, std, lifted.gain, p_value, against)


def _tested(
    idle: ActiveConstraint, wanted: float, std: float, cost: float, p_value: float, against: ConstraintInterpretation
) -> ActiveConstraint:
    pressure = against
    if p_value >= LEVELS.constraint:
        # The margin of the pseudo-inertia is no bound that a std compares with.
        vague = against is not ConstraintInterpretation.IMPOSSIBLE and std > abs(idle.held) > 0
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
    if len(others) == 1:
        return "inertia about the centre of mass", "kg m²", vector
    along = ", ".join(f"{x:.2f}" for x in u)
    return f"second moment about the centre of mass along ({along})", "kg m²", vector
