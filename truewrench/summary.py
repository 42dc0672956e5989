"""Summary: a diagnosis in words and tables for somebody who stands beside the rig."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import floor, isfinite, log10

from diagnosis.comparison import Comparison
from diagnosis.diagnosis import Diagnosis
from diagnosis.finding import Finding
from diagnosis.step import Step
from diagnosis.verdict import EffectVerdict, RecordVerdict
from estimation.fit import Estimate, table
from estimation.noise import NoiseSource

RIGID = "rigid tool"

VERDICTS: Mapping[RecordVerdict, str] = {
    RecordVerdict.NOTHING_MISSING: "Nothing is missing: the rigid tool explains the readings down to their noise.",
    RecordVerdict.EXPLAINED: "Explained: the rigid tool alone does not explain the readings; with {effects} it does.",
    RecordVerdict.PARTLY_EXPLAINED: (
        "Partly explained: with {effects} most of the error goes; what is left no effect of the catalogue accounts for."
    ),
    RecordVerdict.UNEXPLAINED: (
        "Unexplained: the model misses something, and no effect of the catalogue accounts for it."
    ),
}
"""What each verdict means, in a sentence; {effects} are the ids added."""

SOURCES: Mapping[NoiseSource, str] = {
    NoiseSource.REPEATS: "from the differences between repeats",
    NoiseSource.RIG: "as the rig file states it; it was not measured",
    NoiseSource.RESIDUAL: (
        "from what the model leaves, for want of repeats: this verdict is weaker. "
        "Run one motion several times without pause, with a column `repeat`"
    ),
}
"""Where the noise is known from, in words."""


def summary(diagnosis: Diagnosis) -> str:
    """The verdict, the effects with their sizes, the fall of the error, every candidate, and what is left."""
    parts = [sentence(diagnosis), *_added(diagnosis), staircase(diagnosis), _basis(diagnosis), _candidates(diagnosis)]
    if diagnosis.remainder is not None:
        parts.append(_left(diagnosis))
    return "\n\n".join(parts)


def sentence(diagnosis: Diagnosis) -> str:
    """The verdict in plain words, its name in brackets."""
    effects = " and ".join(diagnosis.added)
    words = VERDICTS[diagnosis.verdict].format(effects=effects)
    if diagnosis.verdict is RecordVerdict.UNEXPLAINED and effects:
        words += f" With {effects} less than half of it goes."
    return f"{words} [{diagnosis.verdict.value}]"


def _added(diagnosis: Diagnosis) -> Iterator[str]:
    for finding in diagnosis.findings:
        if finding.verdict is EffectVerdict.SUPPORTED:
            yield effect_text(finding)


def effect_text(finding: Finding) -> str:
    """An effect that was added: its size, what else it may be, and what to look at on the rig."""
    effect = finding.effect
    lines = [f"Added {effect.id}: {effect.title}, {effect.equation}"]
    lines += [f"  {line}" for line in table_of(finding.parameters).splitlines()]
    if finding.confusable_with:
        lines.append(f"  These recordings cannot tell it from: {', '.join(finding.confusable_with)}.")
    lines.append(f"  On the rig: {effect.advice}.")
    return "\n".join(lines)


def table_of(estimates: Mapping[str, Estimate]) -> str:
    """Estimates as lines `name = value ± std unit`, names and values each in a column."""
    names = max((len(name) for name in estimates), default=0)
    return "\n".join(f"{name.ljust(names)} = {measured(e)}" for name, e in estimates.items())


def measured(estimate: Estimate) -> str:
    """An estimate as `value ± std unit`, to two digits of its standard deviation."""
    value, std, unit = estimate.value, estimate.std, estimate.unit
    unit = "" if unit == "1" else f" {unit}"
    if std == 0:
        return f"{value:.6g}{unit}, held"
    if not isfinite(std):
        return f"{value:.6g}{unit}, not determined by these recordings"
    digits = max(0, 1 - floor(log10(std)))
    if digits > 9:
        return f"{value:.6g} ± {std:.2g}{unit}"
    return f"{value:.{digits}f} ± {std:.{digits}f}{unit}"


# ------------------------------------------------------------------------------------- the staircase


def staircase(diagnosis: Diagnosis) -> str:
    """The error of each channel, step by step, on each recording, against the noise floor."""
    steps = diagnosis.steps
    first = steps[0].training[0]
    repeating = all(c.explainable_rms is not None for s in steps for c in (*s.training, *s.validation))
    kind = "explainable RMS, what repeats with the motion" if repeating else "RMS; `~` where it has no explainable part"
    units = [f"{c} [{u}]" for c, u in zip(first.recording.channels, first.space.units, strict=True)]
    rows = [row for step in steps for row in _step_rows(step)]
    rows += [_floor_row(c) for c in (*steps[-1].training, *steps[-1].validation)]
    header = ("model", "recording", "misfit", *units)
    return f"Error of each channel ({kind}):\n{table(header, rows)}"


def _step_rows(step: Step) -> Iterator[tuple[str, ...]]:
    name = RIGID if step.effect is None else f"+ {step.effect}"
    for comparison in step.training:
        yield (name, comparison.recording.name, *_sizes(comparison))
    for comparison in step.validation:
        yield (name, f"{comparison.recording.name} (validation)", *_sizes(comparison))


def _sizes(comparison: Comparison) -> tuple[str, ...]:
    misfit = "-" if comparison.misfit is None else f"{comparison.misfit:.3g}"
    explainable = comparison.explainable_rms
    if explainable is None:
        return (misfit, *(f"~{size:.3g}" for size in comparison.rms.values()))
    return (misfit, *(f"{size:.3g}" for size in explainable.values()))


def _floor_row(comparison: Comparison) -> tuple[str, ...]:
    return ("noise floor", comparison.recording.name, "1", *(f"{f:.3g}" for f in comparison.noise_floor.values()))


def _basis(diagnosis: Diagnosis) -> str:
    """What the verdict rests on: the noise's source, and whether another motion was seen."""
    last = diagnosis.steps[-1]
    lines = [f"Noise: {SOURCES[last.training[0].noise.source]}."]
    if not last.validation:
        lines.append("Only the motion that was fitted has been judged: give another with --validate.")
    if diagnosis.zero_shift:
        shifts = zip(diagnosis.zero_shift.items(), last.training[0].space.units, strict=True)
        lines.append("Zero shift of the validation: " + ", ".join(f"{c} {s:.3g} {u}" for (c, s), u in shifts) + ".")
    lines += [f"{own}; that is left out of the judgement." for own in diagnosis.own]
    return "\n".join(lines)


def _candidates(diagnosis: Diagnosis) -> str:
    head = ("effect", "verdict", "p", "error removed", "reason")
    return f"Every effect of the catalogue:\n{table(head, diagnosis.rows())}"


def _left(diagnosis: Diagnosis) -> str:
    left = diagnosis.remainder
    assert left is not None
    terms = ", ".join(left.looks_like)
    return f"Left: {left.where}.\nIt looks like {terms} ({left.share:.0%} of what is left of that channel)."
