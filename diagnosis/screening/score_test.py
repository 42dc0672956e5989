"""Score test of each candidate effect given the fitted model."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from math import isfinite

import numpy as np

from diagnosis.progress import CountCallback
from diagnosis.screening.grid_search import GridSearch, refine_onsets, search_domain
from diagnosis.screening.null_model import NullModel, ScreeningCache
from diagnosis.screening.whitened_sensitivity import GridPoint
from estimation.fit import Fit, refit
from estimation.gravity.gravity_direction import with_gravity_direction
from estimation.model_response import missing_inputs
from estimation.multiplicity import bonferroni_level, holm_adjusted
from estimation.noise.recording_noise import RecordingNoise
from estimation.noise.whitening import FourierLineWhitener
from estimation.recordings.recording import Recording
from estimation.recordings.sign_convention import with_decided_convention
from modeling.chain.chain import Stage
from modeling.chain.effect import Effect, NuisanceValues
from modeling.chain.model import WrenchModel
from modeling.chain.prediction import compiled_prediction
from modeling.noise import NoiseSource
from modeling.parameter import Role
from modeling.significance import LEVELS

# Score that an effect gets from the noise of the motion alone.
#
# The motion is measured, and its noise enters twice: in the prediction, so in the residual, and in the effect's score
# columns. The two are correlated, so that an effect that is not there may have a score (errors in variables).


DRAWS = 4
"""Of the motion: the largest of as many scores bounds that of the motion's noise."""


@dataclass(frozen=True, eq=False)
class DrawnMotion:
    """Fits to what a model predicts, at motions drawn at random from what the recordings' samples leave open.

    Their residual is the noise of the motion alone. `cache` is that of their score tests.
    """

    fits: tuple[Fit, ...]
    cache: ScreeningCache = field(default_factory=ScreeningCache)

    @classmethod
    def of(cls, fit: Fit, cache: ScreeningCache | None = None) -> DrawnMotion | None:
        """Of a fit; None where no recording's motion is noisy."""
        noisy = tuple(noise.motion is not None for noise in fit.noise)
        if not any(noisy):
            return None
        cache = ScreeningCache() if cache is None else cache
        motions = cache.motions((fit.recordings, noisy), lambda: _drawn_motions(fit.recordings, noisy))
        return cls(tuple(_at_motion(fit, motion) for motion in motions), cache.in_other_noise())

    @cached_property
    def largest_power(self) -> float:
        """Upper limit of any score: the whitened chi-square of the residual itself."""
        residuals = (NullModel.of(fit, self.cache).residual for fit in self.fits)
        return max(float(rows @ rows) for rows in residuals)


def _drawn_motions(recordings: Sequence[Recording], noisy: Sequence[bool]) -> list[tuple[Recording, ...]]:
    """DRAWS times the recordings, those whose motion is noisy with another one."""
    rng, drawn = np.random.default_rng(0), []
    for recording in recordings:
        recording.signals  # noqa: B018  motions are drawn from the splines of its signals
    for _ in range(DRAWS):
        drawn.append(tuple(r.drawn_motions(rng, 1) if n else r for r, n in zip(recordings, noisy, strict=True)))
    return drawn


def _at_motion(fit: Fit, motion: Sequence[Recording]) -> Fit:
    """The fit to what it predicts for its own recordings, as readings at another motion."""
    readings = [fit.predicted_readings(number) for number in range(len(fit.recordings))]
    return replace(fit, recordings=tuple(r.with_readings(w) for r, w in zip(motion, readings, strict=True)))


CLEARLY_SIGNIFICANT = 1e-6
"""P-value by a limit of the motion's noise that needs no better one, whatever the number of effects."""


@dataclass(frozen=True, eq=False)
class ScoreTest:
    """Score test of one effect given a fit.

    statistic   drop of the whitened chi-square by its amplitudes' linear estimate (0 when not excited)
    p_value     corrected for the effective number of grid points tested, not for the number of effects
    start       initial values of the exact refit
    amounts     estimated changes of the amplitudes from nominal, with their std
    limits      computes `detectable`
    point       grid point of the best score, None when not excited
    reason      why it is not excited, empty when it is
    searched    effective number of grid points tested
    """

    effect: Effect
    statistic: float
    p_value: float
    start: NuisanceValues
    amounts: Mapping[str, tuple[float, float]]
    limits: Callable[[], Mapping[str, float]] = field(default=dict, repr=False)
    point: GridPoint | None = None
    reason: str = ""
    searched: float = 1.0

    @property
    def excited(self) -> bool:
        """Whether the effect is identifiable from the recordings."""
        return not self.reason

    @cached_property
    def detectable(self) -> Mapping[str, float]:
        """Changes of the amplitudes that are detected with 80 % power; computed when asked for, as it takes long."""
        return self.limits()


