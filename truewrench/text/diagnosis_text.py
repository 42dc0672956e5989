"""Text summary of a diagnosis."""

from __future__ import annotations

from collections.abc import Mapping

from diagnosis.comparison.compared_step import error_table
from diagnosis.diagnosis import Diagnosis
from diagnosis.verdict.finding import Finding
from diagnosis.verdict.unexplained_residual import UnexplainedResidual, motion_notes
from diagnosis.verdict_rule import EffectVerdict, RecordVerdict
from estimation.fit import Fit
from estimation.least_squares.estimates import NOT_CONVERGED, Estimate
from estimation.recordings.recording import Recording
from modeling.chain.effect import Effect
from modeling.noise import NoiseSource
from modeling.number_format import as_sentence, estimate_text, format_number, format_percentage, format_unit
from modeling.significance import LEVELS
from truewrench.effect_description.effect_size import size_sentence
from truewrench.text.tool_text import tool_lines

# Names of the models of a diagnosis, from the one that the search began with to the last effect added, by ids.


RIGID_TOOL = "rigid tool"


def base_name(diagnosis: Diagnosis) -> str:
    """Label of the model that the search began with: the rigid tool, with gravity's direction and the effects given."""
    gravity = ["direction of gravity"] if diagnosis.tilt_fitted else []
    return " + ".join([RIGID_TOOL, *gravity, *diagnosis.given])


def step_names(diagnosis: Diagnosis) -> list[str]:
    """Label of each selection step."""
    return [base_name(diagnosis) if s.effect is None else f"+ {s.effect}" for s in diagnosis.steps]


# Words of a verdict and of its evidence, the same on the terminal and in the report.


RECORD_VERDICT_LABELS = {
    RecordVerdict.NOTHING_MISSING: "Nothing missing",
    RecordVerdict.EXPLAINED: "Explained",
    RecordVerdict.PARTLY_EXPLAINED: "Partly explained",
    RecordVerdict.UNEXPLAINED: "Unexplained",
}
EFFECT_VERDICT_LABELS = {
    EffectVerdict.SUPPORTED: "added",
    EffectVerdict.CONFUSABLE: "indistinguishable",
    EffectVerdict.NEGLIGIBLE: "negligible",
    EffectVerdict.NOT_EXCITED: "not excited",
    EffectVerdict.NOT_SUPPORTED: "rejected",
}
"""What a report calls the verdict on an effect."""
CANDIDATES_NOTE = (
    "p is of the score test, given the effects added before: how often noise alone would give as strong a sign of the"
    " effect, corrected for the number of tests. The score test is a first look, linear in the effect. A candidate is"
    " added only if it is also significant after the exact refit, in which all parameters are estimated together with"
    " it; there another effect, or other values of the tool, may take its place."
)
"""What p of the table of candidate effects is, and why a small one is not enough."""
NOISE_SOURCES = {
    NoiseSource.REPEATS: "measured from {repeats} repeats",
    NoiseSource.RIG: "as stated in the rig file; no repeats",
    NoiseSource.RESIDUAL: "estimated from the residual; no repeats",
    NoiseSource.DWELLS: "that of the means of dwells, from the rows within each",
}
WEAKER = {
    NoiseSource.RESIDUAL: "the noise is estimated from the residual, so that systematic error may count as noise",
    NoiseSource.RIG: "it depends on the noise stated in the rig file",
}
"""Why a verdict without repeats is weaker; the worst first."""
ALMOST_ALL = 0.995
"""Share of what a residual holds beyond noise that is written as 100 %: less than the rest is not worth a sentence."""
TOTAL_RMS_NOTE = "Without repeats, systematic error and noise cannot be separated: the total RMS is shown"
"""Of errors of recordings without repeats, in place of the systematic error."""


def verdict_headline(diagnosis: Diagnosis) -> str:
    """The verdict as one sentence, with ids and titles of the effects added, and whether its fit has not converged."""
    return f"{_verdict_words(diagnosis)}{'' if diagnosis.fit.converged else f'; {NOT_CONVERGED}'}"


