"""Search over an effect's nonlinear parameters: its domain, the rows that it is tested in, and refined onsets."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import replace
from itertools import product
from math import inf

import numpy as np
from numpy.typing import NDArray

from diagnosis.screening.null_model import (
    MAX_BYTES,
    BatchedColumns,
    NullModel,
    RowChoice,
    RowSet,
    ScreeningCache,
    WhitenedColumns,
    row_ranges,
)
from diagnosis.screening.projection import ProjectedColumns
from diagnosis.screening.whitened_sensitivity import MAX_EXACT_POINTS, GridPoint, score_columns, sensitivity_of
from estimation.fit import Fit
from estimation.fit_column_space import rows_of_recordings
from estimation.model_response import signals_are_periodic
from estimation.noise.tones import NonperiodicResidual
from estimation.noise.whitening import FourierLineWhitener
from estimation.parameter_layout import parameter_layout
from estimation.recordings.recording import Recording
from modeling.chain.chain import Stage
from modeling.chain.effect import Effect, GridSuperposition, NuisanceValues, SearchDomain
from modeling.chain.model import WrenchModel
from modeling.chain.prediction import compiled_prediction
from modeling.parameter import Role
from modeling.rigid_body import inertia_parameters

# Search domain of an effect's nonlinear parameters in a recording.


UNSTATED_TIP = 0.2
"""Length (m) of a tool whose rig states none: most are shorter, and the search reaches twice as far."""
MAX_TONES = 3
"""Tones taken up: noise may make a neighbour of the right line the strongest."""


def search_domain(null_model: NullModel, number: int, effect: Effect) -> SearchDomain:
    """Search domain of an effect in one of the fit's recordings, given the fit's residual."""
    domain = recording_domain(null_model.fit, number)
    if effect.has_role(Role.FREQUENCY, null_model.fit.model.space):
        return replace(domain, tones=strongest_tones(null_model, number))
    return domain


def recording_domain(fit: Fit, number: int) -> SearchDomain:
    """Search domain of one of the fit's recordings, without tones."""
    recording = fit.recordings[number]
    low, high = _position_box(recording)
    load = recording.wrench - fit.residuals[number]
    tip = recording.rig.tip_length if recording.rig is not None else None
    return SearchDomain(
        low=low,
        high=high,
        start=0.0,
        end=recording.samples * (recording.dt or 0.0),
        reach=2 * (tip or UNSTATED_TIP),
        events=fit.noise[number].events,
        contacts=tuple(shape.interval for shape in fit.noise[number].shapes if shape.judged),
        tones=(),
        largest=tuple(map(float, np.abs(recording.wrench).max(axis=0))),
        swing=tuple(map(float, np.ptp(load, axis=0) / 2)),
        inertia=_inertia(fit),
    )


def _position_box(recording: Recording) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Corners (m) of the bounding box of the sensor's positions, empty without positions."""
    signals = recording.motion.model_signals
    axes = [a for a in ("px", "py", "pz") if a in signals][: recording.dimension]
    low, high = (tuple(float(f(signals[a])) for a in axes) for f in (np.min, np.max))
    return low, high


def _inertia(fit: Fit) -> float:
    """The largest fitted moment of inertia of the tool about the sensor, kg m²."""
    return max(abs(fit.values[p.name]) for p in inertia_parameters(fit.model.space))


def strongest_tones(null_model: NullModel, number: int) -> tuple[float, ...]:
    """Frequencies (Hz) of the residual's strongest non-excited lines, refined between lines.

    The strongest is always among them, so that the multiplicity correction may count the search as one over all lines.
    """
    fit = null_model.fit
    recording, noise = fit.recordings[number], fit.noise[number]
    whitener = noise.whitener
    if not isinstance(whitener, FourierLineWhitener) or not len(whitener.non_excited_lines) or len(noise.spectra) == 0:
        return ()
    rows = null_model.residual[rows_of_recordings(fit)[number]][whitener.periodic_rows :]
    power = (rows.reshape(len(whitener.non_excited_lines), -1) ** 2).sum(axis=1)
    power[whitener.non_excited_lines < whitener.repeats] = -inf
    between = NonperiodicResidual(recording, fit.residuals[number])
    lines = whitener.non_excited_lines[np.argsort(power)[::-1][:MAX_TONES]]
    duration = recording.samples * (recording.dt or 1.0)
    weights = [1 / np.array([s(np.array([line / duration]))[0] for s in noise.spectra]) for line in lines]
    return tuple(between.sharpened(float(line), w) for line, w in zip(lines, weights, strict=True))


