"""Report of a diagnosis: a self-contained HTML page, and Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from diagnosis.comparison.compared_step import error_table, noise_floors, systematic_error, systematic_error_text
from diagnosis.comparison.comparison import Comparison
from diagnosis.comparison.residual_map import ResidualMap, residual_maps
from diagnosis.diagnosis import Diagnosis
from diagnosis.verdict.unexplained_residual import unknown_tool_sentences
from diagnosis.verdict_rule import EffectVerdict, RecordVerdict
from estimation.recordings.recording import Recording
from modeling.noise import NoiseSource
from modeling.number_format import P_VALUE, SHARE, FormattedQuantity, format_number, format_p_value, format_unit
from modeling.rig import Convention
from modeling.table import Column, Table
from truewrench.files.case_files import load_sentences
from truewrench.files.output import atomic_write
from truewrench.plots.interactive_figure import InteractiveFigure, shared_columns
from truewrench.plots.matplotlib_chart import matplotlib_figure
from truewrench.plots.parameters_plot import error_reduction_image
from truewrench.plots.residual_plots import residual_map_figure, residual_spectrum_chart, residual_spectrum_figure
from truewrench.plots.svg_image import SvgImage
from truewrench.plots.time_series_plot import (
    MIN_SIGNAL_TO_NOISE,
    LabelledComparison,
    nonperiodic_residual,
    nonperiodic_residual_figure,
    overlaid_chart,
    std_of_interval_means,
    time_series_chart,
    worst_channel,
    worst_channel_figure,
)
from truewrench.reports.effect_row import EffectRow, effect_cards, effect_row
from truewrench.reports.page_templates import html_page
from truewrench.reports.parameter_changes import ParameterChanges, compared_models, worst_recording
from truewrench.reports.report_files import Provenance, ReportTexts
from truewrench.text.diagnosis_text import (
    CANDIDATES_NOTE,
    EFFECT_VERDICT_LABELS,
    RECORD_VERDICT_LABELS,
    TOTAL_RMS_NOTE,
    base_name,
    disturbance_sentences,
    evidence_notes,
    finding_sentence,
    fixed_point_sentence,
    given_sentences,
    step_names,
    verdict_headline,
    weaker_verdict_warning,
)
from truewrench.text.tool_text import tool_notes

# Head of the report: verdict, effects added, residual of the worst channel.


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
    number = worst_recording(diagnosis)
    sides = compared_models(diagnosis, number)
    worst = worst_channel(sides[0])
    alt = "Residual of the worst channel, with the rigid tool and with the final model."
    picture = SvgImage(lambda: worst_channel_figure(sides, worst), alt, _figure_caption(sides[0], worst))
    return {
        "kind": diagnosis.verdict.value,
        "label": RECORD_VERDICT_LABELS[diagnosis.verdict],
        "symbol": VERDICT_SYMBOLS[diagnosis.verdict],
        "headline": verdict_headline(diagnosis),
        "effects": [r for r in rows if r.finding.verdict is EffectVerdict.SUPPORTED],
        "sentences": _sentences(diagnosis, number, worst[1]),
        "notes": _notes(diagnosis),
        "warning": weaker_verdict_warning(diagnosis),
        "picture": picture,
    }


def _figure_caption(side: LabelledComparison, worst: tuple[bool, int]) -> str:
    """Caption of the figure of the worst channel."""
    nonperiodic, channel = worst
    recording = side.recording
    name = f"{recording.name}, {recording.channels[channel]}"
    if nonperiodic:
        return f"{name}: non-periodic residual over the record. Grey: ± 2 standard deviations of the noise."
    if recording.repeats == 1:
        event = " Yellow: a transient event, excluded from the noise estimate." if side.comparison.noise.events else ""
        return f"Residual of {name}. Grey: ± {side.noise_label}.{event}"
    mean = f"mean over {recording.repeats} repeats"
    return f"Residual of {name}, {mean}. Grey: ± noise of one sample; darker: ± noise of the mean."


def _sentences(diagnosis: Diagnosis, number: int, channel: int) -> list[str]:
    """What was decided and found; the error is that of a channel of the recording with this number."""
    reductions = [_error_reduction_sentence([s.training[number] for s in diagnosis.steps], channel, "")]
    if diagnosis.steps[0].validation:
        held_out = [s.validation[0] for s in diagnosis.steps]
        reductions.append(
            _error_reduction_sentence(held_out, channel, f"On {held_out[0].recording.name} (held out, not fitted): ")
        )
    gravity = [] if diagnosis.gravity is None else [diagnosis.gravity.sentence]
    points = filter(None, map(fixed_point_sentence, diagnosis.findings))
    reading = [doubted.sentence for doubted in diagnosis.readings]
    doubts = [*diagnosis.averaged.sentences, *given_sentences(diagnosis)]
    return [*reading, *doubts, *gravity, *reductions, *points, *disturbance_sentences(diagnosis)]


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
    return [
        *evidence_notes(diagnosis),
        CONVENTION_SENTENCES[diagnosis.model.convention]
        + (" The sensor's y axis runs along the tip." if diagnosis.model.mirror_y else ""),
        f"Tolerance: {'as stated in the rig file' if stated else 'a tenth of the noise floor'}.",
        f"Lack-of-fit test of the final model: p = {p_value}".replace("p = <", "p <") + " (significant below 0.01).",
    ]


# Section of one recording: time series, residual maps, spectrum, non-periodic residual.


MAX_MAP_VARIABLES = 6
"""Variables of the residual maps of a channel: those that explain most of its residual."""


@dataclass(frozen=True)
class RecordingSection:
    """Figures of one recording; `disturbances` are sentences on its recording-specific disturbances.

    zoomable, zoomable_spectra   drawn at a reader's request: a figure for each of `series`, a spectrum by channel
    """

    name: str
    facts: str
    fitted: bool
    repeats: bool
    series: tuple[SvgImage, ...]
    zoomable: tuple[InteractiveFigure, ...] = ()
    zoomable_spectra: tuple[tuple[str, InteractiveFigure], ...] = ()
    nonperiodic: SvgImage | None = None
    maps: tuple[SvgImage, ...] = ()
    spectrum: SvgImage | None = None
    disturbances: tuple[str, ...] = ()


Sides = Sequence[LabelledComparison]


def sharing_numbers(sections: Iterable[RecordingSection]) -> list[RecordingSection]:
    """The sections of a page, their interactive figures sharing the numbers that a page holds."""
    shown = list(sections)
    spectra = [figure for section in shown for _, figure in section.zoomable_spectra]
    columns = shared_columns([f.chart for f in (*spectra, *(f for section in shown for f in section.zoomable))])
    return [
        replace(
            section,
            zoomable=tuple(replace(f, columns=columns) for f in section.zoomable),
            zoomable_spectra=tuple((name, replace(f, columns=columns)) for name, f in section.zoomable_spectra),
        )
        for section in shown
    ]


def full_section(sides: Sides, tolerance: Mapping[str, float]) -> RecordingSection:
    """Time series, residual maps and spectrum of one recording."""
    recording = sides[0].recording
    periodic = recording.repeats > 1 and recording.continuous and not recording.at_rest
    alt = "Amplitude spectrum of the residual, per channel."
    return replace(
        short_section(sides, fitted=True),
        maps=_map_images(sides, tolerance),
        spectrum=None if recording.at_rest else SvgImage(lambda: residual_spectrum_figure(sides), alt),
        zoomable_spectra=()
        if recording.at_rest
        else tuple(
            (name, InteractiveFigure(residual_spectrum_chart(sides, i))) for i, name in enumerate(recording.channels)
        ),
        nonperiodic=_nonperiodic_residual_image(sides) if periodic else None,
    )


def short_section(sides: Sides, *, fitted: bool) -> RecordingSection:
    """Facts and time series of a recording."""
    recording = sides[0].recording
    return RecordingSection(
        recording.name, recording_facts(recording), fitted, repeats=recording.repeats > 1,
        series=_series_images(sides),
        zoomable=tuple(InteractiveFigure(overlaid_chart(sides, i)) for i in range(len(recording.channels))),
    )  # fmt: skip


def _nonperiodic_residual_image(sides: Sequence[LabelledComparison]) -> SvgImage:
    """Non-periodic residual; of the final model alone where the effects added do not change it."""
    first, last = nonperiodic_residual(sides[0])[1], nonperiodic_residual(sides[-1])[1]
    unchanged = np.all(np.abs(first - last).max(axis=0) < 0.2 * std_of_interval_means(sides[0]))
    shown = sides[-1:] if unchanged else sides
    return SvgImage(lambda: nonperiodic_residual_figure(shown), "Non-periodic residual over the record.")


def diagnosis_sections(diagnosis: Diagnosis) -> list[RecordingSection]:
    """A section for each fitted recording, then for each validation one, with its recording-specific disturbances."""
    fitted = [compared_models(diagnosis, i) for i in range(len(diagnosis.steps[0].training))]
    held_out = [compared_models(diagnosis, i, held_out=True) for i in range(len(diagnosis.steps[0].validation))]
    said = list(zip(diagnosis.disturbances, disturbance_sentences(diagnosis), strict=True))
    tested = (
        replace(
            short_section(sides, fitted=False),
            disturbances=tuple(sentence for d, sentence in said if d.recording is sides[0].recording),
        )
        for sides in held_out
    )
    return sharing_numbers([*(full_section(sides, diagnosis.tolerance) for sides in fitted), *tested])


def _series_images(sides: Sequence[LabelledComparison]) -> tuple[SvgImage, ...]:
    return tuple(
        SvgImage(partial(_series_figure, sides, i), f"{c}: measured and predicted; below, the residual.")
        for i, c in enumerate(sides[0].recording.channels)
    )


def _series_figure(sides: Sides, channel: int) -> Figure:
    return matplotlib_figure(time_series_chart(sides, channel))


def _map_images(sides: Sequence[LabelledComparison], tolerance: Mapping[str, float]) -> tuple[SvgImage, ...]:
    """Residual maps of each channel against the variables that explain most of the rigid tool's residual."""
    maps = [residual_maps(s.comparison, tolerance) for s in sides]
    images = []
    for channel in sides[0].recording.channels:
        variables = [m.variable for m in maps[0] if m.channel == channel][:MAX_MAP_VARIABLES]
        chosen = [[_map_of(maps_of_side, channel, v) for v in variables] for maps_of_side in maps]
        labelled = [(s.label, row) for s, row in zip(sides, chosen, strict=True)]
        count = sum(int(m.practically_significant.sum()) for m in chosen[0])
        alt = f"{channel} against {', '.join(variables)}, rigid tool: {count} significant cells above tolerance."
        images.append(SvgImage(partial(residual_map_figure, labelled), alt))
    return tuple(images)


