"""Channels that are no readings: one that never changes, one that is another's copy, one that stays at its limit."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Any

import numpy as np

from estimation.noise.recording_noise import constant_channels
from estimation.reading.recording_check import clipped_rows
from estimation.readings.doubted_reading import DoubtedReading
from estimation.readings.row_reading import Rows, pose_outlier, without_rows
from estimation.recordings.recording import Recording
from estimation.recordings.sign_convention import in_sensor_frame
from modeling.rig import Convention, Rig
from modeling.space import Space

OF_CHANNELS = ("channel_constant", "channel_copied")
"""Ids of readings by which a channel measures nothing of the tool, or nobody knows what."""
ALONG_AXIS = 0.9
"""Cosine of the angle between a force's weight and its axis, above which the axes are the pose's: 26 degrees."""


@dataclass(frozen=True, eq=False)
class LeftOut:
    """Rows and channels that a recording is read without.

    A channel is held at its mean: no fit weighs it then. Repeats are one run, as it has no noise that they show.
    """

    rows: Rows = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    channels: tuple[str, ...] = ()

    def of(self, recording: Recording) -> Recording:
        """The recording without them."""
        if self.channels:
            held = np.isin(recording.channels, self.channels)
            recording = recording.with_readings(np.where(held, recording.wrench.mean(axis=0), recording.wrench))
            recording = recording.moved(repeats=1) if recording.repeats > 1 and recording.continuous else recording
        return without_rows(recording, self.rows)

    def and_also(self, other: LeftOut) -> LeftOut:
        """Both."""
        return LeftOut(np.union1d(self.rows, other.rows), (*self.channels, *other.channels))


Doubt = tuple[DoubtedReading, Sequence[LeftOut] | None]
"""What is doubted, and what each recording is read without then; None where nothing says what to do."""


def log_readings(
    recordings: Sequence[Recording], read: Collection[str]
) -> tuple[tuple[DoubtedReading, ...], tuple[Recording, ...]]:
    """What is doubted of channels and rows of recordings, whatever their frames are, and the recordings as read.

    Those whose id is among `read` are adopted, where something says what the recordings are then.
    """
    readings, left_out = [], [LeftOut() for _ in recordings]
    saturated = _saturated(recordings)
    at_limit = None if saturated is None else saturated[1]
    outlier = pose_outlier(recordings, [each.rows for each in at_limit or left_out])
    outlying = None if outlier is None else (outlier[0], [LeftOut(rows) for rows in outlier[1]])
    for doubt in (_constant(recordings), _copied(recordings), saturated, outlying):
        if doubt is None:
            continue
        doubted, without = doubt
        adopted = without is not None and doubted.id in read
        readings.append(replace(doubted, adopted=adopted))
        if without is not None and (adopted or not doubted.mends):
            left_out = [own.and_also(other) for own, other in zip(left_out, without, strict=True)]
    several = (without.of(recording) for recording, without in zip(recordings, left_out, strict=True))
    return tuple(readings), tuple(several)


def convention_by_axes(recordings: Sequence[Recording]) -> Convention | None:
    """Sign convention of six-axis readings without the forces that are no readings; None where they do not show it.

    With a force missing, a mounting that is turned reads as one with the other sign, so that the axes of the sensor are
    taken for those of the pose: the weight in each of the other forces is along gravity's direction there, or against.
    """
    slopes = []
    for recording in recordings:
        forces = recording.wrench[:, :3]
        copied = {c for first, second, _ in _equal_channels(recording) for c in (first, second)}
        read = [i for i in range(3) if np.ptp(forces[:, i]) > 0 and recording.channels[i] not in copied]
        signals, gravity = recording.signals, (recording.rig or Rig()).gravity
        falling = [-np.asarray(signals.get(f"ap{axis}", 0.0)) / gravity for axis in "xyz"]
        weight = in_sensor_frame(signals, (falling[0], falling[1], falling[2] - 1.0))
        slope = np.linalg.lstsq(np.column_stack([np.ones(len(weight)), weight]), forces, rcond=None)[0][1:]
        slopes += [(slope[i, i], float(np.linalg.norm(slope[:, i]))) for i in read]
    along = [own for own, size in slopes if abs(own) > ALONG_AXIS * size]
    if not along or len(along) < len(slopes) or (min(along) < 0 < max(along)):
        return None
    return Convention.ON_SENSOR if along[0] > 0 else Convention.ON_TOOL


def _constant(recordings: Sequence[Recording]) -> Doubt | None:
    """Channels that never change. No fit weighs them (`without_constant_channels`), adopted or not."""
    held = {(r.name, r.channels[i]): float(r.wrench[0, i]) for r in recordings for i in constant_channels(r)}
    if not held:
        return None
    channels = list(dict.fromkeys(c for _, c in held))
    one = len(channels) == 1
    doubted = DoubtedReading(
        id="channel_constant", value=channels, applies_to="map", mends=False,
        meaning=f"{_listed(channels)} {'is' if one else 'are'} no reading{'s' * (not one)}",
        shown_by="; ".join(
            f"{c} is {value:.6g} {_unit(c)} in every row of {name}" for (name, c), value in held.items()
        ),
        statement=f"--read channel_constant, which leaves {'it' if one else 'them'} out, or name the right"
        f" column{'s' * (not one)} in a map",
    )  # fmt: skip
    in_repeats = [tuple(c for name, c in held if r.repeats > 1 and name == r.name) for r in recordings]
    return doubted, [LeftOut(channels=channels) for channels in in_repeats]


def _copied(recordings: Sequence[Recording]) -> Doubt | None:
    """Channels that hold the numbers of another, or those with the other sign: nobody knows which is right."""
    pairs = list(dict.fromkeys(pair for r in recordings for pair in _equal_channels(r)))
    if not pairs:
        return None
    first, second, sign = pairs[0]
    doubted = DoubtedReading(
        id="channel_copied", value=sorted({c for a, b, _ in pairs for c in (a, b)}), applies_to="map",
        meaning=f"{second} holds the numbers of {first}" + " with the other sign" * (sign < 0),
        shown_by="they are the same in every row, which those of two axes are not",
        statement="--read channel_copied, which leaves both out, or name the right columns in a map",
    )  # fmt: skip
    copied = (tuple({c for a, b, _ in _equal_channels(r) for c in (a, b)}) for r in recordings)
    return doubted, [LeftOut(channels=channels) for channels in copied]


def _equal_channels(recording: Recording) -> Iterator[tuple[str, str, int]]:
    for (i, first), (j, second) in combinations(enumerate(recording.channels), 2):
        a, b = recording.wrench[:, i], recording.wrench[:, j]
        if np.ptp(a) > 0:
            yield from ((first, second, sign) for sign in (1, -1) if np.array_equal(a, sign * b))


def _saturated(recordings: Sequence[Recording]) -> Doubt | None:
    """Channels with many rows at exactly their extreme value: poses that are left out; of a run, `saturation`."""
    limits: dict[tuple[str, str], tuple[float, int]] = {}
    for recording in recordings:
        for channel, column in zip(recording.channels, recording.wrench.T, strict=True):
            clipped = clipped_rows(column) if np.ptp(column) > 0 else None
            if clipped is not None:
                limits[recording.name, channel] = clipped
    if not limits:
        return None
    channels: dict[str, Any] = {c: limit for (_, c), (limit, _) in limits.items()}
    posed = all(r.at_rest for r in recordings if any((r.name, c) in limits for c in r.channels))
    doubted = DoubtedReading(
        id="channel_saturated", value=channels, applies_to="rig", explained_by="saturation",
        meaning="; ".join(f"{c} stays at its limit, {limit:.6g} {_unit(c)}" for c, limit in channels.items()),
        shown_by="; ".join(
            f"{count} rows of {c} of {name} are exactly that" for (name, c), (_, count) in limits.items()
        ),
        statement="--read channel_saturated, which leaves these poses out" if posed
        else "the effect saturation, a larger range of the sensor, or a lighter tool",
    )  # fmt: skip
    return doubted, [
        _rows_at(r, {c: v for (n, c), (v, _) in limits.items() if n == r.name}) for r in recordings
    ] if posed else None


def _rows_at(recording: Recording, limits: Mapping[str, float]) -> LeftOut:
    """The rows of a recording in which a channel is at its limit."""
    at_limit = np.zeros(recording.samples, dtype=bool)
    for channel, limit in limits.items():
        at_limit |= recording.wrench[:, recording.channels.index(channel)] == limit
    return LeftOut(np.flatnonzero(at_limit))


def _unit(channel: str) -> str:
    return {**Space.PLANE.channel_units, **Space.SPACE.channel_units}[channel]


def _listed(words: Sequence[str]) -> str:
    *first, last = words
    return f"{', '.join(first)} and {last}" if first else last
