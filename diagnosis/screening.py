"""Screening: every effect of the catalogue at once, as the derivative of the prediction at its nominal value."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.stats import chi2, ncx2

from diagnosis.comparison import orthonormal, tail
from estimation.fit import Fit, Problem
from estimation.layout import layout
from estimation.noise import NoiseSource
from estimation.recording import Recording
from estimation.response import missing_inputs, repeats_with_motion, respond, signals_of, through_memory
from estimation.whitening import Whitener
from modeling.chain import Stage
from modeling.effect import Effect, Extent, Values
from modeling.effects import CATALOGUE
from modeling.model import WrenchModel
from modeling.prediction import compiled

Array = NDArray[np.float64]

SIGNIFICANCE = 0.01
POWER = 0.8
RANK_TOLERANCE = 1e-4
"""Share of a column that must be left after projection; less is a derivative's rounding, not a direction."""
DRAWS = 100
SEED = 0
"""Draws of pure noise from which a supremum over nuisance values takes its number of trials."""


@dataclass(frozen=True, eq=False)
class Screening:
    """One effect's chance to explain what is left.

    statistic   drop of the whitened chi-square that its best linear amount would bring (0 when not excited)
    p_value     paid for by the number of nuisance values tried, not yet by the number of effects
    start       parameter values from which to refit exactly
    amounts     estimated amplitudes, with their std and the amount detectable with 80 % power
    soaked      share of its column that other parameters have soaked up already
    reason      why it is not excited, empty when it is
    """

    effect: Effect
    statistic: float
    freedom: int
    p_value: float
    start: Values
    amounts: Mapping[str, tuple[float, float]]
    detectable: Mapping[str, float]
    soaked: float
    reason: str = ""

    @property
    def excited(self) -> bool:
        """Whether this recording can show the effect at all."""
        return not self.reason


@dataclass(frozen=True, eq=False)
class Background:
    """A fit as seen by a new column: what is left, and the directions that are taken already."""

    fit: Fit

    @cached_property
    def problem(self) -> Problem:
        """The whitened problem of the fit."""
        return Problem(self.fit.layout, self.fit.recordings, self.fit.noise)

    @cached_property
    def _evaluated(self) -> tuple[Array, Array]:
        return self.problem.evaluate(self.fit.theta)

    @cached_property
    def basis(self) -> Array:
        """Orthonormal basis (rows, r) of the derivative's columns."""
        return orthonormal(self._evaluated[1])

    def doubt_of(self, fitted: Array) -> Array:
        """Doubt (g,) of the chi-square that each column of fitted rows (rows, g) takes away, by where it comes from."""
        shares = fitted**2 / np.maximum((fitted**2).sum(axis=0), 1e-300)
        bounds = np.cumsum([n.whitener.rows for n in self.fit.noise])[:-1]
        parts = np.split(shares, bounds)
        return np.asarray(sum(n.doubt_of(part) for n, part in zip(self.fit.noise, parts, strict=True)))

    @cached_property
    def residual(self) -> Array:
        """Whitened residual (rows,) with those directions taken out."""
        raw = self._evaluated[0]
        return np.asarray(raw - self.basis @ (self.basis.T @ raw))

    @cached_property
    def draws(self) -> Array:
        """Pure noise (rows, DRAWS) with the directions taken out; always the same, so that a p-value repeats."""
        noise = np.random.default_rng(SEED).standard_normal((len(self.residual), DRAWS))
        return np.asarray(noise - self.basis @ (self.basis.T @ noise))

    @property
    def cost(self) -> float:
        """Whitened chi-square of the fit."""
        return float(self._evaluated[0] @ self._evaluated[0])


def extent_of(recording: Recording, events: Sequence[tuple[float, float]] = ()) -> Extent:
    """Where nuisance parameters can lie for a recording."""
    signals = signals_of(recording)
    axes = [a for a in ("px", "py", "pz") if a in signals][: recording.dimension]
    low, high = (tuple(float(f(signals[a])) for a in axes) for f in (np.min, np.max))
    tip = recording.rig.tip_length if recording.rig is not None else None
    time = recording.time
    end = 0.0 if time is None else recording.samples * (recording.dt or 0.0)
    return Extent(low=low, high=high, start=0.0, end=end, reach=2 * (tip or 0.2), events=tuple(events))