def _map_of(maps: Sequence[ResidualMap], channel: str, variable: str) -> ResidualMap:
    return next(m for m in maps if m.channel == channel and m.variable == variable)


def recording_facts(recording: Recording) -> str:
    """Length, repeats and sampling rate of a recording."""
    once = recording.samples_per_repeat
    if recording.at_rest or recording.dt is None:
        poses = f"{once} static poses"
        return poses if recording.repeats == 1 else f"{poses}, {recording.repeats} times"
    rate, span = format_number(1 / recording.dt), format_number(once * recording.dt)
    if recording.repeats == 1:
        return f"a single run of {recording.samples} samples, {span} s at {rate} Hz"
    kind = "without pause" if recording.continuous else "as separate runs"
    return f"{recording.repeats} repeats {kind}, {once} samples each, {span} s at {rate} Hz"


def write_report(diagnosis: Diagnosis, path: str | Path, provenance: Provenance | None = None) -> Path:
    """Write the diagnosis as one HTML file, atomically; return its path.

    Figures, styles and script are embedded, nothing is fetched. Raises InputError when it cannot be written.
    """
    target = Path(path)
    with atomic_write(target) as temporary:
        temporary.write_text(report_page(diagnosis, provenance), encoding="utf-8")
    return target


def report_page(diagnosis: Diagnosis, provenance: Provenance | None = None) -> str:
    """The report as HTML text; names given by users are escaped."""
    return html_page("report.html", _values(diagnosis, provenance or Provenance.now()))