Array = NDArray[np.float64]

MAX_MOVES = 8
"""Most steps of either size in refining onset times; grids of windows at detected events are finer."""
WIDEST_REACH = 1 / 64
"""Of the recording, by which the first step moves onset times at the most: half of what a grid's times are apart."""
ONSET_REACHES = (4.0, 1.0)
"""Samples that the last steps move them at the most, each in eighths of twice its reach. The last but one is for the
noise of a filtered sensor: there high frequencies weigh most, the score oscillates along an onset, and its nearest
maximum may be wrong."""
ONSET_SCAN = 128
"""Most places on either side, four samples or more apart, at which another maximum is looked for, as far as the next of
a grid's times: in noise that was estimated with a time that is wrong the one at the right time is as narrow as thirty
samples, and a load that is taken up where repeats meet has others a hundred samples beside it."""


def grid_points(model: WrenchModel, effect: Effect, grid: Sequence[NuisanceValues]) -> list[GridPoint]:
    """The points of an effect's grid, with the parameters' full names."""
    short, full = effect.parameters(model.space), effect.qualified(model.space)
    names = {p.name: q.name for p, q in zip(short, full, strict=True)}
    amplitudes = tuple(p for p in full if not p.nuisance)
    return [GridPoint({names[k]: v for k, v in values.items()}, amplitudes) for values in grid]


def affected_rows(fit: Fit, model: WrenchModel, point: GridPoint | None = None, *, tested: bool = True) -> RowChoice:
    """The rows of each recording that a model's last effect changes, or (`tested`) those that enter its score test.

    Given a `point` of its grid without finite differences, only the signals of the sensitivities there count.

    Effects that do not repeat with the motion are tested on the non-excited lines only: on excited lines a contact or
    a drift, whose spectrum is broad, would absorb any systematic error of the model. A gain that follows a temperature
    scales what repeats, and differs between recordings: it is there, or nowhere.
    """
    effect = model.effects[-1]
    alone = compiled_prediction(model.base + effect)
    inputs = {*alone.load.inputs, *alone.bias.inputs}
    lasting = effect.stage is Stage.GAIN or all(signals_are_periodic(inputs, r.motion) for r in fit.recordings)
    unknowns = parameter_layout(model, fit.recordings)
    choice = []
    for its_model, recording, noise in zip(unknowns.models, fit.recordings, fit.noise, strict=True):
        rest = noise.whitener.rows > noise.whitener.periodic_rows
        if effect.id not in [e.id for e in its_model.effects]:
            choice.append(RowSet.NONE)
        elif not rest or signals_are_periodic(sensitivity_signals(its_model, point), recording.motion):
            choice.append(RowSet.EXCITED)
        elif tested and not lasting and not signals_are_periodic(inputs, recording.motion):
            choice.append(RowSet.NON_EXCITED)
        else:
            choice.append(RowSet.WHOLE)
    return tuple(choice)


def sensitivity_signals(model: WrenchModel, point: GridPoint | None) -> set[str]:
    """Signals that the sensitivities of a model's last effect depend on; all of the model's for finite differences."""
    prediction = compiled_prediction(model)
    functions = (prediction.load, prediction.bias)
    everything = {name for function in functions for name in function.inputs}
    if point is None or point.named or not all(s.linear for s in prediction.stages) or prediction.deflection:
        return everything
    names = [p.name for p in model.parameters]
    which = tuple(names.index(p.name) for p in point.amplitudes)
    if set(which) & set(prediction.transfer_parameters):
        return everything
    changed = [function for function in functions if set(which) & set(function.active)]
    return {name for function in changed for name in sensitivity_of(model, function, which).signals}


