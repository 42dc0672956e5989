"""What a model predicts for a recording, sample by sample, with its derivative in every parameter."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from estimation.differentiation import smooth
from estimation.recording import Recording
from modeling.model import WrenchModel
from modeling.prediction import Prediction, compiled

Array = NDArray[np.float64]

PASSING = ("time", "progress", "order")
"""Signals that do not repeat with the motion; auxiliary signals do not either."""


@dataclass(frozen=True, eq=False)
class Response:
    """A predicted series in two parts that add: one that repeats with the motion, one over the whole record.

    Either part is (value (samples, p), derivative (samples, p, k)); `periodic` holds one repeat, and is the whole
    series where the recording has no repeats (`whole` is None then).
    """

    periodic: tuple[Array, Array]
    whole: tuple[Array, Array] | None
    repeats: int

    @property
    def value(self) -> Array:
        """The predicted readings over the whole record, (n, p)."""
        tiled = np.tile(self.periodic[0], (self.repeats, 1))
        return tiled if self.whole is None else tiled + self.whole[0]

    @property
    def derivative(self) -> Array:
        """Derivative of the predicted readings over the whole record, (n, p, k)."""
        tiled = np.tile(self.periodic[1], (self.repeats, 1, 1))
        return tiled if self.whole is None else tiled + self.whole[1]


@lru_cache(maxsize=32)
def signals_of(recording: Recording) -> Mapping[str, Array]:
    """The recording's signals, auxiliary ones smoothed, and `progress`, -1 to 1 over the record."""
    signals = dict(recording.signals)
    if recording.dt is not None:
        for name in (name for name in recording.auxiliary if np.ptp(signals[name]) > 0):
            signals[name] = smooth(signals[name][:, None], recording.dt).value[:, 0]
    return signals | {"progress": np.linspace(-1.0, 1.0, recording.samples)}


def missing_inputs(model: WrenchModel, recording: Recording) -> tuple[str, ...]:
    """Signals that the model needs and the recording cannot give."""
    available = signals_of(recording)
    return tuple(name for name in model.inputs if name not in available)


def respond(model: WrenchModel, recording: Recording, theta: Array) -> Response:
    """Prediction of a recording at the parameters theta (k,), in the model's order and units.

    Raises InputError when the recording lacks a signal that the model needs.
    """
    prediction, signals = compiled(model), signals_of(recording)
    n, once, size = recording.samples, recording.samples_per_repeat, (len(model.channels), len(theta))
    periodic = (np.zeros((once, size[0])), np.zeros((once, *size)))
    whole = None
    for emitted, remembers in ((prediction.load, prediction.remembers), (prediction.zero, False)):
        steady = repeats_with_motion(emitted.inputs, recording)
        part = emitted.tangent(signals, theta, once if steady else n)
        if remembers:
            part = _remembered(prediction, recording, *part, theta)
        if steady:
            periodic = (periodic[0] + part[0], periodic[1] + part[1])
        else:
            whole = part if whole is None else (whole[0] + part[0], whole[1] + part[1])
    return Response(periodic, whole, recording.repeats)


def repeats_with_motion(inputs: Iterable[str], recording: Recording) -> bool:
    """Whether these signals are the same in every repeat; in a single run there is only one."""
    return recording.repeats == 1 or not set(inputs) & {*PASSING, *recording.auxiliary}


def predicted(model: WrenchModel, recording: Recording, theta: Array) -> Array:
    """The predicted readings of a recording, (n, p), in the channels' units."""
    return respond(model, recording, theta).value


def _remembered(
    prediction: Prediction, recording: Recording, value: Array, derivative: Array, theta: Array
) -> tuple[Array, Array]:
    """Load and its derivative through the transfer function: dy = H dload + dH load."""
    reading = through_memory(prediction, recording, value, theta)
    tangent = through_memory(prediction, recording, derivative, theta)
    for number, index in enumerate(prediction.memory_parameters):
        tangent[:, :, index] += through_memory(prediction, recording, value, theta, slope=number)
    return reading, tangent


def through_memory(
    prediction: Prediction, recording: Recording, series: Array, theta: Array, slope: int | None = None
) -> Array:
    """A series (samples, ...) through H(s), or through H's derivative in one of its parameters.

    A motion that repeats without pause is in its periodic steady state. A single run is continued on both sides by
    its point reflections before it is transformed. At rest H(0) = 1.
    """
    if not prediction.remembers or recording.dt is None:
        return series if slope is None else np.zeros_like(series)
    if not recording.continuous and len(series) > recording.samples_per_repeat:
        runs = np.split(series, recording.repeats)
        return np.concatenate([through_memory(prediction, recording, run, theta, slope) for run in runs])
    periodic = recording.repeats > 1 and recording.continuous
    pad = 0 if periodic else min(len(series) - 1, max(64, len(series) // 8))
    closed = _padded(series, pad)
    omega = np.asarray(2 * np.pi * np.fft.rfftfreq(len(closed), recording.dt), dtype=np.float64)
    gain, slopes = prediction.transfer(omega, theta)
    factor = gain if slope is None else slopes[slope]
    lines = np.fft.rfft(closed, axis=0) * factor.reshape(-1, *([1] * (series.ndim - 1)))
    filtered = np.fft.irfft(lines, n=len(closed), axis=0)
    return filtered[pad : len(closed) - pad]


def _padded(series: Array, pad: int) -> Array:
    """The series between its point reflections at both ends, blended into one another so that it closes on itself."""
    if not pad:
        return series
    before = 2 * series[:1] - series[pad:0:-1]
    after = 2 * series[-1:] - series[-2 : -pad - 2 : -1]
    fade = (0.5 + 0.5 * np.cos(np.linspace(0, np.pi, pad))).reshape(-1, *([1] * (series.ndim - 1)))
    middle = (series[:1] + series[-1:]) / 2
    return np.concatenate([middle + (before - middle) * fade[::-1], series, middle + (after - middle) * fade])
