"""Held-out recording with its noise and its recording-specific disturbances."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from diagnosis.comparison.comparison import Comparison, comparison_of
from diagnosis.comparison.validation import ValidationFit, non_excited_noise, validation_fit
from diagnosis.screening.null_model import ScreeningCache
from diagnosis.screening.score_test import ScoreTest, refit_initial_values, screen, significant_effects
from diagnosis.subset_search import effect_with_offsets
from estimation.fit import Fit
from estimation.least_squares.estimates import Estimate
from estimation.model_response import predicted_readings
from estimation.multiplicity import chi_square_penalty
from estimation.noise.recording_noise import RecordingNoise
from estimation.recordings.recording import Recording
from modeling.chain.effect import Effect, NuisanceValues
from modeling.effects import catalogue
from modeling.space import Space


@dataclass(eq=False)
class HeldOut:
    """A recording that was not used for the fit, with its noise.

    disturbances  its recording-specific disturbances: drift, contact
    start         initial values of their parameters
    """

    recording: Recording
    noise: RecordingNoise
    disturbances: tuple[Effect, ...] = ()
    start: NuisanceValues = field(default_factory=dict)
    _fits: dict[Fit, ValidationFit] = field(default_factory=dict, init=False, repr=False)
    _comparisons: dict[Fit, Comparison] = field(default_factory=dict, init=False, repr=False)

    def validation_fit(self, fit: Fit) -> ValidationFit:
        """Validation fit to this recording: its biases and its disturbances estimated here."""
        if fit not in self._fits:
            self._fits[fit] = validation_fit(fit, self.recording, self.noise, self.disturbances, self.start)
        return self._fits[fit]

    def comparison(self, fit: Fit) -> Comparison:
        """This recording with its prediction by a fit."""
        if fit not in self._comparisons:
            self._comparisons[fit] = comparison_of(self.validation_fit(fit), 0)
        return self._comparisons[fit]

    @property
    def disturbances_identifiable(self) -> bool:
        """Whether disturbances are identifiable: it has non-excited lines, or a detected event."""
        return non_excited_noise(self.noise) is not None or bool(self.noise.events)

    def non_excited_fit(self, fit: Fit) -> Fit:
        """The validation fit restricted to the non-excited lines, where there are any."""
        carried = self.validation_fit(fit)
        return replace(carried, problem=carried.problem.in_noise([non_excited_noise(self.noise) or self.noise]))

    def reestimated(self, fit: Fit) -> HeldOut:
        """The recording with its disturbances and its noise without them re-estimated, given a fit."""
        from estimation.transients import noise_beside_events  # of effects alone

        carried = self.validation_fit(fit)
        start = {p.name: carried.values[p.name] for e in self.disturbances for p in e.qualified(fit.model.space)}
        return replace(self, noise=noise_beside_events(carried, 0), start=start)


# Recording-specific disturbances (drift, contact, payload, interference) of a held-out recording.


@dataclass(frozen=True, eq=False)
class RecordingDisturbance:
    """A recording-specific disturbance of one held-out recording.

    parameters  by the effect's short parameter names
    swing       peak-to-peak contribution to each channel, in its unit
    """

    recording: Recording
    effect: Effect
    parameters: Mapping[str, Estimate]
    swing: Mapping[str, float]

    def __str__(self) -> str:
        kind = self.effect.disturbance or f"effect ({self.effect.title})"
        space = Space(self.recording.dimension)
        sizes = [f"{c} by {s:.2g} {u}" for (c, s), u in zip(self.swing.items(), space.units, strict=True)]
        nuisances = [p.name for p in self.effect.parameters(space) if p.nuisance]
        where = [f"{n} {self.parameters[n].value:.4g} {self.parameters[n].unit}" for n in nuisances]
        listed = ", ".join([*where, *sizes])
        return f"{self.recording.name} has a recording-specific {kind}: {listed} peak to peak"


def with_disturbances(
    held_out: HeldOut, fit: Fit, candidates: Sequence[Effect] = (), cache: ScreeningCache | None = None
) -> HeldOut:
    """The recording with its significant disturbances given a validation fit (score test, Holm, 1 %).

    Tested are the recording-specific effects of the catalogue and of the candidates, on the non-excited lines only, so
    that they cannot absorb systematic error of the fit. Without repeats there are no such lines: disturbances are then
    tested only where the noise has a detected event. After each one found the noise is re-estimated. Noise draws are
    those of the `cache`.
    """
    space = fit.model.space
    listed = [e for e in {e.id: e for e in (*catalogue(space), *candidates)}.values() if e.per_recording]
    disturbed = replace(held_out, disturbances=(), start={})
    cache = ScreeningCache() if cache is None else cache
    while disturbed.disturbances_identifiable and (
        extended := _with_best_effect(disturbed, fit, _others(listed, disturbed.disturbances), cache)
    ):
        disturbed = _relocated(extended, fit, cache)
    for effect in disturbed.disturbances[:-1]:
        without = replace(disturbed, disturbances=_others(disturbed.disturbances, [effect]))
        if not _significant(without.non_excited_fit(fit), [effect], cache.in_other_noise()):
            disturbed = without.reestimated(fit)
    return disturbed


def _others(effects: Sequence[Effect], left_out: Sequence[Effect]) -> tuple[Effect, ...]:
    """The effects without those left out."""
    return tuple(e for e in effects if e.id not in {other.id for other in left_out})


def _with_best_effect(held_out: HeldOut, fit: Fit, effects: Sequence[Effect], cache: ScreeningCache) -> HeldOut | None:
    """The recording with the significant effect that lowers the criterion most; None without a significant one."""
    extended = _with_each_significant(held_out, fit, effects, cache)
    return _best(extended, fit, len(effects)).reestimated(fit) if extended else None


def _relocated(held_out: HeldOut, fit: Fit, cache: ScreeningCache) -> HeldOut:
    """The recording with its last effect searched again in the re-estimated noise, of which it is no longer a part."""
    before = replace(held_out, disturbances=held_out.disturbances[:-1])
    again = _with_each_significant(before, fit, held_out.disturbances[-1:], cache)
    return _best([held_out, *again], fit, 1).reestimated(fit)


def _with_each_significant(
    held_out: HeldOut, fit: Fit, effects: Sequence[Effect], cache: ScreeningCache
) -> list[HeldOut]:
    """The recording with each significant effect that is identifiable in turn, from its score test's initial values."""
    non_excited, cache = held_out.non_excited_fit(fit), cache.in_other_noise()
    identifiable = []
    for screening in _significant(non_excited, effects, cache):
        start = {**held_out.start, **refit_initial_values(non_excited, screening, cache)}
        on_axis = replace(held_out, disturbances=(*held_out.disturbances, screening.effect), start=start)
        tested = effect_with_offsets(on_axis.non_excited_fit(fit), screening.effect, cache)
        extended = replace(on_axis, disturbances=(*held_out.disturbances, tested))
        if extended.validation_fit(fit).identifies(tested):
            identifiable.append(extended)
    return identifiable


