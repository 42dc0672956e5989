"""Long log: one run in a file that need not fit into memory, read in chunks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from estimation.motion_form import motion_form, wrench_channels
from estimation.recording import QUATERNION, MotionForm, numbered
from estimation.stream.chunk import Chunk
from estimation.stream.column_file import column_file, with_history
from estimation.table import Table
from modeling.errors import InputError
from modeling.rig import Rig

Array = NDArray[np.float64]

SIZE = 65536
"""Rows that are read at once: some 5 MB of columns, and far more than what every chunk costs by itself."""
POSITION, VELOCITY, ACCELERATION = ("px", "py"), ("vx", "vy"), ("ax", "ay")


@dataclass(frozen=True, kw_only=True)
class LongLog:
    """The chunks of a log, as often as it is gone through; `size` rows each, with `overlap` rows of history.

    inputs  the signals that are asked for, so that other columns are not read; None for all that there are
    """

    path: Path
    rig: Rig | None
    size: int
    overlap: int
    inputs: tuple[str, ...] | None = None

    def needing(self, inputs: Sequence[str]) -> LongLog:
        """The same log, its chunks with these signals alone as far as they are there."""
        return replace(self, inputs=tuple(inputs))

    @property
    def channels(self) -> tuple[str, ...]:
        """The channels of the wrench, by the header alone; InputError as when the log is gone through."""
        return Motion.of(column_file(self.path).names, str(self.path), self.rig).channels

    def __iter__(self) -> Iterator[Chunk]:
        file = column_file(self.path)
        motion = Motion.of(file.names, str(self.path), self.rig)
        columns = [n for n in file.names if self.inputs is None or n in motion.needed or n in self.inputs]
        last = -np.inf
        tables = file.stretches(self.size, columns)
        for table, history in with_history(tables, self.overlap):
            last = _require_one_run(table, history, last)
            yield motion.chunk(table, self.path.name, history)
        if not np.isfinite(last):
            raise InputError(what="there are no samples", where=str(self.path), remedy="give a recording with rows")


def read_chunks(path: str | Path, *, rig: Rig | None = None, size: int = SIZE, overlap: int = 0) -> LongLog:
    """The chunks of one run in a CSV or Parquet file, which has to hold the derivatives too (FORMATS, SI units).

    Joint angles need q1.., dq1.., ddq1.. and the rig's kinematics, a planar pose phi, dphi, ddphi, an orientation
    wx.., alx..; without position, velocity and acceleration the sensor origin counts as slow. Signals are taken as they
    are recorded, where `read` smooths the motion over the whole run. The overlap is the noise's memory.
    Raises InputError for a size below 1 or the overlap, and, when it is gone through, for what cannot be such a log.
    """
    if not size >= max(overlap, 1) or overlap < 0:
        what = f"chunks of {size} rows with an overlap of {overlap}"
        raise InputError(what=what, where=str(path), remedy="give a size above 0 and not below the overlap")
    return LongLog(path=Path(path), rig=rig, size=size, overlap=overlap)


def _require_one_run(table: Table, history: int, last: float) -> float:
    """The last time of the table, after that of the stretch before; InputError where time does not increase."""
    time = table.columns["time"]
    before = -np.inf if history else last
    wrong = np.flatnonzero(np.diff(time, prepend=before) <= 0)
    if wrong.size:
        what = f"time does not increase at row {table.row(int(wrong[0]))}"
        raise table.error(what, "sort the rows, or write each run to a file of its own")
    return float(time[-1])


@dataclass(frozen=True, kw_only=True)
class Motion:
    """What a log says of the motion, and in which columns.

    channels  of the wrench, `form` of the motion, and the `needed` columns of both
    """

    channels: tuple[str, ...]
    form: MotionForm
    needed: frozenset[str]
    rig: Rig | None

    @classmethod
    def of(cls, names: Sequence[str], where: str, rig: Rig | None) -> Motion:
        """Of a log with columns of these names. Raises InputError for what it lacks."""
        header = Table(columns={name: np.zeros(0) for name in names}, where=where, first_row=1)
        if "time" not in names:
            raise header.error("column time is missing", "record it; poses at rest are few enough for `read`")
        channels = wrench_channels(header)
        form = motion_form(header, channels, rig)
        needed = _needed(form, header, rig)
        missing = [name for name in needed if name not in names]
        if missing:
            what = f"a long log has to hold its derivatives, and {', '.join(missing)} is missing"
            raise header.error(what, "record it, or read the run as a whole")
        return cls(channels=channels, form=form, needed=frozenset({"time", *channels, *needed}), rig=rig)

    def chunk(self, table: Table, run: str, history: int) -> Chunk:
        """The samples of a table as a chunk."""
        columns = table.columns
        derive = {MotionForm.JOINTS: _joints, MotionForm.PLANAR_POSE: _planar_pose, MotionForm.POSE: _pose}
        signals = {n: v for n, v in columns.items() if n not in (*self.channels, "repeat")}
        wrench = np.stack([columns[channel] for channel in self.channels])  # every channel contiguous
        return Chunk(run=run, signals=signals | derive[self.form](columns, self.rig), wrench=wrench.T, history=history)


def _needed(form: MotionForm, header: Table, rig: Rig | None) -> tuple[str, ...]:
    """The columns that say the motion in this form, with what it takes of the sensor origin when anything does."""
    if form is MotionForm.JOINTS:
        arm = None if rig is None else rig.arm
        return () if arm is None else tuple(n for prefix in ("q", "dq", "ddq") for n in numbered(prefix, arm.joints))
    if form is MotionForm.PLANAR_POSE:
        return ("phi", "dphi", "ddphi", *_origin(header.columns, POSITION, VELOCITY, ACCELERATION))
    position, velocity, acceleration = _spatial_origin()
    turning = tuple(prefix + axis for prefix in ("w", "al") for axis in "xyz")
    return (*QUATERNION, *turning, *_origin(header.columns, position, velocity, acceleration))


def _spatial_origin() -> tuple[tuple[str, ...], ...]:
    """Names of position, velocity and acceleration."""
    return tuple(tuple(prefix + axis for axis in "xyz") for prefix in ("p", "vp", "ap"))


def _origin(
    columns: Mapping[str, Array], position: Sequence[str], velocity: Sequence[str], acceleration: Sequence[str]
) -> tuple[str, ...]:
    """The acceleration where anything was recorded of the sensor origin; nothing where it counts as slow."""
    return tuple(acceleration) if any(n in columns for n in (*position, *velocity, *acceleration)) else ()


def _joints(columns: Mapping[str, Array], rig: Rig | None) -> dict[str, Array]:
    arm = None if rig is None else rig.arm
    if arm is None:
        return {}
    names = [numbered(prefix, arm.joints) for prefix in ("q", "dq", "ddq")]
    return arm.pose(*(np.stack([columns[name] for name in own], axis=1) for own in names))


def _planar_pose(columns: Mapping[str, Array], rig: Rig | None) -> dict[str, Array]:
    return _slow(columns, VELOCITY, ACCELERATION)


def _pose(columns: Mapping[str, Array], rig: Rig | None) -> dict[str, Array]:
    quaternion = np.stack([columns[name] for name in QUATERNION])
    unit = dict(zip(QUATERNION, quaternion / np.linalg.norm(quaternion, axis=0), strict=True))
    return unit | _slow(columns, *_spatial_origin()[1:])


def _slow(columns: Mapping[str, Array], velocity: Sequence[str], acceleration: Sequence[str]) -> dict[str, Array]:
    """Rates of the sensor origin where nothing was recorded of it: it is slow."""
    if all(name in columns for name in acceleration):
        return {}
    samples = len(next(iter(columns.values())))
    return {name: np.zeros(samples) for name in (*velocity, *acceleration)}
