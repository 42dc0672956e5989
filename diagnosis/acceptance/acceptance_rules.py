"""Acceptance rules: which effect of a set is rejected on held-out data, and when the set is accepted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import isfinite

import numpy as np

from diagnosis.acceptance.coefficient_consistency import inconsistent_effect
from diagnosis.acceptance.foreign_residual import effect_of_foreign_residual
from diagnosis.acceptance.held_out import HeldOut
from diagnosis.comparison.comparison import noise_from_residual
from diagnosis.comparison.data_split import half_splits
from diagnosis.comparison.removed_share import remaining_power, removed_power
from diagnosis.selection.subset_search import CandidateModel
from diagnosis.verdict_rule import VerdictRule
from estimation.fit import Fit, refit
from estimation.noise.recording_noise import NoiseSource, RecordingNoise
from modeling.significance import LEVELS
from modeling.tool.rigid_body import inertial_parameters

LEAST_SHARE = 0.01
"""That an effect removes of a single run's residual beyond noise. Its significance is by the residual's spectrum, which
holds for noise: physics that no effect explains and that comes and goes makes some effect significant in every run."""


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

        Its std is below a tenth of its value in the base model, and above its value in the candidate.
        """
        for p in inertial_parameters(self.candidate.fit.model.space):
            before, after = (c.fit.parameters[p.name] for c in (self.base, self.candidate))
            if before.std < abs(before.value) / 10 and after.std > abs(before.value):
                return p.name
        return None

    @cached_property
    def not_improved(self) -> str | None:
        """The first held-out recording whose excited chi-square does not fall."""
        for other in self.held_out if self.lasting else ():
            if _excited_cost(other.validation_fit(self.candidate.fit)) >= _excited_cost(
                other.validation_fit(self.base.fit)
            ):
                return other.recording.name
        return None

    @cached_property
    def adequate(self) -> bool:
        """Whether lack of fit is significant neither in training nor in held-out data, in noise known independently."""
        fit = self.candidate.fit
        tested = self.held_out if self.lasting else ()
        return (
            not noise_from_residual(fit)
            and self.candidate.adequate
            and all(h.prediction(fit).comparison.lack_of_fit >= LEVELS.held_out for h in tested)
        )

    @cached_property
    def holds_across_halves(self) -> bool:
        """Twofold cross-validation: whether effects estimated on one half of the training data explain the other.

        Their chi-square drop on the test halves has to exceed half of that on the fitted halves: a true effect keeps
        nearly all of it, one that fits noise raises the error by as much as it had lowered it.
        """
        halves = half_splits(self.candidate.fit)
        ways: list[tuple[Fit, Sequence[RecordingNoise], Sequence[RecordingNoise]]]
        ways = [(c.fit, a, b) for c in (self.base, self.candidate) for a, b in (halves, halves[::-1])]

        def costs(way: tuple[Fit, Sequence[RecordingNoise], Sequence[RecordingNoise]]) -> tuple[float, float]:
            whole, trained_on, tested_on = way
            half = refit(whole.model, whole.recordings, noise=trained_on, start=whole.values)
            return _cost(half, trained_on), _cost(half, tested_on)

        both_ways = np.array([costs(way) for way in ways]).reshape(2, 2, 2).sum(axis=1)
        fitted_drop, tested_drop = both_ways[0] - both_ways[1]
        return bool(tested_drop > fitted_drop / 2)

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
        """Of single runs alone the effect that removes least, if less than what remains and `LEAST_SHARE` of all."""
        if any(noise.source is not NoiseSource.RESIDUAL for noise in self.candidate.fit.noise):
            return None
        whole = self.candidate.reported
        remains = remaining_power(whole)
        if not remains:
            return None
        smaller = self.candidate.without_each()
        removed = {i: removed_power(without.reported, whole) for i, without in smaller.items()}
        least = min(removed, key=lambda effect_id: removed[effect_id])
        limit = min(remains, LEAST_SHARE * (removed_power(self.base.reported, whole) + remains))
        return least if removed[least] < limit else None

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
    return replace(fitted.problem, noise=tuple(noise)).chi_square(fitted.theta)


def _excited_cost(fitted: Fit) -> float:
    """Whitened chi-square of the first recording's excited lines."""
    rows = fitted.whitened_residual()[: fitted.noise[0].whitener.periodic_rows]
    return float(rows @ rows)


RejectedEffect = Callable[[AcceptanceEvidence], str | None]
"""The id of the effect to reject; None accepts the set."""


def _accepted(_evidence: AcceptanceEvidence) -> str | None:
    return None


def _least_significant(evidence: AcceptanceEvidence) -> str | None:
    return evidence.least_significant


def _at_bound(evidence: AcceptanceEvidence) -> str | None:
    return evidence.at_bound and evidence.at_bound[0]


def _inconsistent(evidence: AcceptanceEvidence) -> str | None:
    return evidence.inconsistent and evidence.inconsistent[0]


def _foreign(evidence: AcceptanceEvidence) -> str | None:
    return evidence.foreign and evidence.foreign[0]


AcceptanceRule = VerdictRule[AcceptanceEvidence, RejectedEffect]
ACCEPTANCE_RULES: tuple[AcceptanceRule, ...] = (
    VerdictRule("no effect", lambda e: not e.candidate.ids, _accepted),
    VerdictRule(
        "no identifiable parameter",
        lambda e: e.unidentifiable is not None,
        lambda e: e.unidentifiable,
        "none of its parameters is identifiable in these data",
    ),
    VerdictRule("a parameter on a physical bound", lambda e: e.at_bound is not None, _at_bound, "{e.at_bound[1]}"),
    VerdictRule(
        "collinear with a tool parameter",
        lambda e: e.collinear_parameter is not None and e.lasting,
        _least_significant,
        "it is collinear with the tool's {e.collinear_parameter} in these data",
    ),
    VerdictRule("a residual that is not the tool's", lambda e: e.foreign is not None, _foreign, "{e.foreign[1]}"),
    VerdictRule(
        "hardly anything beside what remains",
        lambda e: e.hardly_removes is not None,
        lambda e: e.hardly_removes,
        f"it removes less than {LEAST_SHARE:.0%} of what a single run holds beyond noise, and more remains unexplained",
    ),
    VerdictRule(
        "no smaller error on held-out data",
        lambda e: e.not_improved is not None,
        _least_significant,
        "it does not lower the error on held-out {e.not_improved}",
    ),
    VerdictRule("no lack of fit", lambda e: e.adequate, _accepted),
    VerdictRule(
        "not confirmed by the other half of the training data",
        lambda e: not e.held_out and not e.holds_across_halves,
        _least_significant,
        "it does not explain the other half of the data",
    ),
    VerdictRule("inconsistent", lambda e: e.inconsistent is not None, _inconsistent, "{e.inconsistent[1]}"),
    VerdictRule("consistent coefficients", lambda e: True, _accepted),
)
"""In order: a set with lack of fit is accepted when its coefficients are consistent between data sets."""
