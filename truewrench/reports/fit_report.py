"""Report of a fit: whether the model fits, its parameters, and its residual on every recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

from diagnosis.comparison.comparison import Comparison
from diagnosis.comparison.model_comparison import ModelComparison
from diagnosis.study import Study
from diagnosis.verdict.aliasing import channel_tolerance
from diagnosis.verdict.unexplained_residual import unknown_tool_sentences
from modeling.number_format import axis_label
from modeling.significance import LEVELS
from modeling.table import Column, Table
from truewrench.plots.style import ADEQUATE_COLOUR, HELD_OUT, MISFIT_COLOUR
from truewrench.plots.time_series_plot import LabelledComparison
from truewrench.reports.effect_row import effect_cards
from truewrench.reports.parameter_changes import ParameterChanges
from truewrench.reports.report_files import Provenance, ReportTexts
from truewrench.reports.report_html import RecordingSection, full_section, sharing_numbers, short_section
from truewrench.text.fit_summary import FitSummary
from truewrench.text.tool_text import tool_notes

# Report of a comparison: several models on the same recordings.


COLOURS = (MISFIT_COLOUR, ADEQUATE_COLOUR, HELD_OUT)
"""Of the models in the pictures, in the order given; more models are in the tables alone."""


def comparison_report(comparison: ModelComparison, provenance: Provenance) -> ReportTexts:
    """The report as HTML and as Markdown; names given by users are escaped."""
    return ReportTexts.of("comparison", _comparison_values(comparison, provenance))


def _comparison_values(comparison: ModelComparison, provenance: Provenance) -> dict[str, Any]:
    rig = comparison.recordings[0].rig
    sentences = [_begun(sentence) for sentence in comparison.remarks()]
    names = [model.name for model in comparison.models]
    return {
        "title": f"Comparison: {', '.join(names)}",
        "rig": "" if rig is None else rig.name,
        "provenance": provenance,
        "headline": sentences[0].removesuffix(".") if len(sentences) == 1 else _best(comparison),
        "sentences": sentences,
        "errors": comparison.table,
        "parameters": comparison.parameter_table,
        "bands": comparison.band_table,
        "recordings": _comparison_sections(comparison),
        "drawn": names[: len(COLOURS)],
        "omitted": names[len(COLOURS) :],
    }


def _begun(sentence: str) -> str:
    """With a capital, unless the name of a model comes first."""
    return f"No {sentence.removeprefix('no ')}" if sentence.startswith("no ") else sentence


def _best(comparison: ModelComparison) -> str:
    """The model of the smallest information criterion, and whether all others are significantly worse."""
    best = min(comparison.models, key=lambda model: model.information_criterion)
    worse = [d for d in comparison.differences if d.better == best.name]
    if len(comparison.models) == 1:
        return f"One model: {best.name}"
    sure = len(worse) == len(comparison.models) - 1 and all(d.p_value < LEVELS.effect for d in worse)
    return f"{best.name} is best" + ("" if sure else ", but not significantly better than every other model")


def _comparison_sections(comparison: ModelComparison) -> list[RecordingSection]:
    recordings = [
        [
            LabelledComparison(model.name, colour, model.predictions[number].comparison)
            for model, colour in zip(comparison.models, COLOURS, strict=False)
        ]
        for number in range(len(comparison.recordings))
    ]
    return sharing_numbers(full_section(sides, _tenth_of_noise(sides[0])) for sides in recordings)


def _tenth_of_noise(side: LabelledComparison) -> dict[str, float]:
    """Tolerance of the residual maps, as the default one of a diagnosis is."""
    return {channel: floor / 10 for channel, floor in side.comparison.noise_floor.items()}


@dataclass(frozen=True)
class StudySteps:
    """The steps of a study, each with what changed, and the error of each channel after each."""

    steps: Table
    stairs: Table

    @classmethod
    def of(cls, study: Study) -> Self:
        """The steps up to the current one."""
        first, *others = study.table.columns
        rows = [(row[0], s.change, *row[1:]) for row, s in zip(study.table.rows, study.steps, strict=True)]
        return cls(Table.of((first, "change", *others), rows), study.stairs().table)


def study_report(study: Study, provenance: Provenance) -> ReportTexts:
    """The report of a study's current model, with the steps that led to it."""
    summary = FitSummary(study.fit, study.fit.intervals(), validation=study.steps[-1].validation)
    return fit_report(summary, provenance, steps=StudySteps.of(study))


