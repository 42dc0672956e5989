"""Score test of each candidate effect given the fitted model."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from math import ceil, inf, isfinite

import numpy as np
from numpy.typing import NDArray

from diagnosis.comparison.slow_residual import SlowResidual
from diagnosis.progress import CountCallback
from diagnosis.screening.grid_search import grid_points, projected_columns, refine_onsets, search_domain
from diagnosis.screening.null_model import ScreeningCache
from diagnosis.screening.projection import PointTest, ProjectedColumns
from diagnosis.screening.whitened_sensitivity import GridPoint
from estimation.case import Case
from estimation.fit import Fit, reestimated_noise, unchecked_fit, with_ordinary_estimate
from estimation.model_response import missing_inputs
from estimation.multiplicity import (
    bonferroni_level,
    effective_number_of_frequencies,
    effective_number_of_tests,
    holm_adjusted,
)
from estimation.noise.recording_noise import RecordingNoise
from estimation.noise.whitening import FourierLineWhitener
from estimation.recordings.recording import Recording
from modeling.chain.chain import Stage
from modeling.chain.effect import Effect, NuisanceValues
from modeling.chain.model import WrenchModel
from modeling.chain.prediction import compiled_prediction
from modeling.effects.disturbances import ThermalDrift
from modeling.effects.sensor import SensorLag, TimeDelay
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
        residuals = (self.cache.null_model(fit).residual for fit in self.fits)
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
    drawn = [r.with_readings(w) for r, w in zip(motion, readings, strict=True)]
    return replace(fit, problem=fit.problem.of_recordings(drawn))


CLEARLY_SIGNIFICANT = 1e-6
"""P-value by a limit of the motion's noise that needs no better one, whatever the number of effects."""


def _undetectable(_level: float) -> tuple[Mapping[str, float], NuisanceValues]:
    return {}, {}


SHARE_OF_PLACES = 0.9
"""Share of the places searched (points of application, times, widths) at which no more is needed than what is stated as
detectable: not all, as at a few an effect hardly acts, such as a payload taken up at the end of a record."""


@dataclass(frozen=True, eq=False)
class ScoreTest:
    """Score test of one effect given a fit, at the best point of its search domain.

    statistic   drop of the whitened chi-square by its amplitudes' linear estimate (0 when not excited)
    p_value     corrected for the effective number of grid points tested, not for the number of effects
    start       initial values of the exact refit
    amounts     estimated changes of the amplitudes from nominal, with their std; of the value itself if nominal is
                infinite: such an amplitude acts by its inverse, the amount a at the grid value v means v / a
    limits      changes of the amplitudes that a test at a level of significance detects with 80 % power, and where
    level       that level, of each point tested
    point       grid point of the best score, None when not excited
    reason      why it is not excited, empty when it is
    searched    effective number of grid points tested
    test        the tests at that point, None when not excited
    """

    effect: Effect
    statistic: float
    p_value: float
    start: NuisanceValues
    amounts: Mapping[str, tuple[float, float]]
    limits: Callable[[float], tuple[Mapping[str, float], NuisanceValues]] = field(default=_undetectable, repr=False)
    level: float = LEVELS.effect
    point: GridPoint | None = None
    reason: str = ""
    searched: float = 1.0
    test: PointTest | None = None

    @property
    def excited(self) -> bool:
        """Whether the effect is identifiable from the recordings."""
        return not self.reason

    @property
    def detectable(self) -> Mapping[str, float]:
        """Changes of the amplitudes that are detected with 80 % power where they are as `detectable_at`."""
        return self._limits[0]

    @property
    def detectable_at(self) -> NuisanceValues:
        """The place, times or width that `detectable` is for: none that depends on the noise of the recording."""
        return self._limits[1]

    @cached_property
    def _limits(self) -> tuple[Mapping[str, float], NuisanceValues]:
        """Computed when asked for, as it takes long."""
        return self.limits(self.level)

    def share_of(self, excess: float | None) -> float | None:
        """Share of an excess of chi-square that the effect would remove; None where there is none, or it is unknown."""
        return min(1.0, self.statistic / excess) if excess and self.excited else None

    def p_value_beyond(self, from_motion: float) -> float:
        """P-value of what is beyond the score that the motion's noise gives by itself."""
        return 1.0 if self.test is None else min(1.0, self.searched * self.test.p_value(from_motion))


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
    tests = run_searches(absent_effects(fit, effects), cache, announce)
    motion = _scores_of_motion(tests, fit, cache)
    corrected = [
        replace(
            test,
            p_value=test.p_value_beyond(motion[test.effect.id]) if test.effect.id in motion else test.p_value,
            level=bonferroni_level(count) / test.searched,
        )
        for test in tests
    ]
    return sorted(corrected, key=lambda s: (s.p_value, -s.statistic))


