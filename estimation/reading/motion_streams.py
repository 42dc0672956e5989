"""Motion and wrench of mapped columns in SI units: orientation as a quaternion x y z w without jumps of sign."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import pi

import numpy as np

from estimation.reading.column_map import KINDS, ColumnMap, name_and_unit
from estimation.reading.column_recognition import ColumnGroup, ColumnMapping
from estimation.reading.gravity_vector import extra_acceleration, in_si
from estimation.reading.log_reader import Array, LogTable
from estimation.reading.orientation_form import UPWARD, OrientationForm, matrix_form, matrix_positions
from estimation.reading.step_log import StepLog
from estimation.recordings.motion import QUATERNION
from estimation.recordings.reading_report import Assumption, UsedColumns
from modeling.errors import InputError, quoted

POSITION = ("px", "py", "pz")
PLANAR_FORM = OrientationForm("planar")
UNIT_NORM = 1e-3
"""Of the square of a quaternion's norm, by which it may differ from 1: the rounding of four decimals and more."""
LARGEST_NUMBER = 1e9
"""Beyond any force, angle and position in a log's units: overflow marks and damaged bytes are larger."""
LARGEST_LEVER = 20.0
"""Metres: no arm reaches further, so that larger positions are in millimetres."""
LARGEST_JOINT = 2.5 * 2 * pi
"""Radians: joints turn by two revolutions at most, so that larger angles are in degrees."""

LARGEST_TURN = 2.2 * pi
"""Radians: Euler angles and rotation vectors are within a turn."""


