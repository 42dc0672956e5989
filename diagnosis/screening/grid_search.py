"""Grid search over an effect's nonlinear parameters: best score and effective number of tests."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import inf, isfinite

import numpy as np
from numpy.typing import NDArray

from diagnosis.screening.null_model import NullModel, RowChoice, RowSet
from diagnosis.screening.projection import PointScore, PointTest, ProjectedColumns, WhitenedColumns
from diagnosis.screening.whitened_sensitivity import MAX_EXACT_POINTS, GridPoint, score_columns, sensitivity_of
from estimation.model_response import signals_are_periodic
from estimation.multiplicity import effective_number_of_frequencies, effective_number_of_tests
from estimation.noise.tones import NonperiodicResidual
from estimation.noise.whitening import FourierLineWhitener
from estimation.parameter_layout import parameter_layout
from estimation.recordings.recording import Recording
from modeling.chain.effect import Effect, NuisanceValues, SearchDomain
from modeling.chain.model import WrenchModel
from modeling.chain.prediction import compiled_prediction
from modeling.parameter import Role
from modeling.rigid_body import inertia_parameters
from modeling.space import Space

# Search domain of an effect's nonlinear parameters in a recording.


MAX_TONES = 3
"""Tones taken up: noise may make a neighbour of the right line the strongest."""


def search_domain(null_model: NullModel, number: int, effect: Effect) -> SearchDomain:
    """Search domain of an effect in one of the fit's recordings, given the fit's residual."""
    domain = null_model.search_domain(number, lambda: _recording_domain(null_model, number))
    if effect.has_role(Role.FREQUENCY, null_model.fit.model.space):
        return replace(domain, tones=strongest_tones(null_model, number))
    return domain


def _recording_domain(null_model: NullModel, number: int) -> SearchDomain:
    """Search domain of one of the fit's recordings, without tones."""
    fit = null_model.fit
    recording = fit.recordings[number]
    low, high = _position_box(recording)
    load = recording.wrench - fit.residuals[number]
    tip = recording.rig.tip_length if recording.rig is not None else None
    return SearchDomain(
        low=low,
        high=high,
        start=0.0,
        end=recording.samples * (recording.dt or 0.0),
        reach=2 * (tip or 0.2),
        events=fit.noise[number].events,
        tones=(),
        largest=tuple(map(float, np.abs(recording.wrench).max(axis=0))),
        swing=tuple(map(float, np.ptp(load, axis=0) / 2)),
        inertia=_inertia(null_model),
    )


def _position_box(recording: Recording) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Corners (m) of the bounding box of the sensor's positions, empty without positions."""
    signals = recording.motion.model_signals
    axes = [a for a in ("px", "py", "pz") if a in signals][: recording.dimension]
    low, high = (tuple(float(f(signals[a])) for a in axes) for f in (np.min, np.max))
    return low, high


def _inertia(null_model: NullModel) -> float:
    """The largest fitted moment of inertia of the tool about the sensor, kg m²."""
    values = null_model.fit.values
    return max(abs(values[p.name]) for p in inertia_parameters(null_model.fit.model.space))


def strongest_tones(null_model: NullModel, number: int) -> tuple[float, ...]:
    """Frequencies (Hz) of the residual's strongest non-excited lines, refined between lines.

    The strongest is always among them, so that the multiplicity correction may count the search as one over all lines.
    """
    fit = null_model.fit
    recording, noise = fit.recordings[number], fit.noise[number]
    whitener = noise.whitener
    if not isinstance(whitener, FourierLineWhitener) or not len(whitener.non_excited_lines) or len(noise.spectra) == 0:
        return ()
    start = sum(n.whitener.rows for n in fit.noise[:number]) + whitener.periodic_rows
    rows = null_model.residual[start : start + whitener.rows - whitener.periodic_rows]
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
ONSET_REACHES = (4.0, 1.0)
"""Samples that a step moves onset times at the most, in eighths of twice that. The first is for the noise of a filtered
sensor: there high frequencies weigh most, the score oscillates along an onset, and its nearest maximum may be wrong."""


def grid_points(model: WrenchModel, effect: Effect, grid: Sequence[NuisanceValues]) -> list[GridPoint]:
    """The points of an effect's grid, with the parameters' full names."""
    own, full = effect.parameters(model.space), effect.qualified(model.space)
    names = {p.name: q.name for p, q in zip(own, full, strict=True)}
    amplitudes = tuple(p for p in full if not p.nuisance)
    return [GridPoint({names[k]: v for k, v in values.items()}, amplitudes) for values in grid]