def diagnosis_report(diagnosis: Diagnosis, provenance: Provenance) -> ReportTexts:
    """The report as HTML and as Markdown; names given by users are escaped."""
    return ReportTexts.of("report", _values(diagnosis, provenance))


def _values(diagnosis: Diagnosis, provenance: Provenance) -> dict[str, Any]:
    """What the templates show."""
    rows = [effect_row(f, diagnosis.model.space, diagnosis.findings) for f in diagnosis.findings]
    has_repeats = all(c.explainable_rms is not None for c in diagnosis.steps[0].training)
    series = diagnosis.steps, step_names(diagnosis), diagnosis.tolerance
    leading = [r for r in rows if r.finding.verdict in (EffectVerdict.SUPPORTED, EffectVerdict.CONFUSABLE)]
    changed = bool(diagnosis.added)
    return {
        "title": _title(diagnosis),
        "rig": _rig_name(diagnosis),
        "provenance": provenance,
        "head": verdict_section(diagnosis, rows),
        "error_image": error_reduction_image(*series) if changed or has_repeats else None,
        "error_table": error_table(*series),
        "has_repeats": has_repeats,
        "total_rms_note": TOTAL_RMS_NOTE,
        "steps_heading": "Error after each selection step" if changed else f"Error of the {base_name(diagnosis)}",
        "recordings": diagnosis_sections(diagnosis),
        "cards": effect_cards(diagnosis.fit),
        "cards_heading": "The effects of the model" if diagnosis.steps[0].fit.model.effects else "The effects added",
        "leading": leading,
        "others": [r for r in rows if r not in leading],
        "findings_table": findings_table(diagnosis),
        "candidates_note": CANDIDATES_NOTE,
        "expanded": diagnosis.verdict in (RecordVerdict.UNEXPLAINED, RecordVerdict.PARTLY_EXPLAINED),
        "changed": changed,
        "base_name": base_name(diagnosis),
        "parameters": ParameterChanges(
            diagnosis.steps[0].fit if changed else None, diagnosis.fit, known=not diagnosis.tool_unknown
        ),
        "unknown_tool": unknown_tool_sentences(diagnosis.tool_unknown),
        "tool": []
        if diagnosis.tool_unknown
        else [
            *load_sentences(diagnosis.fit.recordings, diagnosis.fit.model),
            *tool_notes(diagnosis.fit, misfitting=bool(diagnosis.misfitting)),
        ],
        "zero_shift": _by_channel(diagnosis, diagnosis.zero_shift or {}),
        "unexplained": diagnosis.unexplained,
        "unexplained_sizes": _by_channel(
            diagnosis, diagnosis.unexplained.explainable_rms if diagnosis.unexplained else {}
        ),
    }


def findings_table(diagnosis: Diagnosis) -> Table:
    """Every candidate effect: verdict, p-value, share of the systematic error removed, and why."""
    numbers = (Column("p", format=P_VALUE), Column("error removed", format=SHARE))
    rows = [
        (f.effect.id, EFFECT_VERDICT_LABELS[f.verdict], f.p_value, f.significant_share, finding_sentence(f))
        for f in diagnosis.findings
    ]
    return Table.of(("effect", "verdict", *numbers, "why"), rows)


def _title(diagnosis: Diagnosis) -> str:
    names = ", ".join(c.recording.name for c in diagnosis.steps[0].training)
    return f"{RECORD_VERDICT_LABELS[diagnosis.verdict]}: {names}"


def _rig_name(diagnosis: Diagnosis) -> str:
    rig = diagnosis.steps[0].training[0].recording.rig
    return rig.name if rig is not None else ""


def _by_channel(diagnosis: Diagnosis, values: Mapping[str, float | None]) -> list[FormattedQuantity]:
    units = diagnosis.model.space.channel_units
    return [FormattedQuantity.of(c, v, units[c]) for c, v in values.items() if v is not None]
