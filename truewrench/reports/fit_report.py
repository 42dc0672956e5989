"""Report of a fit: whether the model fits, its parameters, and its residual on every recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

from diagnosis.comparison.comparison import Comparison
from diagnosis.study import Study
from diagnosis.verdict.upper_limit import channel_tolerance
from modeling.number_format import axis_label
from modeling.significance import LEVELS
from modeling.table import Column, Table
from truewrench.plots.residuals.labelled_comparison import LabelledComparison
from truewrench.plots.style import ADEQUATE_COLOUR, MISFIT_COLOUR
from truewrench.reports.effect_card import effect_cards
from truewrench.reports.parameter_changes import ParameterChanges
from truewrench.reports.provenance import Provenance
from truewrench.reports.recording_section import RecordingSection, full_section, line_count, short_section
from truewrench.reports.report_files import ReportTexts
from truewrench.reports.zoom.zoomable_figure import points_of_line
from truewrench.text.fit_summary import FitSummary


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
        "unknown_tool": summary.unknown_tool,
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
    points = points_of_line(line_count([*fitted, *held_out]))
    tolerance, _ = channel_tolerance(summary.fit)
    return [
        *(full_section(sides, tolerance, points) for sides in fitted),
        *(short_section(sides, points, fitted=False) for sides in held_out),
    ]


def _side(comparison: Comparison) -> LabelledComparison:
    colour = ADEQUATE_COLOUR if comparison.lack_of_fit >= LEVELS.effect else MISFIT_COLOUR
    return LabelledComparison("the fitted model", colour, comparison)
