"""Finding: what is said of each effect, in the user's units."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np

from diagnosis.confusion import CONFUSABLE, Rival, contests_of, prediction_of, rivals, separation
from diagnosis.limits import contribution_limit, within
from diagnosis.price import SIGNIFICANCE
from diagnosis.screening import Screening, screen
from diagnosis.selection import Candidate, Selection, holm
from diagnosis.step import Step, explainable
from diagnosis.verdict import EffectVerdict
from diagnosis.workers import Task
from estimation.distributions import chi2_sf
from estimation.fit import Estimate, Fit
from modeling.effect import Effect


@dataclass(frozen=True, eq=False)
class Finding:
    """What is said of one effect."""

    effect: Effect
    verdict: EffectVerdict
    p_value: float | None
    error_removed: float | None
    detectable: Mapping[str, float]
    confusable_with: tuple[str, ...]
    reason: str
    parameters: Mapping[str, Estimate]


@dataclass(frozen=True)
class Weighed:
    """What it takes to judge every effect.

    rivals  of each added effect, the closest first
    limits  by effect, how large one that was not added could still be: upper 95 % limit per channel, RMS
    """

    rivals: Mapping[str, list[Rival]]
    limits: Mapping[str, Mapping[str, float]]


def weighed(selection: Selection, final: Candidate, effects: Sequence[Effect], rejected: Collection[str]) -> Weighed:
    """The rivals of a candidate's effects, and the limits of those that it lacks; all of it one batch of work."""
    contests = contests_of(selection, final, effects)
    limited = [
        s
        for s in final.screened(effects)
        if s.excited and s.effect.id not in rejected and not _beyond_range(s, final.fit)
    ]
    target = prediction_of(final)
    tasks = [Task(c.screening.effect.id, partial(separation, target, c)) for c in contests]
    tasks += [Task(s.effect.id, partial(contribution_limit, final.fit, s, final.workspace)) for s in limited]
    found = final.workspace.workers.run(tasks)
    limits = {s.effect.id: limit for s, limit in zip(limited, found[len(contests) :], strict=True)}
    return Weighed(rivals(contests, found[: len(contests)]), limits)


def findings_of(
    selection: Selection,
    final: Candidate,
    steps: Sequence[Step],
    evidence: Weighed,
    rejected: Mapping[str, str],
    candidates: Sequence[Effect],
    tolerance: Mapping[str, float],
) -> tuple[Finding, ...]:
    """What is said of every candidate effect, those added first."""
    lookalikes, left = evidence.rivals, explainable(steps)
    removed = np.clip((left[:-1] - left[1:]) / max(left[0], 1e-300), 0.0, 1.0)
    added = [
        _supported(screening, float(share), lookalikes.get(step.effect, []), steps[-1].fit, final.among)
        for step, share, screening in zip(steps[1:], removed, _path(final, steps), strict=True)
        if step.effect is not None
    ]
    confusable = {
        r.effect.id: (added_id, r) for added_id, found in lookalikes.items() for r in found if r.separation < CONFUSABLE
    }
    screenings = final.screened(candidates)
    adjusted = holm(screenings)
    excess = None if selection.base.adequate else selection.base.excess
    others = []
    for screening in screenings:
        effect_id = screening.effect.id
        negligible = effect_id in evidence.limits and within(evidence.limits[effect_id], tolerance)
        verdict, reason = _judged(
            screening, final.fit, confusable.get(effect_id), rejected.get(effect_id), negligible=negligible
        )
        others.append(
            Finding(
                effect=screening.effect,
                verdict=verdict,
                p_value=adjusted.get(effect_id),
                error_removed=min(1.0, screening.statistic / excess) if excess and screening.excited else None,
                detectable=_own_names(screening.effect, screening.detectable),
                confusable_with=(confusable[effect_id][0],) if effect_id in confusable else (),
                reason=reason,
                parameters=_amounts(screening, final.fit),
            )
        )
    return (*added, *others)


def _path(final: Candidate, steps: Sequence[Step]) -> list[Screening]:
    """The screening of each added effect, given those added before it."""
    found = []
    for before, step in pairwise(steps):
        effect = next(e for e in final.fit.model.effects if e.id == step.effect)
        found.append(screen(before.fit, [effect], candidates=final.among, workspace=final.workspace)[0])
    return found


def _supported(screening: Screening, removed: float, lookalikes: list[Rival], final: Fit, trials: int) -> Finding:
    effect = screening.effect
    names = [p.name for p in effect.qualified(final.model.space)]
    return Finding(
        effect=effect,
        verdict=EffectVerdict.SUPPORTED,
        p_value=min(1.0, trials * screening.p_value),
        error_removed=removed,
        detectable=_own_names(effect, screening.detectable),
        confusable_with=tuple(r.effect.id for r in lookalikes if r.separation < CONFUSABLE),
        reason="",
        parameters={n.split(".", 1)[1]: final.parameters[n] for n in names},
    )


def _judged(
    screening: Screening,
    final: Fit,
    confusable: tuple[str, Rival] | None,
    rejected: str | None,
    *,
    negligible: bool,
) -> tuple[EffectVerdict, str]:
    if confusable is not None:
        added, rival = confusable
        reason = (
            f"explains as much as {added} (separation {rival.separation:.2g}, mistaken {rival.chance:.0%} of times)"
        )
        return EffectVerdict.CONFUSABLE, reason
    if rejected is not None:
        return EffectVerdict.NOT_SUPPORTED, rejected
    if not screening.excited:
        return EffectVerdict.NOT_EXCITED, screening.reason
    if beyond := _beyond_range(screening, final):
        return EffectVerdict.NOT_EXCITED, beyond
    if negligible:
        return EffectVerdict.NEGLIGIBLE, "its upper 95 % limit is below tolerance"
    if screening.p_value < SIGNIFICANCE / 10:
        return EffectVerdict.NOT_SUPPORTED, "follows what is left, but does not explain it when refitted exactly"
    if chi2_sf(screening.statistic, max(1, len(screening.amounts))) < SIGNIFICANCE / 100:
        reason = "would explain some of it, but noise this slow is known from too few repeats to be sure"
        return EffectVerdict.NOT_SUPPORTED, reason
    return EffectVerdict.NOT_SUPPORTED, ""


def _beyond_range(screening: Screening, fitted: Fit) -> str:
    """Why an effect could not have been seen: its detectable amounts all lie beyond the physical range."""
    bounds = {p.name: p for p in screening.effect.qualified(fitted.model.space)}
    wide = [n for n, amount in screening.detectable.items() if amount > max(np.abs(bounds[n].bounds))]
    if wide and len(wide) == len(screening.detectable):
        return f"this motion shows {wide[0].split('.', 1)[1]} only beyond its physical range"
    return ""


def _own_names(effect: Effect, values: Mapping[str, float]) -> dict[str, float]:
    return {name.removeprefix(f"{effect.id}."): value for name, value in values.items()}


def _amounts(screening: Screening, fitted: Fit) -> dict[str, Estimate]:
    units = {p.name: p.unit for p in screening.effect.qualified(fitted.model.space)}
    return {
        name.split(".", 1)[1]: Estimate(name, value, std, units[name])
        for name, (value, std) in screening.amounts.items()
    }