def _verdict_words(diagnosis: Diagnosis) -> str:
    added = (f.effect for f in diagnosis.findings if f.verdict is EffectVerdict.SUPPORTED)
    missing = ", ".join(f"{effect.id} ({effect.title})" for effect in added)
    if diagnosis.verdict is RecordVerdict.NOTHING_MISSING:
        nothing = f"Nothing {'more ' if diagnosis.given else ''}is missing"
        return f"{nothing}: the residual of the {base_name(diagnosis)} is consistent with the noise"
    if diagnosis.verdict is RecordVerdict.EXPLAINED:
        return f"The model lacks {missing}"
    if diagnosis.verdict is RecordVerdict.PARTLY_EXPLAINED:
        return f"The model lacks {missing}; an unexplained residual remains"
    if missing:
        return f"Significant residual; adding {missing} removes less than half of the systematic error"
    return f"Significant residual{_on_held_out_alone(diagnosis)}, and {_no_candidate(diagnosis)}"


def _no_candidate(diagnosis: Diagnosis) -> str:
    """That no candidate effect explains the residual, or that none was or could be tested, and why."""
    if not diagnosis.findings and any(not doubted.adopted for doubted in diagnosis.readings):
        return "no effect is looked for before it is decided how the recording is read"
    if not diagnosis.findings or any(f.verdict is not EffectVerdict.NOT_EXCITED for f in diagnosis.findings):
        return "no candidate effect explains it"
    reasons = "; ".join(f"{f.effect.id}: {f.reason}" for f in diagnosis.findings)
    return f"no candidate effect could be tested ({reasons})"


def _on_held_out_alone(diagnosis: Diagnosis) -> str:
    """Where the fitted repeats show no lack of fit: the held-out recordings, or other rows, that do; else empty."""
    last = diagnosis.steps[-1]
    failing = [c.recording.name for c in last.validation if c.lack_of_fit < LEVELS.held_out]
    if any(c.lack_of_fit < LEVELS.effect for c in last.training):
        return ""
    outside = [rows.name for rows in diagnosis.rows_left_out if rows.deviations]
    if outside and not failing:
        return f" outside the whole repeats of {', '.join(outside)}, while these show none"
    if not failing:
        return ""
    fitted = ", ".join(dict.fromkeys(c.recording.name for c in last.training))
    return f" on {', '.join(failing)}, held out, while {fitted} shows none"


def finding_sentence(finding: Finding) -> str:
    """Why an effect has its verdict, as a sentence; empty for an added one."""
    return as_sentence(finding.reason)


def closest_sentence(finding: Finding) -> str:
    """How far the closest other effect is from imitating an added one; empty where some are indistinguishable."""
    if finding.confusable_with:
        return ""
    if finding.closest is None:
        return "No other candidate effect is confusable with it in these recordings: none is significant in its place."
    other, alias = finding.closest.effect.id, finding.closest
    if alias.separated:
        return f"No other candidate effect is confusable with it in these recordings; the closest is {other}."
    risk = format_percentage(alias.error_probability)
    size = f"chi-square {alias.excess:.2g} higher with it; probability of confusion by such motions {risk}"
    return f"The closest other effect is {other}, which these recordings barely separate from it ({size})."


def given_sentences(diagnosis: Diagnosis) -> list[str]:
    """Which other effects fit as well, or better, in the place of a given one."""
    sentences = (alternative.sentence for alternative in diagnosis.given_alternatives)
    return [f"{sentence}. Fit each, and compare." for sentence in sentences]


