"""Diagnosis: fit, compare, search, accept, and say what is missing, or that nothing is, or that nobody knows."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import isfinite
from typing import Any

import numpy as np

from diagnosis.acceptance import HELD_OUT_SIGNIFICANCE, HeldOut, accepted
from diagnosis.comparison import Comparison, comparison_of
from diagnosis.confusion import CONFUSABLE, Rival, rivals
from diagnosis.limits import contribution_limit
from diagnosis.remainder import Remainder, remainder
from diagnosis.screening import SIGNIFICANCE, Screening, screen
from diagnosis.selection import Candidate, Progress, Selection, holm, refitted, select, silent
from diagnosis.validation import transferred, zero_shift
from diagnosis.verdict import EffectVerdict, RecordVerdict
from estimation.convention import decided
from estimation.fit import Estimate, Fit, first_noise, fit, table
from estimation.recording import Recording
from modeling.effect import Effect
from modeling.effects import catalogue
from modeling.errors import InputError
from modeling.model import WrenchModel


@dataclass(frozen=True, eq=False)
class Step:
    """One step of the staircase: the model after one more effect, on the training and the held-out recordings."""

    effect: str | None
    fit: Fit
    training: tuple[Comparison, ...]
    validation: tuple[Comparison, ...]


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


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Everything found in the recordings of one rig and tool.

    steps      the staircase, from the rigid tip to the last effect added
    findings   every effect of the catalogue, the added first
    remainder  what is left and where, None when the record is explained
    """

    model: WrenchModel
    verdict: RecordVerdict
    steps: tuple[Step, ...]
    findings: tuple[Finding, ...]
    zero_shift: Mapping[str, float] | None
    tolerance: Mapping[str, float]
    remainder: Remainder | None

    @property
    def fit(self) -> Fit:
        """The last fit, with every added effect."""
        return self.steps[-1].fit

    @property
    def added(self) -> tuple[str, ...]:
        """Ids of the effects added, in their order."""
        return tuple(s.effect for s in self.steps if s.effect is not None)

    @cached_property
    def lack_of_fit(self) -> float:
        """P-value of the final model's lack of fit."""
        return min(1.0, len(self.steps[-1].training) * min(c.lack_of_fit for c in self.steps[-1].training))

    def rows(self) -> list[tuple[str, ...]]:
        """Effect, verdict, p-value, share of the error removed and reason, as text."""
        return [
            (f.effect.id, f.verdict.value, _short(f.p_value), _short(f.error_removed), f.reason) for f in self.findings
        ]

    def __str__(self) -> str:
        head = f"verdict: {self.verdict.value}" + (f" ({', '.join(self.added)})" if self.added else "")
        left = f"\nleft: {self.remainder.where}" if self.remainder else ""
        body = table(("effect", "verdict", "p", "error removed", "reason"), self.rows())
        return f"{head}\n{self.steps[-1].training[0]}\n{body}{left}"

    def to_data(self) -> dict[str, Any]:
        """The `result.json` of this diagnosis: numbers are finite or None."""
        first = self.steps[0].training[0]
        data = {
            "channels": list(first.recording.channels),
            "convention": self.model.convention.value,
            "verdict": self.verdict.value,
            "noise_floor": dict(first.noise_floor),
            "noise_source": first.noise.source.value,
            "added": list(self.added),
            "lack_of_fit_p": self.lack_of_fit,
            "converged": self.fit.converged,
            "steps": [_step_data(s) for s in self.steps],
            "effects": [_finding_data(f) for f in self.findings],
            "parameters": _estimates_data(self.fit.parameters),
            "zero_shift": None if self.zero_shift is None else dict(self.zero_shift),
            "unexplained": None if self.remainder is None else _remainder_data(self.remainder),
        }
        finite: dict[str, Any] = _finite(data)
        return finite


