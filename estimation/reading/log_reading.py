"""Reading of recordings and logs: files as FORMATS has them strictly, all else by an import with a report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimation.reading.log_reader import LogTable, episode_of
from estimation.reading.recording_check import checked
from estimation.reading.repeat_cutting import cut_into_repeats
from estimation.reading.sample_mending import differ_slightly, repeat_lengths
from estimation.reading.step_log import StepLog
from estimation.recordings.column_table import (
    ColumnTable,
    table_file,
    table_from_columns,
    table_from_file,
    table_from_frame,
)
from estimation.recordings.differentiation import TrueSamples, held_rows
from estimation.recordings.motion import QUATERNION
from estimation.recordings.reading import read as read_recording
from estimation.recordings.reading import recording_from_table
from estimation.recordings.reading_report import ReadingReport
from estimation.recordings.recording import Recording, WholeLog
from modeling.errors import InputError, kind_of
from modeling.rig import PLANAR_CHANNELS, SPATIAL_CHANNELS, Rig

if TYPE_CHECKING:
    import pandas as pd

    from estimation.reading.column_map import ColumnMap
    from estimation.reading.log_import import ImportedRecording


def read(
    *sources: str | Path,
    rig: Rig | str | Path | None = None,
    preset: str | None = None,
    map: str | Path | ColumnMap | None = None,  # the option's name on the command line
    period: float | None = None,
    strict: bool = False,
    one_run: bool = False,
    clock_offset: float | None = None,
) -> Recording:
    """The recording in one or several files.

    One CSV or Parquet file with the columns of FORMATS is read as it stands, and anything wrong with it is an error;
    but a motion that repeats to within its noise is cut into repeats where no column counts them, and repeats of
    slightly different length are brought onto one clock, as `Recording.reading` says then.
    What is only suspicious (units, axes, order of the quaternion, a stuck channel) is in `Recording.reading` too.
    All else is what robots write, and read as `truewrench import` does: any separator, compression, Excel, MATLAB,
    NumPy, HDF5, ROS bags and episodes of LeRobot data sets. What was done is in `Recording.reading`.

    Parameters
    ----------
    *sources : str or Path
        One file; or several, each with some of the columns, on their own clocks.
    rig : Rig, str or Path, optional
        A rig or its file: the kinematics that joint angles need, and [columns], names of the log's columns.
    preset : str, optional
        Name of a layout; by default recognised.
    map : str or Path or ColumnMap, optional
        TOML file of columns and units.
    period : float, optional
        Period of the motion, s, to cut repeats; by default found, where the motion has one.
    strict : bool, optional
        Refuse what has to be mended; by default False.
    one_run : bool, optional
        Take everything as one run, whatever repeats; by default False.
    clock_offset : float, optional
        Stamp of the wrench minus stamp of the motion at one instant, s; by default estimated where they differ.

    Returns
    -------
    Recording
        Wrench (n, p), N and N m, motion and auxiliary columns, SI.

    Raises
    ------
    InputError
        In one line with file and row or column, for whatever cannot be a recording. Rows are counted with a CSV's
        header as row 1.

    Examples
    --------
    >>> import truewrench as tw
    >>> recording = tw.read("train.csv", rig=tw.Rig.read("rig.toml"))
    >>> recording.channels, recording.wrench.shape, recording.repeats
    (('fx', 'fy', 'tau'), (4000, 3), 8)
    """
    for source in sources:
        require_path(source)
    rig = Rig.read(rig) if isinstance(rig, str | Path) else rig
    as_it_stands = preset is None and map is None and period is None and clock_offset is None
    as_it_stands = as_it_stands and not (rig is not None and rig.columns)
    if len(sources) == 1 and as_it_stands and is_recording(Path(sources[0])):
        recording = _as_it_stands(Path(sources[0]), rig, strict=strict, one_run=one_run)
    else:
        recorded = imported(
            *sources, rig=rig, preset=preset, map=map, period=period, strict=strict, one_run=one_run,
            clock_offset=clock_offset,
        )  # fmt: skip
        recording = recorded.recording(rig)
    return _carrying(recording, rig, sources)


def imported(
    *sources: str | Path | LogTable,
    rig: Rig | None = None,
    preset: str | None = None,
    map: str | Path | ColumnMap | None = None,  # the option's name on the command line
    period: float | None = None,
    strict: bool = False,
    one_run: bool = False,
    clock_offset: float | None = None,
) -> ImportedRecording:
    """Logs as a table of FORMATS with its reading report, whatever their columns are called; arguments as of `read`.

    A source may be a table in memory. With `one_run`, no period is looked for, and repeats are not counted.
    """
    from estimation.reading.column_map import ColumnMap
    from estimation.reading.log_import import ReadingOptions, import_recording  # slow to import: for logs alone

    if not sources:
        raise InputError(what="no sources were given", where="read", remedy="give the paths of recordings or logs")
    stated = ColumnMap.read(map) if isinstance(map, str | Path) else map
    options = ReadingOptions(
        preset=preset, stated=stated, period=period, strict=strict, one_run=one_run, clock_offset=clock_offset
    )
    return import_recording(sources, options, rig=rig)


def require_path(given: object) -> None:
    """InputError, in a sentence, for what is no path of a file."""
    if not isinstance(given, str | Path):
        remedy = "give the path of a file; a data frame goes to tw.from_dataframe(frame), arrays to tw.from_arrays"
        raise InputError(what=f"{kind_of(given)} is no path", where="read", remedy=remedy)


def is_recording(path: Path) -> bool:
    """Whether the columns of a CSV or Parquet file are called as FORMATS has them: a wrench and a motion."""
    try:
        names = set(table_file(path).names)
    except InputError:
        return False
    wrench = any(names.issuperset(channels) for channels in (PLANAR_CHANNELS, SPATIAL_CHANNELS))
    return wrench and ("q1" in names or "phi" in names or names.issuperset(QUATERNION))


def read_with_rig(
    path: str | Path,
    *,
    rig: Rig | None,
    period: float | None = None,
    one_run: bool = False,
    every_row: bool = False,
) -> Recording:
    """A recording as it stands; an episode of a data set, or where the rig names the columns of its logs, a log.

    Repeats are those of the `period` (s), where it is given. With `every_row` nothing is cut or moved for the sake of
    repeats; with `one_run` they are not counted either.
    """
    is_episode = episode_of(Path(path)) is not None  # whose description names its columns
    if period is not None or (rig is not None and rig.columns) or is_episode:
        return read(path, rig=rig, period=period, one_run=one_run or every_row)
    recording = read_recording(path, rig=rig) if every_row else _as_it_stands(Path(path), rig, one_run=one_run)
    return _carrying(recording, rig, [path])


def _carrying(recording: Recording, rig: Rig | None, sources: Sequence[str | Path]) -> Recording:
    """The recording with the loads that the rig states of one of its files."""
    of_files = [] if rig is None else list(dict.fromkeys(rig.loads_of(path) for path in sources))
    loads = [load for of_file in of_files for load in of_file]
    return recording.carrying(*loads) if loads else recording


def _as_it_stands(path: Path, rig: Rig | None, *, strict: bool = False, one_run: bool = False) -> Recording:
    """The recording in a file of FORMATS' columns; repeats that no column counts, or unequal ones, are cut."""
    table = table_from_file(path)
    if not one_run and _has_unequal_repeats(table):
        return imported(path, rig=rig, strict=strict).recording(rig)
    return recording_with_repeats(table, name=path.name, rig=rig, strict=strict, one_run=one_run)


