"""Recording check: what is suspicious in a file that has the columns of a recording already, for its reading report."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from estimation.reading.log_reader import Array
from estimation.reading.motion_evidence import angle_names, impossible_speed, motion_evidence
from estimation.reading.step_log import StepLog
from estimation.recordings.column_table import ColumnTable
from estimation.recordings.motion import MotionForm
from estimation.recordings.reading import recording_from_table
from estimation.recordings.reading_report import Assumption, ReadingReport, spans
from estimation.recordings.recording import Recording
from estimation.recordings.repeat_motion import NO_REPEATS, largest_deviation
from modeling.errors import InputError
from modeling.rig import Rig

CLIPPED_SHARE = 0.01
"""Of the rows, at the extreme value, from which it is no single peak."""
NEIGHBOURS = 10
"""Levels next to the extreme one whose rows are counted against its."""
CLIPPED_RATIO = 10.0
"""Repeated rows at the extreme value, over those at a usual one of the next levels. A slow signal that turns within its
resolution stays at its last level for sqrt(1), at the next ones for sqrt(k) - sqrt(k - 1): a ratio of 5 over ten."""
LONGEST_STOP, LEAST_STOP = 0.02, 25
"""Share of the rows, and rows, from which a channel that keeps its value has stopped."""
STOP_RATIO = 50.0
"""Length of a stop over that of a usual hold: a slow sinusoid of n levels turns in the last one for 1.2 sqrt(n) usual
holds, 39 of 1000 levels. With more levels it turns in less than `LONGEST_STOP` of the record."""


def clipped_rows(column: Array) -> tuple[float, int] | None:
    """The extreme value at which a channel (n,) clips, and its rows there; None if it does not."""
    for extreme in (float(column.min()), float(column.max())):
        count = int((column == extreme).sum())
        if extreme == 0.0 or count - 1 <= max(CLIPPED_SHARE * len(column), 3):
            continue
        levels, counts = np.unique(column, return_counts=True)
        others = counts[levels != extreme]
        others = others[:NEIGHBOURS] if extreme == levels[0] else others[-NEIGHBOURS:]
        if count - 1 > CLIPPED_RATIO * (float(np.median(others)) - 1 if len(others) else 0.0):
            return extreme, count
    return None


def stops(column: Array) -> list[tuple[int, int]]:
    """First row and the one behind the last of each stretch in which a channel (n,) keeps its value unusually long."""
    starts = np.concatenate([[0], np.flatnonzero(column[1:] != column[:-1]) + 1])
    ends = np.append(starts[1:], len(column))
    long = ends - starts >= max(LEAST_STOP, STOP_RATIO * float(np.median(ends - starts)))
    return [(int(a), int(b)) for a, b in zip(starts[long], ends[long], strict=True)] if len(starts) > 2 else []


def longest_stop(column: Array) -> tuple[int, int] | None:
    """First row and length of the longest stop of a channel (n,) that changes otherwise; None without one."""
    first, last = max(stops(column), key=lambda stop: stop[1] - stop[0], default=(0, 0))
    return (first, last - first) if last - first >= max(LONGEST_STOP * len(column), 1) else None


ZERO_SHARE = 0.01
"""Of the rows, exactly zero as the row before: a reading with noise passes zero, and does not stay there."""


def note_suspicious_channels(columns: Mapping[str, Array], stamps: Array, where: str, log: StepLog) -> None:
    """Log channels that never change, stay at their largest value, or are exactly zero in a dead band.

    Columns (n,) by channel at stamps (n,), s.
    """
    whole = (float(stamps[0]), float(stamps[-1]))
    for name, column in columns.items():
        low, high = float(np.min(column)), float(np.max(column))
        if low == high:
            log.suspicious(f"{name} never changes ({low:.6g})", where, at=(whole,), channels=(name,))
            continue
        clipped, stop, whose = clipped_rows(column), longest_stop(column), (name,)
        if clipped is not None:
            what = f"{name} stays at its extreme value {clipped[0]:.6g}: saturated?"
            log.suspicious(what, where, clipped[1], len(column), spans(stamps, column == clipped[0]), whose)
        elif stop is not None and column[stop[0]] != 0.0:
            what = f"{name} stops at {column[stop[0]]:.6g} from row {stop[0] + 1} on: stuck?"
            log.suspicious(what, where, stop[1], len(column), spans(stamps, stop[0] + np.arange(stop[1])), whose)
        zeros = column == 0.0
        count = int((zeros[1:] & zeros[:-1]).sum())
        if count > ZERO_SHARE * len(column):
            what = f"{name} is exactly zero: a dead band, or no reading?"
            log.suspicious(what, where, count, len(column), spans(stamps, _runs(zeros)), whose)


def _runs(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Mask of those that have a neighbour."""
    pairs = mask[1:] & mask[:-1]
    return np.asarray(np.concatenate([pairs, [False]]) | np.concatenate([[False], pairs]))


PROPOSED = {"the angles are in degrees": ("angle", "deg"), "the wrench is along base axes": ("wrench_axes", "base")}
"""What the weight may show of joint logs and planar ones, so that a verdict on them is withheld."""
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
    if not log.steps and not log.assumptions:
        return recording
    if recording.reading is not None:
        steps = (*recording.reading.steps, *log.steps)
        assumptions = (*recording.reading.assumptions, *log.assumptions)
        return replace(recording, reading=replace(recording.reading, steps=steps, assumptions=assumptions))
    columns = (*(() if recording.time is None else ("time",)), *recording.columns, *recording.channels)
    report = ReadingReport(
        sources=((recording.name, "recording", recording.samples, len(columns)),), used=(), clocks=(), offset=None,
        steps=tuple(log.steps), samples=recording.samples, rate=None if recording.dt is None else 1 / recording.dt,
        columns=columns, assumptions=tuple(log.assumptions),
    )  # fmt: skip
    return replace(recording, reading=report)


def note_motion(recording: Recording, log: StepLog, how: str = "") -> None:
    """Log what the weight and the speed show against the units, axes and orientation as read; `how` to mend it."""
    evidence = motion_evidence(recording)
    if evidence is not None and evidence.is_better:
        if recording.form is MotionForm.POSE:  # in which frames and units it was logged, its case says
            return
        mending = how if evidence.best.advice.endswith("in a map") else ""
        if evidence.best.meaning in PROPOSED:
            kind, value = PROPOSED[evidence.best.meaning]
            why = evidence.sentence.removeprefix(f"{evidence.best.meaning}: ")
            remedy = f"{evidence.best.advice.removeprefix('state ')}{mending}"
            log.assumptions.append(Assumption(kind, value, why, adopted=False, remedy=remedy))
            return
        log.suspicious(f"{evidence.sentence}; {evidence.best.advice}{mending}", recording.name)
        return
    if evidence is not None and evidence.shows_no_weight:
        log.suspicious(evidence.weight_sentence, recording.name)
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