def screen(
    fit: Fit,
    effects: Sequence[Effect],
    *,
    candidates: int | None = None,
    cache: ScreeningCache | None = None,
    announce: CountCallback | None = None,
) -> list[ScoreTest]:
    """Score tests of all effects that the model lacks, given the fit; the most significant first.

    `candidates` is the number of candidate effects for the multiplicity correction, by default of those given. The
    `cache` holds what fits in the same noise share; no effect is searched twice given the same fit.
    """
    count = len(effects) if candidates is None else candidates
    cache = ScreeningCache() if cache is None else cache
    searches = run_searches(absent_effects(fit, effects), cache, announce)
    motion = _scores_of_motion([s for s in searches if isinstance(s, GridSearch)], fit, cache)
    found = [_score_test(s, count, motion) if isinstance(s, GridSearch) else s for s in searches]
    return sorted(found, key=lambda s: (s.p_value, -s.statistic))


def absent_effects(fit: Fit, effects: Sequence[Effect]) -> list[tuple[Fit, Effect]]:
    """Pairs of the fit and each of the effects that its model lacks, at a point on the tip axis if it has one."""
    present = {e.id for e in fit.model.effects}
    return [(fit, e.restricted(fit.model.space)) for e in effects if e.id not in present]


def run_searches(
    wanted: Sequence[tuple[Fit, Effect]], cache: ScreeningCache, announce: CountCallback | None = None
) -> list[GridSearch | ScoreTest]:
    """Grid searches of effects, each given a fit; no search is made twice."""
    return cache.results(wanted, lambda key: _search(NullModel.of(key[0], cache), key[1]), announce)


def refit_initial_values(fit: Fit, screening: ScoreTest, cache: ScreeningCache | None = None) -> NuisanceValues:
    """Initial values of the exact refit with a screened effect, its onset times refined."""
    null_model = NullModel.of(fit, ScreeningCache() if cache is None else cache)
    return refine_onsets(null_model, screening.effect, screening.start)


def adjusted_p_values(score_tests: Sequence[ScoreTest]) -> dict[str, float]:
    """Holm-adjusted p-values of the excited effects, by id."""
    excited = [s for s in score_tests if s.excited]
    return dict(zip((s.effect.id for s in excited), holm_adjusted([s.p_value for s in excited]), strict=True))


def significant_effects(score_tests: Sequence[ScoreTest]) -> list[ScoreTest]:
    """The excited effects that are significant at 1 % (Holm), in the order given."""
    adjusted = adjusted_p_values(score_tests)
    return [s for s in score_tests if s.excited and adjusted[s.effect.id] < LEVELS.effect]


def _search(null_model: NullModel, new: Effect) -> GridSearch | ScoreTest:
    """The grid search of an effect, or a score test that says why there is none."""
    fit = null_model.fit
    model = fit.model + new
    effect = model.effects[-1]
    alone = compiled_prediction(model.base + effect).model
    missing = [_missing_inputs(alone, effect, r, n) for r, n in zip(fit.recordings, fit.noise, strict=True)]
    numbers = [i for i, absent in enumerate(missing) if not absent]
    static = [effect.stage is Stage.LINEAR_DYNAMICS and r.at_rest for r in fit.recordings]
    everywhere = effect.per_recording or all(s or not m for s, m in zip(static, missing, strict=True))
    if not numbers or not everywhere:
        first = next(i for i, absent in enumerate(missing) if absent)
        return _not_excited(effect, f"no {_quantities(missing[first])} in {fit.recordings[first].name}")
    grid = effect.nuisance_grid(search_domain(null_model, numbers[0], effect))
    if not grid:
        return _not_excited(effect, "the recording has no position")
    return GridSearch.over(null_model, model, effect, grid)


def _quantities(names: Sequence[str]) -> str:
    """What signals are: joint angles for q1, q2 and their derivatives."""
    known = ("joint angles" if re.fullmatch(r"d*q\d+", name) else name for name in names)
    return ", ".join(dict.fromkeys(known))


