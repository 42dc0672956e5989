"""Predicted response of a model to a recording, sample by sample, with parameter derivatives."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np
import scipy  # loads scipy.fft with its first use
from numpy.typing import NDArray

from estimation.recordings.differentiation import spline_derivatives
from estimation.recordings.recording import Recording
from modeling.chain.model import WrenchModel
from modeling.chain.prediction import DeflectedLoad, Prediction, VectorFunction, compiled_prediction
from modeling.dynamics.equation_of_motion import DEFLECTION_TOLERANCE
from modeling.dynamics.time_base import TimeBase

if TYPE_CHECKING:
    from modeling.dynamics.play import PlayResponse

Array = NDArray[np.float64]

FILTER_BATCH = 50_000
"""Numbers filtered at once: with their Fourier lines they fit in a core's cache."""

NONPERIODIC_SIGNALS = ("time", "progress", "order")
"""Signals that are not periodic with the motion; auxiliary signals are not either."""


@dataclass(frozen=True, eq=False)
class ModelResponse:
    """Predicted series as the sum of a part that is periodic with the motion and one over the whole record.

    Either part is (value (samples, p), derivative (samples, p, k)); `periodic` holds one repeat, and is the whole
    series where the recording has no repeats (`whole` is None then). The derivative of `whole` is with respect to the
    parameters at the positions `columns` (None: all); in the others it vanishes.
    """

    periodic: tuple[Array, Array]
    whole: tuple[Array, Array] | None
    repeats: int
    columns: tuple[int, ...] | None = None

    @property
    def value(self) -> Array:
        """The predicted readings over the whole record, (n, p)."""
        tiled = np.tile(self.periodic[0], (self.repeats, 1))
        return tiled if self.whole is None else tiled + self.whole[0]

    @property
    def derivative(self) -> Array:
        """Derivative of the predicted readings over the whole record, (n, p, k)."""
        tiled = np.tile(self.periodic[1], (self.repeats, 1, 1))
        if self.whole is not None:
            tiled[:, :, slice(None) if self.columns is None else list(self.columns)] += self.whole[1]
        return tiled


@lru_cache(maxsize=32)
def model_signals(recording: Recording) -> Mapping[str, Array]:
    """The recording's signals, auxiliary ones smoothed, and `progress`, -1 to 1 over the record."""
    signals = dict(recording.signals)
    if recording.dt is not None:
        for name in (name for name in recording.auxiliary if np.ptp(signals[name]) > 0):
            signals[name] = spline_derivatives(signals[name][:, None], recording.dt).value[:, 0]
    return signals | {"progress": np.linspace(-1.0, 1.0, recording.samples)}


def missing_inputs(model: WrenchModel, recording: Recording) -> tuple[str, ...]:
    """Signals that the model needs and the recording lacks."""
    if model.arm is None and any(effect.needs_joints for effect in model.effects):
        return ("q1",)
    available = model_signals(recording)
    return tuple(name for name in compiled_prediction(model).model.inputs if name not in available)


@dataclass(frozen=True, eq=False)
class ResponsePart:
    """A summand of the response: value (n, p), derivative (n, p, k), of one repeat (`periodic`) or the whole record.

    The derivative is with respect to the parameters at the positions `columns` (None: all).
    """

    value: Array
    derivative: Array
    periodic: bool
    columns: tuple[int, ...] | None = None

    def over(self, repeats: int) -> ResponsePart:
        """The same over the whole record."""
        if not self.periodic:
            return self
        return ResponsePart(
            np.tile(self.value, (repeats, 1)), np.tile(self.derivative, (repeats, 1, 1)), periodic=False
        )


def model_response(
    model: WrenchModel,
    recording: Recording,
    theta: Array,
    *,
    derivative: bool = True,
    tolerance: float = DEFLECTION_TOLERANCE,
) -> ModelResponse:
    """Prediction of a recording at the parameters theta (k,), in the model's order and units.

    With `derivative` False its arrays are (n, p, 0). `tolerance` is the relative size of the last correction of a
    deflection, which is solved by iteration. Raises InputError when the recording lacks a signal that the model needs.
    """
    prediction = compiled_prediction(model)
    k = len(theta) if derivative else 0
    if prediction.deflection is not None:
        loads = [_deflected_load(prediction.deflection, recording, theta, derivative=derivative, tolerance=tolerance)]
    else:
        loads = _parts(prediction, prediction.load, recording, theta, derivative=derivative)
    if prediction.play is not None or prediction.has_memory:
        dynamics = SensorDynamics(prediction, recording, theta, loads[0].value)
        loads = [dynamics.response(load) for load in loads]
    parts = [*loads, *_parts(prediction, prediction.zero, recording, theta, derivative=derivative)]
    if prediction.level is not None:
        parts = [saturated(parts, prediction.level, theta, recording.repeats)]
    once = recording.samples_per_repeat
    zero = (np.zeros((once, len(model.channels))), np.zeros((once, len(model.channels), k)))
    nonperiodic = [part for part in parts if not part.periodic]
    columns = _columns_of(nonperiodic, k)
    return ModelResponse(
        periodic=_sum([part for part in parts if part.periodic], tuple(range(k))) or zero,
        whole=_sum(nonperiodic, columns),
        repeats=recording.repeats,
        columns=columns,
    )