def screen(fit: Fit, effects: Sequence[Effect]) -> list[Screening]:
    """Every effect that the model lacks, screened against the fit's residual; the most significant first."""
    background = Background(fit)
    present = {e.id for e in fit.model.effects}
    found = [_screened(background, e) for e in effects if e.id not in present]
    return sorted(found, key=lambda s: (s.p_value, -s.statistic))


def _screened(background: Background, effect: Effect) -> Screening:
    fit = background.fit
    model = fit.model + effect
    missing = [_missing(fit.model.base, effect, r) for r in fit.recordings]
    numbers = [i for i, lacking in enumerate(missing) if not lacking]
    spared = [effect.stage is Stage.MEMORY and r.at_rest for r in fit.recordings]
    everywhere = effect.per_recording or all(s or not m for s, m in zip(spared, missing, strict=True))
    if not numbers or not everywhere:
        first = next(i for i, lacking in enumerate(missing) if lacking)
        return _not_excited(effect, f"{fit.recordings[first].name} has no {', '.join(missing[first])}")
    extent = extent_of(fit.recordings[numbers[0]], fit.noise[numbers[0]].events)
    grid = effect.nuisance_grid(extent)
    if not grid:
        return _not_excited(effect, "the recording has no position")
    return _best_of_grid(background, model, effect, grid)


def _missing(base: WrenchModel, effect: Effect, recording: Recording) -> tuple[str, ...]:
    """What a recording lacks for an effect: signals, or repeats for what slow physics would imitate."""
    missing = missing_inputs(base + effect, recording)
    if effect.needs_repeats and recording.repeats == 1 and not recording.at_rest:
        return (*missing, "repeats, without which slow physics would look the same")
    return missing


def _not_excited(effect: Effect, reason: str) -> Screening:
    return Screening(effect, 0.0, 0, 1.0, {}, {}, {}, 1.0, reason)


@dataclass(frozen=True, eq=False)
class _Candidate:
    """What the columns of an effect's amplitudes would bring at one nuisance value."""

    score: float
    rank: int
    amounts: Array
    std: Array
    soaked: float
    doubt: float


def _best_of_grid(background: Background, model: WrenchModel, effect: Effect, grid: Sequence[Values]) -> Screening:
    parameters = effect.qualified(model.space)
    amplitudes = [p for p in parameters if not p.nuisance]
    names = {p.name: q.name for p, q in zip(effect.parameters(model.space), parameters, strict=True)}
    low = amplitudes[0].bounds[0] if len(amplitudes) == 1 else -np.inf
    noise_scores = np.zeros(DRAWS)
    best: tuple[_Candidate, Values] | None = None
    for chunk in _chunks([{names[k]: v for k, v in values.items()} for values in grid], 64):
        columns = where_judged(background.fit, amplitude_columns(background, model, chunk))
        projected = Projected(background, columns, low)
        for candidate, values in zip(projected.candidates, chunk, strict=True):
            if best is None or candidate.score > best[0].score:
                best = (candidate, values)
        if len(grid) > 1:
            noise_scores = np.maximum(noise_scores, projected.noise_scores())
    if best is None or best[0].rank == 0:
        return _not_excited(effect, why_not_shown(projected))
    candidate, start = best
    named = [p.name for p in amplitudes]
    trials = _trials(noise_scores, candidate.rank) if len(grid) > 1 else 1.0
    needed = np.sqrt(detectable_separation(candidate.rank, SIGNIFICANCE / len(CATALOGUE) / trials))
    return Screening(
        effect=effect,
        statistic=candidate.score,
        freedom=candidate.rank,
        p_value=min(1.0, trials * tail(candidate.score, candidate.rank, candidate.doubt)),
        start=start | {n: float(a) for n, a in zip(named, candidate.amounts, strict=True)},
        amounts={n: (float(a), float(s)) for n, a, s in zip(named, candidate.amounts, candidate.std, strict=True)},
        detectable={n: float(needed * s) for n, s in zip(named, candidate.std, strict=True)},
        soaked=candidate.soaked,
    )


