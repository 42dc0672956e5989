"""Long log: one run in a file that need not fit into memory, read in chunks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from estimation.motion_form import motion_form, wrench_channels
from estimation.recording import QUATERNION, MotionForm, numbered
from estimation.stream.chunk import Chunk
from estimation.table import Table, frame_table
from modeling.errors import InputError
from modeling.rig import Rig

Array = NDArray[np.float64]

SIZE = 65536
"""Rows that are read at once: some 10 MB of columns, and far more than the whitening of a stretch costs to begin."""


@dataclass(frozen=True, kw_only=True)
class LongLog:
    """The chunks of a log, as often as it is gone through; `size` rows each, with `overlap` rows of history."""

    path: Path
    rig: Rig | None
    size: int
    overlap: int

    def __iter__(self) -> Iterator[Chunk]:
        held: pd.DataFrame | None = None
        row, last = 2, -np.inf
        for frame in _frames(self.path, self.size):
            where = f"{self.path}, from row {row} on"
            table = frame_table(frame, where)
            last = _require_one_run(table, last)
            row += len(frame)
            whole = frame if held is None else pd.concat([held, frame], ignore_index=True)
            history = len(whole) - len(frame)
            yield _chunk(frame_table(whole, where), self.path.name, self.rig, history)
            held = whole.iloc[len(whole) - self.overlap :] if self.overlap else None


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


def _frames(path: Path, size: int) -> Iterator[pd.DataFrame]:
    """Stretches of `size` rows of the file."""
    import pyarrow as pa  # slow to import
    import pyarrow.parquet as pq

    try:
        if path.suffix.lower() in (".parquet", ".pq"):
            with pq.ParquetFile(path) as file:
                for batch in file.iter_batches(batch_size=size):
                    yield batch.to_pandas()
        else:
            with pd.read_csv(path, chunksize=size, skipinitialspace=True) as reader:
                yield from reader
    except (OSError, ValueError, pa.ArrowException) as error:
        what = f"cannot be read: {error}"
        raise InputError(what=what, where=str(path), remedy="give a CSV or Parquet file with a header") from None


def _require_one_run(table: Table, last: float) -> float:
    """The last time of the table, after that of the stretch before; InputError where time does not increase."""
    time = table.columns.get("time")
    if time is None:
        raise table.error("column time is missing", "record it; poses at rest are few enough for `read`")
    if time[0] <= last or np.any(np.diff(time) <= 0):
        raise table.error("time does not increase", "sort the rows, or write each run to a file of its own")
    return float(time[-1])


def _chunk(table: Table, run: str, rig: Rig | None, history: int) -> Chunk:
    channels = wrench_channels(table)
    form = motion_form(table, channels, rig)
    derive = {MotionForm.JOINTS: _joints, MotionForm.PLANAR_POSE: _planar_pose, MotionForm.POSE: _pose}
    signals = {n: v for n, v in table.columns.items() if n not in (*channels, "repeat")} | derive[form](table, rig)
    wrench = np.stack([table.columns[channel] for channel in channels], axis=1)
    return Chunk(run=run, signals=signals, wrench=wrench, history=history)


def _joints(table: Table, rig: Rig | None) -> dict[str, Array]:
    arm = None if rig is None else rig.arm
    if arm is None:
        return {}
    names = [numbered(prefix, arm.joints) for prefix in ("q", "dq", "ddq")]
    return arm.pose(*(np.stack(_given(table, own), axis=1) for own in names))


def _planar_pose(table: Table, rig: Rig | None) -> dict[str, Array]:
    _given(table, ("phi", "dphi", "ddphi"))
    return _origin(table, ("px", "py"), ("vx", "vy"), ("ax", "ay"))


def _pose(table: Table, rig: Rig | None) -> dict[str, Array]:
    quaternion = np.stack(_given(table, QUATERNION))
    _given(table, [prefix + axis for prefix in ("w", "al") for axis in "xyz"])
    position, velocity, acceleration = ([prefix + axis for axis in "xyz"] for prefix in ("p", "vp", "ap"))
    unit = dict(zip(QUATERNION, quaternion / np.linalg.norm(quaternion, axis=0), strict=True))
    return unit | _origin(table, position, velocity, acceleration)


def _origin(
    table: Table, position: Sequence[str], velocity: Sequence[str], acceleration: Sequence[str]
) -> dict[str, Array]:
    """Rates of the sensor origin where nothing was recorded of it: it is slow."""
    if any(name in table.columns for name in (*position, *velocity, *acceleration)):
        _given(table, acceleration)
        return {}
    return {name: np.zeros(len(table)) for name in (*velocity, *acceleration)}


def _given(table: Table, names: Sequence[str]) -> list[Array]:
    missing = [name for name in names if name not in table.columns]
    if missing:
        what = f"a long log has to hold its derivatives, and {', '.join(missing)} is missing"
        raise table.error(what, "record it, or read the run as a whole")
    return [table.columns[name] for name in names]
