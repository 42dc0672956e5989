"""Readings of logs: what the reader of a log decided before there was a case, as it is said with the case."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from estimation.readings.doubted_reading import DoubtedReading
from estimation.recordings.reading_report import Assumption
from estimation.recordings.recording import Recording

ASSUMED = {
    "position": ("length_unit", "the positions are in"),
    "angle": ("angle_unit", "the angles are in"),
    "rate": ("angle_unit", "the angular velocity is in"),
    "time": ("time_unit", "the time is in"),
    "orientation": ("orientation_order", "the quaternion is"),
    "wrench_axes": ("wrench_axes", "forces and torques are along the axes of the"),
}
"""Id of the reading that a unit or order is assumed in, and its meaning, by the kind that a map calls it."""


def readings_of_logs(recordings: Sequence[Recording]) -> tuple[DoubtedReading, ...]:
    """What was decided when the logs were read, each thing once."""
    offsets = [recording.clock_offset for recording in recordings if recording.clock_offset is not None]
    reports = [recording.reading for recording in recordings if recording.reading is not None]
    readings = [_clock_offset(max(offsets, key=abs))] if offsets else []
    readings += [_polled_twice(report.held) for report in reports if report.held]
    readings += [_assumed(assumption) for report in reports for assumption in report.assumptions]
    return tuple({(reading.id, str(reading.value)): reading for reading in readings}.values())


def _clock_offset(offset: float) -> DoubtedReading:
    """`offset`, s, was estimated between the clocks of wrench and motion, and a delay with it."""
    return _of_log(
        "clock_offset", offset,
        f"the stamps of the wrench are {1e3 * offset:.4g} ms late against those of the motion",
        "estimated from the motion that both show, so that it takes a delay or lag of the sensor in: neither time_delay"
        " nor sensor_lag is measured by this recording",
        "`import --clock-offset` with the offset of the clocks alone, s (0 where one clock stamped both)",
    )  # fmt: skip


def _polled_twice(held: Mapping[str, int]) -> DoubtedReading:
    """Rows were polled faster than there were new values, by the rows for which each quantity is held."""
    listed = ", ".join(f"the {quantity} for {rows} rows" for quantity, rows in held.items())
    return _of_log(
        "polled_twice", dict(held),
        "each value counts once, in the row where it is new",
        f"the log holds {listed} each, which would delay the wrench by half a hold, and count its noise again",
        "log at the rate of the slower clock",
    )  # fmt: skip


def _assumed(assumption: Assumption) -> DoubtedReading:
    """A unit, order or frame that nothing states was taken by the numbers, or is proposed."""
    identity, meaning = ASSUMED[assumption.kind]
    line = f'{assumption.kind} = "{assumption.value}"'
    line = f"units = {{ {line} }}" if assumption.kind in ("position", "angle", "rate", "time") else line
    statement = assumption.remedy or f"{line} in a map"
    reading = _of_log(identity, assumption.value, f"{meaning} {assumption.value}", assumption.why, statement)
    return replace(reading, adopted=assumption.adopted)


def _of_log(identity: str, value: Any, meaning: str, why: str, statement: str) -> DoubtedReading:
    return DoubtedReading(
        id=identity, value=value, meaning=meaning, shown_by=why, statement=statement, adopted=True, mends=False,
        of_log=True, applies_to="map",
    )  # fmt: skip
