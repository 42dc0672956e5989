"""Picture of a log's reading: the recording's curves, and when each step happened, on the recording's stamps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from estimation.logs.log_table import Array
from estimation.recordings.column_table import ColumnTable
from estimation.recordings.reading import MIN_POSES, recording_from_table
from estimation.recordings.recording import Recording
from estimation.recordings.reports.reading_curves import ReadingCurves
from estimation.recordings.reports.reading_report import OffsetReading, ReadingReport, ReadingStep, UsedColumns
from estimation.recordings.signal_unit import signal_unit
from modeling.errors import InputError
from modeling.rig.rig import Rig

MOST_DIRECTIONS = 600
OTHER_UNITS = {**dict.fromkeys(("fx", "fy", "fz"), "N"), **dict.fromkeys(("tau", "tx", "ty", "tz"), "N m")}
OTHER_UNITS |= {**dict.fromkeys(("qx", "qy", "qz", "qw"), ""), "temperature": "°C"}


def picture_of(
    columns: Mapping[str, Array],
    stamps: Array | None,
    steps: Sequence[ReadingStep],
    wrench: str,
    offset: OffsetReading | None,
    rig: Rig | None,
) -> tuple[ReadingCurves, tuple[ReadingStep, ...]]:
    """Curves of a recording's columns (n,), and the steps with their times, both from its first sample on.

    stamps  (n,) of the samples on the clock of the `wrench`'s source, s; None for static poses
    """
    start = 0.0 if stamps is None else float(stamps[0])
    late = offset.offset if offset is not None and offset.applied else 0.0
    origins = {step.where: start if step.where == wrench else start - late for step in steps}
    moved = tuple(
        replace(step, at=tuple((a - origins[step.where], b - origins[step.where]) for a, b in step.at))
        for step in steps
    )
    return ReadingCurves.of(columns, _units(columns, rig), stamps, gravity_directions(columns, rig)), moved


def pictured_reading(recording: Recording) -> ReadingReport:
    """The report of a recording's reading with the curves of a picture, also of one that was read as it stands."""
    if recording.reading is not None and recording.reading.curves is not None:
        return recording.reading
    columns = {str(name): column.to_numpy(dtype=np.float64) for name, column in recording.to_frame().items()}
    stamps: Array | None = columns.get("time")
    curves, _ = picture_of(columns, stamps, (), recording.name, None, recording.rig)
    motion = tuple(name for name in recording.columns if name not in recording.auxiliary)
    used = [
        UsedColumns(quantity=quantity, source=recording.name, columns=names, targets=names, how="as it stands")
        for quantity, names in (("wrench", recording.channels), ("motion", motion))
    ]
    return ReadingReport(
        sources=((recording.name, "recording", recording.samples, len(columns)),),
        used=tuple(used),
        clocks=(),
        offset=None,
        steps=() if recording.reading is None else recording.reading.steps,
        samples=recording.samples,
        rate=None if recording.dt is None else 1 / recording.dt,
        columns=tuple(columns),
        curves=curves,
    )


def _units(columns: Mapping[str, Array], rig: Rig | None) -> dict[str, str]:
    """SI units by channel; joint coordinates are angles where no arm says otherwise."""
    arm = None if rig is None else rig.arm
    units = {name: signal_unit(name) or OTHER_UNITS.get(name, "") for name in columns}
    units |= {f"q{j}": unit for j, unit in enumerate(arm.units if arm is not None else (), 1) if f"q{j}" in units}
    return units


def gravity_directions(columns: Mapping[str, Array], rig: Rig | None) -> Array | None:
    """Directions of gravity in the sensor's axes, (k, 3) or in the plane (k, 2), of some of the rows.

    None where the orientation is not known, as of joint angles without an arm.
    """
    samples = len(next(iter(columns.values())))
    every = slice(0, samples, -(-samples // MOST_DIRECTIONS))
    poses = {name: column[every].copy() for name, column in columns.items() if name != "repeat"}
    shown = len(next(iter(poses.values())))
    if shown < MIN_POSES:
        return None
    if "time" in columns and "qw" not in columns:
        step = every.step * float(columns["time"][1] - columns["time"][0])
        poses["time"] = np.asarray(step * np.arange(shown), dtype=np.float64)
    angles = poses if "qw" in columns else _signals(poses, rig)
    if "phi" in angles:  # y up in the world, phi clockwise
        return np.stack([np.sin(angles["phi"]), -np.cos(angles["phi"])], axis=1)
    if "qw" not in angles:
        return None
    from scipy.spatial.transform import Rotation  # slow to import

    turn = Rotation.from_quat(np.stack([angles[name] for name in ("qx", "qy", "qz", "qw")], axis=1))
    return np.asarray(turn.apply([0.0, 0.0, -1.0], inverse=True))


def _signals(columns: Mapping[str, Array], rig: Rig | None) -> Mapping[str, Array]:
    """Signals (k,) of a recording of these columns; none where they are no recording."""
    table = ColumnTable(columns=columns, where="poses", first_row=1)
    try:
        return recording_from_table(table, name="poses", rig=rig).signals
    except InputError:
        return {}