def absent_effects(fit: Fit, effects: Sequence[Effect]) -> list[tuple[Fit, Effect]]:
    """Pairs of the fit and each of the effects that its model lacks, at a point on the tip axis if it has one.

    Of poses at rest alone in the form for these.
    """
    present, at_rest = {e.id for e in fit.model.effects}, all(r.at_rest for r in fit.recordings)
    absent = [e.restricted(fit.model.space) for e in effects if e.id not in present]
    return [(fit, e.at_rest() if at_rest else e) for e in absent]


def run_searches(
    wanted: Sequence[tuple[Fit, Effect]], cache: ScreeningCache, announce: CountCallback | None = None
) -> list[ScoreTest]:
    """Score tests of effects, each given a fit, as if the motion had no noise; none is made twice."""
    return cache.results(wanted, lambda key: search(key[0], key[1], cache), announce)


def refit_initial_values(fit: Fit, screening: ScoreTest, cache: ScreeningCache | None = None) -> NuisanceValues:
    """Initial values of the exact refit with a screened effect, its onset times refined."""
    cache = ScreeningCache() if cache is None else cache
    return refine_onsets(cache.null_model(fit), screening.effect, screening.start)


def adjusted_p_values(score_tests: Sequence[ScoreTest]) -> dict[str, float]:
    """Holm-adjusted p-values of the excited effects, by id."""
    excited = [s for s in score_tests if s.excited]
    return dict(zip((s.effect.id for s in excited), holm_adjusted([s.p_value for s in excited]), strict=True))


def significant_effects(score_tests: Sequence[ScoreTest]) -> list[ScoreTest]:
    """The excited effects that are significant at 1 % (Holm), in the order given."""
    adjusted = adjusted_p_values(score_tests)
    return [s for s in score_tests if s.excited and adjusted[s.effect.id] < LEVELS.effect]


def search(fit: Fit, new: Effect, cache: ScreeningCache) -> ScoreTest:
    """The score test of an effect at the best point of its search domain, or why there is none."""
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
    if any(r.clock_offset is not None for r in fit.recordings):
        (fit,) = cache.results([(TimeDelay.id, fit)], lambda key: _beside_clocks(key[1]))
        model = fit.model + new
    if isinstance(effect, ThermalDrift) and all(
        _is_of_run(r, n) for r, n in zip(fit.recordings, fit.noise, strict=True)
    ):
        fit, cache = _in_noise_beside(fit, effect), cache.in_other_noise()
    null_model = cache.null_model(fit)
    grid = effect.nuisance_grid(search_domain(null_model, numbers[0], effect))
    if not grid:
        return _not_excited(effect, "the recording has no position")
    return _best_of(projected_columns(null_model, model, effect, grid, cache), effect, grid_points(model, effect, grid))


def _is_of_run(recording: Recording, noise: RecordingNoise) -> bool:
    """Whether a noise is that of the residual of a run in motion."""
    return noise.source is NoiseSource.RESIDUAL and not recording.at_rest


def _beside_clocks(fit: Fit) -> Fit:
    """The fit beside an error of the clocks' offset, which was estimated: a small drag looks like one of two std."""
    delay = TimeDelay()
    return fit if delay.id in [e.id for e in fit.model.effects] else fit.refitted(fit.model + delay, fit.values)


