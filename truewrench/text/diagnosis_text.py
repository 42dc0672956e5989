"""Text summary of a diagnosis."""

from __future__ import annotations

from collections.abc import Mapping

from diagnosis.comparison.error_table import error_table
from diagnosis.diagnosis import Diagnosis
from diagnosis.verdict.finding import Finding
from diagnosis.verdict.motion_notes import motion_notes
from diagnosis.verdict.unexplained_residual import UnexplainedResidual
from diagnosis.verdict.verdict import EffectVerdict, RecordVerdict
from estimation.fit import Fit
from estimation.least_squares.estimates import Estimate
from modeling.chain.effect import Effect
from modeling.number_format import estimate_text
from truewrench.effect_description import parameter_meaning
from truewrench.effect_description.effect_size import size_sentence
from truewrench.text.step_names import step_names
from truewrench.text.tool_extent import tool_extent_text
from truewrench.text.tool_text import tool_text
from truewrench.text.verdict_words import (
    CANDIDATES_NOTE,
    RECORD_VERDICT_LABELS,
    closest_sentence,
    disturbance_sentences,
    fixed_point_sentence,
    given_sentences,
    noise_notes,
    verdict_headline,
    weaker_verdict_warning,
)


def diagnosis_text(diagnosis: Diagnosis) -> str:
    """Verdict, effects added, error after each selection step, evidence, candidates, unexplained residual."""
    parts = [
        verdict_sentence(diagnosis),
        *(_given_text(diagnosis, effect_id) for effect_id in diagnosis.given),
        *(effect_text(f, diagnosis.fit) for f in diagnosis.findings if f.verdict is EffectVerdict.SUPPORTED),
        *_tool_lines(diagnosis),
        error_reduction_text(diagnosis),
        "\n".join(_evidence(diagnosis)),
        f"Candidate effects:\n{diagnosis.table}\n{CANDIDATES_NOTE}",
    ]
    return "\n\n".join(parts if diagnosis.unexplained is None else [*parts, _unexplained_text(diagnosis.unexplained)])


def _tool_lines(diagnosis: Diagnosis) -> list[str]:
    """The tool, and whether it is as large as no tool is; of readings that are not its own, that it is not known."""
    unknown = diagnosis.tool_unknown
    tool = tool_text(diagnosis.fit, misfitting=bool(diagnosis.misfitting), unknown=unknown)
    extent = "" if unknown else tool_extent_text(diagnosis.fit)
    return [line for line in (tool, extent) if line]


def verdict_sentence(diagnosis: Diagnosis) -> str:
    """The verdict as a sentence, its name in brackets."""
    verdict, headline = diagnosis.verdict, verdict_headline(diagnosis)
    label = "" if verdict is RecordVerdict.NOTHING_MISSING else f"{RECORD_VERDICT_LABELS[verdict]}: "
    return f"{label}{headline[0].lower() if label else headline[0]}{headline[1:]}. [{verdict.value}]"


def _given_text(diagnosis: Diagnosis, effect_id: str) -> str:
    """An effect that the model was given with, and its estimates in the final fit."""
    effect = next(e for e in diagnosis.model.effects if e.id == effect_id)
    names = (p.name for p in effect.qualified(diagnosis.model.space))
    estimates = {name.split(".", 1)[1]: diagnosis.fit.parameters[name] for name in names}
    return "\n".join(
        [f"Given {effect.id}: {effect.title}, {effect.equation}", *_estimate_lines(effect, estimates, diagnosis.fit)]
    )


def _estimate_lines(effect: Effect, estimates: Mapping[str, Estimate], fit: Fit) -> list[str]:
    """Each estimate with what it is, then the size of the effect in the readings."""
    values = {name: estimate_text(e.value, e.std, e.unit) for name, e in estimates.items()}
    width, wide = max(map(len, values), default=0), max(map(len, values.values()), default=0)
    lines = [f"  {n.ljust(width)} = {v.ljust(wide)}  {parameter_meaning(effect, n)}" for n, v in values.items()]
    size = size_sentence(fit, effect.id)
    return [line.rstrip() for line in [*lines, *([f"  {size}"] if size else [])]]


def effect_text(finding: Finding, fit: Fit) -> str:
    """An effect added to a fit: estimates, its size, aliases, and what to check on the rig."""
    effect = finding.effect
    lines = [f"Added {effect.id}: {effect.title}, {effect.equation}", *_estimate_lines(effect, finding.parameters, fit)]
    if sentence := fixed_point_sentence(finding):
        lines.append(f"  {sentence}")
    if finding.confusable_with:
        lines.append(f"  Indistinguishable in these recordings from: {', '.join(finding.confusable_with)}.")
    closest = [f"  {sentence}"] if (sentence := closest_sentence(finding)) else []
    return "\n".join([*lines, *closest, f"  On the rig: {effect.advice}."])


def error_reduction_text(diagnosis: Diagnosis) -> str:
    """Systematic error of each channel on each recording after each selection step, and the noise floor."""
    steps = diagnosis.steps
    repeating = all(c.explainable_rms is not None for s in steps for c in (*s.training, *s.validation))
    kind = "systematic RMS, repeats with the motion" if repeating else "RMS; `~`: total, no repeats"
    table = error_table(steps, step_names(diagnosis), diagnosis.tolerance).without_unknown("reduced chi-square")
    return f"Error of each channel ({kind}):\n{table}"


def _evidence(diagnosis: Diagnosis) -> list[str]:
    """Evidence of the verdict: source of the noise, what the motion leaves unknown, validation, disturbances."""
    last, warning = diagnosis.steps[-1], weaker_verdict_warning(diagnosis)
    lines = [
        *given_sentences(diagnosis),
        *noise_notes(diagnosis),
        *motion_notes(last.training, diagnosis.fit.model),
    ]
    lines += [warning] if warning else []
    lines += [f"{slow.sentence[0].upper()}{slow.sentence[1:]}." for slow in diagnosis.slow_residuals]
    if diagnosis.removed_share < 0.995:
        lines.append(
            f"The effects added remove {diagnosis.removed_share:.0%} of what the residual holds beyond noise, as far as"
            " one run shows; the rest is slow noise or physics."
        )
    if not last.validation:
        lines.append("Nothing held out: only the fitted recordings were tested; give another motion with --validate.")
    if diagnosis.zero_shift:
        shifts = zip(diagnosis.zero_shift.items(), last.training[0].space.units, strict=True)
        texts = ", ".join(f"{c} {s:.3g} {u}" for (c, s), u in shifts)
        lines.append(f"Zero shift of the held-out recording: {texts}.")
    if diagnosis.calibration is not None:
        lines.append(f"Calibration: {'; '.join(diagnosis.calibration_sentences)}.")
    return lines + disturbance_sentences(diagnosis)


def _unexplained_text(residual: UnexplainedResidual) -> str:
    alike = f"\nResembles {residual.resembles}." if residual.resembles else ""
    return f"Unexplained residual: {residual.where}.{alike}"