def affected_rows(
    null_model: NullModel, model: WrenchModel, point: GridPoint | None = None, *, tested: bool = True
) -> RowChoice:
    """The rows of each recording that a model's last effect changes, or (`tested`) those that enter its score test.

    Given a `point` of its grid without finite differences, only the signals of the sensitivities there count.

    Effects that do not repeat with the motion are tested on the non-excited lines only: on excited lines a contact or
    a drift, whose spectrum is broad, would absorb any systematic error of the model.
    """
    fit, effect = null_model.fit, model.effects[-1]
    alone = compiled_prediction(model.base + effect)
    inputs = {*alone.load.inputs, *alone.bias.inputs}
    lasting = all(signals_are_periodic(inputs, recording.motion) for recording in fit.recordings)
    unknowns = parameter_layout(model, fit.recordings)
    choice = []
    for own, recording, noise in zip(unknowns.models, fit.recordings, fit.noise, strict=True):
        rest = noise.whitener.rows > noise.whitener.periodic_rows
        if effect.id not in [e.id for e in own.effects]:
            choice.append(RowSet.NONE)
        elif not rest or signals_are_periodic(sensitivity_signals(own, point), recording.motion):
            choice.append(RowSet.EXCITED)
        elif tested and not lasting and not signals_are_periodic(inputs, recording.motion):
            choice.append(RowSet.NON_EXCITED)
        else:
            choice.append(RowSet.WHOLE)
    return tuple(choice)


def sensitivity_signals(model: WrenchModel, point: GridPoint | None) -> set[str]:
    """Signals that the sensitivities of a model's last effect depend on; all of the model's for finite differences."""
    prediction = compiled_prediction(model)
    parts = (prediction.load, prediction.bias)
    everything = {name for part in parts for name in part.inputs}
    if point is None or point.named or not all(s.linear for s in prediction.stages) or prediction.deflection:
        return everything
    names = [p.name for p in model.parameters]
    which = tuple(names.index(p.name) for p in point.amplitudes)
    if set(which) & set(prediction.transfer_parameters):
        return everything
    return {
        name for part in parts if set(which) & set(part.active) for name in sensitivity_of(model, part, which).signals
    }


def projected_columns(
    null_model: NullModel, model: WrenchModel, effect: Effect, grid: Sequence[NuisanceValues], *, refined: bool = False
) -> ProjectedColumns:
    """Projected score columns of an effect, the last of the model, at its grid points, in the rows of its score test.

    A `refined` search evaluates its points once, whatever the amplitude's sign, and does not cache the columns.
    """
    points = grid_points(model, effect, grid)
    combination = effect.combination(grid)
    blocks = points if combination.blocks == tuple(grid) else grid_points(model, effect, combination.blocks)
    choice = affected_rows(null_model, model, blocks[0])

    def make() -> WhitenedColumns:
        return WhitenedColumns(score_columns(null_model, model, blocks, choice), choice)

    key = None if refined else _cache_key(null_model, model, blocks, choice)
    low = -np.inf if refined else points[0].lowest()
    return ProjectedColumns(null_model, null_model.cache.whitened(key, make), combination, low)


def _cache_key(
    null_model: NullModel, model: WrenchModel, blocks: Sequence[GridPoint], choice: RowChoice
) -> Hashable | None:
    """Everything that whitened columns depend on; None where it changes from fit to fit, or the columns are few."""
    fit, prediction = null_model.fit, compiled_prediction(model)
    simple = prediction.instantaneous and len(fit.recordings) == 1 and not blocks[0].named
    if len(blocks) <= MAX_EXACT_POINTS or not simple:
        return None
    names = [p.name for p in model.parameters]
    which = tuple(names.index(p.name) for p in blocks[0].amplitudes)
    parts = []
    for emitted in (prediction.load, prediction.bias):
        if set(which) & set(emitted.active):
            found = sensitivity_of(model, emitted, which)
            parts.append((found.expression, tuple((n, fit.values[n]) for n in found.parameters if n in fit.values)))
    values = tuple(tuple(sorted(point.values.items())) for point in blocks)
    return (fit.noise, fit.recordings, choice, tuple(parts), values)


