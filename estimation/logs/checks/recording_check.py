"""Recording check: what is suspicious in a file that has the columns of a recording already, for its reading report."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from estimation.logs.clocks.suspicious_channels import note_suspicious_channels
from estimation.logs.log_table import Array
from estimation.logs.motion_evidence import angle_names, impossible_speed, motion_evidence
from estimation.logs.step_log import StepLog
from estimation.recordings.column_table import ColumnTable
from estimation.recordings.reading import recording_from_table
from estimation.recordings.recording import Recording
from estimation.recordings.repeat_motion import NO_REPEATS, largest_deviation
from estimation.recordings.reports.reading_report import ReadingReport
from modeling.errors import InputError
from modeling.rig.rig import Rig

BY_IMPORT = ", and bring the recording in by `truewrench import --map` or `tw.read(..., map=...)`"


def checked(recording: Recording) -> Recording:
    """The recording, with a report of its reading where anything in it is suspicious."""
    log = StepLog()
    instants: Array = np.asarray((recording.dt or 1.0) * np.arange(recording.samples), dtype=np.float64)
    note_suspicious_channels(
        dict(zip(recording.channels, recording.wrench.T, strict=True)), instants, recording.name, log
    )
    note_motion(recording, log, BY_IMPORT)
    note_repeats(recording, log)
    if not log.steps:
        return recording
    if recording.reading is not None:
        return replace(recording, reading=replace(recording.reading, steps=(*recording.reading.steps, *log.steps)))
    columns = (*(() if recording.time is None else ("time",)), *recording.columns, *recording.channels)
    report = ReadingReport(
        sources=((recording.name, "recording", recording.samples, len(columns)),), used=(), clocks=(), offset=None,
        steps=tuple(log.steps), samples=recording.samples, rate=None if recording.dt is None else 1 / recording.dt,
        columns=columns,
    )  # fmt: skip
    return replace(recording, reading=report)


def note_motion(recording: Recording, log: StepLog, how: str = "") -> None:
    """Log what the weight and the speed show against the units, axes and orientation as read; `how` to mend it."""
    found = motion_evidence(recording)
    if found is not None and found.is_better:
        mending = how if found.best.advice.endswith("in a map") else ""
        log.suspicious(f"{found.sentence}; {found.best.advice}{mending}", recording.name)
        return
    if found is not None and found.shows_no_weight:
        log.suspicious(found.weight_sentence, recording.name)
    if recording.dt is not None:
        rows = recording.samples_per_repeat
        angles = {name: recording.columns[name][:rows] for name in angle_names(recording)}
        note_speed(angles, recording.dt, recording.name, log, how)


def note_repeats(recording: Recording, log: StepLog) -> None:
    """Log that repeats moved differently: so much that they are none, or beyond the noise of the motion."""
    if recording.repeats == 1 or recording.dt is None:
        return
    worst = largest_deviation(recording.columns, recording.repeats)
    if worst is None:
        return
    what = f"the motion of repeat {worst.repeat}, counted from 0, {worst.sentence(recording.dt)}"
    if worst.gross:
        log.suspicious(f"{what}: {NO_REPEATS}", recording.name)
    elif recording.own_motion is not None:
        log.taken(f"{what}: where the readings show it, each repeat is predicted with its own motion", recording.name)


def note_columns(columns: Mapping[str, Array], where: str, rig: Rig | None, log: StepLog) -> None:
    """What `note_motion` does, of columns (n,) with joint angles or a planar pose, as far as they are a recording."""
    angles = {name: column for name, column in columns.items() if re.fullmatch(r"q[1-9]\d*|phi", name)}
    if (rig is None or rig.arm is None) and "time" in columns and "phi" not in columns:
        note_speed(angles, float(columns["time"][1] - columns["time"][0]), where, log)
        return
    try:
        recording = recording_from_table(ColumnTable(columns=columns, where=where, first_row=1), name=where, rig=rig)
    except InputError:  # said when the columns are used as a recording
        return
    note_motion(recording, log)
    note_repeats(recording, log)


def note_speed(angles: Mapping[str, Array], dt: float, where: str, log: StepLog, how: str = "") -> None:
    """Log a speed that no arm has."""
    fastest = impossible_speed(angles, dt)
    if fastest is not None:
        what = f"{fastest[0]} turns at {fastest[1]:.3g} rad/s, faster than any arm: is it in degrees, or the time in"
        log.suspicious(f'{what} other units? State units = {{ angle = "deg" }} in a map{how}', where)
