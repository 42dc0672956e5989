"""What a model predicts for a recording, sample by sample, with its derivative in every parameter."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, rfft

from estimation.differentiation import smooth
from estimation.recording import Recording
from modeling.model import WrenchModel
from modeling.operators.balance import SETTLED
from modeling.operators.clock import Clock
from modeling.prediction import BentLoad, Emitted, Prediction, compiled

if TYPE_CHECKING:
    from modeling.operators.play import Played

Array = NDArray[np.float64]

MOST_NUMBERS = 50_000
"""Numbers that pass a transfer function together: with their lines they stay in a core's cache."""

PASSING = ("time", "progress", "order")
"""Signals that do not repeat with the motion; auxiliary signals do not either."""


@dataclass(frozen=True, eq=False)
class Response:
    """A predicted series in two parts that add: one that repeats with the motion, one over the whole record.

    Either part is (value (samples, p), derivative (samples, p, k)); `periodic` holds one repeat, and is the whole
    series where the recording has no repeats (`whole` is None then). The derivative of `whole` is in the parameters at
    the places `columns` alone, None for all; in the others it vanishes.
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
def signals_of(recording: Recording) -> Mapping[str, Array]:
    """The recording's signals, auxiliary ones smoothed, and `progress`, -1 to 1 over the record."""
    signals = dict(recording.signals)
    if recording.dt is not None:
        for name in (name for name in recording.auxiliary if np.ptp(signals[name]) > 0):
            signals[name] = smooth(signals[name][:, None], recording.dt).value[:, 0]
    return signals | {"progress": np.linspace(-1.0, 1.0, recording.samples)}


def missing_inputs(model: WrenchModel, recording: Recording) -> tuple[str, ...]:
    """Signals that the model needs and the recording cannot give."""
    if model.arm is None and any(effect.needs_joints for effect in model.effects):
        return ("q1",)
    available = signals_of(recording)
    return tuple(name for name in compiled(model).model.inputs if name not in available)


@dataclass(frozen=True, eq=False)
class Part:
    """A summand of a reading: value (n, p) and derivative (n, p, k) of one repeat (`steady`) or of the whole record.

    The derivative is in the parameters at the places `columns`, None for all.
    """

    value: Array
    derivative: Array
    steady: bool
    columns: tuple[int, ...] | None = None

    def over(self, repeats: int) -> Part:
        """The same over the whole record."""
        if not self.steady:
            return self
        return Part(np.tile(self.value, (repeats, 1)), np.tile(self.derivative, (repeats, 1, 1)), steady=False)


def respond(
    model: WrenchModel, recording: Recording, theta: Array, *, derivative: bool = True, tolerance: float = SETTLED
) -> Response:
    """Prediction of a recording at the parameters theta (k,), in the model's order and units.

    With `derivative` False there is none: arrays (n, p, 0). `tolerance` is the size of the last correction, against
    its own, of what is found by iterating. Raises InputError when the recording lacks a signal that the model needs.
    """
    prediction = compiled(model)
    k = len(theta) if derivative else 0
    if prediction.bend is not None:
        loads = [_bent(prediction.bend, recording, theta, derivative=derivative, tolerance=tolerance)]
    else:
        loads = _parts(prediction, prediction.load, recording, theta, derivative=derivative)
    if prediction.play is not None or prediction.remembers:
        passage = Passage(prediction, recording, theta, loads[0].value)
        loads = [passage.read(load) for load in loads]
    parts = [*loads, *_parts(prediction, prediction.zero, recording, theta, derivative=derivative)]
    if prediction.level is not None:
        parts = [clipped(parts, prediction.level, theta, recording.repeats)]
    once = recording.samples_per_repeat
    none = (np.zeros((once, len(model.channels))), np.zeros((once, len(model.channels), k)))
    passing = [part for part in parts if not part.steady]
    columns = _columns_of(passing, k)
    return Response(
        periodic=_sum([part for part in parts if part.steady], tuple(range(k))) or none,
        whole=_sum(passing, columns),
        repeats=recording.repeats,
        columns=columns,
    )


def _columns_of(parts: Sequence[Part], count: int) -> tuple[int, ...]:
    """The places of the parameters that any of the parts depends on."""
    if any(part.columns is None for part in parts):
        return tuple(range(count))
    return tuple(sorted({i for part in parts for i in part.columns or ()}))


