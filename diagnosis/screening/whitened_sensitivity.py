"""Whitened sensitivities of the prediction to an effect's amplitudes at many values of its nonlinear parameters."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from diagnosis.screening.null_model import RowChoice, RowSet, row_ranges
from estimation.fit import Fit
from estimation.model_response import (
    ModelResponse,
    averaged_block,
    first_readings,
    model_response,
    motion_record,
    signals_are_periodic,
    with_loads,
)
from estimation.noise.whitening import FourierLineWhitener, Whitener
from estimation.parameter_layout import ParameterLayout, parameter_layout
from estimation.recordings.recording import Recording
from modeling.chain.chain import Stage
from modeling.chain.effect import NuisanceValues
from modeling.chain.model import WrenchModel
from modeling.chain.prediction import VectorFunction, compiled_prediction
from modeling.compiled.vector_function import Sensitivity
from modeling.dynamics.motion_record import MotionRecord
from modeling.dynamics.play import PlayedRecord
from modeling.dynamics.transfer_function import through_transfer_function
from modeling.errors import InputError
from modeling.parameter import Parameter

Array = NDArray[np.float64]

MAX_ELEMENTS = 4_500_000
"""Samples x channels x columns evaluated and whitened at once: the memory limit."""
BATCH_ELEMENTS = 1_500_000
"""Elements of each batch where there are more: smaller batches move less memory."""
MAX_EXACT_POINTS = 8
"""Grid points up to which a model with deflection or clipping is differentiated exactly, and nothing is cached."""


def whitened_sensitivities(
    fit: Fit,
    model: WrenchModel,
    grid: Sequence[NuisanceValues],
    amplitudes: Sequence[str],
    choice: RowChoice,
) -> Array:
    """Whitened derivatives (r, g, a) in a amplitudes of the last effect at their nominal values, in the chosen rows."""
    unknowns = parameter_layout(model, fit.recordings)
    each = [
        _recording_sensitivities(fit, unknowns, number, grid, amplitudes, rows)
        for number, rows in enumerate(choice)
        if rows is not RowSet.NONE
    ]
    if not each:
        return np.zeros((0, len(grid), len(amplitudes)))
    return each[0] if len(each) == 1 else np.concatenate(each)


def _recording_sensitivities(
    fit: Fit,
    unknowns: ParameterLayout,
    number: int,
    grid: Sequence[NuisanceValues],
    amplitudes: Sequence[str],
    rows: RowSet,
) -> Array:
    model, recording, whitener = unknowns.models[number], fit.recordings[number], fit.noise[number].whitener
    theta = np.tile(unknowns.values_of(number, fit.values), (len(grid), 1))
    place = {p.name: i for i, p in enumerate(model.parameters)}
    for point, values in zip(theta, grid, strict=True):
        for name, value in values.items():
            point[place[name]] = value
    which = tuple(place[name] for name in amplitudes)
    samples = recording.samples_per_repeat if rows is RowSet.EXCITED else recording.samples
    samples //= averaged_block(model, recording, whitener.block)
    numbers = samples * len(recording.channels) * len(which)
    if numbers * len(theta) <= MAX_ELEMENTS:
        return _whitened_derivatives(model, recording, whitener, theta, which, rows)
    first, last = rows.within(whitener)
    columns = np.empty((last - first, len(theta), len(which)), order="F")
    for start in range(0, len(theta), at_once := max(1, BATCH_ELEMENTS // numbers)):
        batch = slice(start, start + at_once)
        columns[:, batch] = _whitened_derivatives(model, recording, whitener, theta[batch], which, rows)
    return columns


def _whitened_derivatives(
    model: WrenchModel, recording: Recording, whitener: Whitener, theta: Array, which: tuple[int, ...], rows: RowSet
) -> Array:
    """Whitened derivatives (r, g, len(which)) in some parameters, at g parameter vectors theta (g, k)."""
    prediction, first, last = compiled_prediction(model), *rows.within(whitener)
    clipped = prediction.saturation is not None
    if (
        set(which) & set(prediction.transfer_parameters)
        or not prediction.linearised
        or (clipped and len(theta) <= MAX_EXACT_POINTS)
    ):
        columns = np.zeros((last - first, len(theta), len(which)))
        for place, row in enumerate(theta):
            reached = whitener.nonzero_rows(model_response(model, recording, row, block=whitener.block))[first:, 1:]
            columns[: len(reached), place] = reached[: last - first, list(which)]
        return columns
    each = sensitivity_series(model, recording, theta, which, averaged_block(model, recording, whitener.block))
    summands = [summand.whitened(rows, whitener) for summand in each]
    for summand in summands[1:]:
        summands[0] += summand
    return summands[0] if summands else np.zeros((last - first, len(theta), len(which)))


@dataclass(frozen=True, eq=False)
class ReadingSummand:
    """A summand (n, p, ...) of readings or their derivatives, over one repeat (`periodic`) or the whole record.

    `unfiltered` is the record whose transfer function is still to be applied to it, None where there is none.
    """

    series: Array
    periodic: bool
    unfiltered: MotionRecord | None = None

    def read(self) -> Array:
        """The summand after the transfer function."""
        return self.series if self.unfiltered is None else through_transfer_function(self.unfiltered, self.series)

    def whitened(self, rows: RowSet, whitener: Whitener) -> Array:
        """Whitened, in some rows (r, ...); on Fourier lines a transfer function is a factor of each line."""
        after = whitener if self.unfiltered is None else _whitener_with_transfer(self.unfiltered, whitener)
        if after is None:
            return rows.whitened(whitener, self.read(), periodic=self.periodic)
        return rows.whitened(after, self.series, periodic=self.periodic)


def _whitener_with_transfer(record: MotionRecord, whitener: Whitener) -> Whitener | None:
    """Whitener that also applies the sensor's transfer function; None where that is not a factor of each line."""
    if record.dt is None:
        return whitener
    if not (isinstance(whitener, FourierLineWhitener) and record.clock.periodic):
        return None
    return whitener.with_filter(lambda omega: record.transfer(omega, record.theta)[0], record.dt)


