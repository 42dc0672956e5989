"""Finding: verdict, p-value, size and detection limit of each effect."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from diagnosis.comparison.comparison import noise_from_residual
from diagnosis.screening.score_test import ScoreTest, adjusted_p_values, screen, significant_effects
from diagnosis.subset_search import MAX_REFITS, CandidateModel, SubsetSearch
from diagnosis.verdict.aliasing import Alias, aliases_of_added, contribution_upper_limit, within_tolerance
from diagnosis.verdict.selection_step import EffectRefits, FinalRefit, SelectionStep, effect_refits
from diagnosis.verdict_rule import EffectVerdict, VerdictRule, judge
from estimation.least_squares.estimates import Estimate, estimates_data, parameter_table
from estimation.multiplicity import chi2_sf
from modeling.chain.effect import Effect, NuisanceValues
from modeling.number_format import finite, p_value_text
from modeling.significance import LEVELS
from modeling.space import Space
from modeling.table import Table, Tabular

# Verdict rules on an effect.


ALIAS_SENTENCE = "indistinguishable from {e.alias[0]} ({e.alias[1].closeness})"
REPLACEMENT_SENTENCE = (
    "rejected, because in the place of {e.replacement[0]} it fits worse: the chi-square is higher by"
    " {e.replacement[1].excess_in_words}; beside it, it is collinear"
)
RANGE_SENTENCE = "{e.beyond_range} is not excited: detectable only beyond its physical range"
NOT_SIGNIFICANT_SENTENCE = "rejected, because it is not significant: what it would explain is within the noise"
LIMIT_SENTENCE = "the upper 95 % limit of its contribution is below tolerance"
NOT_AFTER_REFIT_SENTENCE = "rejected, because it is significant in the score test, but not after the exact refit"
REFIT_UNCONVERGED_SENTENCE = (
    "rejected, because it is significant in the score test, but its exact refit has not converged"
)
LEFT_OUT_SENTENCE = "rejected, because it was below tolerance beside the effects with which the search chose it"
EXPLAINS_NOTHING_SENTENCE = (
    "rejected, because no set that it was refitted in explains the residual{e.refits.place}{e.refits.early_end}"
)
PREFERRED_SENTENCE = (
    "rejected, because the search preferred {e.refits.chosen} to every set that it was refitted in{e.refits.place}"
)
UNSOLVED_SENTENCE = "rejected, because {e.refits.unsolved} has no solution at the initial values of its exact refit"
UNCONVERGED_SENTENCE = (
    "not tried, because the search does not go on from {e.refits.unconverged}, whose refit has not converged: exclude"
    " effects of that set by --without{e.refits.limited}"
)
PASSED_OVER_SENTENCE = (
    f"not tried, because the search refits at most {MAX_REFITS} effects beside each set, and others had larger scores:"
    " give it fewer candidates by --only"
)
ADEQUATE_SENTENCE = (
    "not tried, because the search had ended at {e.refits.chosen}, which explains the residual: go on from there by"
    " --given"
)
LATER_SENTENCE = "not tried, because it was not significant beside any set that the search extended{e.refits.later}"


@dataclass(frozen=True, eq=False, kw_only=True)
class EffectEvidence:
    """Evidence on an effect, with the final model.

    screening   its score test given the model without it
    added       whether the final model has it
    kept        with what reservation it was added: held out it does not help, or its std is large; empty without any
    alias       the added effect's id and itself as an alias of that, None unless indistinguishable from one
    replacement the added effect's id and itself fitted in its place, where it is separated from that one
    rejection   why it was not accepted, None unless it was tried for acceptance
    negligible  whether the upper 95 % limit of its contribution is within tolerance
    one_run     whether no recording has repeats
    posed       whether all are poses at rest
    adjusted_p_value  of its score test, Holm over the effects that the final model lacks, as in the search
    refits      what the search has refitted with it
    """

    screening: ScoreTest
    space: Space
    added: bool = False
    kept: str = ""
    alias: tuple[str, Alias] | None = None
    replacement: tuple[str, Alias] | None = None
    rejection: str | None = None
    negligible: bool = False
    one_run: bool = False
    posed: bool = False
    adjusted_p_value: float = 1.0
    refits: EffectRefits = field(default_factory=EffectRefits)

    @property
    def id(self) -> str:
        """The effect's id."""
        return self.screening.effect.id

    @property
    def significant(self) -> bool:
        """Whether the search would refit it beside the final model: its absence has another reason than its p-value."""
        return self.adjusted_p_value < LEVELS.effect

    @property
    def beyond_range(self) -> str | None:
        """The first of its amplitudes, when all are detectable only beyond their physical range, else None."""
        return beyond_range(self.screening, self.space)

    @property
    def chi_square_p_value(self) -> float:
        """P-value of its score by chi-square, as if the noise were known, corrected for the grid points tested."""
        alone = float(chi2_sf(self.screening.statistic, max(1, len(self.screening.amounts))))
        return min(1.0, self.screening.searched * alone)

    @property
    def unknown_noise(self) -> str:
        """What does not suffice to know the noise, of runs at low frequencies."""
        if self.posed:
            return "so few poses do not tell the noise well enough"
        if self.one_run:
            return "one run does not tell the low-frequency noise well enough"
        return "there are too few repeats to know the low-frequency noise"


