"""Components and signs of the contact wrench, the environment's wrench on the tool."""

from __future__ import annotations

from collections.abc import Sequence

from modeling import symbolic as sp
from modeling.space import Space, vector


def contact_components(space: Space) -> tuple[str, ...]:
    """Names of a contact wrench's components: fcx along x', fcy along y', tauc clockwise; sensor frame in six axes."""
    return ("fcx", "fcy", "tauc") if space is Space.PLANE else ("fcx", "fcy", "fcz", "tcx", "tcy", "tcz")


def contact_force_torque(space: Space, wrench: Sequence[sp.Expr]) -> tuple[sp.Matrix, sp.Matrix]:
    """Force and torque about the sensor origin, in the sensor axes, of a contact wrench in its `contact_components`.

    In the plane the sensor axes are e1 = x', e2 = -y', e3 clockwise.
    """
    if space is Space.PLANE:
        x, y, clockwise = wrench
        return vector(x, -y, 0), vector(0, 0, clockwise)
    return vector(*wrench[:3]), vector(*wrench[3:])
