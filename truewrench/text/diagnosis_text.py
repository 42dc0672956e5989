"""Text summary of a diagnosis."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import floor, isfinite, log10

from diagnosis.comparison.comparison import Comparison
from diagnosis.diagnosis import Diagnosis
from diagnosis.verdict.finding import Finding
from diagnosis.verdict.selection_step import SelectionStep
from diagnosis.verdict.verdict import EffectVerdict, RecordVerdict
from estimation.fit import Estimate, table
from estimation.noise.recording_noise import NoiseSource

RIGID_TOOL = "rigid tool"

VERDICT_SENTENCES: Mapping[RecordVerdict, str] = {
    RecordVerdict.NOTHING_MISSING: "Nothing is missing: the residual of the rigid tool is consistent with the noise.",
    RecordVerdict.EXPLAINED: (
        "Explained: the residual of the rigid tool is significant; with {effects} it is consistent with the noise."
    ),
    RecordVerdict.PARTLY_EXPLAINED: (
        "Partly explained: adding {effects} removes most of the systematic error; "
        "no candidate effect explains the rest."
    ),
    RecordVerdict.UNEXPLAINED: "Unexplained: the residual is significant, and no candidate effect explains it.",
}
"""Sentence of each verdict; {effects} are the ids added."""

NOISE_SOURCES: Mapping[NoiseSource, str] = {
    NoiseSource.REPEATS: "from the differences between repeats",
    NoiseSource.RIG: "as stated in the rig file, not measured",
    NoiseSource.RESIDUAL: (
        "estimated from the residual, as there are no repeats: the verdict is weaker. "
        "Record one periodic motion several times without pause, with a column `repeat`"
    ),
}
"""Source of the noise estimate."""


def diagnosis_text(diagnosis: Diagnosis) -> str:
    """Verdict, effects added, error after each selection step, evidence, candidates, unexplained residual."""
    parts = [
        verdict_sentence(diagnosis),
        *_added_effects(diagnosis),
        error_reduction_text(diagnosis),
        _evidence_text(diagnosis),
        _candidates(diagnosis),
    ]
    if diagnosis.remainder is not None:
        parts.append(_unexplained_text(diagnosis))
    return "\n\n".join(parts)


def verdict_sentence(diagnosis: Diagnosis) -> str:
    """The verdict as a sentence, its name in brackets."""
    effects = " and ".join(diagnosis.added)
    sentence = VERDICT_SENTENCES[diagnosis.verdict].format(effects=effects)
    if diagnosis.verdict is RecordVerdict.UNEXPLAINED and effects:
        sentence += f" With {effects} less than half of the systematic error is removed."
    return f"{sentence} [{diagnosis.verdict.value}]"


def _added_effects(diagnosis: Diagnosis) -> Iterator[str]:
    for finding in diagnosis.findings:
        if finding.verdict is EffectVerdict.SUPPORTED:
            yield effect_text(finding)


def effect_text(finding: Finding) -> str:
    """An effect added: estimates, effects indistinguishable from it, and what to check on the rig."""
    effect = finding.effect
    lines = [f"Added {effect.id}: {effect.title}, {effect.equation}"]
    lines += [f"  {line}" for line in estimates_text(finding.parameters).splitlines()]
    if finding.confusable_with:
        lines.append(f"  Indistinguishable in these recordings from: {', '.join(finding.confusable_with)}.")
    lines.append(f"  On the rig: {effect.advice}.")
    return "\n".join(lines)


def estimates_text(estimates: Mapping[str, Estimate]) -> str:
    """Estimates as lines `name = value ± std unit`, names and values each in a column."""
    names = max((len(name) for name in estimates), default=0)
    return "\n".join(f"{name.ljust(names)} = {estimate_text(e)}" for name, e in estimates.items())


def estimate_text(estimate: Estimate) -> str:
    """An estimate as `value ± std unit`, to two digits of its standard deviation."""
    value, std, unit = estimate.value, estimate.std, estimate.unit
    unit = "" if unit == "1" else f" {unit}"
    if std == 0:
        return f"{value:.6g}{unit}, fixed"
    if not isfinite(std):
        return f"{value:.6g}{unit}, not identifiable from these recordings"
    digits = max(0, 1 - floor(log10(std)))
    if digits > 9:
        return f"{value:.6g} ± {std:.2g}{unit}"
    return f"{value:.{digits}f} ± {std:.{digits}f}{unit}"


# ------------------------------------------------------------------------------------- errors by selection step


def error_reduction_text(diagnosis: Diagnosis) -> str:
    """Systematic error of each channel on each recording after each selection step, and the noise floor."""
    steps = diagnosis.steps
    first = steps[0].training[0]
    repeating = all(c.explainable_rms is not None for s in steps for c in (*s.training, *s.validation))
    kind = "systematic RMS, repeats with the motion" if repeating else "RMS; `~`: total, no repeats"
    units = [f"{c} [{u}]" for c, u in zip(first.recording.channels, first.space.units, strict=True)]
    rows = [row for step in steps for row in _step_rows(step)]
    rows += [_noise_floor_row(c) for c in (*steps[-1].training, *steps[-1].validation)]
    header = ("model", "recording", "reduced chi-square", *units)
    return f"Error of each channel ({kind}):\n{table(header, rows)}"


def _step_rows(step: SelectionStep) -> Iterator[tuple[str, ...]]:
    name = RIGID_TOOL if step.effect is None else f"+ {step.effect}"
    for comparison in step.training:
        yield (name, comparison.recording.name, *_error_cells(comparison))
    for comparison in step.validation:
        yield (name, f"{comparison.recording.name} (validation)", *_error_cells(comparison))


def _error_cells(comparison: Comparison) -> tuple[str, ...]:
    reduced_chi_square = "-" if comparison.misfit is None else f"{comparison.misfit:.3g}"
    systematic = comparison.explainable_rms
    if systematic is None:
        return (reduced_chi_square, *(f"~{size:.3g}" for size in comparison.rms.values()))
    return (reduced_chi_square, *(f"{size:.3g}" for size in systematic.values()))


def _noise_floor_row(comparison: Comparison) -> tuple[str, ...]:
    return ("noise floor", comparison.recording.name, "1", *(f"{f:.3g}" for f in comparison.noise_floor.values()))


def _evidence_text(diagnosis: Diagnosis) -> str:
    """Evidence of the verdict: source of the noise, validation, recording-specific disturbances."""
    last = diagnosis.steps[-1]
    lines = [f"Noise: {NOISE_SOURCES[last.training[0].noise.source]}."]
    if not last.validation:
        lines.append("No validation: only the fitted recordings were tested; give another motion with --validate.")
    if diagnosis.zero_shift:
        shifts = zip(diagnosis.zero_shift.items(), last.training[0].space.units, strict=True)
        lines.append(
            "Zero shift of the validation recording: " + ", ".join(f"{c} {s:.3g} {u}" for (c, s), u in shifts) + "."
        )
    lines += [f"{disturbance} (recording-specific, excluded from the verdict)." for disturbance in diagnosis.own]
    return "\n".join(lines)


def _candidates(diagnosis: Diagnosis) -> str:
    head = ("effect", "verdict", "p", "error removed", "reason")
    return f"Candidate effects:\n{table(head, diagnosis.rows())}"


def _unexplained_text(diagnosis: Diagnosis) -> str:
    residual = diagnosis.remainder
    assert residual is not None
    terms = ", ".join(residual.looks_like)
    resembles = f"Resembles {terms} ({residual.share:.0%} of its power in that channel)."
    return f"Unexplained residual: {residual.where}.\n{resembles}"
