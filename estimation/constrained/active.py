"""Active: a constraint that holds an estimate back, and what that says about the data."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from estimation.constrained.edge import svec_size
from estimation.constrained.optimality import OPTIMAL, Optimality, sum_of_squares
from estimation.constrained.tangent import Tangent
from estimation.distributions import chi2_sf
from modeling.pseudo_inertia import PseudoInertia

Array = NDArray[np.float64]

SURE = 1e-3
"""Chance below which noise alone does not push an estimate against a constraint: 3 std to one side."""


class Pressure(Enum):
    """What a constraint on which the estimate rests says about the data, in words."""

    CONTRADICTED = "the data contradict it: the constraint is wrong, or physics is missing"
    NEGATIVE_MASS = "the readings have the other sign than was stated, or physics is missing"
    IMPOSSIBLE = "no distribution of mass moves like that: physics is missing, or the noise is larger than stated"
    WITHIN_NOISE = "within noise: the data agree with it, and hardly show this"
    IDLE = "costs nothing: the data leave it open, or another constraint holds it already"


@dataclass(frozen=True, kw_only=True)
class Active:
    """A constraint on which an estimate rests.

    constraint  in words
    quantity    what it holds, at `held`, in `unit`
    wanted      its estimate ± `std` with this constraint lifted and the others kept; None where it costs nothing
    chi_square  what the constraint costs
    p_value     chance of a cost as high if the truth lay on the constraint, from the mixture (chi-bar-squared)
                P(c) = (P(chi²_q-1 > c) + P(chi²_q > c)) / 2: q = 1 for an end or a simple zero of the pseudo-inertia;
                an upper limit for a cone of q = r (r + 1)/2 dimensions, r zeros (Perlman 1969; Shapiro 1985). An end
                that fixes its parameter is tested both ways, chi²_1.
    """

    constraint: str
    quantity: str
    unit: str
    held: float
    wanted: float | None = None
    std: float | None = None
    chi_square: float = 0.0
    p_value: float = 1.0
    pressure: Pressure = Pressure.IDLE

    @property
    def distance(self) -> float:
        """How many std the constraint is from what the data want: the root of its chi-square."""
        return float(np.sqrt(self.chi_square))

    @property
    def sentence(self) -> str:
        """The finding in one sentence."""
        start = f"{self.quantity} is held at {self.held:.6g} {self.unit} by {self.constraint}"
        if self.wanted is None:
            return f"{start}: {self.pressure.value}"
        return f"{start}: the data want {self._wanted} ({self.distance:.3g} std): {self.pressure.value}"

    @property
    def _wanted(self) -> str:
        return "-" if self.wanted is None else f"{self.wanted:.6g} ± {self.std:.2g} {self.unit}"

    def rows(self) -> list[tuple[str, ...]]:
        """Constraint, quantity, wanted, distance in std, chi-square, p and meaning, as text."""
        numbers = (f"{self.distance:.3g}", f"{self.chi_square:.4g}", probability(self.p_value))
        return [(self.constraint, self.quantity, self._wanted, *numbers, self.pressure.value)]


def probability(p_value: float) -> str:
    """As text; what has underflown is not impossible."""
    return f"{max(p_value, 1e-300):.2g}"


HEADER = ("constraint", "holds", "the data want", "std away", "chi²", "p", "says")


def findings(found: Optimality) -> tuple[Active, ...]:
    """Every constraint that a minimum rests on, the costliest first."""
    return tuple(sorted(_findings(found), key=lambda active: -active.chi_square))


def pressing(found: Optimality) -> NDArray[np.bool_]:
    """(c,) which of the edge's normals belong to a constraint that costs something."""
    ends = len(found.edge.ends)
    strong = np.abs(found.strengths) > OPTIMAL
    strong[ends:] = strong[ends:].any()
    return strong


def _findings(found: Optimality) -> Iterator[Active]:
    edge, strong = found.edge, pressing(found)
    alone = np.eye(len(strong), dtype=bool)
    for place, (index, lower) in enumerate(edge.ends):
        tangent = lifted(found, alone[place]) if strong[place] else None
        yield _of_end(found, index, lower=lower, lifted=tangent)
    if edge.rank:
        of_inertia = np.arange(len(strong)) >= len(edge.ends)
        yield _of_inertia(found, lifted(found, of_inertia) if strong[of_inertia].any() else None)


def lifted(found: Optimality, spared: NDArray[np.bool_]) -> Tangent:
    """The local problem with what presses or is fixed held, but for those spared."""
    edge = found.edge
    kept = (pressing(found) | edge.either_way) & ~spared
    curved = found.inner if kept[len(edge.ends) :].any() else None
    return Tangent(edge.local, *sum_of_squares(edge, curved), edge.normals[kept], np.zeros(int(kept.sum())))


def _of_end(found: Optimality, index: int, *, lower: bool, lifted: Tangent | None) -> Active:
    region, local = found.edge.region, found.edge.local
    parameter, held = region.parameters[index], float(local.theta[index])
    idle = Active(constraint=region.text(index, lower=lower), quantity=parameter.name, unit=parameter.unit, held=held)
    if lifted is None:
        return idle
    wanted, std = held + float(lifted.step[index]), float(np.sqrt(lifted.covariance[index, index]))
    cost = lifted.gain
    p_value = float(chi2_sf(cost, 1)) if region.fixed[index] else chi_bar(cost, 1)
    against = Pressure.NEGATIVE_MASS if parameter.name == "m" and wanted < 0 else Pressure.CONTRADICTED
    return _pressed(idle, wanted, std, cost, p_value, against)


def _of_inertia(found: Optimality, lifted: Tangent | None) -> Active:
    edge, inertia = found.edge, found.edge.region.inertia
    assert inertia is not None
    theta = edge.local.theta if lifted is None else edge.local.theta + lifted.step
    quantity, unit, vector = witness(inertia, theta)
    first = inertia.mass[0]
    held = float(inertia.at(edge.local.theta)[first, first]) if unit == "kg" else 0.0
    idle = Active(constraint=inertia.condition, quantity=quantity, unit=unit, held=held)
    if lifted is None:
        return idle
    form = np.einsum("n,knm,m->k", vector, inertia.slopes, vector)
    wanted = float(vector @ inertia.at(theta) @ vector)
    std = float(np.sqrt(form @ lifted.covariance @ form))
    p_value = chi_bar(lifted.gain, svec_size(edge.rank))
    against = Pressure.NEGATIVE_MASS if unit == "kg" else Pressure.IMPOSSIBLE
    return _pressed(idle, wanted, std, lifted.gain, p_value, against)


def _pressed(idle: Active, wanted: float, std: float, cost: float, p_value: float, against: Pressure) -> Active:
    pressure = against if p_value < SURE else Pressure.WITHIN_NOISE
    return replace(idle, wanted=wanted, std=std, chi_square=cost, p_value=p_value, pressure=pressure)


def chi_bar(cost: float, q: int) -> float:
    """(P(chi²_q-1 > cost) + P(chi²_q > cost)) / 2."""
    lower = chi2_sf(cost, q - 1) if q > 1 else float(cost <= 0)
    return float(lower + chi2_sf(cost, q)) / 2


def witness(inertia: PseudoInertia, theta: Array) -> tuple[str, str, Array]:
    """The moment that is not positive in J(theta): its name, unit and the vector w with w' J w, in that unit.

    It is the mass where that is negative. Else the second moments about the centre of mass, the Schur complement
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