@dataclass(frozen=True, eq=False)
class GridSearch:
    """Score tests of an effect at every point of its grid.

    best_index       index of the best point
    test             the score tests there
    std              standard deviations (g, a) of the amounts at each point
    effective_tests  effective number of tests over the grid
    nonzero          whether the effect changes any row
    samples          of the longest recording
    """

    effect: Effect
    space: Space
    grid: tuple[GridPoint, ...]
    best_index: int
    test: PointTest
    std: Array
    effective_tests: float
    nonzero: bool
    samples: int

    @classmethod
    def over(
        cls, null_model: NullModel, model: WrenchModel, effect: Effect, grid: Sequence[NuisanceValues]
    ) -> GridSearch:
        """The search over a grid that is not empty."""
        projected = projected_columns(null_model, model, effect, grid)
        place = _best_point(projected)
        test = projected.test(place)
        return cls(
            effect=effect,
            space=model.space,
            grid=tuple(grid_points(model, effect, grid)),
            best_index=place,
            test=test,
            std=projected.std,
            effective_tests=effective_number_of_tests(projected.noise_scores(), test.score.rank)
            if len(grid) > 1 and test.score.rank
            else 1.0,
            nonzero=bool(projected.gram.any()),
            samples=max(r.samples for r in null_model.fit.recordings),
        )

    @property
    def best(self) -> PointScore:
        """The best score."""
        return self.test.score

    @property
    def point(self) -> GridPoint:
        """The grid point of the best score."""
        return self.grid[self.best_index]

    @property
    def start(self) -> NuisanceValues:
        """Initial values of a refit."""
        return self.point.start(self.best.amounts)

    @property
    def number_of_tests(self) -> float:
        """Effective number of tests: that of the grid, or, for a tone, at least that over all frequencies."""
        if self.effect.has_role(Role.FREQUENCY, self.space):
            return max(self.effective_tests, effective_number_of_frequencies(self.best.score, self.samples))
        return self.effective_tests

    def p_value(self, from_motion: float = 0.0) -> float:
        """P-value beyond the score that the motion's noise gives by itself, corrected for the tests over the grid."""
        return min(1.0, self.number_of_tests * self.test.p_value(from_motion))

    @property
    def unidentifiable_reason(self) -> str:
        """Why the effect's amplitudes are not identifiable."""
        if not self.nonzero:
            return "not excited by this motion"
        return "collinear with other parameters of the model in this motion"

    def amounts(self) -> Mapping[str, tuple[float, float]]:
        """Estimate of each amplitude's change from nominal, with its std; of the value itself if nominal is infinite.

        An amplitude with infinite nominal value acts by its inverse: the amount a at the grid value v means v / a.
        """
        found = {}
        for p, amount, std in zip(self.point.amplitudes, self.best.amounts, self.best.std, strict=True):
            unit = self.point.unit_of(p)
            if isfinite(p.nominal):
                found[p.name] = (float(amount * unit), float(std * abs(unit)) if isfinite(std) else inf)
            else:
                found[p.name] = (unit, float(abs(unit) * std))
        return found

    def detectable(self, level: float) -> Mapping[str, float]:
        """Change of each amplitude from nominal that the test at this level detects with 80 % power.

        Where the nominal value is infinite, the effect decreases with the value: the value within the grid range, from
        the grid point whose own noncentrality is nearest.
        """
        needed = np.sqrt(self.test.power * self.test.detectable_noncentrality(level)) * self.std
        found = {}
        for i, p in enumerate(self.point.amplitudes):
            if isfinite(p.nominal):
                found[p.name] = float(needed[self.best_index, i] * abs(self.point.unit_of(p)))
                continue
            sizes = np.array([point.unit_of(p) for point in self.grid])
            amount = np.maximum(np.where(needed[:, i] > 0, needed[:, i], np.inf), 1e-300)
            near = int(np.argmin(np.abs(np.log(amount))))
            found[p.name] = float(np.clip(sizes[near] / amount[near], sizes.min(), sizes.max()))
        return found


def _best_point(projected: ProjectedColumns) -> int:
    """Index of the largest score; where all are zero, of a point where the effect is identifiable."""
    return int(np.lexsort((-np.arange(len(projected.found[0])), projected.directions[1], projected.found[0]))[-1])


def refine_onsets(null_model: NullModel, effect: Effect, start: NuisanceValues) -> NuisanceValues:
    """Initial values of a refit with its onset times (s) moved, in quarter samples, to the largest score.

    An edge shorter than a sample has no derivative in its time between samples, so that the exact refit could not
    move away from the grid; in low-frequency noise an error of half a sample already costs much of the score.
    """
    fit = null_model.fit
    model = fit.model + effect
    own = model.effects[-1].qualified(model.space)
    times = [p.name for p in own if p.role is Role.ONSET]
    steps = [r.dt for r in fit.recordings if r.dt is not None and r.repeats > 1]
    if not times or not steps:
        return start
    short = {p.name: p.name.removeprefix(f"{effect.id}.") for p in own}
    nuisances = {p.name: start[p.name] for p in own if p.nuisance and not p.fixed}
    reaches = ONSET_REACHES if any(noise.filtered for noise in fit.noise) else ONSET_REACHES[1:]
    for reach in reaches:
        shifts = list(product(reach * min(steps) * np.linspace(-1.0, 1.0, 9), repeat=len(times)))
        for _ in range(MAX_MOVES):
            moved = [nuisances | {t: nuisances[t] + by for t, by in zip(times, shift, strict=True)} for shift in shifts]
            grid = [{short[name]: value for name, value in values.items()} for values in moved]
            scores = projected_columns(null_model, model, model.effects[-1], grid, refined=True).found[0]
            best = moved[int(scores.argmax())]
            if scores.max() <= scores[len(shifts) // 2]:
                break
            nuisances = best
    return start | nuisances