def _columns_of(parts: Sequence[ResponsePart], count: int) -> tuple[int, ...]:
    """Positions of the parameters that any of the parts depends on."""
    if any(part.columns is None for part in parts):
        return tuple(range(count))
    return tuple(sorted({i for part in parts for i in part.columns or ()}))


def _sum(parts: Sequence[ResponsePart], columns: tuple[int, ...]) -> tuple[Array, Array] | None:
    """Value of the sum and its derivative in the parameters `columns`: views of one array, value first."""
    if not parts:
        return None
    joined = np.zeros((*parts[0].value.shape, 1 + len(columns)), order="F")
    value, derivative = joined[:, :, 0], joined[:, :, 1:]
    for part in parts:
        value += part.value
        if part.columns is None or part.columns == columns:
            derivative += part.derivative
        else:
            for place, i in enumerate(part.columns):
                derivative[:, :, columns.index(i)] += part.derivative[:, :, place]
    return value, derivative


def _parts(
    prediction: Prediction, emitted: VectorFunction, recording: Recording, theta: Array, *, derivative: bool
) -> list[ResponsePart]:
    """Response of an instantaneous function of the signals, split into non-periodic and periodic parts.

    A derivative that is the same in every repeat is evaluated over one: with a transient event or a drift all but its
    own are. Play and saturation act on the sum, so that nothing is split there.
    """
    signals, periodic = model_signals(recording), signals_are_periodic(emitted.inputs, recording)
    samples = recording.samples_per_repeat if periodic else recording.samples
    if not derivative:
        value = emitted.value(signals, theta, samples)
        return [ResponsePart(value, np.zeros((samples, emitted.rows, 0)), periodic=periodic)]
    if prediction.play is not None or prediction.level is not None:
        return [ResponsePart(*emitted.tangent(signals, theta, samples), periodic=periodic)]
    if periodic:
        own = tuple(sorted({*emitted.active, *prediction.transfer_parameters}))
        return [ResponsePart(*emitted.tangent_in(signals, theta, own, samples), periodic=True, columns=own)]
    changing = set(emitted.depending_on(frozenset(emitted.inputs) & {*NONPERIODIC_SIGNALS, *recording.auxiliary}))
    nonperiodic = tuple(sorted({i for i in emitted.active if i in changing} | set(prediction.transfer_parameters)))
    repeating = tuple(i for i in emitted.active if i not in changing)
    value, nonperiodic_derivative = emitted.tangent_in(signals, theta, nonperiodic, samples)
    once = recording.samples_per_repeat
    _, repeating_derivative = emitted.tangent_in(signals, theta, repeating, once, valued=False)
    whole = np.zeros((once, emitted.rows, emitted.count), order="F")
    whole[:, :, list(repeating)] = repeating_derivative
    zero = np.zeros((once, emitted.rows))
    return [
        ResponsePart(value, nonperiodic_derivative, periodic=False, columns=nonperiodic),
        ResponsePart(zero, whole, periodic=True),
    ]


def _deflected_load(
    deflected: DeflectedLoad, recording: Recording, theta: Array, *, derivative: bool, tolerance: float
) -> ResponsePart:
    """Load of a deflecting tool: periodic steady state for a periodic motion, from rest in every single run."""
    periodic = signals_are_periodic(deflected.inputs, recording)
    samples = recording.samples_per_repeat if periodic else recording.samples
    known = {name: values[:samples] for name, values in model_signals(recording).items()}
    clock = TimeBase(recording.dt, periodic=recording.repeats > 1 and recording.continuous)
    runs = {name: _separate_runs(recording, values) for name, values in known.items()}
    several = [dict(zip(runs, run, strict=True)) for run in zip(*runs.values(), strict=True)]
    each = samples // len(several)
    parts = [deflected.tangent(run, theta, each, clock, derivative=derivative, tolerance=tolerance) for run in several]
    value, slopes = (np.concatenate(part) for part in zip(*parts, strict=True))
    return ResponsePart(value, slopes, periodic)


def saturated(parts: Sequence[ResponsePart], level: VectorFunction, theta: Array, repeats: int) -> ResponsePart:
    """Sum of the parts, saturated at ± the level (p,); where it is clipped its only derivative is that of the level."""
    if not all(part.periodic for part in parts):
        parts = [part.over(repeats) for part in parts]
    value, derivative = sum(part.value for part in parts), sum(part.derivative for part in parts)
    limit, slope = (array[0] for array in level.tangent({}, theta, 1))
    outside = np.abs(value) > limit
    sign = np.sign(value)
    clipped = sign[:, :, None] * slope if np.shape(derivative)[2] else derivative
    value = np.where(outside, sign * limit, value)
    return ResponsePart(value, np.where(outside[:, :, None], clipped, derivative), periodic=parts[0].periodic)


