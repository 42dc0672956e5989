"""Rows that do not belong: a pose at rest that was mistyped or pushed, a sample of a run that jumps off and back."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.noise.pose_noise import PoseRegression, affine_columns
from estimation.readings.doubted_reading import ANY_EFFECT, DoubtedReading
from estimation.recordings.motion import QUATERNION, motion_columns
from estimation.recordings.recording import Recording
from estimation.recordings.sign_convention import to_sensor_frame
from modeling.rig import Rig
from modeling.space import Space

Array = NDArray[np.float64]
Rows = NDArray[np.intp]

JUMP = 10.0
"""Deviation of a sample from the cubic through its neighbours, over the largest of others near it. Of normal noise none
is beyond 3; of noise with the tails of Student's t with 4 degrees of freedom about one sample in a hundred thousand."""
JUMP_SHARE = 0.05
"""Of a column's range: a jump that is smaller does no harm, and may be a step of a column that changes in steps."""
BACK = 0.2
"""Of a jump, the most by which the samples beside it may differ from the slope across it: else it is a step, or an
angle that wraps."""
NEARBY = 25
"""Samples on either side with which a jump is compared: a knock lasts for some of them."""
BESIDE = 3
"""Samples on either side whose cubic a jump itself is in."""
MOST_JUMPS = 20
"""Jumps of a column that are looked at, the largest; a run with more of them is a noisy one."""
SAMPLES_FOR_ONE = 200
"""Samples of a run for each that is named, at the least."""


@dataclass(frozen=True, eq=False)
class OutlyingRows:
    """Rows (k,) of a recording that do not belong to the others.

    p_value  that noise alone makes the most likely of them, family-wise over the rows; None of a run
    detail   by how much the first of them is off, as a clause
    before, after  root mean square over the noise of what the pose does not explain, with and without them
    mass     kg, of the tool by the others; None of a run
    """

    recording: Recording
    rows: Rows
    p_value: float | None
    detail: str
    before: float
    after: float
    mass: float | None = None

    @property
    def numbers(self) -> list[int]:
        """Of the poses or samples, counted from 1."""
        return [int(row) + 1 for row in self.rows]

    @property
    def words(self) -> str:
        """The rows in words."""
        *first, last = map(str, self.numbers)
        noun = "pose" if self.recording.at_rest else "sample"
        return f"{noun}s {', '.join(first)} and {last}" if first else f"{noun} {last}"


def pose_outlier(
    recordings: Sequence[Recording], passed_over: Sequence[Rows] = ()
) -> tuple[DoubtedReading, list[Rows]] | None:
    """The reading that leaves out what does not belong, with its rows; None where every row does.

    `passed_over` are rows of each recording that are doubted already.
    """
    passed_over = passed_over or [np.zeros(0, dtype=np.intp) for _ in recordings]
    outlying = [outlying_rows(r, other) for r, other in zip(recordings, passed_over, strict=True)]
    every = [rows for rows in outlying if rows is not None]
    if not every:
        return None
    several, one = len(recordings) > 1, sum(len(o.rows) for o in every) == 1
    value: Any = {o.recording.name: o.numbers for o in every} if several else every[0].numbers
    where = "; ".join(o.words + f" of {o.recording.name}" * several for o in every)
    posed = all(o.recording.at_rest for o in every)
    doubted = DoubtedReading(
        id="pose_outlier", value=value, applies_to="map", explained_by=ANY_EFFECT,
        meaning=f"{where} {'does' if one else 'do'} not belong to the others" + " (mistyped, pushed or loaded)" * posed,
        statement=f"--read pose_outlier, which leaves {'it' if one else 'them'} out",
        before=max(o.before for o in every), after=max(o.after for o in every), mass=every[0].mass,
        p_value=min((o.p_value for o in every if o.p_value is not None), default=None),
        shown_by="; ".join(o.detail for o in every),
    )  # fmt: skip
    return doubted, [np.zeros(0, dtype=np.intp) if rows is None else rows.rows for rows in outlying]


def outlying_rows(recording: Recording, passed_over: Rows) -> OutlyingRows | None:
    """The rows of a recording that do not belong to the others, None without any.

    Repeats show by themselves which readings do not, and not which of the motion.
    """
    return _outlying_poses(recording, passed_over) if recording.at_rest else _jumps(recording)


def without_rows(recording: Recording, rows: Rows) -> Recording:
    """A recording without these poses (k,) at rest; a run with these samples halfway between their neighbours."""
    kept = np.setdiff1d(np.arange(recording.samples), rows)
    if len(kept) == recording.samples:
        return recording
    if recording.at_rest:
        columns = {name: column[kept] for name, column in recording.columns.items()}
        without = replace(recording.moved(columns=columns), wrench=recording.wrench[kept], whole=None)
        if recording.dwells is None:
            return without
        dwells = replace(recording.dwells, ends=recording.dwells.ends[kept], at_pose=recording.dwells.at_pose[kept])
        return replace(without.moved(instants=dwells.instants), dwells=dwells)
    places = np.clip(np.searchsorted(kept, rows), 1, len(kept) - 1)
    before, after = kept[places - 1], kept[places]
    columns, wrench = {name: column.copy() for name, column in recording.columns.items()}, recording.wrench.copy()
    turned = [name for name in QUATERNION if name in columns]
    same = sum((columns[name][before] * columns[name][after] for name in turned), np.zeros(len(rows)))
    for name, column in columns.items():
        other = np.where((same < 0) & (name in turned), -1.0, 1.0) * column[after]
        wraps = np.abs(other - column[before]) > np.pi  # of an angle; no position jumps as many metres
        column[rows] = np.where(wraps, other, (column[before] + other) / 2)
    wrench[rows] = (wrench[before] + wrench[after]) / 2
    return replace(recording.moved(columns=columns), wrench=wrench, whole=None)


