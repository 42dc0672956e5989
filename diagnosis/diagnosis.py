"""Diagnosis: fit, compare, search, accept, and say what is missing, or that nothing is, or that nobody knows."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from diagnosis.acceptance import HELD_OUT_SIGNIFICANCE, HeldOut, accepted
from diagnosis.confusion import rivals
from diagnosis.finding import Finding, findings_of
from diagnosis.limits import contribution_limit, tolerance_of, within
from diagnosis.remainder import Remainder, remainder
from diagnosis.result import estimates_data, finding_data, finite, remainder_data, step_data
from diagnosis.screening import SIGNIFICANCE, residual_judges_itself, screen
from diagnosis.selection import Candidate, Progress, Selection, refitted, select, silent
from diagnosis.step import Step, explainable, staircase
from diagnosis.validation import transferred, zero_shift
from diagnosis.verdict import RecordVerdict
from estimation.convention import decided
from estimation.fit import Fit, check_channels, first_noise, refit, require_weight, table
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
            "steps": [step_data(s) for s in self.steps],
            "effects": [finding_data(f) for f in self.findings],
            "parameters": estimates_data(self.fit.parameters),
            "zero_shift": None if self.zero_shift is None else dict(self.zero_shift),
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
) -> Diagnosis:
    """Find the physical effects that a model lacks for its recordings to be explained.

    `validate` are recordings of other motions of the same rig and tool, never fitted; `effects` are the candidates,
    by default the whole catalogue.
    Raises InputError when the model has effects already, its signals are not recorded, or the mass comes out negative.
    """
    training = (recordings,) if isinstance(recordings, Recording) else tuple(recordings)
    others = (validate,) if isinstance(validate, Recording) else tuple(validate or ())
    if model.effects:
        raise InputError(
            what=f"the model has {', '.join(e.id for e in model.effects)} already",
            where="model",
            remedy="diagnose the rigid tool: model.base",
        )
    check_channels(model, training)
    model = decided(model, (*training, *others))
    candidates = catalogue(model.space) if effects is None else tuple(effects)
    progress("fit the rigid tip")
    base = refit(model, training)
    held_out = [HeldOut(r, n) for r, n in zip(others, first_noise(model, others), strict=True)]
    selection = select(base, candidates, progress)
    progress("check on other data")
    tolerance, stated = tolerance_of(base)
    believed = accepted(_worthwhile(selection.chosen, tolerance, stated), selection.base, held_out)
    final, reasons = believed.candidate, dict(believed.reasons)
    steps = staircase(selection.base, final, held_out)
    verdict = _verdict(selection, final, steps, tolerance)
    if verdict is RecordVerdict.UNEXPLAINED and final.ids:
        reasons |= dict.fromkeys(sorted(final.ids), "takes less than half of an error that is not explained by it")
        final, steps = selection.base, steps[:1]
    require_weight(final.fit)
    progress("judge every effect")
    added = [e.id for e in final.fit.model.effects]
    lookalikes = {i: rivals(final, i, list(candidates)) for i in added}
    findings = findings_of(selection, final, steps, lookalikes, reasons, candidates, tolerance)
    left = None
    if verdict in (RecordVerdict.UNEXPLAINED, RecordVerdict.PARTLY_EXPLAINED):
        left = remainder(steps[-1].training[_worst_recording(steps[-1])], tolerance)
    shift = zero_shift(final.fit, transferred(final.fit, others[0], held_out[0].noise)) if others else None
    return Diagnosis(final.fit.model, verdict, steps, findings, shift, tolerance, left)


def _worthwhile(candidate: Candidate, tolerance: Mapping[str, float], stated: bool) -> Candidate:
    """The candidate less the effects that the user has said not to care about."""
    if not stated:
        return candidate
    for effect in candidate.fit.model.effects:
        without = refitted(candidate, [e for e in candidate.fit.model.effects if e.id != effect.id])
        (screening,) = screen(without.fit, [effect])
        if screening.excited and within(contribution_limit(without.fit, screening), tolerance):
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
    halved = explainable(steps[-1]) <= explainable(steps[0]) / 2
    return RecordVerdict.PARTLY_EXPLAINED if halved else RecordVerdict.UNEXPLAINED


def _worst_recording(step: Step) -> int:
    return int(np.argmin([c.lack_of_fit for c in step.training]))


def _short(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
