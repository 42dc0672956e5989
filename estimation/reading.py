"""From a file, or columns, to a Recording; or one line that says what is wrong and where."""

from __future__ import annotations

import csv
import io
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from estimation.clock import Clock
from estimation.recording import QUATERNION, MotionForm, Recording, numbered
from modeling.errors import InputError
from modeling.rig import PLANAR_CHANNELS, SPATIAL_CHANNELS, Rig

Array: TypeAlias = NDArray[np.float64]

JOINT_ANGLE = re.compile(r"q[1-9]\d*")
LEAST_SAMPLES = 20  # of one repeat: fewer do not carry a motion and its acceleration
LEAST_POSES = 3  # at rest: fewer never part the weight from the zero of three channels
NORM_ERROR = 1e-2  # of a unit quaternion: printed digits and interpolation stay far below
RECORD = "record it, or rename the column that holds it"


@dataclass(frozen=True, kw_only=True, eq=False)
class _Table:
    """Finite columns by name, (n,) each; where they come from, and the row of the first sample there."""

    columns: Mapping[str, Array]
    where: str
    first_row: int

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    def row(self, index: int) -> int:
        """Row in the file of a sample; a CSV's header is row 1."""
        return self.first_row + index

    def error(self, what: str, remedy: str) -> InputError:
        """An InputError about this table."""
        return InputError(what=what, where=self.where, remedy=remedy)


def read(path: str | Path, *, rig: Rig | None = None) -> Recording:
    """The recording in a CSV or Parquet file (columns as in FORMATS, SI units).

    `rig` gives the kinematics that joint angles need. Raises InputError, in one line with file and row or
    column, for whatever cannot be a recording. Rows are counted with a CSV's header as row 1.
    """
    path = Path(path)
    content = _content(path)
    parquet = path.suffix.lower() in (".parquet", ".pq") or content.startswith(b"PAR1")
    table = _parquet_table(content, str(path)) if parquet else _csv_table(content, str(path))
    return _recording(table, name=path.name, rig=rig)


def from_columns(columns: Mapping[str, ArrayLike], *, name: str = "recording", rig: Rig | None = None) -> Recording:
    """The recording in columns (n,) by name, as `read` takes them from a file; rows are counted from 1."""
    arrays = {key: np.asarray(column) for key, column in columns.items()}
    if len({array.shape for array in arrays.values()}) > 1 or any(array.ndim != 1 for array in arrays.values()):
        shapes = ", ".join(f"{key} {array.shape}" for key, array in arrays.items())
        remedy = "give one array per column, all of one length"
        raise InputError(what=f"columns of different shapes: {shapes}", where=name, remedy=remedy)
    frame = pd.DataFrame(arrays)
    return _recording(_frame_table(frame, name), name=name, rig=rig)


# ------------------------------------------------------------------------------------ files to tables


def _content(path: Path) -> bytes:
    try:
        content = path.read_bytes()
    except OSError as error:
        what = error.strerror or "cannot be read"
        raise InputError(what=what, where=str(path), remedy="give the path of a CSV or Parquet file") from None
    if not content.strip():
        raise InputError(what="the file is empty", where=str(path), remedy="give a recording with a header row")
    return content


def _csv_table(content: bytes, where: str) -> _Table:
    text = _decoded(content, where)
    names = _names(text, where)
    try:
        with warnings.catch_warnings():
            # Rows that are too long would be cut off with no more than this warning.
            warnings.simplefilter("error", pd.errors.ParserWarning)
            frame = pd.read_csv(
                io.StringIO(text),
                header=0,
                names=names,
                index_col=False,
                dtype=np.float64,
                skip_blank_lines=False,
            )
        trouble = "" if np.isfinite(frame.to_numpy()).all() else "a value is missing or not finite"
    except (ValueError, OverflowError, pd.errors.ParserWarning) as error:  # parser errors are ValueErrors
        trouble = str(error)
    if trouble:
        _explain(text, names, where)
        raise InputError(what=trouble, where=where, remedy="correct the file")
    return _filled({name: frame[name].to_numpy(dtype=float) for name in names}, where=where, first_row=2)


def _decoded(content: bytes, where: str) -> str:
    remedy = "give a CSV file in UTF-8, or a Parquet file"
    if b"\0" in content:
        raise InputError(what="a binary file, not a CSV", where=where, remedy=remedy)
    try:
        return content.decode("utf-8-sig").rstrip() + "\n"
    except UnicodeDecodeError as error:
        raise InputError(what=f"not UTF-8 text: {error}", where=where, remedy=remedy) from None