class SiColumns:
    """Columns in SI units of the groups of a mapping, with how each was read."""

    def __init__(self, mapping: ColumnMapping, stated: ColumnMap, log: StepLog) -> None:
        self.mapping, self.stated, self.log = mapping, stated, log
        self.used: list[UsedColumns] = []

    def wrench(self) -> dict[str, Array]:
        """The wrench by channel, N and N m, along the axes in which it is given."""
        group = self.mapping.wrench
        kinds = ["force" if target.startswith("f") else "torque" for target in group.targets]
        how = "base axes, turned into the sensor's by the pose" if self.base_axes else "sensor axes"
        if frame := stated_frame(group.table):
            how += f", frame {quoted(frame)} as its header states"
        if group.compensated:
            how += "; compensated by the robot"
        if group.why:
            how += f"; {group.why}"
        if group.compensated:
            what = "the robot takes a payload's weight out of these readings: a tool's mass is not what they show"
            self.log.suspicious(what, group.table.name)
        if group.table.without_pose and self.mapping.orientation is not None:
            pose = self.mapping.orientation.table.name
            self.log.suspicious(f"{group.table.without_pose}; the pose of {pose} is taken for it", group.table.name)
        return self._scaled(group, kinds, how)

    @property
    def base_axes(self) -> bool:
        """Whether the wrench is given along the axes of the robot's base."""
        return self.mapping.wrench.base_axes if self.stated.axes is None else self.stated.axes == "base"

    def motion(self, group: ColumnGroup) -> dict[str, Array]:
        """The columns of one group of the motion under their names in a recording."""
        if group is self.mapping.position:
            return self._checked_position(self._scaled(group, ["position"] * 3, "m"), group)
        if group is self.mapping.rate:
            return self._scaled(group, ["rate"] * 3, "rad/s, in the sensor's axes")
        if group in self.mapping.signals:
            self._note(group, group.targets, "as it stands, as the map names it")
            return dict(zip(group.targets, group.values().T, strict=True))
        if group is not self.mapping.orientation:
            return self._joints(group)
        if group.form == PLANAR_FORM:
            columns = self._scaled(group, ["angle"], "rad", ("phi",))
            return {"phi": -columns["phi"]} if self.stated.inverse else columns
        return self._pose(group)

    def _joints(self, group: ColumnGroup) -> dict[str, Array]:
        columns = self._scaled(group, ["angle"] * len(group.columns), "rad")
        largest = max(float(np.nanmax(np.abs(column), initial=0.0)) for column in columns.values())
        if largest > LARGEST_JOINT and self._factor("angle", group.columns[0]) == 1.0:
            self.log.mended(f"joint angles up to {largest:.4g}, taken as degrees", group.table.name)
            self.log.assumptions.append(Assumption("angle", "deg", f"joint angles reach {largest:.4g}"))
            columns = {name: column * KINDS["angle"]["deg"] for name, column in columns.items()}
        raw = [float(np.nanmax(np.abs(group.table.columns[name]), initial=0.0)) for name in group.columns]
        self._doubt_degrees(max(raw), self._factor("angle", group.columns[0]), group)
        return columns

    def _doubt_degrees(self, largest: float, factor: float, group: ColumnGroup) -> None:
        """Log angles stated as degrees that would be within a turn if they were radians."""
        if factor == KINDS["angle"]["deg"] and largest < LARGEST_TURN:
            what = f"angles up to {largest:.3g}, stated as degrees, hardly move the sensor: radians?"
            self.log.suspicious(what, group.table.name)

    def _pose(self, group: ColumnGroup) -> dict[str, Array]:
        parts = [group.table.columns[name] for name in group.columns]
        plain = group.form == OrientationForm("xyzw") and len(parts) == 4 and not self.stated.inverse
        if plain and _is_continuous(parts):
            self._note(group, QUATERNION, str(group.form))
            return dict(zip(QUATERNION, parts, strict=True))  # as they are, without a copy
        values = group.values()
        where = group.table.name
        place: Array | None = None
        if len(group.columns) in (6, 7) and group.quantity.value == "pose":
            place, values = values[:, :3], values[:, 3:]
        form = group.form or (matrix_form(values) if values.shape[1] > 4 else OrientationForm("xyzw"))
        if form.name.startswith("matrix"):
            form = form if self.stated.form is not None else matrix_form(values)
            place = matrix_positions(values, form)
        if form.has_angles:
            values = self._radians(values, group)
        columns = {}
        if form.name in UPWARD:
            unit = name_and_unit(group.columns[0])[1]
            stated = self._factor("acceleration", group.columns[0]) if unit else self.stated.factor("acceleration")
            values = in_si(values, stated, where)
            columns = extra_acceleration(values) if form.name == "accelerometer" else {}
            self._note_vertical(form, where)
        if place is not None:
            columns = dict(zip(POSITION, (place * self._factor("position", group.columns[0])).T, strict=True))
        if place is not None:
            columns = self._checked_position(columns, group)
        self._note(group, (*QUATERNION, *columns), str(form))
        turned = _without_jumps(form.quaternions(values, where))
        if self.stated.inverse:
            turned = turned * [-1.0, -1.0, -1.0, 1.0]
            columns = {} if not columns else _origin_of_inverse(turned, columns)
        return dict(zip(QUATERNION, turned.T, strict=True)) | columns

    def _note_vertical(self, form: OrientationForm, where: str) -> None:
        """Log what a vertical was taken for: the opposite gives the same tool, and the other sign convention."""
        taken, other = ("gravity, which points down", "up, as an accelerometer's reading")
        if form.name == "accelerometer":
            taken, other = "an accelerometer at the sensor, along its axes, which reads up at rest", "down, as gravity"
        name = next(name for name in UPWARD if name != form.name)
        self.log.taken(
            f'the vertical is taken as {taken}; if it points {other} does, state orientation = "{name}" in a map:'
            " the tool is the same, the sign convention the other one",
            where,
        )

    def _radians(self, values: Array, group: ColumnGroup) -> Array:
        """Angles of an orientation (n, 3) in rad; more than a turn is taken as degrees."""
        factor = self._factor("angle", group.columns[-1])
        largest = float(np.nanmax(np.abs(values), initial=0.0))
        if factor == 1.0 and largest > LARGEST_TURN:
            self.log.mended(f"angles up to {largest:.4g}, taken as degrees", group.table.name)
            self.log.assumptions.append(Assumption("angle", "deg", f"the angles reach {largest:.4g}"))
            factor = KINDS["angle"]["deg"]
        else:
            self._doubt_degrees(largest, factor, group)
        return values * factor

    def _checked_position(self, columns: dict[str, Array], group: ColumnGroup) -> dict[str, Array]:
        largest = max((float(np.nanmax(np.abs(column), initial=0.0)) for column in columns.values()), default=0.0)
        if largest > LARGEST_LEVER and self._factor("position", group.columns[0]) == 1.0:
            self.log.mended(f"positions up to {largest:.4g}, taken as millimetres", group.table.name)
            self.log.assumptions.append(Assumption("position", "mm", f"the positions reach {largest:.4g}"))
            return {name: column * 1e-3 for name, column in columns.items()}
        return columns

    def _scaled(
        self, group: ColumnGroup, kinds: list[str], how: str, targets: tuple[str, ...] | None = None
    ) -> dict[str, Array]:
        targets = targets or group.targets
        columns = {}
        units = []
        for target, name, kind in zip(targets, group.columns, kinds, strict=True):
            factor, column = self._factor(kind, name), group.table.columns[name]
            column = self._plausible(column, name, group)
            columns[target] = column if factor == 1.0 else column * factor
            unit = name_and_unit(name)[1]
            units += [unit] if factor != 1.0 and unit else []
        self._note(group, targets, how + (f", from {', '.join(dict.fromkeys(units))}" if units else ""))
        return columns

    def _plausible(self, column: Array, name: str, group: ColumnGroup) -> Array:
        """The column, with numbers that no sensor has (damaged bytes, overflow marks) as missing."""
        with np.errstate(invalid="ignore"):
            wild = np.abs(column) > LARGEST_NUMBER
        if not wild.any():
            return column
        self.log.mended(
            f"numbers of {name} beyond {LARGEST_NUMBER:g} taken as missing",
            group.table.name,
            int(wild.sum()),
            len(column),
        )
        return np.where(wild, np.nan, column)

    def _note(self, group: ColumnGroup, targets: tuple[str, ...], how: str) -> None:
        self.used.append(
            UsedColumns(
                quantity=group.quantity.value, source=group.table.name, columns=group.columns, targets=targets, how=how
            )
        )

    def _factor(self, kind: str, name: str) -> float:
        stated = self.stated.factor(kind)
        unit = name_and_unit(name)[1]
        if stated is not None:
            return stated
        if unit is None:
            return 1.0
        factors = KINDS[kind]
        if unit not in factors:
            what = f"column {name} names the unit {unit}, which is none of {kind}"
            raise InputError(
                what=what,
                where=self.mapping.wrench.table.name,
                remedy=f'state it in a map: units = {{ {kind} = "..." }}',
            )
        return factors[unit]


