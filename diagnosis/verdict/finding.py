"""Finding: verdict, p-value, size and detection limit of each effect."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np

from diagnosis.parallel.workers import WorkItem
from diagnosis.screening.multiplicity import SIGNIFICANCE
from diagnosis.screening.score_test import ScoreTest, adjusted_p_values, screen
from diagnosis.selection.subset_search import CandidateModel, SubsetSearch
from diagnosis.verdict.aliasing import (
    ALIAS_SEPARATION,
    Alias,
    alias_candidates,
    alias_separation,
    aliases,
    whitened_prediction,
)
from diagnosis.verdict.selection_step import SelectionStep, explainable_power_by_step
from diagnosis.verdict.upper_limit import contribution_upper_limit, within_tolerance
from diagnosis.verdict.verdict import EffectVerdict
from estimation.distributions import chi2_sf
from estimation.fit import Estimate, Fit
from modeling.chain.effect import Effect


@dataclass(frozen=True, eq=False)
class Finding:
    """Verdict on one effect, with its evidence.

    p_value         multiplicity-corrected, of the score test; None when not tested
    error_removed   share of the systematic power that it removes; not added: of the excess chi-square, by its score
    detectable      changes of its amplitudes that are detected with 80 % power
    confusable_with ids of its aliases (of an alias: the added effect)
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


@dataclass(frozen=True)
class Evidence:
    """Evidence for the verdicts.

    aliases  of each added effect, the closest first
    limits   of each effect not added: upper 95 % limit of its contribution to each channel, RMS
    """

    aliases: Mapping[str, list[Alias]]
    limits: Mapping[str, Mapping[str, float]]


def gather_evidence(
    selection: SubsetSearch, final: CandidateModel, effects: Sequence[Effect], rejected: Collection[str]
) -> Evidence:
    """Aliases of the final model's effects, and upper limits of those that it lacks, in one batch of work."""
    alternatives = alias_candidates(selection, final, effects)
    limited = [
        s
        for s in final.screened(effects)
        if s.excited and s.effect.id not in rejected and not _beyond_range(s, final.fit)
    ]
    target = whitened_prediction(final)
    tasks = [WorkItem(c.screening.effect.id, partial(alias_separation, target, c)) for c in alternatives]
    tasks += [WorkItem(s.effect.id, partial(contribution_upper_limit, final.fit, s, final.workspace)) for s in limited]
    found = final.workspace.workers.run(tasks)
    limits = {s.effect.id: limit for s, limit in zip(limited, found[len(alternatives) :], strict=True)}
    return Evidence(aliases(alternatives, found[: len(alternatives)]), limits)


def judge_effects(
    selection: SubsetSearch,
    final: CandidateModel,
    steps: Sequence[SelectionStep],
    evidence: Evidence,
    rejected: Mapping[str, str],
    candidates: Sequence[Effect],
    tolerance: Mapping[str, float],
) -> tuple[Finding, ...]:
    """Findings on every candidate effect, the added ones first."""
    aliases_of_added, power = evidence.aliases, explainable_power_by_step(steps)
    removed = np.clip((power[:-1] - power[1:]) / max(power[0], 1e-300), 0.0, 1.0)
    added = [
        _supported(screening, float(share), aliases_of_added.get(step.effect, []), steps[-1].fit, final.among)
        for step, share, screening in zip(steps[1:], removed, _score_tests_of_added(final, steps), strict=True)
        if step.effect is not None
    ]
    confusable = {
        r.effect.id: (added_id, r)
        for added_id, found in aliases_of_added.items()
        for r in found
        if r.separation < ALIAS_SEPARATION
    }
    screenings = final.screened(candidates)
    adjusted = adjusted_p_values(screenings)
    excess = None if selection.base.adequate else selection.base.excess
    others = []
    for screening in screenings:
        effect_id = screening.effect.id
        negligible = effect_id in evidence.limits and within_tolerance(evidence.limits[effect_id], tolerance)
        verdict, reason = _effect_verdict(
            screening, final.fit, confusable.get(effect_id), rejected.get(effect_id), negligible=negligible
        )
        others.append(
            Finding(
                effect=screening.effect,
                verdict=verdict,
                p_value=adjusted.get(effect_id),
                error_removed=min(1.0, screening.statistic / excess) if excess and screening.excited else None,
                detectable=_short_names(screening.effect, screening.detectable),
                confusable_with=(confusable[effect_id][0],) if effect_id in confusable else (),
                reason=reason,
                parameters=_amounts(screening, final.fit),
            )
        )
    return (*added, *others)