def signals_are_periodic(inputs: Iterable[str], recording: Recording) -> bool:
    """Whether these signals are the same in every repeat; true for a single run."""
    return recording.repeats == 1 or not set(inputs) & {*NONPERIODIC_SIGNALS, *recording.auxiliary}


def predicted_readings(model: WrenchModel, recording: Recording, theta: Array) -> Array:
    """The predicted readings of a recording, (n, p), in the channels' units."""
    return model_response(model, recording, theta).value


@dataclass(frozen=True, eq=False)
class SensorDynamics:
    """Dynamics from load to reading: play, then H(s), at theta (k,), linearised about one load (n, p)."""

    prediction: Prediction
    recording: Recording
    theta: Array
    load: Array

    @cached_property
    def _runs(self) -> tuple[PlayResponse, ...]:
        """Play in each separate run; a single one where repeats follow each other without pause."""
        from modeling.dynamics.play import PlayResponse

        if self.prediction.play is None:
            return ()
        width = self.prediction.play.value({}, self.theta, 1)[0]
        periodic = self.recording.repeats > 1 and self.recording.continuous
        return tuple(
            PlayResponse.of(run, width, periodic=periodic, smooth=not self.recording.at_rest)
            for run in _separate_runs(self.recording, self.load)
        )

    def response(self, load: ResponsePart) -> ResponsePart:
        """Response to a load, with its derivative: play y = P(x; w), then H, dy = H dP + dH P."""
        value, derivative = load.value, load.derivative
        if self.prediction.play is not None:
            value, derivative = np.concatenate([run.reading for run in self._runs]), self.played(derivative)
            if derivative.shape[2]:
                by_width = np.concatenate([run.by_width for run in self._runs])
                derivative = derivative + by_width[:, :, None] * self.prediction.play.tangent({}, self.theta, 1)[1]
        reading, tangent = (self.remembered(series) for series in (value, derivative))
        for number, index in enumerate(self.prediction.transfer_parameters if tangent.shape[2] and value.any() else ()):
            place = index if load.columns is None else load.columns.index(index)
            tangent[:, :, place] += self.remembered(value, slope=number)
        return ResponsePart(reading, tangent, load.periodic, load.columns)

    def played(self, series: Array) -> Array:
        """A small variation (n, p, ...) of the load through the linearised play."""
        if not self._runs:
            return series
        pieces = zip(self._runs, _separate_runs(self.recording, series), strict=True)
        return np.concatenate([run.through(piece) for run, piece in pieces])

    def remembered(self, series: Array, slope: int | None = None) -> Array:
        """A series (n, p, ...) filtered by H(s), or by H's derivative in its parameter number `slope`."""
        if not series.size:
            return series
        return through_transfer_function(self.prediction, self.recording, series, self.theta, slope)


def _separate_runs(recording: Recording, series: Array) -> list[Array]:
    """A series (n, ...) split into its separate runs, or whole where the repeats are continuous."""
    if recording.continuous or len(series) <= recording.samples_per_repeat:
        return [series]
    return np.split(series, recording.repeats)


def through_transfer_function(
    prediction: Prediction, recording: Recording, series: Array, theta: Array, slope: int | None = None
) -> Array:
    """A series (samples, ...) filtered by H(s), or by H's derivative in its parameter number `slope`.

    A motion that repeats without pause is in its periodic steady state. A single run is extended on both sides by
    its point reflections before it is transformed. In static poses H(0) = 1.
    """
    if not prediction.has_memory or recording.dt is None:
        return series if slope is None else np.zeros_like(series)
    runs = _separate_runs(recording, series)
    if len(runs) > 1:
        return np.concatenate([through_transfer_function(prediction, recording, run, theta, slope) for run in runs])
    periodic = recording.repeats > 1 and recording.continuous
    pad = 0 if periodic else min(len(series) - 1, max(64, len(series) // 8))
    length = len(series) + 2 * pad
    omega = np.asarray(2 * np.pi * np.fft.rfftfreq(length, recording.dt), dtype=np.float64)
    gain, slopes = prediction.transfer(omega, theta)
    factor = gain if slope is None else slopes[slope]
    columns = series.T.reshape(-1, len(series))
    found = np.empty(columns.shape)
    for first in range(0, len(found), at_once := max(1, FILTER_BATCH // length)):
        part = slice(first, first + at_once)
        lines = scipy.fft.rfft(_reflected_ends(columns[part], pad))
        lines *= factor
        found[part] = scipy.fft.irfft(lines, n=length, overwrite_x=True)[:, pad : length - pad]
    return found.reshape(series.T.shape).T


def _reflected_ends(series: Array, pad: int) -> Array:
    """Series (c, n) extended by point reflections at both ends, cross-faded so that they close periodically."""
    if not pad:
        return series
    before = 2 * series[:, :1] - series[:, pad:0:-1]
    after = 2 * series[:, -1:] - series[:, -2 : -pad - 2 : -1]
    fade = 0.5 + 0.5 * np.cos(np.linspace(0, np.pi, pad))
    middle = (series[:, :1] + series[:, -1:]) / 2
    ends = middle + (before - middle) * fade[::-1], middle + (after - middle) * fade
    return np.concatenate([ends[0], series, ends[1]], axis=1)