def diagnose(
    model: WrenchModel,
    recordings: Recording | Iterable[Recording],
    *,
    validate: Recording | Iterable[Recording] | None = None,
    effects: Sequence[Effect] | None = None,
    progress: Progress = silent,
) -> Diagnosis:
    """Find the physical effects that a model lacks for its recordings to be explained.

    `validate` are recordings of other motions of the same rig and tool, never fitted; `effects` are the candidates,
    by default the whole catalogue.
    Raises InputError when the model has effects already, or its signals are not recorded.
    """
    training = (recordings,) if isinstance(recordings, Recording) else tuple(recordings)
    others = (validate,) if isinstance(validate, Recording) else tuple(validate or ())
    if model.effects:
        raise InputError(
            what=f"the model has {', '.join(e.id for e in model.effects)} already",
            where="model",
            remedy="diagnose the rigid tool: model.base",
        )
    model = decided(model, (*training, *others))
    candidates = catalogue(model.space) if effects is None else tuple(effects)
    progress("fit the rigid tip")
    base = fit(model, training)
    held_out = [HeldOut(r, n) for r, n in zip(others, first_noise(model, others), strict=True)]
    selection = select(base, candidates, progress)
    progress("check on other data")
    tolerance, stated = tolerance_of(base)
    believed = accepted(_worthwhile(selection.chosen, tolerance, stated), selection.base, held_out)
    final, reasons = believed.candidate, dict(believed.reasons)
    steps = _staircase(selection.base, final, held_out)
    verdict = _verdict(final, steps, tolerance)
    if verdict is RecordVerdict.UNEXPLAINED and final.ids:
        reasons |= dict.fromkeys(sorted(final.ids), "takes less than half of an error that is not explained by it")
        final, steps = selection.base, steps[:1]
    progress("judge every effect")
    added = [e.id for e in final.fit.model.effects]
    lookalikes = {i: rivals(final, i, list(candidates)) for i in added}
    findings = _findings(selection, final, steps, lookalikes, reasons, candidates, tolerance)
    left = None
    if verdict in (RecordVerdict.UNEXPLAINED, RecordVerdict.PARTLY_EXPLAINED):
        left = remainder(steps[-1].training[_worst_recording(steps[-1])], tolerance)
    shift = zero_shift(final.fit, transferred(final.fit, others[0], held_out[0].noise)) if others else None
    return Diagnosis(final.fit.model, verdict, steps, findings, shift, tolerance, left)


def tolerance_of(base: Fit) -> tuple[dict[str, float], bool]:
    """What the user does not care about per channel, else a tenth of the noise floor; and whether it was stated."""
    recording, floor = base.recordings[0], base.noise[0].floor
    stated = (recording.rig.sensor.tolerance if recording.rig is not None else None) or {}
    tolerance = {c: float(stated.get(c, f / 10)) for c, f in zip(recording.channels, floor, strict=True)}
    return tolerance, bool(stated)


def _worthwhile(candidate: Candidate, tolerance: Mapping[str, float], stated: bool) -> Candidate:
    """The candidate less the effects that the user has said not to care about."""
    if not stated:
        return candidate
    for effect in candidate.fit.model.effects:
        without = refitted(candidate, [e for e in candidate.fit.model.effects if e.id != effect.id])
        (screening,) = screen(without.fit, [effect])
        if screening.excited and _within(contribution_limit(without.fit, screening), tolerance):
            return _worthwhile(without, tolerance, stated)
    return candidate


def _within(size: Mapping[str, float], tolerance: Mapping[str, float]) -> bool:
    return all(size[c] <= tolerance[c] for c in tolerance)


def _staircase(base: Candidate, final: Candidate, held_out: Sequence[HeldOut]) -> tuple[Step, ...]:
    steps = [_step(None, base.fit, held_out)]
    effects = final.fit.model.effects
    for count in range(1, len(effects) + 1):
        partial = final if count == len(effects) else refitted(final, effects[:count])
        steps.append(_step(effects[count - 1].id, partial.fit, held_out))
    return tuple(steps)


def _step(effect: str | None, fitted: Fit, held_out: Sequence[HeldOut]) -> Step:
    training = tuple(comparison_of(fitted, i) for i in range(len(fitted.recordings)))
    validation = tuple(comparison_of(transferred(fitted, o.recording, o.noise), 0) for o in held_out)
    return Step(effect, fitted, training, validation)


def explainable(step: Step) -> float:
    """Power of the training error that can be explained, in units of the noise floor's, over all recordings."""
    total = 0.0
    for comparison in step.training:
        size = comparison.explainable_rms or comparison.rms
        total += sum((size[c] / max(comparison.noise_floor[c], 1e-300)) ** 2 for c in size)
    return total


def _findings(
    selection: Selection,
    final: Candidate,
    steps: Sequence[Step],
    lookalikes: Mapping[str, list[Rival]],
    rejected: Mapping[str, str],
    candidates: Sequence[Effect],
    tolerance: Mapping[str, float],
) -> tuple[Finding, ...]:
    added = [
        _supported(step, before, screening, lookalikes[step.effect], steps, len(candidates))
        for before, step, screening in zip(steps, steps[1:], _path(final, steps), strict=False)
        if step.effect is not None
    ]
    confusable = {
        r.effect.id: (added_id, r) for added_id, found in lookalikes.items() for r in found if r.separation < CONFUSABLE
    }
    screenings = screen(final.fit, candidates)
    adjusted = holm(screenings)
    excess = None if selection.base.adequate else selection.base.excess
    others = []
    for screening in screenings:
        effect_id = screening.effect.id
        verdict, reason = _judged(screening, final, confusable.get(effect_id), rejected.get(effect_id), tolerance)
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
        found.append(screen(before.fit, [effect])[0])
    return found


