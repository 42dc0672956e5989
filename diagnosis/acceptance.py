"""Acceptance of effects: held-out error, coefficient consistency, physical bounds, confounding with tool parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf, isfinite

import numpy as np
from numpy.typing import NDArray

from diagnosis.comparison.comparison import noise_from_residual
from diagnosis.comparison.slow_residual import Part, SlowResidual, remaining_power, removed_power
from diagnosis.comparison.validation import half_splits
from diagnosis.held_out import HeldOut, with_disturbances
from diagnosis.subset_search import CandidateModel, refit_effects
from diagnosis.verdict_rule import VerdictRule, judge
from estimation.fit import Fit, solved
from estimation.least_squares.problem import Problem
from estimation.least_squares.square_root_information import orthonormal_basis
from estimation.model_response import model_response
from estimation.multiplicity import chi2_isf, chi2_sf
from estimation.noise.recording_noise import RecordingNoise
from modeling.chain.effect import Effect
from modeling.effects.disturbances import ThermalDrift
from modeling.errors import InputError
from modeling.noise import NoiseSource
from modeling.rigid_body import inertial_parameters
from modeling.significance import LEVELS

# Consistency of an effect's coefficients between data sets: training and held-out data, or halves of training data.


Array = NDArray[np.float64]

MAX_COEFFICIENT_CHANGE = 0.1
"""Largest relative change of an effect's prediction between two data sets that counts as consistent: at most its
square, 1 % of the effect's power, is then unexplained."""
ESTIMABLE = 1e-10
"""Variance of a direction of scaled coefficients, over the largest: below it is rounding, and nothing to divide by."""


def inconsistent_effect(candidate: CandidateModel, held_out: Sequence[HeldOut]) -> tuple[str, str] | None:
    """The lasting effect whose coefficients change most between data sets, if significantly and by more than 10 %, and
    the reason to reject it."""
    inconsistent, pairs = [], _fit_pairs(candidate, held_out)
    for effect in (e for e in candidate.added if not e.per_recording):
        for first, second, where in pairs:
            p_value, change = coefficient_change(effect, first, second)
            if p_value < LEVELS.effect and change > MAX_COEFFICIENT_CHANGE:
                inconsistent.append((change, effect.id, where))
    if not inconsistent:
        return None
    change, effect_id, where = max(inconsistent, key=lambda i: i[0])
    share = f"{change:.0%}" if change < 10 else "more than ten times"
    return effect_id, f"its coefficients are inconsistent: its prediction changes by {share} {where}"


def _fit_pairs(candidate: CandidateModel, held_out: Sequence[HeldOut]) -> list[tuple[Fit, Fit, str]]:
    """Pairs of fits of the same effects to different data: training and held-out, or halves of the training data."""
    trained = candidate.fit
    model = trained.model.without_recording_specific
    pairs = []
    for other in held_out:
        start = {**trained.values, **other.start}
        alone = solved(Problem.of(model + other.disturbances, [other.recording], [other.noise]), start)
        pairs.append((trained, alone, f"on {other.recording.name}"))
    if not pairs or noise_from_residual(trained):
        first, second = (trained.in_noise(noise) for noise in half_splits(trained))
        pairs.append((first, second, "between two halves of the data"))
    return pairs


def coefficient_change(effect: Effect, first: Fit, second: Fit) -> tuple[float, float]:
    """P-value of a Wald test for equal coefficients of an effect in two fits, and their relative change.

    The test is in the identifiable directions. The relative change is that of the effect's whitened prediction on the
    second recording, with the base model's column space projected out.
    """
    names = [p.name for p in effect.qualified(first.model.space)]
    differences = np.array([first.values[n] - second.values[n] for n in names])
    covariance = _covariance(first, names) + _covariance(second, names)
    return _wald_p_value(differences, covariance), _relative_change(effect, first, second)