def _score_tests_of_added(final: CandidateModel, steps: Sequence[SelectionStep]) -> list[ScoreTest]:
    """The score test of each added effect, given those added before it."""
    found = []
    for before, step in pairwise(steps):
        effect = next(e for e in final.fit.model.effects if e.id == step.effect)
        found.append(screen(before.fit, [effect], candidates=final.among, workspace=final.workspace)[0])
    return found


def _supported(screening: ScoreTest, removed: float, found: list[Alias], final: Fit, trials: int) -> Finding:
    effect = screening.effect
    names = [p.name for p in effect.qualified(final.model.space)]
    return Finding(
        effect=effect,
        verdict=EffectVerdict.SUPPORTED,
        p_value=min(1.0, trials * screening.p_value),
        error_removed=removed,
        detectable=_short_names(effect, screening.detectable),
        confusable_with=tuple(r.effect.id for r in found if r.separation < ALIAS_SEPARATION),
        reason="",
        parameters={n.split(".", 1)[1]: final.parameters[n] for n in names},
    )


def _effect_verdict(
    screening: ScoreTest,
    final: Fit,
    confusable: tuple[str, Alias] | None,
    rejected: str | None,
    *,
    negligible: bool,
) -> tuple[EffectVerdict, str]:
    if confusable is not None:
        added, alias = confusable
        how = f"separation {alias.separation:.2g}, probability of confusion {alias.chance:.0%}"
        return EffectVerdict.CONFUSABLE, f"indistinguishable from {added} ({how})"
    if rejected is not None:
        return EffectVerdict.NOT_SUPPORTED, f"rejected, because {rejected}"
    if not screening.excited:
        return EffectVerdict.NOT_EXCITED, screening.reason
    if beyond := _beyond_range(screening, final):
        return EffectVerdict.NOT_EXCITED, beyond
    if negligible:
        return EffectVerdict.NEGLIGIBLE, "the upper 95 % limit of its contribution is below tolerance"
    if screening.p_value < SIGNIFICANCE / 10:
        reason = "rejected, because it is significant in the score test, but not after the exact refit"
        return EffectVerdict.NOT_SUPPORTED, reason
    if chi2_sf(screening.statistic, max(1, len(screening.amounts))) < SIGNIFICANCE / 100:
        reason = "rejected, because there are too few repeats to know the low-frequency noise"
        return EffectVerdict.NOT_SUPPORTED, reason
    return EffectVerdict.NOT_SUPPORTED, ""


def _beyond_range(screening: ScoreTest, fitted: Fit) -> str:
    """Reason when all detectable amounts of an effect lie beyond the physical range, else empty."""
    bounds = {p.name: p for p in screening.effect.qualified(fitted.model.space)}
    wide = [n for n, amount in screening.detectable.items() if amount > max(np.abs(bounds[n].bounds))]
    if wide and len(wide) == len(screening.detectable):
        return f"{wide[0].split('.', 1)[1]} is not excited: detectable only beyond its physical range"
    return ""


def _short_names(effect: Effect, values: Mapping[str, float]) -> dict[str, float]:
    return {name.removeprefix(f"{effect.id}."): value for name, value in values.items()}


def _amounts(screening: ScoreTest, fitted: Fit) -> dict[str, Estimate]:
    units = {p.name: p.unit for p in screening.effect.qualified(fitted.model.space)}
    return {
        name.split(".", 1)[1]: Estimate(name, value, std, units[name])
        for name, (value, std) in screening.amounts.items()
    }
