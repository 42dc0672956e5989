"""Whether the tool is as large as its inertia and centre of mass say: if not, the torque may be in other units."""

from __future__ import annotations

from math import isfinite, sqrt

from estimation.fit import Fit
from estimation.static.centre_of_mass import CentreOfMass
from modeling.space import Space

FARTHEST = 2.0
"""Distance, m, of a tool's mass from the sensor that nobody carries on a wrist: tools reach some 0.5 m, and a torque in
N mm makes a centre of mass of 10 mm one of 10 m. It is a remark alone; no verdict rests on it."""
CLEAR = 5.0
"""Std by which the distances exceed `FARTHEST`: an inertia that the motion hardly excites may have any value."""
SIGNIFICANT = 5.0
"""Std of a mass from which the distances are defined."""
INERTIA = {Space.PLANE: (("I", 1.0),), Space.SPACE: (("Ixx", 0.5), ("Iyy", 0.5), ("Izz", 0.5))}
"""Parameters that sum to the mass times its mean square distance from the sensor origin, with their factors."""


def tool_extent_text(fitted: Fit) -> str:
    """One line where inertia or centre of mass lie farther from the sensor than any tool; otherwise empty.

    Inertia about the sensor origin over m is the mean square distance of the mass from it: I / m in the plane, half of
    the trace over m in six axes.
    """
    mass = fitted.parameters["m"]
    if not isfinite(mass.std) or mass.value < SIGNIFICANT * mass.std or mass.value <= 0:
        return ""
    found = []
    inertia, inertia_std = _inertia(fitted)
    if inertia - CLEAR * inertia_std > mass.value * FARTHEST**2:
        found.append(f"the mass is {sqrt(inertia / mass.value):.2g} m (radius of gyration)")
    distance, std = _centre(fitted)
    if distance - CLEAR * std > FARTHEST:
        found.append(f"the centre of mass {distance:.2g} m")
    if not found:
        return ""
    return f"As fitted, {' and '.join(found)} from the sensor: no tool is so large, the torque may be in other units."


def _inertia(fitted: Fit) -> tuple[float, float]:
    """Mass times its mean square distance, kg m², with a bound of its std; not a number where it is unidentifiable."""
    known = [(fitted.parameters[name], factor) for name, factor in INERTIA[fitted.model.space]]
    return sum(e.value * f for e, f in known), sum(e.std * f for e, f in known)


def _centre(fitted: Fit) -> tuple[float, float]:
    """Distance of the centre of mass from the sensor origin along the identifiable axes, m, with a bound of its std."""
    centre = CentreOfMass.of(fitted)
    known = [(float(v), float(s)) for v, s in zip(centre.value, centre.std, strict=True) if isfinite(s)]
    return sqrt(sum(v * v for v, _ in known)), sum(s for _, s in known)