def _in_noise_beside(fit: Fit, effect: Effect) -> Fit:
    """The fit of single runs in the noise that is estimated beside an effect, by ordinary least squares.

    An autoregression of the residual takes a drift for slow noise, in which it does not show: in white noise that of a
    warm-up by 3 K counts a hundredth of what it is. The fit itself where what the effect leaves is slower than noise:
    a zero that wanders takes the shape of any temperature in part.
    """
    beside, units = with_ordinary_estimate(fit.refitted(fit.model + effect, fit.values)), fit.model.space.channel_units
    left = zip(fit.recordings, beside.residuals, strict=True)
    if any(SlowResidual.of_residual(r.name, residual, units).significant for r, residual in left):
        return fit
    return fit.in_noise(reestimated_noise(beside))


def _best_of(projected: ProjectedColumns, effect: Effect, grid: Sequence[GridPoint]) -> ScoreTest:
    """The score test at the best point of an effect's grid."""
    if not projected.gram.any():
        return _not_excited(effect, "not excited by this motion")
    place = projected.best
    test, point = projected.test(place), grid[place]
    if not test.together.rank:
        return _not_excited(effect, "collinear with other parameters of the model in this motion")
    searched = 1.0
    if len(grid) > 1:
        searched = effective_number_of_tests(projected.noise_scores(), test.together.rank)
    fit = projected.null_model.fit
    if effect.has_role(Role.FREQUENCY, fit.model.space):  # at least as many as over all frequencies
        samples = max(r.samples for r in fit.recordings)
        searched = max(searched, effective_number_of_frequencies(test.together.value, samples))
    hard = _hard_place(projected.std)
    at_hard = test if hard == place else projected.test(hard)
    return ScoreTest(
        effect=effect,
        statistic=test.together.value,
        p_value=min(1.0, searched * test.p_value()),
        start=point.start(test.amounts),
        amounts=_amounts(point, test),
        limits=partial(_detectable, at_hard, grid, hard, projected.std),
        point=point,
        searched=searched,
        test=test,
    )


def _amounts(point: GridPoint, test: PointTest) -> dict[str, tuple[float, float]]:
    """Estimate and std of each amplitude, as `ScoreTest.amounts`."""
    amounts = {}
    for p, amount, std in zip(point.amplitudes, test.amounts, test.std, strict=True):
        unit = point.unit_of(p)
        if isfinite(p.nominal):
            amounts[p.name] = (float(amount * unit), float(std * abs(unit)) if isfinite(std) else inf)
        else:
            amounts[p.name] = (unit, float(abs(unit) * std))
    return amounts


def _hard_place(std: NDArray[np.float64]) -> int:
    """Index of the grid point at which more is needed than at `SHARE_OF_PLACES` of those where an effect shows.

    `std` (g, a) are those of the amounts, infinite where an amplitude is not identifiable.
    """
    shows = np.isfinite(std) & (std > 0)
    count = shows.sum(axis=1)
    places = np.flatnonzero(count == count.max())
    needed = np.log(np.where(shows, std, 1.0))[places].sum(axis=1)
    return int(places[np.argsort(needed, kind="stable")[ceil(SHARE_OF_PLACES * len(places)) - 1]])