def projected_columns(
    null_model: NullModel,
    model: WrenchModel,
    effect: Effect,
    grid: Sequence[NuisanceValues],
    cache: ScreeningCache | None = None,
) -> ProjectedColumns:
    """Projected score columns of an effect, the last of the model, at its grid points, in the rows of its score test.

    Without a cache the points are evaluated once, and whatever the amplitude's sign: the search is a refined one.
    """
    points = grid_points(model, effect, grid)
    combination = effect.combination(grid)
    if 2 * len(combination.blocks) > len(grid):  # the inner products of all blocks cost more than is saved
        combination = GridSuperposition.plain(grid)
    is_plain = combination.blocks == tuple(grid)
    blocks = points if is_plain else grid_points(model, effect, combination.blocks)
    fit = null_model.fit
    choice = affected_rows(fit, model, blocks[0])

    def make() -> WhitenedColumns:
        return WhitenedColumns(score_columns(fit, model, blocks, choice), choice)

    exact = len(blocks) <= MAX_EXACT_POINTS
    block_bytes = 8 * sum(last - first for first, last in row_ranges(choice, fit.noise)) * len(blocks[0].amplitudes)
    if block_bytes * len(blocks) > MAX_BYTES / 2 and is_plain:
        batched = BatchedColumns(
            null_model,
            lambda numbers: score_columns(fit, model, [blocks[i] for i in numbers], choice, exact=exact),
            choice,
            blocks=len(blocks),
            at_once=max(1, int(MAX_BYTES / 4 / block_bytes)),
            drawn=cache is not None,
        )
        return ProjectedColumns(null_model, batched, combination, -np.inf if cache is None else points[0].lowest())
    if cache is None:
        return ProjectedColumns(null_model, make(), combination, low=-np.inf)
    whitened = cache.whitened(_cache_key(fit, model, blocks, choice), make)
    return ProjectedColumns(null_model, whitened, combination, points[0].lowest())


def _cache_key(fit: Fit, model: WrenchModel, blocks: Sequence[GridPoint], choice: RowChoice) -> Hashable | None:
    """Everything that whitened columns depend on; None where it changes from fit to fit, or the columns are few."""
    prediction = compiled_prediction(model)
    simple = prediction.instantaneous and len(fit.recordings) == 1 and not blocks[0].named
    if len(blocks) <= MAX_EXACT_POINTS or not simple:
        return None
    names = [p.name for p in model.parameters]
    which = tuple(names.index(p.name) for p in blocks[0].amplitudes)
    derivatives = []
    for emitted in (prediction.load, prediction.bias):
        if set(which) & set(emitted.active):
            of = sensitivity_of(model, emitted, which)
            derivatives.append((of.expression, tuple((n, fit.values[n]) for n in of.parameters if n in fit.values)))
    values = tuple(tuple(sorted(point.values.items())) for point in blocks)
    return (fit.noise, fit.recordings, choice, tuple(derivatives), values)


def refine_onsets(null_model: NullModel, effect: Effect, start: NuisanceValues) -> NuisanceValues:
    """Initial values of a refit with its onset times (s) moved, in quarter samples, to the largest score.

    An edge shorter than a sample has no derivative in its time between samples, so that the exact refit could not
    move away from the grid; in low-frequency noise an error of half a sample already costs much of the score.
    """
    fit = null_model.fit
    model = fit.model + effect
    parameters = model.effects[-1].qualified(model.space)
    times = [p.name for p in parameters if p.role is Role.ONSET]
    steps = [(r.dt, r.samples) for r in fit.recordings if r.dt is not None]
    if not times or not steps or _is_given(fit, [start[name] for name in times]):
        return start
    short = {p.name: p.name.removeprefix(f"{effect.id}.") for p in parameters}
    nuisances = {p.name: start[p.name] for p in parameters if p.nuisance and not p.fixed}
    step, samples = min(steps)
    repeated = any(recording.repeats > 1 for recording in fit.recordings)
    reaches = ONSET_REACHES if any(noise.filtered for noise in fit.noise) else ONSET_REACHES[1:]
    wider = samples * WIDEST_REACH / 4.0 ** np.arange(8)
    eighths = np.linspace(-1.0, 1.0, 9)
    first, last = ([reach * eighths for reach in each] for each in (wider[wider > ONSET_REACHES[0]], reaches))
    apart = max(4.0, 2 * WIDEST_REACH * samples / ONSET_SCAN)
    scan = apart * np.arange(-ONSET_SCAN, ONSET_SCAN + 1)
    for moves in (*first, scan, *last):
        shifts = list(product(step * moves, repeat=len(times)))
        if moves[-1] > ONSET_REACHES[0] or not repeated:
            shifts = [shift for shift in shifts if np.count_nonzero(shift) <= 1]
        for _ in range(MAX_MOVES):
            moved = [nuisances | {t: nuisances[t] + by for t, by in zip(times, shift, strict=True)} for shift in shifts]
            grid = [{short[name]: value for name, value in values.items()} for values in moved]
            scores = projected_columns(null_model, model, model.effects[-1], grid).scores
            best = moved[int(scores.argmax())]
            if scores.max() <= scores[len(shifts) // 2]:
                break
            nuisances = best
    return start | nuisances


def _is_given(fit: Fit, times: Sequence[float]) -> bool:
    """Whether times are those of an event whose shape is free."""
    return any(shape.judged and list(shape.interval) == times for noise in fit.noise for shape in noise.shapes)