def _sum(parts: Sequence[Part], columns: tuple[int, ...]) -> tuple[Array, Array] | None:
    """Value and derivative of the sum, in the parameters at some places: views of one array, value first."""
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
    prediction: Prediction, emitted: Emitted, recording: Recording, theta: Array, *, derivative: bool
) -> list[Part]:
    """An instantaneous function of the recording's signals; that which passes apart from what repeats.

    A derivative that is the same in every repeat is evaluated over one: with a push or a drift all but its own are.
    Play and clipping act on the sum, so that nothing is parted there.
    """
    signals, steady = signals_of(recording), repeats_with_motion(emitted.inputs, recording)
    samples = recording.samples_per_repeat if steady else recording.samples
    if not derivative:
        return [Part(emitted.value(signals, theta, samples), np.zeros((samples, emitted.rows, 0)), steady=steady)]
    if prediction.play is not None or prediction.level is not None:
        return [Part(*emitted.tangent(signals, theta, samples), steady=steady)]
    if steady:
        own = tuple(sorted({*emitted.active, *prediction.memory_parameters}))
        return [Part(*emitted.tangent_in(signals, theta, own, samples), steady=True, columns=own)]
    moved = set(emitted.depending_on(frozenset(emitted.inputs) & {*PASSING, *recording.auxiliary}))
    passing = tuple(sorted({i for i in emitted.active if i in moved} | set(prediction.memory_parameters)))
    lasting = tuple(i for i in emitted.active if i not in moved)
    value, some = emitted.tangent_in(signals, theta, passing, samples)
    once = recording.samples_per_repeat
    _, others = emitted.tangent_in(signals, theta, lasting, once, valued=False)
    spread = np.zeros((once, emitted.rows, emitted.count), order="F")
    spread[:, :, list(lasting)] = others
    still = np.zeros((once, emitted.rows))
    return [Part(value, some, steady=False, columns=passing), Part(still, spread, steady=True)]


def _bent(bend: BentLoad, recording: Recording, theta: Array, *, derivative: bool, tolerance: float) -> Part:
    """The load of a tool that bends: in its steady state where the motion repeats, from rest in every single run."""
    steady = repeats_with_motion(bend.inputs, recording)
    samples = recording.samples_per_repeat if steady else recording.samples
    known = {name: values[:samples] for name, values in signals_of(recording).items()}
    clock = Clock(recording.dt, periodic=recording.repeats > 1 and recording.continuous)
    runs = {name: _separate(recording, values) for name, values in known.items()}
    several = [dict(zip(runs, run, strict=True)) for run in zip(*runs.values(), strict=True)]
    each = samples // len(several)
    parts = [bend.tangent(run, theta, each, clock, derivative=derivative, tolerance=tolerance) for run in several]
    value, slopes = (np.concatenate(part) for part in zip(*parts, strict=True))
    return Part(value, slopes, steady)


def clipped(parts: Sequence[Part], level: Emitted, theta: Array, repeats: int) -> Part:
    """The sum of the parts, no further from zero than the level (p,); where it is clipped only the level moves it."""
    if not all(part.steady for part in parts):
        parts = [part.over(repeats) for part in parts]
    value, derivative = sum(part.value for part in parts), sum(part.derivative for part in parts)
    limit, slope = (array[0] for array in level.tangent({}, theta, 1))
    outside = np.abs(value) > limit
    sign = np.sign(value)
    held = sign[:, :, None] * slope if np.shape(derivative)[2] else derivative
    value = np.where(outside, sign * limit, value)
    return Part(value, np.where(outside[:, :, None], held, derivative), steady=parts[0].steady)


def repeats_with_motion(inputs: Iterable[str], recording: Recording) -> bool:
    """Whether these signals are the same in every repeat; in a single run there is only one."""
    return recording.repeats == 1 or not set(inputs) & {*PASSING, *recording.auxiliary}


def predicted(model: WrenchModel, recording: Recording, theta: Array) -> Array:
    """The predicted readings of a recording, (n, p), in the channels' units."""
    return respond(model, recording, theta).value


