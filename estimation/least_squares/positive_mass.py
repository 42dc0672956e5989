"""Refuses a significantly negative mass: the readings have the opposite sign convention."""

from __future__ import annotations

from estimation.least_squares.estimates import Estimate
from modeling.errors import InputError
from modeling.rig.rig import Convention


def require_positive_mass(mass: Estimate, stated: Convention, where: str) -> None:
    """Raise InputError when the mass is below -3 std: the readings have the sign convention opposite to the stated."""
    if mass.value >= -3 * mass.std:
        return
    other = Convention.ON_SENSOR if stated is Convention.ON_TOOL else Convention.ON_TOOL
    check = "check the axes of the readings, or whether the base hangs (gravity_direction under [robot])"
    raise InputError(
        what=f"the mass comes out as {mass.value:.3g} ± {mass.std:.2g} kg with readings {stated.value}",
        where=where,
        remedy=f'state convention = "{other.value}" under [sensor] in the rig, or {check}',
    )
