"""Report of a comparison: several models on the same recordings."""

from __future__ import annotations

from typing import Any

from diagnosis.comparison.model_comparison import ModelComparison
from modeling.significance import LEVELS
from truewrench.plots.residuals.labelled_comparison import LabelledComparison
from truewrench.plots.style import ADEQUATE_COLOUR, HELD_OUT, MISFIT_COLOUR
from truewrench.reports.provenance import Provenance
from truewrench.reports.recording_section import RecordingSection, full_section, line_count
from truewrench.reports.report_files import ReportTexts
from truewrench.reports.zoom.zoomable_figure import points_of_line

COLOURS = (MISFIT_COLOUR, ADEQUATE_COLOUR, HELD_OUT)
"""Of the models in the pictures, in the order given; more models are in the tables alone."""


def comparison_report(comparison: ModelComparison, provenance: Provenance) -> ReportTexts:
    """The report as HTML and as Markdown; names given by users are escaped."""
    return ReportTexts.of("comparison", _values(comparison, provenance))


def _values(comparison: ModelComparison, provenance: Provenance) -> dict[str, Any]:
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
        "recordings": _sections(comparison),
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


def _sections(comparison: ModelComparison) -> list[RecordingSection]:
    recordings = [
        [
            LabelledComparison(model.name, colour, model.predictions[number].comparison)
            for model, colour in zip(comparison.models, COLOURS, strict=False)
        ]
        for number in range(len(comparison.recordings))
    ]
    points = points_of_line(line_count(recordings))
    return [full_section(sides, _tenth_of_noise(sides[0]), points) for sides in recordings]


def _tenth_of_noise(side: LabelledComparison) -> dict[str, float]:
    """Tolerance of the residual maps, as the default one of a diagnosis is."""
    return {channel: floor / 10 for channel, floor in side.comparison.noise_floor.items()}