def why_not_shown(projected: Projected) -> str:
    """Why no amount of an effect can be estimated."""
    if not projected.columns.any():
        return "nothing in this motion would show it"
    return "other parameters of the model explain all that it would do in this motion"


def _chunks(grid: Sequence[Values], size: int) -> list[Sequence[Values]]:
    return [grid[i : i + size] for i in range(0, len(grid), size)]


def amplitude_columns(background: Background, model: WrenchModel, grid: Sequence[Values]) -> Array:
    """Whitened derivatives (rows, g, amplitudes) of the last effect's amplitudes at their nominal value."""
    fit = background.fit
    effect = model.effects[-1]
    unknowns = layout(model, fit.recordings)
    values = fit.values
    parts = []
    for number, (recording, noise) in enumerate(zip(fit.recordings, fit.noise, strict=True)):
        own = unknowns.models[number]
        names = [unknowns.parameters[i].name for i in unknowns.index[number]]
        count = len([p for p in effect.parameters(model.space) if not p.nuisance])
        if effect.id not in [e.id for e in own.effects]:
            parts.append(np.zeros((noise.whitener.rows, len(grid), count)))
            continue
        theta = np.array(
            [
                [g.get(p.name, values.get(n, p.nominal)) for n, p in zip(names, own.parameters, strict=True)]
                for g in grid
            ]
        )
        amplitude = {p.name for p in effect.qualified(model.space) if not p.nuisance}
        which = tuple(i for i, p in enumerate(own.parameters) if p.name in amplitude)
        parts.append(_whitened_slopes(own, recording, noise.whitener, theta, which))
    return np.concatenate(parts)


def where_judged(fit: Fit, columns: Array) -> Array:
    """Whitened columns (rows, g, a) in the rows where they are judged.

    What does not repeat with the motion is judged between the motion's lines only: on them it would be taken for
    anything periodic that the model lacks, because a push or a drift has some of every shape.
    """
    judged, start = columns.copy(), 0
    for noise in fit.noise:
        steady, end = start + noise.whitener.steady_rows, start + noise.whitener.rows
        if columns[steady:end].any():
            judged[start:steady] = 0
        start = end
    return judged


def _whitened_slopes(
    model: WrenchModel, recording: Recording, whitener: Whitener, theta: Array, which: tuple[int, ...]
) -> Array:
    """Whitened derivatives (rows, g, len(which)) in some parameters, at each of g parameter sets theta (g, k)."""
    prediction, signals = compiled(model), signals_of(recording)
    if set(which) & set(prediction.memory_parameters):
        rows = [whitener.response(respond(model, recording, row))[1][:, list(which)] for row in theta]
        return np.stack(rows, axis=1)
    total = np.zeros((whitener.rows, len(theta), len(which)))
    for emitted, remembers in ((prediction.load, True), (prediction.zero, False)):
        if not set(which) & set(emitted.active):
            continue
        steady = repeats_with_motion(emitted.inputs, recording)
        samples = recording.samples_per_repeat if steady else recording.samples
        slopes = emitted.slopes(signals, theta, which, samples)
        if remembers:
            slopes = through_memory(prediction, recording, slopes, theta[0])
        if steady:
            total[: whitener.steady_rows] += whitener.steady(slopes)
        else:
            total += whitener.series(slopes)
    return total


