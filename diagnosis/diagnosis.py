"""Diagnosis: fit, compare, search, accept, and say what is missing, or that nothing is, or that nobody knows."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from diagnosis.acceptance import HELD_OUT_SIGNIFICANCE, accepted
from diagnosis.comparison import residual_judges_itself
from diagnosis.finding import Finding, findings_of, weighed
from diagnosis.held_out import HeldOut
from diagnosis.limits import contribution_limit, tolerance_of, within
from diagnosis.own_effect import OwnEffect, own_effects, with_own
from diagnosis.price import SIGNIFICANCE
from diagnosis.progress import Progress, silent
from diagnosis.remainder import Remainder, remainder
from diagnosis.renewal import renewed_noise
from diagnosis.result import estimates_data, finding_data, finite, own_data, remainder_data, step_data
from diagnosis.screening import screen
from diagnosis.selection import Candidate, Selection, select
from diagnosis.step import Step, explainable, staircase
from diagnosis.validation import zero_shift
from diagnosis.verdict import RecordVerdict
from diagnosis.workers import Task, Workers, in_step
from estimation.convention import decided
from estimation.fit import Fit, check_channels, first_noise, refit, require_weight, table
from estimation.noise import Noise
from estimation.recording import Recording
from modeling.effect import Effect
from modeling.effects import catalogue
from modeling.errors import InputError
from modeling.model import WrenchModel


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Everything found in the recordings of one rig and tool.

    steps      the staircase, from the rigid tip to the last effect added
    findings   every effect of the catalogue, the added first
    zero_shift of the first held-out recording, None without
    own        what held-out recordings have by themselves: a drift, a push
    remainder  what is left and where, None when the record is explained
    """

    model: WrenchModel
    verdict: RecordVerdict
    steps: tuple[Step, ...]
    findings: tuple[Finding, ...]
    zero_shift: Mapping[str, float] | None
    own: tuple[OwnEffect, ...]
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
        own = "".join(f"\n{o}" for o in self.own)
        return f"{head}\n{self.steps[-1].training[0]}\n{body}{own}{left}"

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
            "steps": [step_data(s) for s in self.steps],
            "effects": [finding_data(f) for f in self.findings],
            "parameters": estimates_data(self.fit.parameters),
            "zero_shift": None if self.zero_shift is None else dict(self.zero_shift),
            "validation_own": [own_data(o) for o in self.own] if self.steps[0].validation else None,
            "unexplained": None if self.remainder is None else remainder_data(self.remainder),
        }
        plain: dict[str, Any] = finite(data)
        return plain


def diagnose(
    model: WrenchModel,
    recordings: Recording | Iterable[Recording],
    *,
    validate: Recording | Iterable[Recording] | None = None,
    effects: Sequence[Effect] | None = None,
    progress: Progress = silent,
    workers: int = 1,
) -> Diagnosis:
    """Find the physical effects that a model lacks for its recordings to be explained.

    `validate` are recordings of other motions of the same rig and tool, never fitted; `effects` are the candidates,
    by default the whole catalogue. So many `workers` (processes) share the work; the result is the same whatever their
    number.
    Raises InputError when the model has effects already, its signals are not recorded, or the mass comes out negative.
    """
    from threadpoolctl import threadpool_limits

    training = (recordings,) if isinstance(recordings, Recording) else tuple(recordings)
    others = (validate,) if isinstance(validate, Recording) else tuple(validate or ())
    candidates = None if effects is None else tuple(effects)
    with threadpool_limits(1):  # matrices are tall and thin: threads of linear algebra only wait for one another
        return in_step(workers, lambda team: _diagnosed(model, training, others, candidates, progress, team))