def amount_p_value(effect: Effect, fitted: Fit) -> float:
    """P-value of a Wald test for no amount of an effect: its free identifiable amplitudes, together, at nominal.

    Of one whose nominal value is infinite the amount is the inverse, which is as many of its std from zero.
    """
    tested = [p for p in effect.qualified(fitted.model.space) if not (p.nuisance or p.fixed)]
    tested = [p for p in tested if isfinite(fitted.parameters[p.name].std)]
    amounts = [fitted.values[p.name] - (p.nominal if isfinite(p.nominal) else 0.0) for p in tested]
    return _wald_p_value(np.array(amounts), _covariance(fitted, [p.name for p in tested])) if tested else 1.0


def _wald_p_value(differences: Array, covariance: Array) -> float:
    """P-value of differences (k,) from zero, of a covariance (k, k), in the directions that it estimates."""
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    estimable = values > ESTIMABLE * values.max()
    along = vectors[:, estimable].T @ (differences / scale) / np.sqrt(values[estimable])
    return float(chi2_sf(float(along @ along), int(estimable.sum())))


def _covariance(fitted: Fit, names: Sequence[str]) -> Array:
    place = [list(fitted.parameters).index(n) for n in names]
    return np.asarray(fitted.covariance[np.ix_(place, place)])


def _relative_change(effect: Effect, first: Fit, second: Fit) -> float:
    number = next((i for i, m in enumerate(second.layout.models) if effect.id in [e.id for e in m.effects]), 0)
    model, recording, noise = second.layout.models[number], second.recordings[number], second.noise[number]
    of_effect = effect.qualified(model.space)
    nominal = {p.name: p.nominal for p in of_effect if not p.nuisance}
    changed = [{}, {p.name: first.values[p.name] for p in of_effect}, nominal]
    unchanged, swapped, absent = (second.layout.values_of(number, {**second.values, **new}) for new in changed)
    without, derivative = noise.whitener.response(model_response(model, recording, absent))
    responses = [model_response(model, recording, theta, derivative=False) for theta in (unchanged, swapped)]
    basis = orthonormal_basis(derivative[:, : model.base_size])
    rows = [*(noise.whitener.response(response)[0] for response in responses), without]
    with_it, with_other, without = (whole - basis @ (basis.T @ whole) for whole in rows)
    size_of_effect = float(np.linalg.norm(with_it - without))
    return float(np.linalg.norm(with_it - with_other)) / max(size_of_effect, 1e-300)


# Effects whose only evidence lies in channels where most of the readings is not the tool's.


def effect_of_foreign_residual(candidate: CandidateModel) -> tuple[str, str] | None:
    """The effect that most lowers the residual in foreign channels and not elsewhere, and the reason to reject it.

    A channel of a single run is foreign where the residual is most of its readings and far above the sensor's noise
    (`Part.FOREIGN`): a hand, another load. The noise model takes that residual for stationary noise, which it is not,
    and so a small correlation with it looks significant. An effect is rejected when it explains no more in all other
    channels together than in the foreign ones, each relative to what remains, or than noise lets expect. A channel of
    which it removes more than remains counts as one of the others.
    """
    numbers = range(len(candidate.fit.recordings))
    foreign = {n: channels for n in numbers if (channels := _foreign_channels(candidate, n))}
    if not foreign:
        return None
    excess = {e.id: _foreign_excess(candidate, e, foreign) for e in candidate.added}
    worst = max(excess, key=lambda effect_id: excess[effect_id])
    if excess[worst] <= 0:
        return None
    number, channels = next(iter(foreign.items()))
    where = f"{', '.join(channels)} of {candidate.fit.recordings[number].name}"
    return worst, f"what it explains is mostly on {where}, where a residual larger than the tool's own wrench remains"


def _foreign_channels(candidate: CandidateModel, number: int) -> tuple[str, ...]:
    slow = SlowResidual.of(candidate.comparisons[number])
    return () if slow is None else tuple(c for c in slow.above_noise if slow.part[c] is Part.FOREIGN)


