"""What a recorded motion leaves unknown: held samples, frequencies above half its rate, accelerations not recorded."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from estimation.recordings.motion import QUATERNION, MotionForm, numbered_names
from estimation.recordings.recording import Recording
from estimation.recordings.sign_convention import to_sensor_frame
from estimation.recordings.smoothing_spline import SmoothingSpline

Array = NDArray[np.float64]

UNCERTAIN = 0.1
"""Std of an acceleration over its rms from which a motion counts as not carried by its rate."""
AT_REST = 0.01
"""Rad, m or parts of a quaternion: std of a series that does not move."""
LEAST_TURN = 5.0
"""Degrees that gravity turns from its mean direction in the sensor, below which it hardly differs from a zero."""
PLACES = 60
"""Samples at which that is evaluated."""


def motion_limits(recording: Recording) -> tuple[str, ...]:
    """One sentence for each thing that the recorded motion leaves unknown; none for static poses."""
    if recording.at_rest:
        return ()
    recording.signals  # noqa: B018  the splines of the motion are those of its signals
    limits = (_held, _lost_frequencies, _unrecorded_acceleration, _constant_orientation)
    return tuple(sentence for limit in limits for sentence in limit(recording))


def world_axes(recording: Recording) -> Array:
    """The world's axes in those of the sensor, (n, 3, 3) with an axis in each column, of a recorded orientation."""
    return to_sensor_frame(np.column_stack([recording.motion.world_columns[name] for name in QUATERNION]))


def acceleration_is_recorded(recording: Recording) -> bool:
    """Whether the acceleration of the sensor's origin follows from what was recorded."""
    if recording.at_rest or recording.form is MotionForm.JOINTS:
        return True
    axes = "xyz"[: recording.dimension]
    return any(all(f"{p}{axis}" in recording.columns for axis in axes) for p in _position_names(recording))


def _position_names(recording: Recording) -> tuple[str, str, str]:
    return ("p", "v", "a") if recording.form is MotionForm.PLANAR_POSE else ("p", "vp", "ap")


def _held(recording: Recording) -> Iterator[str]:
    for noun, names in _groups(recording):
        true = (
            recording.motion.recorded.true_samples(names) if all(name in recording.columns for name in names) else None
        )
        if true is not None and recording.dt is not None:
            yield (
                f"{noun} is held: new values at {true.rate:.3g} Hz in rows at {1 / recording.dt:.3g} Hz; "
                "the motion is rebuilt from the new ones alone"
            )


def _groups(recording: Recording) -> Iterator[tuple[str, Sequence[str]]]:
    if recording.form is MotionForm.JOINTS:
        yield "the joints' motion", numbered_names("q", recording.joints)
        return
    yield "the orientation", QUATERNION if recording.form is MotionForm.POSE else ("phi",)
    first = _position_names(recording)[0]
    yield "the position", tuple(first + axis for axis in "xyz"[: recording.dimension])


def _lost_frequencies(recording: Recording) -> Iterator[str]:
    """Where the smoothing needs the whole band up to half the rate, or takes a good part of the motion for noise."""
    for names, derived in recording.motion.recorded.derivatives.items():
        spline = derived.spline
        if spline is None:
            continue
        size = float(np.sqrt(np.mean(np.var(derived.value, axis=0)) + spline.noise_std**2))
        mistaken = size > AT_REST and spline.noise_std > UNCERTAIN * size
        share = _acceleration_uncertainty(spline)
        if mistaken or (spline.cutoff > spline.half_rate / 2 and share > UNCERTAIN):
            remaining = "its acceleration is not known"
            if not mistaken:
                remaining = f"its acceleration is known to {min(share, 1.0):.0%} only"
            yield (
                f"{2 * spline.half_rate:.3g} Hz cannot carry the motion in {', '.join(names)}: what is above "
                f"{spline.cutoff:.2g} Hz is lost, and {remaining}; log it faster, or move more slowly"
            )


def _acceleration_uncertainty(spline: SmoothingSpline) -> float:
    """Usual std of the second derivative over its rms, all components together."""
    length = spline.end - spline.start
    times = spline.start + length * (np.arange(PLACES) + 0.37) / PLACES  # between samples and on them
    second = spline.derivative(times, 2)
    spread = float(np.median(spline.std(times, 2))) * np.sqrt(second.shape[1])
    return float(spread) / max(float(np.sqrt(np.mean(np.sum(second**2, axis=1)))), np.finfo(float).tiny)


def _unrecorded_acceleration(recording: Recording) -> Iterator[str]:
    if not acceleration_is_recorded(recording):
        yield "no position was recorded: the acceleration of the sensor's origin is taken as zero"


def _constant_orientation(recording: Recording) -> Iterator[str]:
    """Six axes: where gravity keeps its direction in the sensor, the weight looks like the sensor's zero."""
    if recording.form is not MotionForm.POSE:
        return
    down = -world_axes(recording)[:, :, 2]
    mean = down.mean(axis=0) / np.linalg.norm(down.mean(axis=0))
    turn = float(np.degrees(np.arccos(np.clip(down @ mean, -1.0, 1.0).min())))
    if turn < LEAST_TURN:
        yield (
            f"the orientation hardly changes (gravity turns by {turn:.1g}° in the sensor): weight and zero of the "
            "sensor are told apart by accelerations alone; turn the tool about two horizontal axes"
        )