def _best(choices: Sequence[HeldOut], fit: Fit, candidates: int) -> HeldOut:
    return min(choices, key=lambda h: _criterion(h.non_excited_fit(fit), candidates))


def _significant(non_excited: Fit, effects: Sequence[Effect], cache: ScreeningCache) -> list[ScoreTest]:
    return significant_effects(screen(non_excited, effects, cache=cache))


def _criterion(non_excited: Fit, candidates: int) -> float:
    return non_excited.problem.chi_square(non_excited.theta) + chi_square_penalty(non_excited.model, candidates)


def disturbances_of(held_out: HeldOut, fit: Fit) -> tuple[RecordingDisturbance, ...]:
    """The disturbances of a held-out recording, with estimates and sizes."""
    carried = held_out.validation_fit(fit)
    return tuple(_disturbance(carried, effect) for effect in held_out.disturbances)


def _disturbance(carried: Fit, effect: Effect) -> RecordingDisturbance:
    model, recording = carried.model, carried.recordings[0]
    parameters = effect.qualified(model.space)
    nominal = {p.name: p.nominal for p in parameters if not p.nuisance}
    absent = carried.layout.values_of(0, {**carried.values, **nominal})
    added = predicted_readings(model, recording, carried.theta) - predicted_readings(model, recording, absent)
    swing = {c: float(s) for c, s in zip(recording.channels, np.ptp(added, axis=0), strict=True)}
    estimates = {p.name.split(".", 1)[1]: carried.parameters[p.name] for p in parameters}
    return RecordingDisturbance(recording, effect, estimates, swing)