@dataclass(frozen=True, eq=False)
class Projected:
    """Columns (rows, g, a) of one effect's a amplitudes at g nuisance values, less what the model does already.

    Each group is scaled to columns of unit length and brought to its principal directions, of which those with
    less than RANK_TOLERANCE left are no directions. `low` bounds a single amplitude from below.
    """

    background: Background
    columns: Array
    low: float

    @cached_property
    def rows(self) -> slice:
        """The rows that any column reaches."""
        reached = np.flatnonzero(self.columns.any(axis=(1, 2)))
        return slice(0, int(reached[-1]) + 1 if len(reached) else 1)

    @cached_property
    def scale(self) -> Array:
        """Length of each column, (g, a)."""
        length = np.linalg.norm(self.columns, axis=0)
        return np.asarray(np.where(length > 0, length, 1.0))

    @cached_property
    def free(self) -> Array:
        """Unit columns less their part in the model's own directions; whole rows, (rows, g, a)."""
        unit = self.columns / self.scale
        basis = self.background.basis
        along = np.tensordot(basis[self.rows], unit[self.rows], axes=(0, 0))
        return np.asarray(unit - np.tensordot(basis, along, axes=(1, 0)))

    @cached_property
    def directions(self) -> tuple[Array, Array]:
        """Inverse roots (g, a, a) that make the free columns orthonormal, zero where there is none; ranks (g,)."""
        gram = np.einsum("rga,rgb->gab", self.free, self.free, optimize=True)
        values, vectors = np.linalg.eigh(gram)
        kept = values > RANK_TOLERANCE**2
        inverse = np.where(kept, 1 / np.sqrt(np.where(kept, values, 1.0)), 0.0)
        return vectors * inverse[:, None, :], kept.sum(axis=1)

    def scores(self, rows: Array) -> tuple[Array, Array]:
        """Chi-square drop (g, m) and amounts (g, a, m) for residual rows (rows, m) free of the model's directions.

        The free columns and the unit columns have the same product with such residuals.
        """
        unit = self.columns[self.rows] / self.scale
        product = np.tensordot(unit, rows[self.rows], axes=(0, 0))
        roots, _ = self.directions
        along = np.einsum("gab,gam->gbm", roots, product)
        amounts = np.einsum("gab,gbm->gam", roots, along) / self.scale[:, :, None]
        score = (along**2).sum(axis=1)
        if np.isfinite(self.low):
            score = np.where(amounts[:, 0] > self.low, score, 0.0)
        return score, amounts

    @cached_property
    def candidates(self) -> list[_Candidate]:
        """One per nuisance value."""
        score, amounts = self.scores(self.background.residual[:, None])
        roots, rank = self.directions
        std = np.linalg.norm(roots, axis=2) / self.scale
        left = (self.free**2).sum(axis=(0, 2)) / self.columns.shape[2]
        doubt = self.background.doubt_of(np.einsum("rga,ga->rg", self.free, amounts[:, :, 0] * self.scale))
        return [
            _Candidate(
                float(score[g, 0]),
                int(rank[g]),
                amounts[g, :, 0],
                std[g],
                float(1 - left[g]),
                float(doubt[g]),
            )
            for g in range(len(rank))
        ]

    def noise_scores(self) -> Array:
        """The largest score of these columns in draws of pure noise, (DRAWS,)."""
        score, _ = self.scores(self.background.draws)
        return np.asarray(score.max(axis=0))


def _trials(noise_scores: Array, rank: int) -> float:
    """Number of independent trials that a search over nuisance values amounts to.

    Draws of pure noise give the supremum's own distribution; beyond their reach its tail is taken as that of one
    chi-square times the number of trials that the draws' upper tenth implies.
    """
    high = float(np.quantile(noise_scores, 0.9))
    return max(1.0, 0.1 / max(float(chi2.sf(high, rank)), 1e-12))


def detectable_separation(freedom: int, level: float) -> float:
    """Noncentrality that a chi-square test of this freedom at this level shows with 80 % power."""
    limit = chi2.isf(level, freedom)
    return float(brentq(lambda x: ncx2.sf(limit, freedom, x) - POWER, 1e-6, 1e4))


def residual_judges_itself(fit: Fit) -> bool:
    """Whether any recording's noise had to come from the residual."""
    return any(n.source is NoiseSource.RESIDUAL for n in fit.noise)