def recording_with_repeats(
    table: ColumnTable,
    *,
    name: str,
    rig: Rig | None,
    period: float | None = None,
    strict: bool = False,
    one_run: bool = False,
    clock_offset: float | None = None,
) -> Recording:
    """The recording in a table of FORMATS' columns, cut into repeats as `read` says.

    Rows that were polled twice are taken once, and gravity or an accelerometer serves for an orientation.
    """
    if is_polled(table) or has_vertical_alone(table):
        log = LogTable(name=name, kind="recording", columns=table.columns)
        read_as_log = imported(log, rig=rig, period=period, strict=strict, one_run=one_run, clock_offset=clock_offset)
        return read_as_log.recording(rig)
    bare = replace(table, columns={key: column for key, column in table.columns.items() if key != "repeat"})
    if one_run or period is not None:
        table = bare
    unequal = _has_unequal_repeats(table)
    recording = recording_from_table(bare if unequal else table, name=name, rig=rig)
    if recording.dt is None and period is not None:
        what = "poses at rest have no period"
        raise InputError(what=what, where=name, remedy="leave the period out, or give the column time")
    if one_run or recording.repeats > 1 or recording.dt is None:
        return checked(recording)
    return checked(_with_its_repeats(recording, table, period, StepLog(strict=strict)))


