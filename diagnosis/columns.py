"""Columns: an effect's whitened derivatives at the value at which it vanishes, for many nuisance values at once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.background import Background
from diagnosis.rows import Choice, Rows
from estimation.layout import Layout, layout
from estimation.recording import Recording
from estimation.response import Passage, repeats_with_motion, respond, signals_of
from estimation.whitening import LineWhitener, Whitener
from modeling.effect import Values
from modeling.model import WrenchModel
from modeling.prediction import Emitted, compiled
from modeling.sensitivity import Sensitivity

Array = NDArray[np.float64]

MOST_NUMBERS = 4_500_000
"""Samples x channels x columns that are evaluated and whitened together: what memory bears."""
PIECE = 1_500_000
"""Those of each piece where there are more: less memory is moved about."""
FEW = 8
"""Points up to which a bent or clipped model is differentiated point by point, and columns are not kept."""


def amplitude_columns(
    background: Background, model: WrenchModel, grid: Sequence[Values], amplitudes: Sequence[str], choice: Choice
) -> Array:
    """Whitened derivatives (r, g, amplitudes) in amplitudes of the last effect at their nominal value, in some rows."""
    fit = background.fit
    unknowns = layout(model, fit.recordings)
    parts = [
        _of_recording(background, unknowns, number, grid, amplitudes, rows)
        for number, rows in enumerate(choice)
        if rows is not Rows.NONE
    ]
    if not parts:
        return np.zeros((0, len(grid), len(amplitudes)))
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def _of_recording(
    background: Background,
    unknowns: Layout,
    number: int,
    grid: Sequence[Values],
    amplitudes: Sequence[str],
    rows: Rows,
) -> Array:
    fit = background.fit
    own, recording, whitener = unknowns.models[number], fit.recordings[number], fit.noise[number].whitener
    names = [unknowns.parameters[i].name for i in unknowns.index[number]]
    known = np.array([fit.values.get(n, p.nominal) for n, p in zip(names, own.parameters, strict=True)])
    theta = np.tile(known, (len(grid), 1))
    place = {p.name: i for i, p in enumerate(own.parameters)}
    for point, values in zip(theta, grid, strict=True):
        for name, value in values.items():
            point[place[name]] = value
    which = tuple(place[name] for name in amplitudes)
    samples = recording.samples_per_repeat if rows is Rows.STEADY else recording.samples
    numbers = samples * len(recording.channels) * len(which)
    if numbers * len(theta) <= MOST_NUMBERS:
        return _whitened_slopes(own, recording, whitener, theta, which, rows)
    first, last = rows.within(whitener)
    found = np.empty((last - first, len(theta), len(which)), order="F")
    for start in range(0, len(theta), at_once := max(1, PIECE // numbers)):
        part = slice(start, start + at_once)
        found[:, part] = _whitened_slopes(own, recording, whitener, theta[part], which, rows)
    return found


def _whitened_slopes(
    model: WrenchModel, recording: Recording, whitener: Whitener, theta: Array, which: tuple[int, ...], rows: Rows
) -> Array:
    """Whitened derivatives (r, g, len(which)) in some parameters, at each of g parameter sets theta (g, k)."""
    prediction, first, last = compiled(model), *rows.within(whitener)
    clipped = prediction.level is not None
    if set(which) & set(prediction.memory_parameters) or prediction.bend is not None or (clipped and len(theta) <= FEW):
        found = np.zeros((last - first, len(theta), len(which)))
        for place, row in enumerate(theta):
            reached = whitener.reached(respond(model, recording, row))[first:, 1:]
            found[: len(reached), place] = reached[: last - first, list(which)]
        return found
    parts = [summand.whitened(rows, whitener) for summand in sensitivity_series(model, recording, theta, which)]
    for part in parts[1:]:
        parts[0] += part
    return parts[0] if parts else np.zeros((last - first, len(theta), len(which)))


@dataclass(frozen=True, eq=False)
class Summand:
    """A summand (n, p, g, a) of a reading's derivatives, of one repeat (`periodic`) or the whole record.

    `passage` is what it has to pass yet on its way to the reading, None where nothing is left.
    """

    series: Array
    periodic: bool
    passage: Passage | None = None

    def read(self) -> Array:
        """As the sensor reads it."""
        return self.series if self.passage is None else self.passage.remembered(self.series)

    def whitened(self, rows: Rows, whitener: Whitener) -> Array:
        """In some rows (r, g, a): a transfer function is a factor of each line, where the whitener takes lines."""
        after = whitener if self.passage is None else _whitener_before(self.passage, whitener)
        if after is None:
            return rows.whitened(whitener, self.read(), periodic=self.periodic)
        return rows.whitened(after, self.series, periodic=self.periodic)


def _whitener_before(passage: Passage, whitener: Whitener) -> Whitener | None:
    """What whitens a series that has a transfer function before it yet; None where it is no factor of each line."""
    prediction, recording = passage.prediction, passage.recording
    if not prediction.remembers or recording.dt is None:
        return whitener
    if not (isinstance(whitener, LineWhitener) and recording.repeats > 1 and recording.continuous):
        return None
    return whitener.behind(lambda omega: prediction.transfer(omega, passage.theta)[0], recording.dt)


def sensitivity_series(
    model: WrenchModel, recording: Recording, theta: Array, which: tuple[int, ...]
) -> Iterator[Summand]:
    """Summands of the reading's derivatives in some parameters, at g parameter sets theta (g, k).

    Of models whose tool does not bend, in parameters that the transfer function does not have.
    """
    prediction = compiled(model)
    outside = None if prediction.level is None else _clipped(model, recording, theta[0])
    repeats = all(repeats_with_motion(e.inputs, recording) for e in (prediction.load, prediction.zero))
    for emitted, passed in ((prediction.load, True), (prediction.zero, False)):
        if not set(which) & set(emitted.active):
            continue
        sensitivity = sensitivity_of(model, emitted, which)
        around = emitted.inputs if prediction.play is not None else sensitivity.signals  # play goes by the whole load
        periodic = repeats_with_motion(around, recording)
        samples = recording.samples_per_repeat if periodic else recording.samples
        values = {n: theta[:, emitted.names.index(n)] for n in sensitivity.parameters}
        slopes = sensitivity.values(signals_of(recording), values, samples)
        if slopes.shape[2] != len(theta):  # nothing that differs from set to set
            slopes = np.repeat(slopes, len(theta), axis=2)
        summand = Summand(slopes, periodic)
        if passed and (prediction.play is not None or prediction.remembers):
            load = emitted.value(signals_of(recording), theta[0], samples)  # at no amount: the same at each set
            passage = Passage(prediction, recording, theta[0], load)
            summand = Summand(passage.played(slopes), periodic, passage)
        yield summand if outside is None else _inside(summand, outside, recording, whole=not repeats)


def _inside(summand: Summand, outside: NDArray[np.bool_], recording: Recording, *, whole: bool) -> Summand:
    """What is left of a summand where readings (n, p) are clipped, over the `whole` record if it has to be."""
    slopes, periodic = summand.read(), summand.periodic
    if periodic and whole:
        slopes, periodic = np.tile(slopes, (recording.repeats, 1, 1, 1)), False
    slopes[outside[: len(slopes)]] = 0.0
    return Summand(slopes, periodic)


def _clipped(model: WrenchModel, recording: Recording, theta: Array) -> NDArray[np.bool_]:
    """Where readings (n, p) are clipped, so that nothing but the level moves them."""
    prediction = compiled(model)
    assert prediction.level is not None
    limit = prediction.level.value({}, theta, 1)[0]
    return np.asarray(np.abs(respond(model, recording, theta, derivative=False).value) >= limit)


def sensitivity_of(model: WrenchModel, emitted: Emitted, which: tuple[int, ...]) -> Sensitivity:
    """The derivative of a part of a model in some of its parameters, where these have their nominal values."""
    parameters = model.parameters
    return Sensitivity.of(emitted, which, tuple(parameters[i].nominal for i in which))