def fit_report(
    summary: FitSummary, provenance: Provenance, frames: Sequence[str] = (), steps: StudySteps | None = None
) -> ReportTexts:
    """The report as HTML and as Markdown; `frames` are sentences on what the data decided of frames."""
    values = _values(summary, provenance) | {"notes": [*frames, *summary.fit.remarks()], "study": steps}
    return ReportTexts.of("fit", values)


def _values(summary: FitSummary, provenance: Provenance) -> dict[str, Any]:
    fit = summary.fit
    rig = fit.recordings[0].rig
    headline, _, remark = summary.headline().partition(": ")
    doubtful = summary.misfitting or summary.deviating or not fit.converged
    return {
        "title": f"Fit: {', '.join(r.name for r in fit.recordings)}",
        "rig": "" if rig is None else rig.name,
        "provenance": provenance,
        "kind": "unexplained" if doubtful else "explained",
        "symbol": "?" if doubtful else "✓",
        "headline": headline,
        "remark": f"{remark[:1].upper()}{remark[1:]}",
        "errors": _error_table(summary),
        "parameters": ParameterChanges(None, fit, known=not summary.unknown_tool),
        "tool": [] if summary.unknown_tool else tool_notes(fit, misfitting=bool(summary.misfitting)),
        "unknown_tool": unknown_tool_sentences(summary.unknown_tool),
        "cards": effect_cards(fit),
        "recordings": _sections(summary),
    }


def _error_table(summary: FitSummary) -> Table:
    """RMS, noise floor and systematic error of each channel of each recording."""
    sizes = (Column(name, format=".3g") for name in ("residual (RMS)", "noise floor", "systematic (RMS)"))
    measures = (Column("reduced chi-square", format=".3g"), Column("lack-of-fit p", format="p"))
    rows: list[tuple[Any, ...]] = []
    for label, compared in (("fitted", summary.comparisons), ("held out", summary.validation)):
        rows += [row for c in compared for row in _error_rows(c, label)]
    return Table.of(("recording", "channel", *sizes, *measures), rows)


def _error_rows(comparison: Comparison, label: str) -> list[tuple[Any, ...]]:
    name, units = comparison.recording.name, comparison.space.channel_units
    systematic = {} if comparison.explainable_rms is None else {c: comparison.systematic_cell(c) for c in units}
    rows: list[tuple[Any, ...]] = [
        (f"{name} ({label})", axis_label(c, units[c]), rms, comparison.noise_floor[c], systematic.get(c), None, None)
        for c, rms in comparison.rms.items()
    ]
    rows[0] = (*rows[0][:-2], comparison.misfit, comparison.lack_of_fit)
    return rows


def _sections(summary: FitSummary) -> list[RecordingSection]:
    fitted = [[_side(c)] for c in summary.comparisons]
    held_out = [[_side(c)] for c in summary.validation]
    tolerance, _ = channel_tolerance(summary.fit)
    return sharing_numbers(
        [
            *(full_section(sides, tolerance) for sides in fitted),
            *(short_section(sides, fitted=False) for sides in held_out),
        ]
    )


def _side(comparison: Comparison) -> LabelledComparison:
    colour = ADEQUATE_COLOUR if comparison.lack_of_fit >= LEVELS.effect else MISFIT_COLOUR
    return LabelledComparison("the fitted model", colour, comparison)