def sensitivity_series(
    model: WrenchModel, recording: Recording, theta: Array, which: tuple[int, ...], block: int = 1
) -> Iterator[ReadingSummand]:
    """Summands of the reading's derivatives in some parameters, at g parameter vectors theta (g, k).

    For models without deflection, in parameters that are not of the transfer function. Means over blocks of samples,
    of models that allow it.
    """
    prediction = compiled_prediction(model)
    record = motion_record(model, recording.motion, theta[0], measured=first_readings(recording))
    outside = None if prediction.saturation is None else _clipped(model, recording, theta[0])
    theta = with_loads(model, recording.loads, theta)
    repeats = all(signals_are_periodic(e.inputs, recording.motion) for e in (prediction.load, prediction.bias))
    for emitted, passed in ((prediction.load, True), (prediction.bias, False)):
        if not set(which) & set(emitted.active):
            continue
        sensitivity = sensitivity_of(model, emitted, which)
        around = emitted.inputs if prediction.play is not None else sensitivity.signals  # play acts on the whole load
        periodic = signals_are_periodic(around, recording.motion)
        samples = recording.samples_per_repeat if periodic else recording.samples
        values = {n: theta[:, emitted.names.index(n)] for n in sensitivity.parameters}
        slopes = sensitivity.values(recording.motion.model_signals, values, samples, block)
        if slopes.shape[2] != len(theta):  # equal for all parameter vectors
            slopes = np.repeat(slopes, len(theta), axis=2)
        if passed and prediction.play is not None:
            load = emitted.value(recording.motion.model_signals, theta[0], samples)  # amplitudes nominal: equal for all
            slopes = PlayedRecord.of(load, record).through(slopes)
        summand = ReadingSummand(slopes, periodic, record if passed and prediction.has_transfer_function else None)
        yield summand if outside is None else _zero_where_clipped(summand, outside, recording, whole=not repeats)


def _zero_where_clipped(
    summand: ReadingSummand, outside: NDArray[np.bool_], recording: Recording, *, whole: bool
) -> ReadingSummand:
    """A summand with zeros where readings (n, p) are clipped; tiled to the `whole` record where clipping is not
    periodic."""
    slopes, periodic = summand.read(), summand.periodic
    if periodic and whole:
        slopes, periodic = np.tile(slopes, (recording.repeats, 1, 1, 1)), False
    slopes[outside[: len(slopes)]] = 0.0
    return ReadingSummand(slopes, periodic)


def _clipped(model: WrenchModel, recording: Recording, theta: Array) -> NDArray[np.bool_]:
    """Mask (n, p) of clipped readings, whose only non-zero derivative is that in the saturation level."""
    prediction = compiled_prediction(model)
    assert prediction.saturation is not None
    limit = prediction.saturation.value({}, theta, 1)[0]
    return np.asarray(np.abs(model_response(model, recording, theta, derivative=False).value) >= limit)


def sensitivity_of(model: WrenchModel, emitted: VectorFunction, which: tuple[int, ...]) -> Sensitivity:
    """Symbolic derivative of a part of a model in some of its parameters, at their nominal values."""
    parameters = model.parameters
    return Sensitivity.of(emitted, which, tuple(parameters[i].nominal for i in which))


# Score columns by finite difference where the derivative at the nominal value vanishes or does not exist.


SCREENED = 1e-8
"""Relative tolerance of the deflection solution in a finite difference.

Near a resonance the error is ten times as large: 1e-4 std in a score of a thousand std.
"""


