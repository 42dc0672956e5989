"""Static dwells: poses at rest that were logged as a run, or with gaps in time, are read as the poses that they are.

A run that stands still most of the time, and between whose dwells the motion is not sampled well enough for its
accelerations, or is none of a rigid tool, says no more of the tool than its poses do: what the transitions hold is
left out. A run whose transitions a rigid tool fits, or differs from as physics of the motion does, stays a run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimation.multiplicity import bonferroni_p_value, f_sf
from estimation.readings.doubted_reading import DoubtedReading
from estimation.readings.motion_reading import ROTATIONS, TRANSLATIONS
from estimation.readings.rigid_tool import noise_from_sample_to_sample
from estimation.recordings.dwells import Dwells
from estimation.recordings.recording import Recording
from modeling.chain.model import ALIGNED_MOUNTING, WrenchModel
from modeling.chain.prediction import compiled_prediction
from modeling.rig import Convention
from modeling.significance import LEVELS

Array = NDArray[np.float64]

SPANNED = 1.0
"""m/s², std of gravity in the sensor's axes along the direction in which it varies least: less tells no mass from the
zero, and poses that span no more are left as they are logged."""
FITTING = 4.0
"""Mean square of what a rigid tool leaves in the transitions, over that of the noise, from which it does not fit them;
the noise of a motion that is differentiated twice is the rest."""
OF_MOTION = 0.7
"""Share of the misfit in the transitions from which it is physics of the motion, by what is linear in rates: a hand
that moves the tool pushes as it likes."""
NOTABLE = 0.02
"""Share of the transitions' power about the dwells from which their misfit spoils a run: less, as the error of a motion
that is differentiated twice, leaves the inertia to be known."""
DRIFT = 3
"""Degree of the polynomial over the poses by which a zero that drifts is shown: a warm-up bends once or twice."""
MOST_ROWS = 5000
"""Rows that are compared."""
RANK_TOLERANCE = 1e-9
"""Of the largest singular value of features, each of unit length: below it they are collinear."""
SMALLEST = 1e-9
"""Mean square, so that it can be divided by."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DwellsReading(DoubtedReading):
    """Dwells that are read as static poses; `logs` are the names of those that are no run for gaps in time."""

    unread: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """What is averaged, before and after, and how to prevent it."""
        prevented = "" if self.unread else "; --as-read prevents it"
        return f"Read so that {self.meaning}: {self.evidence}. To state it: {self.statement}{prevented}."


@dataclass(frozen=True)
class _Transitions:
    """How a run fits between its dwells: residual over the noise as a run, and the p-value of the transitions' fit."""

    before: float
    p_value: float | None


def as_static_poses(
    recordings: Sequence[Recording], model: WrenchModel, *, runs: bool
) -> tuple[tuple[Recording, ...], DwellsReading | None]:
    """Recordings of one rig, with the dwells of those that are logs of static poses averaged, and what is said of it.

    Without `runs`, of those alone that gaps in time leave no run.
    """
    base = replace(model.base, convention=Convention.ON_TOOL, mounting=ALIGNED_MOUNTING)
    read, before, p_values = list(recordings), [], []
    for number, recording in enumerate(recordings):
        if recording.dt is None or not runs:
            continue
        poses = _poses_of(recording, base)
        transitions = None if poses is None else _transitions(recording, poses, base)
        if poses is not None and transitions is not None:
            read[number] = poses
            before.append(transitions.before)
            p_values += [] if transitions.p_value is None else [transitions.p_value]
    dwelling = [recording for recording in read if recording.dwells is not None]
    if not dwelling:
        return tuple(recordings), None
    after = float(np.sqrt(np.mean([_misfit_of_poses(recording, base) for recording in dwelling])))
    counted = [f"{r.name} is {r.dwells.counted}" for r in dwelling if r.dwells is not None]
    unread = tuple(r.name for r in recordings if r.dwells is not None)
    as_run = f", and {max(before):.2g} times that from sample to sample as a run" if before else ""
    return tuple(read), DwellsReading(
        id="static_dwells",
        value=sum(recording.samples for recording in dwelling),
        meaning="; ".join(counted),
        statement="give the means without the column time",
        before=max(before) if before else None,
        after=after,
        p_value=max(p_values) if p_values else None,
        adopted=True,
        mends=False,
        applies_to="map",
        shown_by=f"a tool's weight leaves {after:.2g} times the noise of a mean in them{as_run}",
        unread=unread,
    )