# Poses at rest: what any rigid tool reads is linear in gravity's direction in the sensor, whatever its gains and axes.


def _outlying_poses(recording: Recording, passed_over: Rows) -> OutlyingRows | None:
    changing = np.ptp(recording.wrench, axis=0) > 0
    whole = PoseRegression(affine_columns(recording), recording.wrench[:, changing])
    kept = np.setdiff1d(np.arange(recording.samples), passed_over)
    named, p_value = whole.of(kept).outlying
    if not len(named):
        return None
    rows = kept[named]
    others = np.setdiff1d(kept, rows)
    deviation, std = whole.readings - whole.expected_by(others), whole.of(others).std
    first, names = np.abs(deviation[rows[0]]) / std, np.array(recording.channels)[changing]
    channel = int(np.argmax(first))
    unit = Space(recording.dimension).channel_units[names[channel]]
    judged = np.append(others, rows)
    before, after = (float(np.sqrt(np.mean((deviation[of] / std) ** 2))) for of in (judged, others))
    mass = whole.weight_by(others, [name.startswith("f") for name in names]) / (recording.rig or Rig()).gravity
    detail = (
        f"{names[channel]} of pose {rows[0] + 1} is {deviation[rows[0], channel]:+.3g} {unit} off what the others let"
        f" expect, {first[channel]:.3g} times the noise (p = {p_value:.1g}); the residual is {before:.3g} times the"
        f" noise with {'it' if len(rows) == 1 else 'them'}, {after:.2g} times without, with a mass of {mass:.4g} kg"
    )
    return OutlyingRows(recording, rows, p_value, detail, before, after, mass)


# Runs: a sample that jumps off the cubic through its neighbours while these agree with each other.


def _jumps(recording: Recording) -> OutlyingRows | None:
    largest: dict[int, tuple[float, str]] = {}
    for name, column in _continuous(recording):
        for row, size in _jumps_of(column):
            largest[row] = max(largest.get(row, (0.0, "")), (size, name))
    if not largest or len(largest) > max(1, recording.samples // SAMPLES_FOR_ONE):
        return None
    size, name = max(largest.values())
    detail = f"{name} jumps off and back, {size:.2g} times as far as samples near it are from their neighbours"
    return OutlyingRows(recording, np.array(sorted(largest)), None, detail, size, 1.0)


def _continuous(recording: Recording) -> Iterator[tuple[str, Array]]:
    """Names and columns (n,) of motion and readings that do not jump where an angle wraps or a quaternion changes sign.

    Such a turn is told by the entries of a rotation.
    """
    columns = recording.columns
    for name in motion_columns(recording.form, recording.joints):
        if name not in columns or name in QUATERNION:
            continue
        if name == "phi" or name.startswith("q"):
            yield name, np.sin(columns[name])
            yield name, np.cos(columns[name])
        else:
            yield name, columns[name]
    if all(name in columns for name in QUATERNION):
        rotations = to_sensor_frame(np.stack([columns[name] for name in QUATERNION], axis=1))
        yield from (("the orientation", entry) for entry in rotations.reshape(len(rotations), -1).T)
    if recording.repeats == 1:
        yield from zip(recording.channels, recording.wrench.T, strict=True)


def _jumps_of(column: Array) -> list[tuple[int, float]]:
    """Samples of a column (n,) that jump, each with its deviation over the largest near it."""
    n = len(column)
    if n < 2 * NEARBY:
        return []
    beside, beyond = column[1:-3] + column[3:-1], column[:-4] + column[4:]
    off = np.zeros(n)
    off[2:-2] = column[2:-2] - (4 * beside - beyond) / 6
    size = np.abs(off)
    jumps = []
    for row in (int(r) for r in np.argpartition(size, -MOST_JUMPS)[-MOST_JUMPS:] if BESIDE <= r < n - BESIDE):
        near = np.arange(max(0, row - NEARBY), min(n, row + NEARBY + 1))
        around = float(size[near[np.abs(near - row) >= BESIDE]].max())
        slope = (column[row + 2] - column[row - 2]) / 2
        back = abs(column[row + 1] - column[row - 1] - slope) < BACK * size[row]
        if back and size[row] > max(JUMP * around, JUMP_SHARE * float(np.ptp(np.delete(column, row)))) > 0:
            jumps.append((row, float(size[row]) / max(around, JUMP_SHARE / JUMP * float(size[row]))))
    return jumps