def beyond_range(screening: ScoreTest, space: Space) -> str | None:
    """The first amplitude of an effect, when all are detectable only beyond their physical range, else None."""
    bounds = {p.name: p.bounds for p in screening.effect.qualified(space)}
    wide = [n for n, amount in screening.detectable.items() if amount > max(np.abs(bounds[n]))]
    return wide[0].split(".", 1)[1] if wide and len(wide) == len(screening.detectable) else None


EffectRule = VerdictRule[EffectEvidence, EffectVerdict]
V = EffectVerdict
EFFECT_RULES: tuple[EffectRule, ...] = (
    VerdictRule("added with a reservation", lambda e: e.added and e.kept != "", V.SUPPORTED, "{e.kept}"),
    VerdictRule("added to the model", lambda e: e.added, V.SUPPORTED),
    VerdictRule("alias of an added effect", lambda e: e.alias is not None, V.CONFUSABLE, ALIAS_SENTENCE),
    VerdictRule("not accepted", lambda e: e.rejection is not None, V.NOT_SUPPORTED, "rejected, because {e.rejection}"),
    VerdictRule(
        "not identifiable beside an effect in whose place it fits worse",
        lambda e: e.replacement is not None and not e.screening.excited,
        V.NOT_SUPPORTED,
        REPLACEMENT_SENTENCE,
    ),
    VerdictRule("not identifiable", lambda e: not e.screening.excited, V.NOT_EXCITED, "{e.screening.reason}"),
    VerdictRule("only beyond its physical range", lambda e: e.beyond_range is not None, V.NOT_EXCITED, RANGE_SENTENCE),
    VerdictRule("upper limit within tolerance", lambda e: e.negligible, V.NEGLIGIBLE, LIMIT_SENTENCE),
    VerdictRule(
        "not significant after the exact refit",
        lambda e: e.significant and e.refits.final is FinalRefit.NOT_SIGNIFICANT,
        V.NOT_SUPPORTED,
        NOT_AFTER_REFIT_SENTENCE,
    ),
    VerdictRule(
        "exact refit not converged",
        lambda e: e.significant and e.refits.final is FinalRefit.UNCONVERGED,
        V.NOT_SUPPORTED,
        REFIT_UNCONVERGED_SENTENCE,
    ),
    VerdictRule(
        "left out of the chosen set as within tolerance",
        lambda e: e.significant and e.refits.left_out,
        V.NOT_SUPPORTED,
        LEFT_OUT_SENTENCE,
    ),
    VerdictRule(
        "refitted in sets that do not explain the residual",
        lambda e: e.significant and e.refits.explains_nothing,
        V.NOT_SUPPORTED,
        EXPLAINS_NOTHING_SENTENCE,
    ),
    VerdictRule(
        "refitted in sets to which the search preferred another",
        lambda e: e.significant and bool(e.refits.smallest),
        V.NOT_SUPPORTED,
        PREFERRED_SENTENCE,
    ),
    VerdictRule(
        "exact refit without a solution",
        lambda e: e.significant and bool(e.refits.unsolved),
        V.NOT_SUPPORTED,
        UNSOLVED_SENTENCE,
    ),
    VerdictRule(
        "not refitted, as the search ended without convergence",
        lambda e: e.significant and bool(e.refits.unconverged),
        V.NOT_SUPPORTED,
        UNCONVERGED_SENTENCE,
    ),
    VerdictRule(
        "not refitted, as refits are limited",
        lambda e: e.significant and e.refits.passed_over,
        V.NOT_SUPPORTED,
        PASSED_OVER_SENTENCE,
    ),
    VerdictRule(
        "not refitted, as the search ended at an adequate model",
        lambda e: e.significant and e.refits.ended_adequate,
        V.NOT_SUPPORTED,
        ADEQUATE_SENTENCE,
    ),
    VerdictRule(
        "not refitted, as it was not significant in the search",
        lambda e: e.significant,
        V.NOT_SUPPORTED,
        LATER_SENTENCE,
    ),
    VerdictRule(
        "significant only in noise that is known",
        lambda e: e.chi_square_p_value < LEVELS.poorly_known_noise,
        V.NOT_SUPPORTED,
        "rejected, because {e.unknown_noise}",
    ),
    VerdictRule("not significant", lambda e: True, V.NOT_SUPPORTED, NOT_SIGNIFICANT_SENTENCE),
)
"""In order; `diagnose(..., effect_rules=(rule, *EFFECT_RULES))` asks another one first."""


Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Finding(Tabular):
    """Verdict on one effect, with its evidence.

    p_value         multiplicity-corrected, of the score test; None when not tested
    error_removed   share of the systematic power that it removes; not added: of the excess chi-square, by its score,
                    None where the noise is taken from the residual, so that there is no such excess
    detectable      changes of its amplitudes that are detected with 80 % power, where they are as `detectable_at`
    confusable_with ids of its aliases (of an alias: the added effect)
    aliases         of an added effect: the others that are significant in its place, the closest first
    reason          why it is not supported, empty when that is its p-value
    """

    effect: Effect
    verdict: EffectVerdict
    p_value: float | None
    error_removed: float | None
    detectable: Mapping[str, float]
    confusable_with: tuple[str, ...]
    reason: str
    parameters: Mapping[str, Estimate]
    aliases: tuple[Alias, ...] = ()
    detectable_at: NuisanceValues = field(default_factory=dict)

    @property
    def closest(self) -> Alias | None:
        """Of an added effect: the other one that imitates it best, None where no other is significant there."""
        return next(iter(self.aliases), None)

    @property
    def significant_share(self) -> float | None:
        """`error_removed` of an effect that is added, or significant in its score test; else None."""
        significant = self.p_value is not None and self.p_value < LEVELS.effect
        return self.error_removed if significant or self.verdict is EffectVerdict.SUPPORTED else None

    @property
    def table(self) -> Table:
        """Name, value, std and unit of its parameters."""
        return parameter_table(self.parameters)

    def printed(self) -> list[Table | str]:
        """Verdict with p-value and reason, then the parameters."""
        p_value = "" if self.p_value is None else f", {p_value_text(self.p_value)}"
        head = f"{self.effect.id}: {self.verdict.value}{p_value}" + (f"; {self.reason}" if self.reason else "")
        return [head, *([self.table] if self.parameters else [])]

    def to_data(self) -> dict[str, Any]:
        """The finding in result.json: numbers are finite or None."""
        data = {
            "id": self.effect.id,
            "verdict": self.verdict.value,
            "p_value": self.p_value,
            "error_removed": self.error_removed,
            "detectable": dict(self.detectable),
            "detectable_at": dict(self.detectable_at),
            "confusable_with": list(self.confusable_with),
            "closest": None if self.closest is None else self.closest.to_data(),
            "reason": self.reason,
            "parameters": estimates_data(self.parameters),
        }
        plain: dict[str, Any] = finite(data)
        return plain