def _names(text: str, where: str) -> list[str]:
    names = [name.strip() for name in next(csv.reader(io.StringIO(text)))]
    if len(names) == 1 and re.search(r"[;\t]", names[0]):
        what = "the columns are not separated by commas"
        raise InputError(what=what, where=where, remedy="write a CSV with commas, and points in the numbers")
    if all(re.fullmatch(r"[-+.\deE]+", name) for name in names):
        raise InputError(what="row 1 is no header", where=where, remedy="name the columns in the first row")
    return _unique(names, where)


def _unique(names: Sequence[str], where: str) -> list[str]:
    for i, name in enumerate(names):
        if not name:
            what = f"column {i + 1} has no name"
            raise InputError(what=what, where=where, remedy="name it in the header, or remove it")
        if name in names[:i]:
            what = f"column {name} is there twice"
            raise InputError(what=what, where=where, remedy="rename or remove one of them")
    return list(names)


def _explain(text: str, names: Sequence[str], where: str) -> None:
    """Raise the InputError of the first cell that is no finite number; the slow way, only after trouble."""
    try:
        reader = csv.reader(io.StringIO(text), strict=True)
        next(reader)
        for cells in reader:
            _explain_row(cells, names, reader.line_num, where)
    except csv.Error as error:
        what = f"row {reader.line_num} cannot be read: {error}"
        raise InputError(what=what, where=where, remedy="correct that row") from None


def _explain_row(cells: Sequence[str], names: Sequence[str], row: int, where: str) -> None:
    if len(cells) != len(names):
        what = f"row {row} has {len(cells)} values, and the header has {len(names)} columns"
        raise InputError(what=what, where=where, remedy="complete or remove that row")
    for name, cell in zip(names, cells, strict=True):
        if not cell.strip():
            what = f"column {name} is empty at row {row}"
            raise InputError(what=what, where=where, remedy="fill in the value, or remove the row")
        try:
            number = float(cell) if "_" not in cell else None
        except ValueError:
            number = None
        if number is None:
            what = f"column {name} is not a number at row {row}: {cell.strip()[:40]!r}"
            raise InputError(what=what, where=where, remedy="make the column numeric, or remove it")
        if not np.isfinite(number):
            what = f"column {name} is {cell.strip()} at row {row}"
            raise InputError(what=what, where=where, remedy="replace it by a finite number, or remove the row")


def _parquet_table(content: bytes, where: str) -> _Table:
    import pyarrow as pa  # slow to import, and a CSV does not need it
    import pyarrow.parquet as pq

    try:
        table = pq.read_table(io.BytesIO(content))
    except (pa.ArrowException, OSError, ValueError) as error:
        what = f"not a Parquet file: {error}"
        raise InputError(what=what, where=where, remedy="give a CSV or Parquet file") from None
    _unique(table.column_names, where)
    frame = table.to_pandas(ignore_metadata=True)
    kept = [name for name in frame.columns if not re.fullmatch(r"__index_level_\d+__", name)]
    return _frame_table(frame[kept], where)


def _frame_table(frame: pd.DataFrame, where: str) -> _Table:
    """A data frame's columns, each checked to be finite numbers; rows are counted from 1."""
    columns = {}
    for name in frame.columns:
        column = frame[name]
        if not _is_real(column):
            what = f"column {name} is not numeric but {column.dtype} from row 1 on"
            raise InputError(what=what, where=where, remedy="make the column numeric, or remove it")
        values = column.to_numpy(dtype=float, na_value=np.nan, copy=True)
        wrong = np.flatnonzero(~np.isfinite(values))
        if wrong.size:
            what = f"column {name} is {values[wrong[0]]} at row {wrong[0] + 1}"
            raise InputError(what=what, where=where, remedy="replace it by a finite number, or remove the row")
        columns[str(name)] = values
    return _filled(columns, where=where, first_row=1)


def _is_real(column: pd.Series) -> bool:
    kind = pd.api.types
    odd = kind.is_bool_dtype(column) or kind.is_complex_dtype(column)
    return kind.is_numeric_dtype(column) and not odd


def _filled(columns: Mapping[str, Array], *, where: str, first_row: int) -> _Table:
    if not columns or not len(next(iter(columns.values()))):
        raise InputError(what="there are no samples", where=where, remedy="give a recording with rows")
    return _Table(columns=columns, where=where, first_row=first_row)


# ------------------------------------------------------------------------------- tables to recordings