EVEN_HOLDS = 0.45
"""Std over mean of the rows for which a value is held, below which a slower clock is behind them: one that is no whole
number of rows gives 0.33 at most, values that are equal by the chance of a coarse resolution 0.7 and more."""


def is_polled(table: ColumnTable) -> bool:
    """Whether the rows were polled faster than the wrench has new values, or some were written twice."""
    channels = [name for name in SPATIAL_CHANNELS + PLANAR_CHANNELS[2:] if name in table.columns]
    if "time" not in table.columns or len(channels) < len(PLANAR_CHANNELS):
        return False
    again = np.flatnonzero(np.diff(table.columns["time"]) == 0)
    if again.size and all((column[again] == column[again + 1]).all() for column in table.columns.values()):
        return True
    wrench = [table.columns[name] for name in channels]
    if TrueSamples.of(wrench, 1.0, len(table)) is None:
        return False
    holds = np.diff(np.flatnonzero(held_rows(wrench, len(table))[0]))
    return float(holds.std()) < EVEN_HOLDS * float(holds.mean())


def has_vertical_alone(table: ColumnTable) -> bool:
    """Whether gravity (gx, gy, gz) or an accelerometer (ax, ay, az) is there instead of a pose or joint angles."""
    names = set(table.columns)
    is_level = any(names.issuperset(vector) for vector in (("gx", "gy", "gz"), ("ax", "ay", "az")))
    return is_level and "fz" in names and not names & {"q1", "phi", *QUATERNION}


def _has_unequal_repeats(table: ColumnTable) -> bool:
    """Whether a column counts repeats of slightly different length."""
    counted = {"repeat", "time"} <= set(table.columns)
    return counted and differ_slightly(repeat_lengths(table.columns["repeat"]))


def _with_its_repeats(recording: Recording, table: ColumnTable, period: float | None, log: StepLog) -> Recording:
    """The recording cut by a stated period (s) or that of its motion; as it is where it has none."""
    columns = {name: column for name, column in table.columns.items() if name != "time"}
    assert recording.dt is not None  # checked before
    cut = cut_into_repeats(columns, recording.dt, period, recording.name, log)
    if cut.period is None and not log.steps:
        return recording
    report = ReadingReport(
        sources=((recording.name, "recording", len(table), len(table.columns)),), used=(), clocks=(), offset=None,
        steps=tuple(log.steps), samples=len(cut.columns["time"]), rate=1 / cut.dt, columns=tuple(cut.columns),
        period=cut.period,
    )  # fmt: skip
    cut_table = ColumnTable(columns=cut.columns, where=table.where, first_row=table.first_row)
    whole = None if cut.kept is None else WholeLog(recording, *cut.kept)
    return replace(recording_from_table(cut_table, name=recording.name, rig=recording.rig), reading=report, whole=whole)


# Recordings from data frames and arrays, cut into repeats as those from files.


def from_dataframe(
    frame: pd.DataFrame,
    *,
    name: str = "recording",
    rig: Rig | None = None,
    period: float | None = None,
    strict: bool = False,
    one_run: bool = False,
) -> Recording:
    """The recording in a data frame with the columns of a recording file, cut into repeats as `read` cuts them.

    Parameters
    ----------
    frame : pandas.DataFrame
        One row a sample, SI: wrench, motion and, unless the rows are poses at rest, `time` in s. A time as the index
        counts as the column `time`.
    name : str, optional
        Its name in messages.
    rig : Rig, optional
        The kinematics that joint angles need.
    period : float, optional
        Period of the motion, s, to cut repeats; by default as a column `repeat` counts them, or as the motion has one.
    strict : bool, optional
        Refuse what has to be interpolated or cut; by default False.
    one_run : bool, optional
        Take everything as one run, whatever repeats; by default False.

    Returns
    -------
    Recording
        Wrench (n, p), N and N m, motion and auxiliary columns.

    Raises
    ------
    InputError
        For missing columns, values that are not numbers, and whatever cannot be a recording.

    Examples
    --------
    >>> import pandas as pd
    >>> import truewrench as tw
    >>> frame = pd.read_csv("train.csv")
    >>> tw.from_dataframe(frame, rig=tw.Rig.read("rig.toml")).repeats
    8
    """
    timed = frame.reset_index() if frame.index.name == "time" and "time" not in frame.columns else frame
    table = table_from_frame(timed.reset_index(drop=True), name)
    return recording_with_repeats(table, name=name, rig=rig, period=period, strict=strict, one_run=one_run)