def _foreign_excess(candidate: CandidateModel, effect: Effect, foreign: dict[int, tuple[str, ...]]) -> float:
    """Log-likelihood ratio of an effect that is foreign or expected of noise, minus that in the other channels.

    In white noise with the variance of each channel's residual.
    """
    smaller = candidate.without(effect.id)
    in_foreign = elsewhere = 0.0
    for number, after in enumerate(candidate.comparisons):
        residuals = (smaller.fit.residuals[number], after.residual)
        before, remains = (np.maximum(r.var(axis=0), 1e-300) for r in residuals)
        explained = np.log(before / remains) * len(after.residual) / 2
        here = np.isin(list(after.space.channel_units), foreign.get(number, ())) & (before <= 2 * remains)
        in_foreign += float(explained[here].sum())
        elsewhere += float(explained[~here].sum())
    coefficients = len(effect.qualified(candidate.fit.model.space))
    return max(in_foreign, float(chi2_isf(LEVELS.effect, coefficients)) / 2) - elsewhere


# Acceptance rules: which effect of a set is rejected on held-out data, and when the set is accepted.


WITHIN_STD = round(chi2_isf(LEVELS.amount, 1) ** 0.5)
"""Std of nothing that `LEVELS.amount` is, of one amplitude."""
UNTOLD_SENTENCE = "kept though it does not lower the error on held-out {}: the motion there does not show it"
"""Of an accepted effect."""
SMALL_SENTENCE = (
    f"kept though its amount is within {WITHIN_STD} standard deviations of none, as these hold what is slower than the"
    " motion, in whose band it is significant"
)
"""Of an accepted effect of a single run."""
LEAST_SHARE = 0.01
"""That an effect removes of what is beyond noise. In a single run its significance is by the residual's spectrum, which
holds for noise: physics that no effect explains and that comes and goes makes some effect significant in every run. In
known noise what another effect's law leaves that is not quite its own, a few per cent of it, looks like others."""
TIMES_WHAT_REMAINS = 10.0
"""That an effect of less than `LEAST_SHARE` removes in known noise, of what then remains significantly. The best of
thirty takes half of what a friction leaves whose step is an arctangent or has a peak; a true one leaves what is small
beside it."""
DETERMINED = 0.1
"""Std of a parameter over its value below which a model determines it; one above 1 says nothing of it."""
CONFIRMED = 0.5
"""Share of the fall of chi-square on fitted halves that has to remain on the others: a true effect keeps nearly all of
it, one that fits noise raises the error by as much as it had lowered it, and a half is about midway."""


@dataclass(frozen=True)
class HeldOutChange:
    """What an effect changes on a held-out recording.

    fall  of chi-square on its excited lines
    told  whether its motion tells: whether what is predicted there with and without the effect is not confusable
    """

    effect_id: str
    held_out: str
    fall: float
    told: bool