def _recording(table: _Table, *, name: str, rig: Rig | None) -> Recording:
    channels = _channels(table)
    form = _form(table, channels, rig)
    repeats = _repeats(table)
    _require_samples(table, repeats)
    time, continuous = _time(table, repeats)
    if form is MotionForm.JOINTS:
        _require_radians(table, rig)
    if form is MotionForm.POSE:
        _require_unit_norm(table)
    rest = {key: values for key, values in table.columns.items() if key not in (*channels, "time", "repeat")}
    wrench = np.stack([table.columns[channel] for channel in channels], axis=1)
    for values in (wrench, *rest.values(), *(() if time is None else (time,))):
        values.flags.writeable = False
    return Recording(
        name=name, channels=channels, wrench=wrench, columns=rest, form=form, time=time,
        repeats=repeats, continuous=continuous, rig=rig,
    )  # fmt: skip


def _channels(table: _Table) -> tuple[str, ...]:
    planar, spatial = (
        [channel for channel in channels if channel in table.columns]
        for channels in (PLANAR_CHANNELS, SPATIAL_CHANNELS)
    )
    lone = [channel for channel in spatial if channel not in PLANAR_CHANNELS]
    if "tau" in planar and lone:
        what = f"a mixed wrench: the planar tau beside {', '.join(lone)}"
        raise table.error(what, "keep fx, fy, tau or fx, fy, fz, tx, ty, tz")
    expected, found = (SPATIAL_CHANNELS, spatial) if lone else (PLANAR_CHANNELS, planar)
    missing = [channel for channel in expected if channel not in found]
    if not found:
        raise table.error("there is no wrench: fx, fy, tau or fx, fy, fz, tx, ty, tz are missing", RECORD)
    if missing:
        raise table.error(f"the wrench is missing {_listed(missing)}", RECORD)
    return expected


def _form(table: _Table, channels: tuple[str, ...], rig: Rig | None) -> MotionForm:
    """The first complete form of motion, in the order of FORMATS, that this wrench can go with."""
    planar = channels == PLANAR_CHANNELS
    forms = (MotionForm.JOINTS, MotionForm.PLANAR_POSE) if planar else (MotionForm.POSE,)
    obstacles = {form: _missing(form, table, rig) for form in forms}
    for form, obstacle in obstacles.items():
        if obstacle is None:
            return form
    for form, obstacle in obstacles.items():
        if obstacle is not None and _begun(form, table):
            raise table.error(*obstacle)
    if planar:
        raise table.error("the motion is missing: neither q1..qn nor phi", RECORD)
    remedy = "record the orientation of the sensor (joint angles are read for planar arms only)"
    raise table.error(f"the motion is missing {_listed(QUATERNION)}", remedy)


def _begun(form: MotionForm, table: _Table) -> bool:
    """Whether anything of this form is there, so that what it lacks is worth naming."""
    if form is MotionForm.JOINTS:
        return bool(_joint_angles(table))
    names = ("phi", "ax", "ay") if form is MotionForm.PLANAR_POSE else QUATERNION
    return any(name in table.columns for name in names)


def _joint_angles(table: _Table) -> list[str]:
    angles = (name for name in table.columns if JOINT_ANGLE.fullmatch(name))
    return sorted(angles, key=lambda name: int(name[1:]))


def _missing(form: MotionForm, table: _Table, rig: Rig | None) -> tuple[str, str] | None:
    """What keeps a form of motion from being complete, and the remedy; None when it is complete."""
    if form is MotionForm.JOINTS:
        return _missing_joints(table, rig)
    needed = ["phi"] if form is MotionForm.PLANAR_POSE else list(QUATERNION)
    if form is MotionForm.PLANAR_POSE and ("ax" in table.columns) != ("ay" in table.columns):
        needed += ["ax", "ay"]
    missing = [name for name in needed if name not in table.columns]
    return (f"the motion is missing {_listed(missing)}", RECORD) if missing else None


def _missing_joints(table: _Table, rig: Rig | None) -> tuple[str, str] | None:
    angles = _joint_angles(table)
    if rig is None or rig.link_lengths is None:
        lacks = "no rig was given" if rig is None else "the rig has no link_lengths"
        return (
            f"columns {_listed(angles)} are joint angles, and {lacks}",
            "give a rig with robot.link_lengths",
        )
    expected = numbered("q", len(rig.link_lengths))
    missing = [name for name in expected if name not in angles]
    if missing:
        return f"the motion is missing {_listed(missing)}", "record every joint of robot.link_lengths"
    extra = [name for name in angles if name not in expected]
    if extra:
        what = f"columns {_listed(extra)} are joint angles beyond the rig's {len(expected)} link_lengths"
        return what, "give a rig with a length for each joint, or rename the column"
    return None


