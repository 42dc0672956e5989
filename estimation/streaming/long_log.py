"""Long log: one run in a file larger than memory, read in chunks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from estimation.recordings.column_table import ColumnTable, table_file
from estimation.recordings.motion import QUATERNION, MotionForm, numbered_names
from estimation.recordings.reading import motion_form, require_increasing, wrench_channels
from estimation.streaming.chunk import Chunk
from modeling.errors import InputError
from modeling.kinematics.placement import motion_in_world
from modeling.rig import Rig

Array = NDArray[np.float64]


def with_history(tables: Iterator[ColumnTable], overlap: int) -> Iterator[tuple[ColumnTable, int]]:
    """Each table preceded by up to `overlap` earlier rows, and their number."""
    held: ColumnTable | None = None
    for table in tables:
        whole = table if held is None else ColumnTable.joined([held, table])
        yield whole, len(whole) - len(table)
        if overlap:
            held = whole.rows(max(len(whole) - overlap, 0), len(whole))


ROWS_PER_CHUNK = 65536
"""Rows read at once: some 5 MB of columns, enough to make the overhead per chunk negligible."""
POSITION, VELOCITY, ACCELERATION = ("px", "py"), ("vx", "vy"), ("ax", "ay")


@dataclass(frozen=True, kw_only=True)
class LongLog:
    """Iterable over the chunks of a log, repeatedly; `size` rows each, with `overlap` rows of history.

    inputs  the signals needed, so that other columns are not read; None for all
    """

    path: Path
    rig: Rig | None
    size: int
    overlap: int
    inputs: tuple[str, ...] | None = None

    def with_signals(self, inputs: Sequence[str]) -> LongLog:
        """The same log, its chunks with these signals alone, as far as present."""
        return replace(self, inputs=tuple(inputs))

    @property
    def channels(self) -> tuple[str, ...]:
        """The channels of the wrench, from the header alone; InputError as on iteration."""
        return LoggedMotion.of(table_file(self.path).names, str(self.path), self.rig).channels

    @property
    def rows(self) -> int:
        """About how many rows the log has, from its size; InputError as on iteration."""
        file = table_file(self.path)
        LoggedMotion.of(file.names, str(self.path), self.rig)
        return file.rows()

    def __iter__(self) -> Iterator[Chunk]:
        file = table_file(self.path)
        motion = LoggedMotion.of(file.names, str(self.path), self.rig)
        columns = [n for n in file.names if self.inputs is None or n in motion.needed or n in self.inputs]
        last = -np.inf
        tables = file.stretches(self.size, columns)
        for table, history in with_history(tables, self.overlap):
            last = _require_one_run(table, history, last)
            yield motion.chunk(table, self.path.name, history)
        if not np.isfinite(last):
            raise InputError(what="there are no samples", where=str(self.path), remedy="give a recording with rows")


def read_chunks(path: str | Path, *, rig: Rig | None = None, size: int = ROWS_PER_CHUNK, overlap: int = 0) -> LongLog:
    r"""The chunks of one run in a CSV or Parquet file with the motion's derivatives as columns.

    Joint angles need q1.., dq1.., ddq1.. and the rig's kinematics, a planar pose phi, dphi, ddphi, an orientation wx..,
    alx..; without position, velocity and acceleration the sensor origin's acceleration is taken as zero. Signals are
    used as recorded, where `read` smooths the motion over the whole run.

    Parameters
    ----------
    path : str or Path
        The file; columns as in FORMATS, SI units.
    rig : Rig, optional
        The kinematics that joint angles need; by default none.
    size : int, optional
        Rows of a chunk after its history, by default 65536.
    overlap : int, optional
        Rows of history, by default 0, as white noise needs; for coloured noise `NoiseModel.memory`.

    Returns
    -------
    LongLog
        Iterable over the chunks, repeatedly; the file is read piece by piece on each iteration.

    Raises
    ------
    InputError
        For a size below 1 or the overlap, and, on iteration, for a file that is not such a log.

    Examples
    --------
    >>> import truewrench as tw
    >>> rows = [f"{0.01 * i:.2f},0.1,0,0,-0.9,-8.8,-0.6" for i in range(300)]
    >>> with open("log.csv", "w") as file:
    ...     print("time,phi,dphi,ddphi,fx,fy,tau", *rows, sep="\n", file=file)
    >>> log = tw.read_chunks("log.csv", size=200, overlap=10)
    >>> log.channels, [(chunk.history, len(chunk.wrench)) for chunk in log]
    (('fx', 'fy', 'tau'), [(0, 200), (10, 110)])
    """
    if not size >= max(overlap, 1) or overlap < 0:
        what = f"chunks of {size} rows with an overlap of {overlap}"
        raise InputError(what=what, where=str(path), remedy="give a size above 0 and not below the overlap")
    if rig is not None and (loads := rig.loads_of(path)):
        what = f"it carries {loads[0]}, which chunks do not say"
        raise InputError(what=what, where=str(path), remedy="read it as a whole recording")
    return LongLog(path=Path(path), rig=rig, size=size, overlap=overlap)


def _require_one_run(table: ColumnTable, history: int, last: float) -> float:
    """Last time of the table, given that of the table before; InputError where time does not increase."""
    time = table.columns["time"]
    remedy = "sort the rows, or write each run to a file of its own"
    require_increasing(time, table.where, table.first_row, remedy, -np.inf if history else last)
    return float(time[-1])


@dataclass(frozen=True, kw_only=True)
class LoggedMotion:
    """Wrench channels, form of motion and needed columns of a log.

    channels  of the wrench; `form` of the motion; `needed` columns of both
    """

    channels: tuple[str, ...]
    form: MotionForm
    needed: frozenset[str]
    rig: Rig | None

    @classmethod
    def of(cls, names: Sequence[str], where: str, rig: Rig | None) -> LoggedMotion:
        """Of a log with columns of these names. Raises InputError when some are missing."""
        header = ColumnTable(columns={name: np.zeros(0) for name in names}, where=where, first_row=1)
        if "time" not in names:
            raise header.error("column time is missing", "record it; read static poses as a whole with `read`")
        channels = wrench_channels(header)
        form = motion_form(header, channels, rig)
        needed = _needed(form, header, rig)
        missing = [name for name in needed if name not in names]
        if missing:
            what = f"a long log needs the motion's derivatives as columns, and {', '.join(missing)} is missing"
            raise header.error(what, "record it, or read the run as a whole with `read`")
        return cls(channels=channels, form=form, needed=frozenset({"time", *channels, *needed}), rig=rig)

    def chunk(self, table: ColumnTable, run: str, history: int) -> Chunk:
        """The samples of a table as a chunk."""
        columns = table.columns
        derive = {MotionForm.JOINTS: _joints, MotionForm.PLANAR_POSE: _planar_pose, MotionForm.POSE: _pose}
        signals = {n: v for n, v in columns.items() if n not in (*self.channels, "repeat")}
        wrench = np.stack([columns[channel] for channel in self.channels])  # every channel contiguous
        signals |= derive[self.form](columns, self.rig)
        direction = None if self.rig is None or self.form is MotionForm.JOINTS else self.rig.gravity_direction
        if direction is not None:
            signals = motion_in_world(signals, direction)
        return Chunk(run=run, signals=signals, wrench=wrench.T, history=history)


def _needed(form: MotionForm, header: ColumnTable, rig: Rig | None) -> tuple[str, ...]:
    """The columns needed for this form of motion, with the sensor origin's acceleration where that moves."""
    if form is MotionForm.JOINTS:
        arm = None if rig is None else rig.arm
        return (
            () if arm is None else tuple(n for prefix in ("q", "dq", "ddq") for n in numbered_names(prefix, arm.joints))
        )
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
    """Names of the acceleration where the sensor origin's motion was recorded; none where it is taken as zero."""
    return tuple(acceleration) if any(n in columns for n in (*position, *velocity, *acceleration)) else ()