@dataclass(frozen=True, eq=False)
class AcceptanceEvidence:
    """Evidence on a set of effects, computed when a rule asks for it.

    candidate  the set, fitted to the training recordings
    base       the rigid tool with the effects given, fitted to them
    held_out   recordings with their disturbances given the candidate
    """

    candidate: CandidateModel
    base: CandidateModel
    held_out: Sequence[HeldOut] = ()

    @cached_property
    def unidentifiable(self) -> str | None:
        """An effect without an identifiable amplitude: whatever its significance, nothing is known of it."""
        fit = self.candidate.fit
        return next((effect.id for effect in self.candidate.added if not fit.identifies(effect)), None)

    @cached_property
    def within_noise(self) -> str | None:
        """The effect whose amount is told least from none; None where all are beyond `LEVELS.amount`.

        As reported; of a run in the noise that its effects are tested in, as an ordinary estimate bears a drift, too.
        """
        of_run = noise_from_residual(self.candidate.fit)
        fit = self.candidate.fit if of_run else self.candidate.reported_fit
        p_values = {e.id: amount_p_value(e, fit) for e in self.candidate.added}
        least = max(p_values, key=lambda effect_id: p_values[effect_id])
        return least if p_values[least] >= LEVELS.amount else None

    @cached_property
    def at_bound(self) -> tuple[str, str] | None:
        """An effect with an estimate on a physical bound other than the nominal value, and the reason to reject it."""
        fitted = self.candidate.fit
        for effect in self.candidate.added:
            for p in effect.qualified(fitted.model.space):
                estimated = p.nuisance or isfinite(fitted.parameters[p.name].std)
                if estimated and fitted.values[p.name] in p.bounds and fitted.values[p.name] != p.nominal:
                    name = p.name.split(".", 1)[1]
                    return effect.id, f"its {name} is estimated at the bound of its physical range"
        return None

    @cached_property
    def lasting(self) -> bool:
        """Whether any effect is not recording-specific: only such effects are tested on held-out data."""
        return any(not effect.per_recording for effect in self.candidate.added)

    @cached_property
    def collinear_parameter(self) -> str | None:
        """An inertial parameter of the tool that the base model determines and the candidate no longer does.

        Its std is below `DETERMINED` of its value in the base model, and above its value in the candidate. Where all
        recordings are poses at rest it may be unknown beside the effect altogether: no pose parts the gains of the
        torques from the first moments, and a fit leaves both where they are.
        """
        posed = all(r.at_rest for r in self.candidate.fit.recordings)
        for p in inertial_parameters(self.candidate.fit.model.space):
            before, after = (c.fit.parameters[p.name] for c in (self.base, self.candidate))
            lost = before.std < DETERMINED * abs(before.value) and after.std > abs(before.value)
            if lost and not (posed and after.std == inf):
                return p.name
        return None

    @cached_property
    def not_improved(self) -> tuple[str, str] | None:
        """The effect without which the error on a held-out recording is smallest, and that recording.

        None where all of them lower it, each and together, or the motion there does not tell: of all together the least
        significant is to go.
        """
        worse = [(c.fall, c.effect_id, c.held_out) for c in self._held_out_changes if c.fall <= 0 and c.told]
        if not worse and len(self.candidate.ids) > 1:
            together = (self._held_out_change(other, self.least_significant, self.base) for other in self.held_out)
            worse = [(c.fall, c.effect_id, c.held_out) for c in together if c.fall <= 0 and c.told]
        return min(worse)[1:] if worse else None

    @property
    def reservations(self) -> dict[str, str]:
        """Why effects are kept that lower the error on no held-out recording, or are reported with a large std."""
        helped = {c.effect_id for c in self._held_out_changes if c.fall > 0}
        untold = {
            c.effect_id: UNTOLD_SENTENCE.format(c.held_out) for c in self._held_out_changes if c.effect_id not in helped
        }
        reported = self.candidate.reported_fit
        small = [e.id for e in self.candidate.added if amount_p_value(e, reported) >= LEVELS.amount]
        return dict.fromkeys(small, SMALL_SENTENCE) | untold

    @cached_property
    def _held_out_changes(self) -> list[HeldOutChange]:
        """Of each effect on each held-out recording.

        What acts in one recording alone changes the tool's parameters, which a recording does not judge that differs
        from the model anyway.
        """
        changes = []
        for other in self.held_out:
            fits = other.comparison(self.candidate.fit).lack_of_fit >= LEVELS.held_out
            judged = [e.id for e in self.candidate.added if fits or not e.per_recording]
            changes += [self._held_out_change(other, i, self.candidate.without(i)) for i in judged]
        return changes

    def _held_out_change(self, other: HeldOut, effect_id: str, smaller: CandidateModel) -> HeldOutChange:
        """From a smaller set, which lacks the effect, to the candidate."""
        without, with_it = (_excited_rows(other.validation_fit(c.fit)) for c in (smaller, self.candidate))
        separation = float((without - with_it) @ (without - with_it))
        fall = float(without @ without - with_it @ with_it)
        return HeldOutChange(effect_id, other.recording.name, fall, separation >= LEVELS.confusable)

    @cached_property
    def adequate(self) -> bool:
        """Whether lack of fit is significant neither in training nor in held-out data, in noise known independently."""
        fit = self.candidate.fit
        tested = self.held_out if self.lasting else ()
        return (
            not noise_from_residual(fit)
            and self.candidate.adequate
            and all(h.comparison(fit).lack_of_fit >= LEVELS.held_out for h in tested)
        )

    @cached_property
    def holds_across_halves(self) -> bool:
        """Twofold cross-validation: whether effects estimated on one half of the training data explain the other.

        Their chi-square drop on the test halves has to exceed `CONFIRMED` of that on the fitted halves. A thermal drift
        is not judged so: the temperature that drives it is recorded, and may have settled in one half.
        """
        thermal = [e for e in self.candidate.added if isinstance(e, ThermalDrift)]
        if len(thermal) == len(self.candidate.ids):
            return True
        base = refit_effects(self.candidate, thermal) if thermal else self.base
        halves = half_splits(self.candidate.fit)
        ways: list[tuple[Fit, Sequence[RecordingNoise], Sequence[RecordingNoise]]]
        ways = [(c.fit, a, b) for c in (base, self.candidate) for a, b in (halves, halves[::-1])]

        def costs(way: tuple[Fit, Sequence[RecordingNoise], Sequence[RecordingNoise]]) -> tuple[float, float]:
            whole, trained_on, tested_on = way
            half = whole.in_noise(trained_on)
            return _cost(half, trained_on), _cost(half, tested_on)

        both_ways = np.array([costs(way) for way in ways]).reshape(2, 2, 2).sum(axis=1)
        fitted_drop, tested_drop = both_ways[0] - both_ways[1]
        return bool(tested_drop > CONFIRMED * fitted_drop)

    @cached_property
    def inconsistent(self) -> tuple[str, str] | None:
        """The effect with the most inconsistent coefficients, and the reason to reject it."""
        return inconsistent_effect(self.candidate, self.held_out)

    @cached_property
    def foreign(self) -> tuple[str, str] | None:
        """The effect that explains only a part of a residual that is not the tool's, and the reason to reject it."""
        return effect_of_foreign_residual(self.candidate) if noise_from_residual(self.candidate.fit) else None

    @cached_property
    def hardly_removes(self) -> str | None:
        """The effect that removes least, if less than `LEAST_SHARE` of all, and little beside what remains.

        Of single runs alone less than remains. In known noise, where a misfit that remains is significant, it is of the
        lasting effects the one below `TIMES_WHAT_REMAINS`.
        """
        if all(noise.source is NoiseSource.RESIDUAL for noise in self.candidate.fit.noise):
            whole = self.candidate.reported
            remains, everything = remaining_power(whole), removed_power(self.base.reported, whole)
            smaller = self.candidate.without_each() if remains else {}
            removed = {i: removed_power(without.reported, whole) for i, without in smaller.items()}
            least = min(remains, LEAST_SHARE * (everything + remains))
        elif noise_from_residual(self.candidate.fit) or self.candidate.adequate:
            return None
        else:
            cost, remains = self.candidate.cost, self.candidate.excess
            lasting = {e.id for e in self.candidate.added if not e.per_recording}
            smaller = self.candidate.without_each() if lasting else {}
            removed = {i: without.cost - cost for i, without in smaller.items() if i in lasting}
            least = min(TIMES_WHAT_REMAINS * remains, LEAST_SHARE * (self.base.cost - cost + remains))
        smallest = min(removed, key=lambda effect_id: removed[effect_id], default=None)
        return smallest if smallest is not None and removed[smallest] < least else None

    @cached_property
    def least_significant(self) -> str:
        """The effect whose removal raises the training chi-square least; among lasting effects if there are any."""
        added = self.candidate.added
        ids = [e.id for e in ([e for e in added if not e.per_recording] or added)]
        if len(ids) == 1:
            return ids[0]
        costs = {i: smaller.cost for i, smaller in self.candidate.without_each().items() if i in ids}
        return min(costs, key=lambda effect_id: costs[effect_id])


