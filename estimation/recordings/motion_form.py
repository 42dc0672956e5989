"""Wrench channels and form of motion of a table by its column names, with errors that name what is missing."""

from __future__ import annotations

import re
from collections.abc import Sequence

from estimation.recordings.column_table import ColumnTable, import_remedy
from estimation.recordings.recording import QUATERNION, MotionForm, numbered_names
from modeling.rig.rig import PLANAR_CHANNELS, SPATIAL_CHANNELS, Rig
from modeling.space import Space

JOINT_ANGLE = re.compile(r"q[1-9]\d*")
KINEMATICS = {Space.PLANE: "link_lengths", Space.SPACE: "urdf"}


def _record(table: ColumnTable) -> str:
    return f"record it, rename the column that holds it, or {import_remedy(table.where)}"


def wrench_channels(table: ColumnTable) -> tuple[str, ...]:
    """The channels of the table's wrench; InputError when it is incomplete or mixed."""
    planar, spatial = (
        [channel for channel in channels if channel in table.columns]
        for channels in (PLANAR_CHANNELS, SPATIAL_CHANNELS)
    )
    lone = [channel for channel in spatial if channel not in PLANAR_CHANNELS]
    if "tau" in planar and lone:
        what = f"a mixed wrench: the planar tau together with {', '.join(lone)}"
        raise table.error(what, "keep fx, fy, tau or fx, fy, fz, tx, ty, tz")
    expected, found = (SPATIAL_CHANNELS, spatial) if lone else (PLANAR_CHANNELS, planar)
    missing = [channel for channel in expected if channel not in found]
    if not found:
        raise table.error("no wrench: fx, fy, tau or fx, fy, fz, tx, ty, tz are missing", _record(table))
    if missing:
        raise table.error(f"the wrench is missing {_listed(missing)}", _record(table))
    return expected


def motion_form(table: ColumnTable, channels: tuple[str, ...], rig: Rig | None) -> MotionForm:
    """The first complete form of motion, in the order of FORMATS, that is compatible with this wrench."""
    space = Space.PLANE if channels == PLANAR_CHANNELS else Space.SPACE
    forms = (MotionForm.JOINTS, MotionForm.PLANAR_POSE if space is Space.PLANE else MotionForm.POSE)
    obstacles = {form: _missing(form, table, rig, space) for form in forms}
    for form, obstacle in obstacles.items():
        if obstacle is None:
            return form
    for form, obstacle in obstacles.items():
        if obstacle is not None and _has_any_column(form, table):
            raise table.error(*obstacle)
    other = "phi" if space is Space.PLANE else _listed(QUATERNION)
    raise table.error(f"the motion is missing: neither q1..qn nor {other}", _record(table))


def _has_any_column(form: MotionForm, table: ColumnTable) -> bool:
    """Whether the table has any column of this form, so that the missing ones are named."""
    if form is MotionForm.JOINTS:
        return bool(_joint_angles(table))
    names = ("phi", "ax", "ay") if form is MotionForm.PLANAR_POSE else QUATERNION
    return any(name in table.columns for name in names)


def _joint_angles(table: ColumnTable) -> list[str]:
    angles = (name for name in table.columns if JOINT_ANGLE.fullmatch(name))
    return sorted(angles, key=lambda name: int(name[1:]))


def _missing(form: MotionForm, table: ColumnTable, rig: Rig | None, space: Space) -> tuple[str, str] | None:
    """What is missing of a form of motion, and the remedy; None when it is complete."""
    if form is MotionForm.JOINTS:
        return _missing_joints(table, rig, space)
    needed = ["phi"] if form is MotionForm.PLANAR_POSE else list(QUATERNION)
    if form is MotionForm.PLANAR_POSE and ("ax" in table.columns) != ("ay" in table.columns):
        needed += ["ax", "ay"]
    missing = [name for name in needed if name not in table.columns]
    return (f"the motion is missing {_listed(missing)}", _record(table)) if missing else None


def _missing_joints(table: ColumnTable, rig: Rig | None, space: Space) -> tuple[str, str] | None:
    angles, kinematics = _joint_angles(table), KINEMATICS[space]
    arm = None if rig is None else rig.arm
    if arm is None or arm.space is not space:
        lacks = "no rig was given" if rig is None else f"the rig has no {kinematics}"
        return f"columns {_listed(angles)} are joint angles, and {lacks}", f"give a rig with robot.{kinematics}"
    expected = numbered_names("q", arm.joints)
    missing = [name for name in expected if name not in angles]
    if missing:
        return f"the motion is missing {_listed(missing)}", f"record every joint of robot.{kinematics}"
    extra = [name for name in angles if name not in expected]
    if extra:
        noun = kinematics if space is Space.PLANE else "joints"
        what = f"columns {_listed(extra)} are joint angles beyond the rig's {len(expected)} {noun}"
        return what, f"give a rig whose {kinematics} has them, or rename the column"
    return None


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names)
