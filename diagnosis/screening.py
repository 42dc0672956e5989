"""Screening: every effect of the catalogue at once, as the derivative of the prediction at its nominal value."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.stats import chi2, ncx2

from diagnosis.background import DRAWS, Background
from diagnosis.columns import amplitude_columns, where_judged
from diagnosis.comparison import tail
from diagnosis.projection import Projected, Trial
from estimation.fit import Fit
from estimation.noise import Noise
from estimation.recording import Recording
from estimation.response import missing_inputs, signals_of
from modeling.chain import Stage
from modeling.effect import Effect, Extent, Values
from modeling.effects import CATALOGUE
from modeling.model import WrenchModel

Array = NDArray[np.float64]

SIGNIFICANCE = 0.01
POWER = 0.8
INTERVAL = 2
"""Times that an effect with a beginning and an end has."""
MOST_MOVES = 8
"""Times that a window's edges may move by a sample: the grid of windows is finer than that where one was noticed."""
CHUNK = 64
"""Nuisance values looked at together: grids have hundreds, and their columns would not fit into memory at once."""


@dataclass(frozen=True, eq=False)
class Screening:
    """One effect's chance to explain what is left.

    statistic   drop of the whitened chi-square that its best linear amount would bring (0 when not excited)
    p_value     paid for by the number of nuisance values tried, not yet by the number of effects
    start       parameter values from which to refit exactly
    amounts     estimated amplitudes, with their std and the amount detectable with 80 % power
    reason      why it is not excited, empty when it is
    """

    effect: Effect
    statistic: float
    p_value: float
    start: Values
    amounts: Mapping[str, tuple[float, float]]
    detectable: Mapping[str, float]
    reason: str = ""

    @property
    def excited(self) -> bool:
        """Whether this recording can show the effect at all."""
        return not self.reason


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
    missing = [_missing(fit.model.base, effect, r, n) for r, n in zip(fit.recordings, fit.noise, strict=True)]
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


def _missing(base: WrenchModel, effect: Effect, recording: Recording, noise: Noise) -> tuple[str, ...]:
    """What a recording lacks for an effect: signals, or repeats for what slow physics would imitate."""
    missing = missing_inputs(base + effect, recording)
    if recording.repeats > 1 or recording.at_rest:
        return missing
    if effect.needs_repeats:
        return (*missing, "repeats, without which slow physics would look the same")
    times = [p for p in effect.parameters(base.space) if p.nuisance and p.unit == "s"]
    if len(times) == INTERVAL and not noise.events:
        return (*missing, "interval in which anything stands out, nor repeats that would show a small one")
    return missing


def _not_excited(effect: Effect, reason: str) -> Screening:
    return Screening(effect, 0.0, 1.0, {}, {}, {}, reason)


def _best_of_grid(background: Background, model: WrenchModel, effect: Effect, grid: Sequence[Values]) -> Screening:
    amplitudes = [p.name for p in effect.qualified(model.space) if not p.nuisance]
    searched = _searched(background, model, effect, grid)
    trial, start = searched.best, searched.start
    if trial.rank == 0:
        return _not_excited(effect, searched.why_not)
    trials = searched.independent
    needed = np.sqrt(detectable_separation(trial.rank, SIGNIFICANCE / len(CATALOGUE) / trials))
    return Screening(
        effect=effect,
        statistic=trial.score,
        p_value=min(1.0, trials * tail(trial.score, trial.rank, trial.doubt)),
        start=start | {n: float(a) for n, a in zip(amplitudes, trial.amounts, strict=True)},
        amounts={n: (float(a), float(s)) for n, a, s in zip(amplitudes, trial.amounts, trial.std, strict=True)},
        detectable={n: float(needed * s) for n, s in zip(amplitudes, trial.std, strict=True)},
    )


@dataclass(frozen=True, eq=False)
class _Searched:
    """The best trial of a grid of nuisance values, and how many independent trials the grid amounts to."""

    best: Trial
    start: Values
    independent: float
    why_not: str


def _searched(background: Background, model: WrenchModel, effect: Effect, grid: Sequence[Values]) -> _Searched:
    parameters = effect.qualified(model.space)
    amplitudes = [p for p in parameters if not p.nuisance]
    names = {p.name: q.name for p, q in zip(effect.parameters(model.space), parameters, strict=True)}
    low = amplitudes[0].bounds[0] if len(amplitudes) == 1 else -np.inf
    full = [{names[k]: v for k, v in values.items()} for values in grid]
    trials: list[Trial] = []
    noise_scores = np.zeros(DRAWS)
    for chunk in (full[i : i + CHUNK] for i in range(0, len(full), CHUNK)):
        projected = Projected(
            background, where_judged(background.fit, amplitude_columns(background, model, chunk)), low
        )
        trials += projected.trials
        if len(grid) > 1:
            noise_scores = np.maximum(noise_scores, projected.noise_scores())
    best = max(range(len(trials)), key=lambda i: trials[i].score)
    independent = independent_trials(noise_scores, trials[best].rank) if len(grid) > 1 else 1.0
    return _Searched(trials[best], full[best], independent, why_not_shown(projected))


def sharpened(fit: Fit, screening: Screening) -> Values:
    """The start of a refit with its times (s) moved, by quarters of a sample, to where the effect explains most.

    An edge shorter than a sample gives its time no derivative until it falls on a sample, and in slow noise half a
    sample beside it is a shock: the exact refit would stop where the screening's grid of windows points.
    """
    effect, start = screening.effect, screening.start
    times = [p.name for p in effect.qualified(fit.model.space) if p.nuisance and p.unit == "s"]
    steps = [r.dt for r in fit.recordings if r.dt is not None and r.repeats > 1]
    if not times or not steps:
        return start
    background, model = Background(fit), fit.model + effect
    shifts = list(product(min(steps) * np.linspace(-1.0, 1.0, 9), repeat=len(times)))
    for _ in range(MOST_MOVES):
        grid = [{**start, **{t: start[t] + by for t, by in zip(times, shift, strict=True)}} for shift in shifts]
        columns = where_judged(fit, amplitude_columns(background, model, grid))
        scores = Projected(background, columns, -np.inf).scores(background.residual[:, None])[0][:, 0]
        best = grid[int(scores.argmax())]
        if scores.max() <= scores[len(shifts) // 2]:
            break
        start = best
    return start


def why_not_shown(projected: Projected) -> str:
    """Why no amount of an effect can be estimated."""
    if not projected.columns.any():
        return "nothing in this motion would show it"
    return "other parameters of the model explain all that it would do in this motion"


def independent_trials(noise_scores: Array, rank: int) -> float:
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