def _cost(fitted: Fit, noise: Sequence[RecordingNoise]) -> float:
    """Whitened chi-square of a fit in the rows of a noise."""
    return fitted.problem.in_noise(noise).chi_square(fitted.theta)


def _excited_rows(fitted: Fit) -> Array:
    """Whitened residual of the first recording's excited lines."""
    return fitted.whitened_residual()[: fitted.noise[0].whitener.periodic_rows]


RejectedEffect = Callable[[AcceptanceEvidence], str | None]
"""The id of the effect to reject; None accepts the set."""


def _accepted(_evidence: AcceptanceEvidence) -> str | None:
    return None


def _least_significant(evidence: AcceptanceEvidence) -> str | None:
    return evidence.least_significant


AcceptanceRule = VerdictRule[AcceptanceEvidence, RejectedEffect]
ACCEPTANCE_RULES: tuple[AcceptanceRule, ...] = (
    VerdictRule("no effect", lambda e: not e.candidate.ids, _accepted),
    VerdictRule(
        "no identifiable parameter",
        lambda e: e.unidentifiable is not None,
        lambda e: e.unidentifiable,
        "none of its parameters is identifiable in these data",
    ),
    VerdictRule(
        "a parameter on a physical bound",
        lambda e: e.at_bound is not None,
        lambda e: e.at_bound and e.at_bound[0],
        "{e.at_bound[1]}",
    ),
    VerdictRule(
        "an amount within the noise",
        lambda e: e.within_noise is not None,
        lambda e: e.within_noise,
        f"its amount is within {WITHIN_STD} standard deviations of none",
    ),
    VerdictRule(
        "collinear with a tool parameter",
        lambda e: e.collinear_parameter is not None and e.lasting,
        _least_significant,
        "it is collinear with the tool's {e.collinear_parameter} in these data",
    ),
    VerdictRule(
        "a residual that is not the tool's",
        lambda e: e.foreign is not None,
        lambda e: e.foreign and e.foreign[0],
        "{e.foreign[1]}",
    ),
    VerdictRule(
        "hardly anything beside what remains",
        lambda e: e.hardly_removes is not None,
        lambda e: e.hardly_removes,
        f"it removes less than {LEAST_SHARE:.0%} of what is beyond noise, too little beside what remains unexplained",
    ),
    VerdictRule(
        "no smaller error on held-out data",
        lambda e: e.not_improved is not None,
        lambda e: e.not_improved and e.not_improved[0],
        "it does not lower the error on held-out {e.not_improved[1]}",
    ),
    VerdictRule("no lack of fit", lambda e: e.adequate, _accepted),
    VerdictRule(
        "not confirmed by the other half of the training data",
        lambda e: not e.held_out and not e.holds_across_halves,
        _least_significant,
        "it does not explain the other half of the data",
    ),
    VerdictRule(
        "inconsistent",
        lambda e: e.inconsistent is not None,
        lambda e: e.inconsistent and e.inconsistent[0],
        "{e.inconsistent[1]}",
    ),
    VerdictRule("consistent coefficients", lambda e: True, _accepted),
)
"""In order: a set with lack of fit is accepted when its coefficients are consistent between data sets."""


