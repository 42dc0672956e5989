"""Head of the report: verdict, effects added, residual of the worst channel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from diagnosis.comparison.comparison import Comparison
from diagnosis.comparison.error_table import noise_floors, systematic_error, systematic_error_text
from diagnosis.diagnosis import Diagnosis
from diagnosis.verdict.motion_notes import motion_notes
from diagnosis.verdict.verdict import EffectVerdict, RecordVerdict
from estimation.noise.recording_noise import NoiseSource
from modeling.number_format import format_number, format_p_value, format_unit
from modeling.rig.rig import Convention
from truewrench.plots.residuals.labelled_comparison import LabelledComparison
from truewrench.plots.residuals.worst_channel_plot import MIN_SIGNAL_TO_NOISE, worst_channel, worst_channel_figure
from truewrench.plots.svg_image import SvgImage
from truewrench.reports.compared_models import compared_models, worst_recording
from truewrench.reports.effect_row import EffectRow
from truewrench.text.verdict_words import (
    RECORD_VERDICT_LABELS,
    disturbance_sentences,
    fixed_point_sentence,
    given_sentences,
    noise_notes,
    verdict_headline,
    weaker_verdict_warning,
)

VERDICT_SYMBOLS = {
    RecordVerdict.NOTHING_MISSING: "=",
    RecordVerdict.EXPLAINED: "✓",
    RecordVerdict.PARTLY_EXPLAINED: "◐",
    RecordVerdict.UNEXPLAINED: "?",
}
CONVENTION_SENTENCES = {
    Convention.ON_TOOL: "Readings are the wrench of the sensor on the tool: F = m (a − g).",
    Convention.ON_SENSOR: "Readings are the wrench of the tool on the sensor: a hanging weight reads + m g.",
    Convention.AUTO: "The sign convention of the readings is undecided.",
}


def verdict_section(diagnosis: Diagnosis, rows: Sequence[EffectRow]) -> dict[str, Any]:
    """What the head of the report shows, with the channel of the largest error-to-noise ratio of the rigid tool."""
    sides = compared_models(diagnosis, worst_recording(diagnosis))
    alt = "Residual of the worst channel, with the rigid tool and with the final model."
    picture = SvgImage(lambda: worst_channel_figure(sides), alt, _figure_caption(sides[0]))
    return {
        "kind": diagnosis.verdict.value,
        "label": RECORD_VERDICT_LABELS[diagnosis.verdict],
        "symbol": VERDICT_SYMBOLS[diagnosis.verdict],
        "headline": verdict_headline(diagnosis),
        "effects": [r for r in rows if r.finding.verdict is EffectVerdict.SUPPORTED],
        "sentences": _sentences(diagnosis),
        "notes": _notes(diagnosis),
        "warning": weaker_verdict_warning(diagnosis),
        "picture": picture,
    }


def _figure_caption(side: LabelledComparison) -> str:
    """Caption of the figure of the worst channel."""
    nonperiodic, channel = worst_channel(side)
    recording = side.recording
    name = f"{recording.name}, {recording.channels[channel]}"
    if nonperiodic:
        return f"{name}: non-periodic residual over the record. Grey: ± 2 standard deviations of the noise."
    if recording.repeats == 1:
        event = " Yellow: a transient event, excluded from the noise estimate." if side.comparison.noise.events else ""
        return f"Residual of {name}. Grey: ± {side.noise_label}.{event}"
    mean = f"mean over {recording.repeats} repeats"
    return f"Residual of {name}, {mean}. Grey: ± noise of one sample; darker: ± noise of the mean."


def _sentences(diagnosis: Diagnosis) -> list[str]:
    number = worst_recording(diagnosis)
    _, channel = worst_channel(compared_models(diagnosis, number)[0])
    found = [_error_reduction_sentence([s.training[number] for s in diagnosis.steps], channel, "")]
    if diagnosis.steps[0].validation:
        held_out = [s.validation[0] for s in diagnosis.steps]
        found.append(
            _error_reduction_sentence(held_out, channel, f"On {held_out[0].recording.name} (held out, not fitted): ")
        )
    gravity = [] if diagnosis.gravity is None else [diagnosis.gravity.sentence]
    points = filter(None, map(fixed_point_sentence, diagnosis.findings))
    return [*given_sentences(diagnosis), *gravity, *found, *points, *disturbance_sentences(diagnosis)]


def _error_reduction_sentence(comparisons: Sequence[Comparison], channel: int, where: str) -> str:
    """Error of a channel with the rigid tool and with the final model, in its unit."""
    first, last = comparisons[0], comparisons[-1]
    name, unit = first.recording.channels[channel], format_unit(first.space.units[channel])
    before, after = (systematic_error_text(c, name, 2).replace("< ", "below ") for c in (first, last))
    kind = "systematic error" if first.explainable_rms is not None else "total error (RMS)"
    noise = noise_floors(comparisons)[name]
    floor = f"the noise of one sample is {format_number(noise, 2)} {unit}"
    lead = f"{where}{'in' if where else 'In'} {name}, the {kind}"
    if systematic_error(first)[name] < MIN_SIGNAL_TO_NOISE * noise and first.noise.source is NoiseSource.RESIDUAL:
        floor = "its noise content is unknown without repeats"
    if len(comparisons) == 1:
        return f"{lead} is {before} {unit}; {floor}."
    return f"{lead} decreases from {before} to {after} {unit}; {floor}."


def _notes(diagnosis: Diagnosis) -> list[str]:
    first = diagnosis.steps[0].training[0]
    rig = first.recording.rig
    stated = rig is not None and rig.sensor.tolerance is not None
    p_value = format_p_value(diagnosis.stated_lack_of_fit)
    calibration = "; ".join(diagnosis.calibration_sentences)
    return [
        *noise_notes(diagnosis),
        *motion_notes(diagnosis.steps[-1].training, diagnosis.fit.model),
        CONVENTION_SENTENCES[diagnosis.model.convention]
        + (" The sensor's y axis runs along the tip." if diagnosis.model.mirror_y else ""),
        f"Tolerance: {'as stated in the rig file' if stated else 'a tenth of the noise floor'}.",
        f"Lack-of-fit test of the final model: p = {p_value}".replace("p = <", "p <") + " (significant below 0.01).",
        *([f"Calibration: {calibration}."] if calibration else []),
    ]