def sampled(recording: Recording, model: WrenchModel) -> Recording:
    """A recording as a fitted model meets it: a run of dwells without the motion between them as static poses."""
    if recording.dt is None:
        return recording
    poses = _poses_of(recording, replace(model.base, convention=Convention.ON_TOOL, mounting=ALIGNED_MOUNTING))
    return recording if poses is None or poses.dwells is None or poses.dwells.are_sampled_between else poses


def _poses_of(recording: Recording, base: WrenchModel) -> Recording | None:
    """The dwells of a run as static poses; None where it is not of dwells, or these span too few directions."""
    assert recording.dt is not None
    stamps: Array = np.asarray(recording.dt * np.arange(recording.samples), dtype=np.float64)
    gaps = np.zeros(recording.samples - 1, dtype=bool)
    if not recording.continuous:
        gaps[recording.samples_per_repeat - 1 :: recording.samples_per_repeat] = True
    dwells = Dwells.of(recording.columns, recording.form, stamps, recording.wrench, gaps)
    if not dwells.are_poses or dwells.distinct < 2 * recording.dimension:
        return None
    poses = recording.at_dwells(dwells)
    gravity = tool_load(poses, base, np.arange(poses.samples))[:, : recording.dimension, 0]
    spread = np.linalg.svd(gravity - gravity.mean(axis=0), compute_uv=False) / np.sqrt(poses.samples)
    return poses if spread[-1] > SPANNED else None


def tool_load(recording: Recording, base: WrenchModel, rows: NDArray[np.int64]) -> Array:
    """Derivative (r, p, k) of a rigid tool's wrench in its parameters, mass first, at some rows of a recording."""
    signals = {name: series[rows] for name, series in recording.signals.items()}
    derivative = compiled_prediction(base).load.tangent(signals, np.zeros(base.base_size), len(rows))[1]
    excited = [i for i, parameter in enumerate(base.parameters) if parameter not in base.biases]
    return np.asarray(derivative[:, :, excited])


def _linear(load: Array) -> Array:
    """What a tool's wrench is linear in, (r, c), whatever the axes and signs of the sensor."""
    columns = load.reshape(len(load), -1)
    return columns[:, np.abs(columns).max(axis=0) > 0]


def _misfit_of_poses(poses: Recording, base: WrenchModel) -> float:
    """Mean square of what is not linear in gravity, over that of the noise of the means."""
    assert poses.dwells is not None
    features = np.column_stack(
        [_linear(tool_load(poses, base, np.arange(poses.samples))[:, :, :1]), np.ones(poses.samples)]
    )
    rest = beyond_linear(poses.wrench, features)
    freedom = max(poses.samples - np.linalg.matrix_rank(features), 1)
    return float((rest**2 / poses.dwells.std**2).mean() * poses.samples / freedom)


