"""Weight: a tool has a positive mass, or the readings have the other sign than was stated."""

from __future__ import annotations

from estimation.linear.estimate import Estimate
from modeling.errors import InputError
from modeling.rig import Convention


def require_positive(mass: Estimate, stated: Convention, where: str) -> None:
    """Raise InputError when the mass is negative beyond doubt: the readings have the other sign than was stated."""
    if mass.value >= -3 * mass.std:
        return
    other = Convention.ON_SENSOR if stated is Convention.ON_TOOL else Convention.ON_TOOL
    raise InputError(
        what=f"the mass comes out as {mass.value:.3g} ± {mass.std:.2g} kg with readings {stated.value}",
        where=where,
        remedy=f'state convention = "{other.value}" under [sensor] in the rig, or check the axes of the readings',
    )