def fixed_point_sentence(finding: Finding) -> str:
    """Which parameters of an added effect are fixed, and why; empty where none is.

    The point is on the tip axis, as none beside it is significantly better, and a friction's step is narrow; at rest a
    vertical force is weight.
    """
    fixed = [name for name, estimate in finding.parameters.items() if estimate.std == 0]
    if finding.verdict is not EffectVerdict.SUPPORTED or not fixed:
        return ""
    weight = [name for name in fixed if name.startswith("force")]
    steps = [estimate for name, estimate in finding.parameters.items() if name == "width" and name in fixed]
    beside = [name for name in fixed if name not in (*weight, "width")]
    sentences = [
        f"width of {finding.effect.id} is fixed at {format_number(step.value)} {format_unit(step.unit)}:"
        " a wider step is not significant."
        for step in steps
    ]
    if beside:
        names = f"{', '.join(beside[:-1])} and {beside[-1]}"
        insignificant = "a point beside the tip axis" + (", or a torque of its own," if len(beside) > 2 else "")
        sentences += [f"{names} of {finding.effect.id} are fixed at 0: {insignificant} is not significant."]
    if weight:
        sentences += [
            f"{weight[0]} of {finding.effect.id} is fixed at 0: poses at rest do not tell a vertical force from weight;"
            " mass and centre of mass are those of both together, and one motion tells them apart."
        ]
    return " ".join(sentences)


def noise_notes(diagnosis: Diagnosis) -> list[str]:
    """Where the noise of each fitted recording comes from, and which rows of its log the verdict is about."""
    sources = [(c.recording, NOISE_SOURCES[c.noise.source]) for c in diagnosis.steps[0].training]
    notes = [f"Noise of {r.name} {source.format(repeats=r.repeats)}.{_period_note(r)}" for r, source in sources]
    return [*dict.fromkeys(notes), *(rows.sentence for rows in diagnosis.rows_left_out)]


def evidence_notes(diagnosis: Diagnosis) -> list[str]:
    """What the verdict rests on: noise, rows, motion, what remains slowly, what was held out, calibration."""
    last = diagnosis.steps[-1]
    notes = [*noise_notes(diagnosis), *(note for c in last.training for note in c.outlier_notes)]
    notes += motion_notes(last.training, diagnosis.fit.model)
    notes += [as_sentence(remainder.sentence) for remainder in diagnosis.slow_residuals]
    if diagnosis.removed_share < ALMOST_ALL:
        notes.append(
            f"The effects added remove {diagnosis.removed_share:.0%} of what the residual holds beyond noise, as far as"
            " one run shows; the rest is slow noise or physics."
        )
    if not last.validation:
        notes.append("Nothing held out: only the fitted recordings were tested; give another motion with --validate.")
    return notes + ([f"Calibration: {'; '.join(diagnosis.calibration_sentences)}."] if diagnosis.calibration else [])


def _period_note(recording: Recording) -> str:
    """The period that was found in the motion, where no column counted the repeats."""
    period = None if recording.reading is None else recording.reading.period
    return "" if period is None else f" {period}"


def weaker_verdict_warning(diagnosis: Diagnosis) -> str:
    """Warning that the verdict is weaker without repeats, and what to record; empty with repeats."""
    sources = {c.noise.source for c in diagnosis.steps[0].training}
    return next(
        (
            f"Without repeats this verdict is weaker: {reason}. Record four or more repeats of the same motion, with a "
            "repeat column, or of the same poses."
            for source, reason in WEAKER.items()
            if source in sources
        ),
        "",
    )


def disturbance_sentences(diagnosis: Diagnosis) -> list[str]:
    """Recording-specific disturbances of the validation recordings."""
    return [f"{disturbance}; the verdict is not about it." for disturbance in diagnosis.disturbances]