def _repeats(table: _Table) -> int:
    """How many repeats there are: whole numbers, rows together, equally many samples each."""
    if "repeat" not in table.columns:
        return 1
    repeat = table.columns["repeat"]
    broken = np.flatnonzero(repeat != np.round(repeat))
    if broken.size:
        what = f"column repeat is {repeat[broken[0]]:g} at row {table.row(int(broken[0]))}"
        raise table.error(what, "number the repeats with integers")
    starts = np.concatenate([[0], np.flatnonzero(np.diff(repeat)) + 1])
    again = np.setdiff1d(np.arange(len(starts)), np.unique(repeat[starts], return_index=True)[1])
    if again.size:
        start = int(starts[again[0]])
        what = f"repeat {repeat[start]:g} comes again at row {table.row(start)}: its rows are not together"
        raise table.error(what, "sort the rows by repeat, then by time")
    _require_equal(table, repeat, starts)
    return len(starts)


def _require_equal(table: _Table, repeat: Array, starts: NDArray[np.int64]) -> None:
    counts = np.diff(np.append(starts, len(repeat)))
    usual = int(max(counts, key=lambda count: (np.sum(counts == count), count)))
    odd = np.flatnonzero(counts != usual)
    if odd.size:
        i = int(odd[0])
        what = f"repeat {repeat[starts[i]]:g}, from row {table.row(int(starts[i]))} on, has {counts[i]} samples"
        remedy = "cut the repeats to one period each, or leave an incomplete one out"
        raise table.error(f"{what} and others {usual}", remedy)


def _require_samples(table: _Table, repeats: int) -> None:
    samples = len(table) // repeats
    least, noun = (LEAST_SAMPLES, "samples") if "time" in table.columns else (LEAST_POSES, "poses at rest")
    if samples < least:
        each = "" if repeats == 1 else " in each repeat"
        what = f"too few {noun}{each}: {samples}, and at least {least} are needed"
        raise table.error(what, "record longer" if noun == "samples" else "record more poses, or a time column")


def _time(table: _Table, repeats: int) -> tuple[Array | None, bool]:
    """Uniform time (n,) from 0 on, and whether the repeats followed each other without a pause."""
    if "time" not in table.columns:
        return None, repeats == 1
    runs = table.columns["time"].reshape(repeats, -1)
    seams = runs[1:, 0] - runs[:-1, -1]
    # A pause between repeats parts them as a restart does: no line of the whole record's spectrum spans it.
    parted = bool(np.any((seams <= 0) | (seams > 3 * (runs[:, -1:] - runs[:, :1]).mean() / (runs.shape[1] - 1))))
    stretches = runs if parted else runs.reshape(1, -1)
    clocks = [
        Clock.of(stamps, where=table.where, first_row=table.row(i * stretches.shape[1]))
        for i, stamps in enumerate(stretches)
    ]
    steps = np.array([clock.dt for clock in clocks])
    if np.ptp(steps) * (stretches.shape[1] - 1) > steps.mean():
        i = int(np.argmax(np.abs(steps - np.median(steps))))
        what = f"the run from row {table.row(i * stretches.shape[1])} on has a step of {steps[i]:.6g} s,"
        what += f" others {np.median(steps):.6g} s"
        raise table.error(what, "give runs of one sample rate")
    samples = stretches.shape[1]
    return np.tile(Clock(start=0.0, dt=float(steps.mean())).times(samples), len(stretches)), not parted


def _require_radians(table: _Table, rig: Rig | None) -> None:
    if rig is None or rig.limits is None:
        return
    for name, (low, high) in zip(numbered("q", rig.limits.joints), rig.limits.position, strict=True):
        outside = np.flatnonzero(np.abs(table.columns[name] - (low + high) / 2) > high - low)
        if outside.size:
            i = int(outside[0])
            what = f"column {name} at row {table.row(i)} is {table.columns[name][i]:g}, far outside the rig's"
            raise table.error(f"{what} [{low:g}, {high:g}] rad (degrees?)", "give joint angles in rad")


def _require_unit_norm(table: _Table) -> None:
    norm = np.linalg.norm([table.columns[name] for name in QUATERNION], axis=0)
    wrong = np.flatnonzero(np.abs(norm - 1) > NORM_ERROR)
    if wrong.size:
        i = int(wrong[0])
        what = f"columns qx, qy, qz, qw at row {table.row(i)} have norm {norm[i]:.4g} instead of 1"
        raise table.error(what, "give unit quaternions, x y z w")


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names)
