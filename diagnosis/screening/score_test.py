"""Score test of each candidate effect given the fitted model."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial

from diagnosis.progress import CountCallback
from diagnosis.screening.finite_difference import GridPoint
from diagnosis.screening.grid_search import GridSearch, refine_onsets
from diagnosis.screening.motion_noise_score import DrawnMotion
from diagnosis.screening.null_model import NullModel
from diagnosis.screening.screening_cache import ScreeningCache
from diagnosis.screening.search_domain import search_domain
from estimation.fit import Fit
from estimation.model_response import missing_inputs
from estimation.multiplicity import bonferroni_level, holm_adjusted
from estimation.noise.recording_noise import NoiseSource, RecordingNoise
from estimation.noise.whitening import FourierLineWhitener
from estimation.recordings.recording import Recording
from modeling.chain.chain import Stage
from modeling.chain.effect import Effect, NuisanceValues
from modeling.chain.model import WrenchModel
from modeling.chain.prediction import compiled_prediction
from modeling.parameter import Role
from modeling.significance import LEVELS

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