def judge_effects(
    selection: SubsetSearch,
    final: CandidateModel,
    steps: Sequence[SelectionStep],
    power: Array,
    rejections: Mapping[str, str],
    candidates: Sequence[Effect],
    tolerance: Mapping[str, float],
    rules: Sequence[EffectRule] = EFFECT_RULES,
) -> tuple[Finding, ...]:
    """Findings on every candidate effect, the added ones first; the first of the rules that applies decides.

    `power` is the systematic power after each step (`explainable_power_by_step`), `rejections` says why an effect was
    not accepted, or with what reservation, by id.
    """
    fit, space = steps[-1].fit, final.fit.model.space
    aliases, screenings = aliases_of_added(selection, final, candidates), final.screened(candidates)
    close = {i: [a for a in several if a.confusable] for i, several in aliases.items()}
    removed = np.clip((power[:-1] - power[1:]) / max(power[0], 1e-300), 0.0, 1.0)
    unknown_excess = noise_from_residual(final.fit) or selection.base.adequate  # the former fits that noise
    excess = None if unknown_excess else selection.base.excess
    added = [
        _finding(
            rules,
            evidence,
            p_value=min(1.0, final.candidates * evidence.screening.p_value),
            error_removed=float(share),
            confusable_with=tuple(a.effect.id for a in close.get(evidence.id, ())),
            parameters={p.name: fit.parameters[p.name] for p in evidence.screening.effect.qualified(space)},
            aliases=tuple(aliases.get(evidence.id, ())),
        )
        for evidence, share in zip(_evidence_on_added(final, steps, rejections), removed, strict=True)
    ]
    adjusted = adjusted_p_values(screenings)
    absent = [
        _finding(
            rules,
            evidence,
            p_value=adjusted.get(evidence.id),
            error_removed=evidence.screening.share_of(excess),
            confusable_with=() if evidence.alias is None else (evidence.alias[0],),
            parameters=_amounts(evidence.screening, space),
        )
        for evidence in _evidence_on_absent(selection, final, screenings, aliases, rejections, tolerance)
    ]
    return (*added, *absent)