ARRAY_COLUMNS = {
    "orientation": ("qx", "qy", "qz", "qw"),
    "position": ("px", "py", "pz"),
    "angular_velocity": ("wx", "wy", "wz"),
    "angular_acceleration": ("alx", "aly", "alz"),
    "acceleration": ("apx", "apy", "apz"),
}
"""Columns of a recording that an array of `from_arrays` holds."""


def from_arrays(
    wrench: ArrayLike,
    *,
    name: str = "recording",
    rig: Rig | None = None,
    period: float | None = None,
    strict: bool = False,
    one_run: bool = False,
    **arrays: ArrayLike,
) -> Recording:
    """The recording in arrays, cut into repeats as `read` cuts them.

    Parameters
    ----------
    wrench : array (n, 3) or (n, 6)
        Readings: fx, fy, tau, or fx, fy, fz, tx, ty, tz; N and N m.
    name : str, optional
        Its name in messages.
    rig : Rig, optional
        The kinematics that joint angles need.
    period : float, optional
        Period of the motion, s, to cut repeats; by default as a column `repeat` counts them, or as the motion has one.
    strict : bool, optional
        Refuse what has to be interpolated or cut; by default False.
    one_run : bool, optional
        Take everything as one run, whatever repeats; by default False.
    **arrays : array
        `time` (n,) in s; `q` (n, joints), `dq`, `ddq` in rad; `orientation` (n, 4), a quaternion x, y, z, w of the
        sensor in the world; `position` (n, 3) in m; `angular_velocity` (n, 3) and `angular_acceleration` in the sensor
        frame; `acceleration` (n, 3) in the world; `repeat` (n,); and any column (n,) of a recording by its name, such
        as `phi`, `ax` or a temperature.

    Returns
    -------
    Recording
        Wrench (n, p), N and N m, motion and auxiliary columns.

    Raises
    ------
    InputError
        For arrays of other shapes, and whatever cannot be a recording.

    Examples
    --------
    >>> import truewrench as tw
    >>> rig = tw.Rig.read("rig.toml")
    >>> recording = tw.read("train.csv", rig=rig)
    >>> time = [i * recording.dt for i in range(recording.samples)]
    >>> angles = [recording.signals[f"q{j}"] for j in (1, 2, 3)]
    >>> tw.from_arrays(recording.wrench, time=time, q=list(zip(*angles)), rig=rig).samples
    4000
    """
    readings = np.asarray(wrench)
    channels = {3: PLANAR_CHANNELS, 6: SPATIAL_CHANNELS}.get(readings.shape[1] if readings.ndim == 2 else 0)
    if channels is None:
        remedy = "give (n, 3) for a planar sensor, (n, 6) for six axes"
        raise InputError(what=f"wrench has the shape {readings.shape}", where=name, remedy=remedy)
    columns = dict(zip(channels, readings.T, strict=True))
    for key, values in arrays.items():
        columns |= _columns_of(key, np.asarray(values), name)
    table = table_from_columns(columns, name)
    return recording_with_repeats(table, name=name, rig=rig, period=period, strict=strict, one_run=one_run)


def _columns_of(key: str, values: NDArray[Any], where: str) -> dict[str, NDArray[Any]]:
    """The columns of one array by name."""
    if values.ndim == 1:
        return {key: values}
    joints = [f"{key}{j}" for j in range(1, values.shape[-1] + 1)] if key in ("q", "dq", "ddq") else None
    names = joints or ARRAY_COLUMNS.get(key)
    if names is None or values.ndim != 2 or values.shape[1] != len(names):
        expected = f"(n, {len(names)})" if names else "(n,)"
        raise InputError(what=f"{key} has the shape {values.shape}", where=where, remedy=f"give {expected}")
    return dict(zip(names, values.T, strict=True))