def _joints(columns: Mapping[str, Array], rig: Rig | None) -> dict[str, Array]:
    arm = None if rig is None else rig.arm
    if arm is None:
        return {}
    names = [numbered_names(prefix, arm.joints) for prefix in ("q", "dq", "ddq")]
    return arm.pose(*(np.stack([columns[name] for name in joint_names], axis=1) for joint_names in names))


def _planar_pose(columns: Mapping[str, Array], rig: Rig | None) -> dict[str, Array]:
    return _zero_rates(columns, VELOCITY, ACCELERATION)


def _pose(columns: Mapping[str, Array], rig: Rig | None) -> dict[str, Array]:
    quaternion = np.stack([columns[name] for name in QUATERNION])
    unit = dict(zip(QUATERNION, quaternion / np.linalg.norm(quaternion, axis=0), strict=True))
    return unit | _zero_rates(columns, *_spatial_origin()[1:])


def _zero_rates(columns: Mapping[str, Array], velocity: Sequence[str], acceleration: Sequence[str]) -> dict[str, Array]:
    """Velocity and acceleration of the sensor origin as zero where its acceleration was not recorded."""
    if all(name in columns for name in acceleration):
        return {}
    samples = len(next(iter(columns.values())))
    return {name: np.zeros(samples) for name in (*velocity, *acceleration)}