def _diagnosed(
    model: WrenchModel,
    training: tuple[Recording, ...],
    others: tuple[Recording, ...],
    effects: tuple[Effect, ...] | None,
    progress: Progress,
    workers: Workers,
) -> Diagnosis:
    """`diagnose`, its arguments in order."""
    if model.effects:
        raise InputError(
            what=f"the model has {', '.join(e.id for e in model.effects)} already",
            where="model",
            remedy="diagnose the rigid tool: model.base",
        )
    progress = progress if workers.rank == 0 else silent
    check_channels(model, training)
    model = decided(model, (*training, *others))
    candidates = catalogue(model.space) if effects is None else effects
    progress("fit the rigid tip")
    base, noise = _begun(model, training, others, workers)
    held_out = [HeldOut(r, n) for r, n in zip(others, noise, strict=True)]
    selection = _selected(base, candidates, progress, workers)
    progress("check on other data")
    tolerance, stated = tolerance_of(base)
    believed = accepted(_worthwhile(selection.chosen, tolerance, stated), selection.base, held_out, candidates)
    final, reasons = believed.candidate, dict(believed.reasons)
    known = believed.held_out
    steps = staircase(selection, final, known)
    verdict = _verdict(selection, final, steps, tolerance)
    if verdict is RecordVerdict.UNEXPLAINED and final.ids:
        reasons |= dict.fromkeys(sorted(final.ids), "takes less than half of an error that is not explained by it")
        final, known = selection.base, tuple(with_own(h, selection.base.fit, candidates, workers) for h in held_out)
        steps = staircase(selection, final, known)
    require_weight(final.fit)
    progress("judge every effect")
    evidence = weighed(selection, final, candidates, reasons)
    findings = findings_of(selection, final, steps, evidence, reasons, candidates, tolerance)
    left = None
    if verdict in (RecordVerdict.UNEXPLAINED, RecordVerdict.PARTLY_EXPLAINED):
        left = _left(steps[-1], tolerance)
    shift = zero_shift(final.fit, known[0].carried(final.fit)) if known else None
    own = tuple(effect for h in known for effect in own_effects(h, final.fit))
    final.workspace.forget()
    return Diagnosis(final.fit.model, verdict, steps, findings, shift, own, tolerance, left)


def _begun(
    model: WrenchModel, training: tuple[Recording, ...], others: tuple[Recording, ...], workers: Workers
) -> tuple[Fit, tuple[Noise, ...]]:
    """The rigid tip fitted to the training recordings, and the noise of the others before any fit."""
    if not others:
        return refit(model, training), ()
    shared = [model, training, others, *(part for r in (*training, *others) for part in (r, r.rig)), model.arm]
    tasks = [Task("fit", lambda: refit(model, training)), Task("noise", lambda: first_noise(model, others))]
    base, noise = workers.run(tasks, shared=shared)
    return base, noise


def _selected(base: Fit, candidates: Sequence[Effect], progress: Progress, workers: Workers) -> Selection:
    """The search's outcome; where it explains what had been taken for noise, that of a second one in the new noise."""
    selection = select(base, candidates, progress, workers)
    noise = renewed_noise(selection.chosen.fit)
    if noise is None:
        return selection
    selection.base.workspace.forget()
    progress("estimate the noise again")
    again = refit(base.model, base.recordings, noise=noise, start=base.values)
    return select(again, candidates, progress, workers)


def _worthwhile(candidate: Candidate, tolerance: Mapping[str, float], stated: bool) -> Candidate:
    """The candidate less the effects that the user has said not to care about."""
    if not stated:
        return candidate
    for effect in candidate.fit.model.effects:
        without = candidate.less(effect.id)
        (screening,) = screen(without.fit, [effect], candidates=candidate.among, workspace=candidate.workspace)
        if screening.excited and within(contribution_limit(without.fit, screening, candidate.workspace), tolerance):
            return _worthwhile(without, tolerance, stated)
    return candidate


def _verdict(
    selection: Selection, final: Candidate, steps: Sequence[Step], tolerance: Mapping[str, float]
) -> RecordVerdict:
    """The record's verdict; a model that fails on held-out data is not adequate, whatever it does in training.

    Where the residual had to give the noise, lack of fit is weak: then nothing is only missing when no effect was
    significant either, be it the right one or not.
    """
    held_out = min((c.lack_of_fit for c in steps[-1].validation), default=1.0)
    adequate = final.lack_of_fit >= SIGNIFICANCE and held_out >= HELD_OUT_SIGNIFICANCE
    if not final.ids:
        followed = residual_judges_itself(final.fit) and len(selection.tried) > 1
        return RecordVerdict.NOTHING_MISSING if adequate and not followed else RecordVerdict.UNEXPLAINED
    compared = (*steps[-1].training, *steps[-1].validation)
    if adequate or all(c.explainable_rms is not None and within(c.explainable_rms, tolerance) for c in compared):
        return RecordVerdict.EXPLAINED
    left = explainable(steps)
    return RecordVerdict.PARTLY_EXPLAINED if left[-1] <= left[0] / 2 else RecordVerdict.UNEXPLAINED


def _left(step: Step, tolerance: Mapping[str, float]) -> Remainder:
    """What is left of the recording explained worst: a fitted one, unless only held-out ones show that it fails."""
    fitted = min(step.training, key=lambda c: c.lack_of_fit)
    held_out = min(step.validation, key=lambda c: c.lack_of_fit, default=fitted)
    if fitted.lack_of_fit >= SIGNIFICANCE and held_out.lack_of_fit < HELD_OUT_SIGNIFICANCE:
        return remainder(held_out, tolerance, fitted=False)
    return remainder(fitted, tolerance)


def _short(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