@dataclass(frozen=True, eq=False)
class GridPoint:
    """One point of an effect's search grid: values (SI) of its parameters by their full names.

    The score column of an amplitude that the point names is the finite difference prediction(value) -
    prediction(nominal), so that an amount of 1 means the value; that of any other is the derivative at its nominal
    value, with amounts in its own unit.
    """

    values: NuisanceValues
    amplitudes: tuple[Parameter, ...]

    @property
    def named(self) -> tuple[Parameter, ...]:
        """The amplitudes with score columns by finite difference."""
        return tuple(p for p in self.amplitudes if p.name in self.values)

    @property
    def nuisances(self) -> NuisanceValues:
        """Values of the nonlinear parameters."""
        amplitudes = {p.name for p in self.amplitudes}
        return {name: value for name, value in self.values.items() if name not in amplitudes}

    def unit_of(self, parameter: Parameter) -> float:
        """Change of an amplitude per unit amount; where its nominal value is infinite, the point's value."""
        if parameter.name not in self.values:
            return 1.0
        value = self.values[parameter.name]
        return value - parameter.nominal if isfinite(parameter.nominal) else value

    def start(self, amounts: Array) -> NuisanceValues:
        """Initial values of a refit, given the estimated amounts (a,) of the amplitudes.

        An amplitude with an infinite nominal value starts at the point's value.
        """
        start = dict(self.values)
        for p, amount in zip(self.amplitudes, amounts, strict=True):
            if isfinite(p.nominal):
                start[p.name] = float(np.clip(p.nominal + amount * self.unit_of(p), *p.bounds))
        return start

    def lowest(self) -> float:
        """Lower bound of a single amplitude's amount; -inf where there are several amplitudes."""
        if len(self.amplitudes) != 1:
            return -np.inf
        (p,) = self.amplitudes
        if not isfinite(p.nominal):
            return 0.0
        return float(min((bound - p.nominal) / self.unit_of(p) for bound in p.bounds))


def score_columns(
    fit: Fit, model: WrenchModel, grid: Sequence[GridPoint], choice: RowChoice, *, exact: bool | None = None
) -> Array:
    """Score columns (r, g, a) of the last effect's a amplitudes at g points, in the chosen rows of each recording.

    Finite differences for amplitudes that the points name, derivatives for the others, `exact` ones of a model with
    deflection by default at few points.
    """
    amplitudes = grid[0].amplitudes
    named = {p.name for p in grid[0].named}
    differentiated = [i for i, p in enumerate(amplitudes) if p.name not in named]
    derivatives: Array | None = None
    if differentiated:
        exact = len(grid) <= MAX_EXACT_POINTS if exact is None else exact
        plain = model if exact else without_deflection(model)
        values, names = [p.nuisances for p in grid], [amplitudes[i].name for i in differentiated]
        derivatives = whitened_sensitivities(fit, plain, values, names, choice)
        if not named:
            return derivatives
    ranges = row_ranges(choice, fit.noise)
    columns = np.zeros((sum(last - first for first, last in ranges), len(grid), len(amplitudes)), order="F")
    if derivatives is not None:
        columns[:, :, differentiated] = derivatives
    unknowns, start = parameter_layout(model, fit.recordings), 0
    for number, (noise, (first, last)) in enumerate(zip(fit.noise, ranges, strict=True)):
        rows = slice(start, start + last - first)
        start = rows.stop
        for g, i, summands in response_differences(fit, unknowns, number, grid) if last > first else ():
            columns[rows, g, i] = sum(summand.whitened(choice[number], noise.whitener) for summand in summands)
    return columns


def without_deflection(model: WrenchModel) -> WrenchModel:
    """The model without deflection, for searches over many points: nearly the same sensitivities, 100 times as fast."""
    return replace(model, effects=tuple(e for e in model.effects if e.stage is not Stage.DEFLECTION))


def response_differences(
    fit: Fit, unknowns: ParameterLayout, number: int, grid: Sequence[GridPoint]
) -> Iterator[tuple[int, int, list[ReadingSummand]]]:
    """Change of a recording's prediction by the last effect, per grid point and for each amplitude named there alone.

    Yields point index, amplitude index and summands (n, p); nothing for a recording without the effect.
    """
    model = unknowns.models[number]
    if not set(grid[0].values) & {p.name for p in model.parameters}:
        return
    recording = fit.recordings[number]
    before = model_response(fit.layout.models[number], recording, fit.theta[fit.layout.index[number]], derivative=False)
    for g, point in enumerate(grid):
        for i, amplitude in enumerate(point.amplitudes):
            if amplitude.name not in point.values:
                continue
            values = {**fit.values, **point.nuisances, amplitude.name: point.values[amplitude.name]}
            theta = unknowns.values_of(number, values)
            try:
                after = model_response(model, recording, theta, derivative=False, tolerance=SCREENED)
            except InputError:
                continue  # a spring too soft to carry the tool: no equilibrium
            yield g, i, _difference(after, before)


def _difference(first: ModelResponse, second: ModelResponse) -> list[ReadingSummand]:
    """First response minus second, of one recording: what repeats, and the rest where there is any."""
    rest = [sign * r.whole[0] for sign, r in ((1, first), (-1, second)) if r.whole is not None]
    summands = [ReadingSummand(first.periodic[0] - second.periodic[0], periodic=True)]
    return summands + ([ReadingSummand(np.asarray(sum(rest)), periodic=False)] if rest else [])