def _transitions(run: Recording, poses: Recording, base: WrenchModel) -> _Transitions | None:
    """How a run and its transitions fit a rigid tool; None where they do, or differ from it as physics of motion does.

    Readings and what a tool's wrench is linear in are taken about the line between the two dwells: a zero that drifts,
    and what the poses lack of a rigid tool, say nothing of the motion. But where the zero drifts, of the two only poses
    show it, as in a run it is aliased with all that is slow.
    """
    dwells = poses.dwells
    assert dwells is not None
    std = noise_from_sample_to_sample([run])
    every = np.arange(0, run.samples, -(-run.samples // MOST_ROWS))
    features = np.column_stack([_linear(tool_load(run, base, every)), np.ones(len(every))])
    misfit = float((beyond_linear(run.wrench[every] / std, features) ** 2).mean())
    if not dwells.are_sampled_between:
        return _Transitions(float(np.sqrt(misfit)), None)
    rows = np.concatenate(
        [np.arange(a + 1, b - 1) for a, b in zip(dwells.ends[:-1, 1], dwells.ends[1:, 0], strict=True)]
    )
    rows = rows[:: -(-len(rows) // MOST_ROWS)]
    wrench = _about_dwells(run.wrench[rows] / std, dwells.means(dwells.wrench) / std, dwells, rows)
    at_rest = tool_load(poses, base, np.arange(poses.samples)).reshape(poses.samples, -1)
    before, now, after = (tool_load(run, base, rows + step).reshape(len(rows), -1) for step in (-1, 0, 1))
    rest = beyond_linear(wrench, _about_dwells(now, at_rest, dwells, rows))
    left, whole = float((rest**2).mean()), float((wrench**2).mean())
    rates = np.column_stack([after - before, after - 2 * now + before, _rates(run, rows)])
    of_motion = (left - float((beyond_linear(rest, rates) ** 2).mean())) / max(left - 1.0, SMALLEST)
    p_value = float(f_sf(left / FITTING, len(dwells) - 1, len(dwells) - 1))
    spoiled = left > FITTING and left > NOTABLE * whole and of_motion < OF_MOTION and p_value < LEVELS.misread
    drifting = misfit > FITTING and _drift_p_value(poses, base) < LEVELS.misread
    return _Transitions(float(np.sqrt(misfit)), p_value if spoiled else None) if spoiled or drifting else None


def beyond_linear(series: Array, features: Array) -> Array:
    """What of a series (r, c) is not linear in features (r, k)."""
    scale = np.linalg.norm(features, axis=0)
    unit = features[:, scale > 0] / scale[scale > 0]
    return np.asarray(series - unit @ np.linalg.lstsq(unit, series, rcond=RANK_TOLERANCE)[0])


def _drift_p_value(poses: Recording, base: WrenchModel) -> float:
    """That poses fit a tool's weight as well without a zero that changes over their order as with it."""
    dwells = poses.dwells
    assert dwells is not None
    weight = np.column_stack(
        [_linear(tool_load(poses, base, np.arange(poses.samples))[:, :, :1]), np.ones(poses.samples)]
    )
    slow = np.polynomial.legendre.legvander(poses.motion.model_signals["progress"], DRIFT)[:, 1:]
    freedom = poses.samples - np.linalg.matrix_rank(weight) - DRIFT
    if freedom < 1:
        return 1.0
    without, beside = (
        ((beyond_linear(poses.wrench, f) / dwells.std) ** 2).sum(axis=0)
        for f in (weight, np.column_stack([weight, slow]))
    )
    ratios = (without - beside) / DRIFT / np.maximum(beside / freedom, 1.0)
    return bonferroni_p_value([float(f_sf(ratio, DRIFT, freedom)) for ratio in ratios])


def _about_dwells(series: Array, means: Array, dwells: Dwells, rows: NDArray[np.int64]) -> Array:
    """A series (r, c) at rows between dwells about the line from the mean (m, c) of one to that of the next."""
    number = np.searchsorted(dwells.ends[:, 1], rows, side="right") - 1
    begin, end = dwells.ends[number, 1], dwells.ends[number + 1, 0]
    share = ((rows - begin + 0.5) / (end - begin))[:, None]
    return np.asarray(series - (1 - share) * means[number] - share * means[number + 1])


def _rates(run: Recording, rows: NDArray[np.int64]) -> Array:
    """What friction and drag are linear in, (r, c): rates, their signs and squares, in the frame of the motion."""
    names = [name for table in (ROTATIONS, TRANSLATIONS) for name in table[run.dimension][1]]
    rate = np.stack([run.signals[name][rows] for name in names if name in run.signals], axis=1)
    return np.column_stack([rate, np.sign(rate), np.abs(rate) * rate])