def _finding(
    rules: Sequence[EffectRule],
    evidence: EffectEvidence,
    *,
    p_value: float | None,
    error_removed: float | None,
    confusable_with: tuple[str, ...],
    parameters: Mapping[str, Estimate],
    aliases: tuple[Alias, ...] = (),
) -> Finding:
    """The finding on an effect, by the first rule that applies to its evidence."""
    verdict, reason = judge(rules, evidence)
    screening, its = evidence.screening, _by_short_name(parameters)
    detectable, place = _by_short_name(screening.detectable), _by_short_name(screening.detectable_at)
    effect = screening.effect
    return Finding(effect, verdict, p_value, error_removed, detectable, confusable_with, reason, its, aliases, place)


def _amounts(screening: ScoreTest, space: Space) -> dict[str, Estimate]:
    units = {p.name: p.unit for p in screening.effect.qualified(space)}
    return {name: Estimate(name, value, std, units[name]) for name, (value, std) in screening.amounts.items()}


def _evidence_on_added(
    final: CandidateModel, steps: Sequence[SelectionStep], reasons: Mapping[str, str]
) -> list[EffectEvidence]:
    """Evidence on each added effect: its score test given those added before it."""
    evidence = []
    for before, step in pairwise(steps):
        effect = next(e for e in final.added if e.id == step.effect)
        (test,) = screen(before.tested, [effect], candidates=final.candidates, cache=final.cache)
        screening, kept = replace(test, effect=effect), reasons.get(effect.id, "")
        evidence.append(EffectEvidence(screening=screening, space=final.fit.model.space, added=True, kept=kept))
    return evidence


def _evidence_on_absent(
    selection: SubsetSearch,
    final: CandidateModel,
    screenings: Sequence[ScoreTest],
    aliases: Mapping[str, Sequence[Alias]],
    rejections: Mapping[str, str],
    tolerance: Mapping[str, float],
) -> list[EffectEvidence]:
    """Evidence on each effect that the final model lacks, by its score test given that model."""
    space, adjusted = final.fit.model.space, adjusted_p_values(screenings)
    alias: dict[str, tuple[str, Alias]] = {}
    separated: dict[str, tuple[str, Alias]] = {}
    for added, several in aliases.items():
        alias |= {a.effect.id: (added, a) for a in several if a.confusable}
        separated |= {a.effect.id: (added, a) for a in several if a.separated}
    limits = {
        s.effect.id: contribution_upper_limit(final.fit, s, final.cache)
        for s in screenings
        if s.excited and s.effect.id not in rejections and beyond_range(s, space) is None
    }
    significant = {s.effect.id for s in significant_effects(screenings)}
    one_run = all(recording.repeats == 1 for recording in final.fit.recordings)
    evidence = []
    for screening in screenings:
        i = screening.effect.id
        evidence.append(EffectEvidence(
            screening=screening,
            space=space,
            alias=alias.get(i),
            replacement=separated.get(i),
            rejection=rejections.get(i),
            negligible=i in limits and within_tolerance(limits[i], tolerance),
            one_run=one_run,
            posed=all(recording.at_rest for recording in final.fit.recordings),
            adjusted_p_value=adjusted.get(i, 1.0),
            refits=effect_refits(selection, final, i) if i in significant else EffectRefits(),
        ))  # fmt: skip
    return evidence


Named = TypeVar("Named")


def _by_short_name(values: Mapping[str, Named]) -> dict[str, Named]:
    """What is given by the full name of an effect's parameter, by its name within the effect."""
    return {name.split(".", 1)[1]: value for name, value in values.items()}