def stated_frame(table: LogTable) -> str:
    """The frame that a wrench's source states for it, in its header or in a column of text; empty for none."""
    texts = next((values for name, values in table.texts.items() if name.lower().endswith("frame_id")), ())
    return table.wrench_frame or (texts[0] if len(texts) == 1 else "")


def _is_continuous(parts: Sequence[Array]) -> bool:
    """Whether quaternions in four columns (n,) have a norm of 1, and none points away from the one before."""
    squares = sum((component * component for component in parts), np.zeros(1))
    if (np.abs(squares - 1) > UNIT_NORM).any():
        return False
    return not bool((sum((component[1:] * component[:-1] for component in parts), np.zeros(1)) < 0).any())


def _without_jumps(quaternions: Array) -> Array:
    """Quaternions (n, 4) of which none points away from the one before; the same array where nothing changes."""
    complete = np.flatnonzero(np.isfinite(quaternions).all(axis=1))
    rows = quaternions if len(complete) == len(quaternions) else quaternions[complete]
    flips = np.einsum("ij,ij->i", rows[1:], rows[:-1]) < 0
    if not flips.any():
        return quaternions
    signs = np.ones(len(quaternions))
    signs[complete] = np.where(np.concatenate([[0], np.cumsum(flips)]) % 2 == 0, 1.0, -1.0)
    return np.asarray(quaternions * signs[:, None])


def _origin_of_inverse(turned: Array, place: Mapping[str, Array]) -> dict[str, Array]:
    """The sensor's origin in the base, of the base's origin in the sensor: p = -R p' with R (n, 4) of the sensor."""
    from scipy.spatial.transform import Rotation  # slow to import

    positions = np.full((len(turned), 3), np.nan)
    complete = np.isfinite(turned).all(axis=1)
    origin = np.stack([place[name] for name in POSITION], axis=1)
    positions[complete] = -Rotation.from_quat(turned[complete]).apply(origin[complete])
    return dict(zip(POSITION, positions.T, strict=True))


def in_sensor_axes(wrench: Mapping[str, Array], motion: Mapping[str, Array]) -> dict[str, Array]:
    """A wrench (n,) a channel along the base's axes, along the sensor's; moments stay about the same point."""
    from scipy.spatial.transform import Rotation  # slow to import

    turn = Rotation.from_quat(np.stack([motion[name] for name in QUATERNION], axis=1))
    turned: dict[str, Array] = {}
    for names in (("fx", "fy", "fz"), ("tx", "ty", "tz")):
        vector = turn.apply(np.stack([wrench[name] for name in names], axis=1), inverse=True)
        turned |= dict(zip(names, vector.T, strict=True))
    return turned