def diagnosis_text(diagnosis: Diagnosis) -> str:
    """Verdict, effects added, error after each selection step, evidence, candidates, unexplained residual."""
    misread = any(not doubted.adopted for doubted in diagnosis.readings)
    parts = [
        *(doubted.sentence for doubted in diagnosis.readings),
        verdict_sentence(diagnosis),
        *(_beginning_text(diagnosis, effect) for effect in diagnosis.steps[0].fit.model.effects),
        *(effect_text(f, diagnosis.fit) for f in diagnosis.findings if f.verdict is EffectVerdict.SUPPORTED),
        *tool_lines(diagnosis.fit, misfitting=bool(diagnosis.misfitting), unknown=diagnosis.tool_unknown),
        *(["\n  ".join(doubts)] if (doubts := diagnosis.averaged.sentences) else []),
        error_reduction_text(diagnosis),
        "\n".join(_evidence(diagnosis)),
        *([f"Candidate effects:\n{diagnosis.table}\n{CANDIDATES_NOTE}"] if diagnosis.findings else []),
    ]
    if diagnosis.unexplained is not None and not misread:  # else it is what was said first
        parts.append(_unexplained_text(diagnosis.unexplained))
    return "\n\n".join(parts)


def verdict_sentence(diagnosis: Diagnosis) -> str:
    """The verdict as a sentence, its name in brackets."""
    verdict, headline = diagnosis.verdict, verdict_headline(diagnosis)
    label = "" if verdict is RecordVerdict.NOTHING_MISSING else f"{RECORD_VERDICT_LABELS[verdict]}: "
    return f"{label}{headline[0].lower() if label else headline[0]}{headline[1:]}. [{verdict.value}]"


def _beginning_text(diagnosis: Diagnosis, effect: Effect) -> str:
    """An effect that the search began with, given or gravity's direction, and its estimates in the final fit."""
    names = (p.name for p in effect.qualified(diagnosis.model.space))
    estimates = {name.split(".", 1)[1]: diagnosis.fit.parameters[name] for name in names}
    origin = "Given" if effect.id in diagnosis.given else "Fitted with the direction of gravity,"
    head = f"{origin} {effect.id}: {effect.title}, {effect.equation}"
    return "\n".join([head, *_estimate_lines(effect, estimates, diagnosis.fit)])


def _estimate_lines(effect: Effect, estimates: Mapping[str, Estimate], fit: Fit) -> list[str]:
    """Each estimate with what it is, then the size of the effect in the readings."""
    values = {name: estimate_text(e.value, e.shown_std, e.unit) for name, e in estimates.items()}
    fitted = next((e for e in fit.model.effects if e.id == effect.id), effect)
    meanings = {p.name: p.meaning for p in fitted.parameters(fit.model.space)}
    width, wide = max(map(len, values), default=0), max(map(len, values.values()), default=0)
    lines = [f"  {n.ljust(width)} = {v.ljust(wide)}  {meanings.get(n, '')}" for n, v in values.items()]
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
    return "\n".join([*lines, *closest, f"  Check on the rig: {effect.advice}."])


def error_reduction_text(diagnosis: Diagnosis) -> str:
    """Systematic error of each channel on each recording after each selection step, and the noise floor."""
    steps = diagnosis.steps
    repeating = all(c.explainable_rms is not None for s in steps for c in (*s.training, *s.validation))
    kind = "systematic RMS, repeats with the motion" if repeating else "RMS; `~`: total, no repeats"
    table = error_table(steps, step_names(diagnosis), diagnosis.tolerance)
    return f"Error of each channel ({kind}):\n{table}"


def _evidence(diagnosis: Diagnosis) -> list[str]:
    """Evidence of the verdict: source of the noise, what the motion leaves unknown, validation, disturbances."""
    last, warning = diagnosis.steps[-1], weaker_verdict_warning(diagnosis)
    lines = [*given_sentences(diagnosis), *evidence_notes(diagnosis), *([warning] if warning else [])]
    if diagnosis.zero_shift:
        shifts = zip(diagnosis.zero_shift.items(), last.training[0].space.units, strict=True)
        texts = ", ".join(f"{c} {s:.3g} {u}" for (c, s), u in shifts)
        lines.append(f"Zero shift of the held-out recording, in sensor axes: {texts}.")
    return lines + disturbance_sentences(diagnosis)


def _unexplained_text(residual: UnexplainedResidual) -> str:
    further = "`truewrench discover` looks for an equation of it, which has to hold on a second motion."
    return f"Unexplained residual: {residual.text}.\n{further}"