def _missing_inputs(alone: WrenchModel, effect: Effect, recording: Recording, noise: RecordingNoise) -> tuple[str, ...]:
    """What a recording lacks for an effect: signals, or repeats where without them it is aliased."""
    missing = missing_inputs(alone, recording)
    whitener = noise.whitener
    nonperiodic_lines = isinstance(whitener, FourierLineWhitener) and len(whitener.non_excited_lines)
    if effect.has_role(Role.FREQUENCY, alone.space) and not nonperiodic_lines:
        return (*missing, "repeats without pause, whose non-excited lines would show a tone")
    if recording.repeats > 1 or recording.at_rest:
        return missing
    if effect.needs_repeats:
        return (*missing, "repeats, without which the effect is aliased with other slow ones")
    if effect.has_role(Role.ONSET, alone.space) and noise.source is NoiseSource.RESIDUAL and not noise.events:
        return (*missing, "detected event, nor repeats in which a small one would be significant")
    return missing


def _not_excited(effect: Effect, reason: str) -> ScoreTest:
    return ScoreTest(effect, 0.0, 1.0, {}, {}, reason=reason)


def _score_test(search: GridSearch, candidates: int, motion: Mapping[str, float]) -> ScoreTest:
    """`motion` are scores that the noise of the motion gives by itself, by effect; zero where there is none."""
    best, effect = search.best, search.effect
    if best.rank == 0:
        return _not_excited(effect, search.unidentifiable_reason)
    level = bonferroni_level(candidates) / search.number_of_tests
    return ScoreTest(
        effect=effect,
        statistic=best.score,
        p_value=search.p_value(motion.get(effect.id, 0.0)),
        start=search.start,
        amounts=search.amounts(),
        limits=partial(search.detectable, level),
        point=search.point,
        searched=search.number_of_tests,
    )


def _scores_of_motion(searches: Sequence[GridSearch], fit: Fit, cache: ScreeningCache) -> dict[str, float]:
    """Score that the noise of the motion alone gives each significant effect, by its id.

    The limit that holds for every effect is tried first, as it costs nothing.
    """
    significant = [s for s in searches if s.best.rank and s.p_value() < LEVELS.effect]
    motion = cache.drawn_motion(fit, lambda: DrawnMotion.of(fit, cache)) if significant else None
    if motion is None:
        return {}
    scores = {s.effect.id: motion.largest_power for s in significant}
    unclear = [s.effect for s in significant if s.p_value(motion.largest_power) >= CLEARLY_SIGNIFICANT]
    wanted = [(drawn, effect) for effect in unclear for drawn in motion.fits]
    again = dict(zip(wanted, run_searches(wanted, motion.cache), strict=True))
    for effect in unclear:
        scores[effect.id] = max(_largest_score(again[drawn, effect]) for drawn in motion.fits)
    return scores


def _largest_score(search: GridSearch | ScoreTest) -> float:
    return search.best.score if isinstance(search, GridSearch) else search.statistic


# Initial values of a nonlinear fit, by screening each effect in turn.


def model_initial_values(model: WrenchModel, recordings: Sequence[Recording]) -> NuisanceValues:
    """Initial values by name for fitting a model to recordings; {} where the nominal values suffice.

    The effects are added to the rigid tool one after the other, in the model's order; each starts at the best point of
    its score test given those before it, and everything before it where it was fitted: far from there, effects that
    are not linear have other minima. An effect that the recordings do not excite is skipped.
    """
    case = with_gravity_direction(model, recordings)
    model, several = case.model, case.recordings
    searched = [e for e in model.effects if _needs_search(e, model)]
    if not searched:
        return {}
    found: NuisanceValues = {}
    fitted = refit(with_decided_convention(model.base, several), several)
    for effect in model.effects:
        cache = ScreeningCache()
        (screening,) = screen(fitted, [effect], cache=cache)
        if not screening.excited:
            continue
        if effect in searched:
            found |= refit_initial_values(fitted, screening, cache)
        fitted = _refit_with(fitted, effect, found) if effect not in model.effects[-1:] else fitted
    return {**fitted.values, **found}


def _needs_search(effect: Effect, model: WrenchModel) -> bool:
    return any(p.nuisance or not isfinite(p.nominal) for p in effect.parameters(model.space))


def _refit_with(fitted: Fit, effect: Effect, start: NuisanceValues) -> Fit:
    return refit(fitted.model + effect, fitted.recordings, noise=fitted.noise, start={**fitted.values, **start})