@dataclass(frozen=True, eq=False)
class Acceptance:
    """The accepted candidate and the held-out recordings with their disturbances.

    reasons  why other effects were rejected, or with what reservation accepted ones are kept
    """

    candidate: CandidateModel
    reasons: dict[str, str]
    held_out: tuple[HeldOut, ...]


def accept(
    candidate: CandidateModel, base: CandidateModel, held_out: Sequence[HeldOut], effects: Sequence[Effect]
) -> Acceptance:
    """Reject effects of a candidate, one by one, until `ACCEPTANCE_RULES` accept the remaining set.

    Recording-specific disturbances (drift, contact, those among `effects`) of held-out recordings are re-estimated for
    each model, also for the base.
    """
    reasons: dict[str, str] = {}
    while True:
        evidence = AcceptanceEvidence(candidate, base)
        try:
            disturbed = tuple(with_disturbances(h, candidate.fit, effects, candidate.cache) for h in held_out)
            evidence = replace(evidence, held_out=disturbed)
            rejected, reason = judge(ACCEPTANCE_RULES, evidence)
            effect_id = rejected(evidence)
        except InputError:
            # the tip's spring is too soft for the held-out motion
            effect_id = AcceptanceEvidence(candidate, base).least_significant
            reason = "its prediction for the held-out motion has no solution"
        if effect_id is None:
            return Acceptance(candidate, reasons | evidence.reservations, tuple(evidence.held_out))
        reasons[effect_id] = reason
        candidate = candidate.without(effect_id)