def _supported(
    step: Step, before: Step, screening: Screening, lookalikes: list[Rival], steps: Sequence[Step], trials: int
) -> Finding:
    effect = screening.effect
    names = [p.name for p in effect.qualified(step.fit.model.space)]
    removed = (explainable(before) - explainable(step)) / max(explainable(steps[0]), 1e-300)
    final = steps[-1].fit.parameters
    return Finding(
        effect=effect,
        verdict=EffectVerdict.SUPPORTED,
        p_value=min(1.0, trials * screening.p_value),
        error_removed=float(np.clip(removed, 0.0, 1.0)),
        detectable=_own_names(effect, screening.detectable),
        confusable_with=tuple(r.effect.id for r in lookalikes if r.separation < CONFUSABLE),
        reason="",
        parameters={n.split(".", 1)[1]: final[n] for n in names},
    )


def _judged(
    screening: Screening,
    final: Candidate,
    confusable: tuple[str, Rival] | None,
    rejected: str | None,
    tolerance: Mapping[str, float],
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
    if beyond := _beyond_range(screening, final.fit):
        return EffectVerdict.NOT_EXCITED, beyond
    if _within(contribution_limit(final.fit, screening), tolerance):
        return EffectVerdict.NEGLIGIBLE, "its upper 95 % limit is below tolerance"
    if screening.p_value < SIGNIFICANCE / 10:
        return EffectVerdict.NOT_SUPPORTED, "follows what is left, but does not explain it when refitted exactly"
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


def _verdict(final: Candidate, steps: Sequence[Step], tolerance: Mapping[str, float]) -> RecordVerdict:
    """The record's verdict; a model that fails on held-out data is not adequate, whatever it does in training."""
    held_out = min((c.lack_of_fit for c in steps[-1].validation), default=1.0)
    adequate = final.lack_of_fit >= SIGNIFICANCE and held_out >= HELD_OUT_SIGNIFICANCE
    if not final.ids:
        return RecordVerdict.NOTHING_MISSING if adequate else RecordVerdict.UNEXPLAINED
    compared = (*steps[-1].training, *steps[-1].validation)
    if adequate or all(c.explainable_rms is not None and _within(c.explainable_rms, tolerance) for c in compared):
        return RecordVerdict.EXPLAINED
    halved = explainable(steps[-1]) <= explainable(steps[0]) / 2
    return RecordVerdict.PARTLY_EXPLAINED if halved else RecordVerdict.UNEXPLAINED


def _worst_recording(step: Step) -> int:
    return int(np.argmin([c.lack_of_fit for c in step.training]))


def _step_data(step: Step) -> dict[str, Any]:
    first = step.training[0]
    validation = step.validation[0] if step.validation else None
    return {
        "effect": step.effect,
        "misfit": first.misfit,
        "rms": dict(first.rms),
        "explainable_rms": _optional(first.explainable_rms),
        "validation_rms": None if validation is None else dict(validation.rms),
        "validation_explainable_rms": None if validation is None else _optional(validation.explainable_rms),
    }


def _optional(values: Mapping[str, float] | None) -> dict[str, float] | None:
    return None if values is None else dict(values)


def _finding_data(finding: Finding) -> dict[str, Any]:
    return {
        "id": finding.effect.id,
        "verdict": finding.verdict.value,
        "p_value": finding.p_value,
        "error_removed": finding.error_removed,
        "detectable": dict(finding.detectable),
        "confusable_with": list(finding.confusable_with),
        "reason": finding.reason,
        "parameters": _estimates_data(finding.parameters),
    }


def _estimates_data(estimates: Mapping[str, Estimate]) -> dict[str, Any]:
    return {name: {"value": e.value, "std": e.std, "unit": e.unit} for name, e in estimates.items()}


def _remainder_data(left: Remainder) -> dict[str, Any]:
    return {
        "where": left.where,
        "explainable_rms": dict(left.explainable_rms),
        "looks_like": list(left.looks_like),
        "share": left.share,
    }


def _finite(value: Any) -> Any:
    """The same data with None for every number that is not finite."""
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_finite(v) for v in value]
    if isinstance(value, float):
        return float(value) if isfinite(value) else None
    return value


def _short(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
