"""Ambiguity: columns that could be either of two things are asked for, with what each would mean."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from estimation.logs.columns.column_recognition import ColumnGroup
from estimation.logs.columns.column_units import name_and_unit
from estimation.logs.frame_evidence import quaternion_orders
from estimation.logs.log_table import Array
from estimation.logs.motion_evidence import impossible_speed
from modeling.errors import InputError
from modeling.kinematics.base_mounting import Direction


def require_plausible_speed(columns: Mapping[str, Array], rate: float, group: ColumnGroup) -> None:
    """Ask for the unit of joint angles that no name states, where they turn as fast as no robot. Raises InputError."""
    if any(name_and_unit(name)[1] for name in group.columns):
        return
    angles = {name: columns[name] for name in columns if re.fullmatch(r"q\d+", name)}
    found = impossible_speed(angles, 1 / rate)
    if found is not None:
        fast = found[1]
        turn = float(max(np.ptp(column) for column in angles.values()))
        what = f"joint angles {group.columns[0]} .. {group.columns[-1]} could be radians ({turn:.3g} rad at speeds of"
        what += f" {fast:.3g} rad/s) or degrees ({np.radians(turn):.3g} rad at {np.radians(fast):.2g} rad/s)"
        remedy = 'state it in a map: units = { angle = "deg" }, or "rad"'
        raise InputError(what=what, where=group.table.name, remedy=remedy)


def require_decided_order(columns: Mapping[str, Array], group: ColumnGroup, direction: Direction | None = None) -> None:
    """Ask for the order of a quaternion that neither names nor the weight decide. Raises InputError."""
    as_read, w_first = quaternion_orders(columns, direction)
    if as_read.fit.is_shown_against(w_first.fit):
        return
    means = [f"{order} (mass {one.mass:.3g} kg, residual of the weight {one.rms:.3g} N)"
             for order, one in (("x y z w", as_read), ("w x y z", w_first))]  # fmt: skip
    raise InputError(
        what=f"the quaternion {group.columns[0]} .. {group.columns[-1]} could be {means[0]} or {means[1]}",
        where=group.table.name,
        remedy='state it in a map: orientation = "xyzw", or "wxyz"',
    )