def _detectable(
    test: PointTest, grid: Sequence[GridPoint], place: int, std: NDArray[np.float64], level: float
) -> tuple[Mapping[str, float], NuisanceValues]:
    """Change of each amplitude from nominal that a test in the noise at one place of a grid detects with 80 % power.

    Where the grid itself is one of sizes of the amplitude, at the point of the size that it detects. Where the nominal
    value is infinite, the effect decreases with the value: it is the value itself, within the grid's range. `std`
    (g, a) are those of the amounts at each point. Returns the nuisance values there, too.
    """
    needed = np.sqrt(test.power * test.detectable_noncentrality(level)) * std
    amounts = np.maximum(np.where(needed > 0, needed, np.inf), 1e-300)
    detectable = {}
    for i, p in enumerate(grid[place].amplitudes):
        sizes = np.array([point.unit_of(p) for point in grid])
        if np.ptp(sizes):
            place = int(np.argmin(np.abs(np.log(amounts[:, i]))))
        if isfinite(p.nominal):
            detectable[p.name] = float(needed[place, i] * abs(sizes[place]))
        else:
            detectable[p.name] = float(np.clip(sizes[place] / amounts[place, i], sizes.min(), sizes.max()))
    return detectable, grid[place].nuisances


TAKEN_IN_BY_CLOCKS = (TimeDelay.id, SensorLag.id)
"""Effects that make the wrench late, as its clock may: an offset that was estimated from both has them in it."""
STATED_OFFSET = "stated offset of the clocks (an estimated one takes a delay in: import with --clock-offset)"


def _quantities(names: Sequence[str]) -> str:
    """What signals are: joint angles for q1, q2 and their derivatives."""
    quantities = ("joint angles" if re.fullmatch(r"d*q\d+", name) else name for name in names)
    return ", ".join(dict.fromkeys(quantities))


def _missing_inputs(alone: WrenchModel, effect: Effect, recording: Recording, noise: RecordingNoise) -> tuple[str, ...]:
    """What a recording lacks for an effect: signals, or repeats where without them it is aliased."""
    missing = missing_inputs(alone, recording)
    if recording.clock_offset is not None and effect.id in TAKEN_IN_BY_CLOCKS:
        return (*missing, STATED_OFFSET)
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


def _scores_of_motion(tests: Sequence[ScoreTest], fit: Fit, cache: ScreeningCache) -> dict[str, float]:
    """Score that the noise of the motion alone gives each significant effect, by its id.

    The limit that holds for every effect is tried first, as it costs nothing.
    """
    significant = [s for s in tests if s.p_value < LEVELS.effect]
    motion = cache.drawn_motion(fit, lambda: DrawnMotion.of(fit, cache)) if significant else None
    if motion is None:
        return {}
    scores = {s.effect.id: motion.largest_power for s in significant}
    unclear = [s.effect for s in significant if s.p_value_beyond(motion.largest_power) >= CLEARLY_SIGNIFICANT]
    wanted = [(drawn, effect) for effect in unclear for drawn in motion.fits]
    again = dict(zip(wanted, run_searches(wanted, motion.cache), strict=True))
    for effect in unclear:
        scores[effect.id] = max(again[drawn, effect].statistic for drawn in motion.fits)
    return scores


# Initial values of a nonlinear fit, by screening each effect in turn.


def model_initial_values(case: Case) -> NuisanceValues:
    """Initial values by name for fitting a case; {} where the nominal values suffice.

    The effects are added to the rigid tool one after the other, in the model's order; each starts at the best point of
    its score test given those before it, and everything before it where it was fitted: far from there, effects that
    are not linear have other minima. An effect that the recordings do not excite is skipped.
    """
    model = case.model
    searched = [e for e in model.effects if _needs_search(e, model)]
    if not searched:
        return {}
    values: NuisanceValues = {}
    fitted = unchecked_fit(replace(case, model=model.base))
    for effect in model.effects:
        cache = ScreeningCache()
        (screening,) = screen(fitted, [effect], cache=cache)
        if not screening.excited:
            continue
        if effect in searched:
            values |= refit_initial_values(fitted, screening, cache)
        fitted = _refit_with(fitted, effect, values) if effect not in model.effects[-1:] else fitted
    return {**fitted.values, **values}


def _needs_search(effect: Effect, model: WrenchModel) -> bool:
    return any(p.nuisance or not isfinite(p.nominal) for p in effect.parameters(model.space))


def _refit_with(fitted: Fit, effect: Effect, start: NuisanceValues) -> Fit:
    return fitted.refitted(fitted.model + effect, {**fitted.values, **start})