@dataclass(frozen=True, eq=False)
class Passage:
    """What a load passes on its way to the reading: play, then H(s), at theta (k,) and around one load (n, p)."""

    prediction: Prediction
    recording: Recording
    theta: Array
    load: Array

    @cached_property
    def _runs(self) -> tuple[Played, ...]:
        """The play in each run by itself; one where they follow each other without pause."""
        from modeling.operators.play import Played

        if self.prediction.play is None:
            return ()
        width = self.prediction.play.value({}, self.theta, 1)[0]
        periodic = self.recording.repeats > 1 and self.recording.continuous
        return tuple(
            Played.of(run, width, periodic=periodic, smooth=not self.recording.at_rest)
            for run in _separate(self.recording, self.load)
        )

    def read(self, load: Part) -> Part:
        """The load read, with its derivative: through play y = P(x; w) and memory, dy = H dP + dH P."""
        value, derivative = load.value, load.derivative
        if self.prediction.play is not None:
            value, derivative = np.concatenate([run.reading for run in self._runs]), self.played(derivative)
            if derivative.shape[2]:
                by_width = np.concatenate([run.by_width for run in self._runs])
                derivative = derivative + by_width[:, :, None] * self.prediction.play.tangent({}, self.theta, 1)[1]
        reading, tangent = (self.remembered(series) for series in (value, derivative))
        for number, index in enumerate(self.prediction.memory_parameters if tangent.shape[2] and value.any() else ()):
            place = index if load.columns is None else load.columns.index(index)
            tangent[:, :, place] += self.remembered(value, slope=number)
        return Part(reading, tangent, load.steady, load.columns)

    def played(self, series: Array) -> Array:
        """What play leaves of a small addition (n, p, ...) to the load."""
        if not self._runs:
            return series
        pieces = zip(self._runs, _separate(self.recording, series), strict=True)
        return np.concatenate([run.through(piece) for run, piece in pieces])

    def remembered(self, series: Array, slope: int | None = None) -> Array:
        """A series (n, p, ...) through H(s), or through H's derivative in one of its parameters."""
        if not series.size:
            return series
        return through_memory(self.prediction, self.recording, series, self.theta, slope)


def _separate(recording: Recording, series: Array) -> list[Array]:
    """A series (n, ...) in its separate runs, or whole where nothing separates them."""
    if recording.continuous or len(series) <= recording.samples_per_repeat:
        return [series]
    return np.split(series, recording.repeats)


def through_memory(
    prediction: Prediction, recording: Recording, series: Array, theta: Array, slope: int | None = None
) -> Array:
    """A series (samples, ...) through H(s), or through H's derivative in one of its parameters.

    A motion that repeats without pause is in its periodic steady state. A single run is continued on both sides by
    its point reflections before it is transformed. At rest H(0) = 1.
    """
    if not prediction.remembers or recording.dt is None:
        return series if slope is None else np.zeros_like(series)
    runs = _separate(recording, series)
    if len(runs) > 1:
        return np.concatenate([through_memory(prediction, recording, run, theta, slope) for run in runs])
    periodic = recording.repeats > 1 and recording.continuous
    pad = 0 if periodic else min(len(series) - 1, max(64, len(series) // 8))
    length = len(series) + 2 * pad
    omega = np.asarray(2 * np.pi * np.fft.rfftfreq(length, recording.dt), dtype=np.float64)
    gain, slopes = prediction.transfer(omega, theta)
    factor = gain if slope is None else slopes[slope]
    columns = series.T.reshape(-1, len(series))
    found = np.empty(columns.shape)
    for first in range(0, len(found), at_once := max(1, MOST_NUMBERS // length)):
        part = slice(first, first + at_once)
        lines = rfft(_padded(columns[part], pad))
        lines *= factor
        found[part] = irfft(lines, n=length, overwrite_x=True)[:, pad : length - pad]
    return found.reshape(series.T.shape).T


def _padded(series: Array, pad: int) -> Array:
    """Series (c, n) between their point reflections at both ends, blended into one another so that they close."""
    if not pad:
        return series
    before = 2 * series[:, :1] - series[:, pad:0:-1]
    after = 2 * series[:, -1:] - series[:, -2 : -pad - 2 : -1]
    fade = 0.5 + 0.5 * np.cos(np.linspace(0, np.pi, pad))
    middle = (series[:, :1] + series[:, -1:]) / 2
    ends = middle + (before - middle) * fade[::-1], middle + (after - middle) * fade
    return np.concatenate([ends[0], series, ends[1]], axis=1)
