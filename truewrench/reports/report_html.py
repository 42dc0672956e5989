"""Report of a diagnosis: a self-contained HTML page, and Markdown."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from diagnosis.comparison.error_table import error_table
from diagnosis.diagnosis import Diagnosis
from diagnosis.verdict.verdict import EffectVerdict, RecordVerdict
from modeling.number_format import P_VALUE, SHARE, FormattedQuantity
from modeling.table import Column, Table
from truewrench.files.output import atomic_write
from truewrench.plots.error_reduction_plot import error_reduction_image
from truewrench.reports.effect_card import effect_cards
from truewrench.reports.effect_row import effect_row
from truewrench.reports.page_templates import html_page
from truewrench.reports.parameter_changes import ParameterChanges
from truewrench.reports.provenance import Provenance
from truewrench.reports.recording_section import diagnosis_sections
from truewrench.reports.report_files import ReportTexts
from truewrench.reports.verdict_section import verdict_section
from truewrench.text.step_names import base_name, step_names
from truewrench.text.verdict_words import (
    CANDIDATES_NOTE,
    EFFECT_VERDICT_LABELS,
    RECORD_VERDICT_LABELS,
    finding_sentence,
)


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
        "steps_heading": "Error after each selection step" if changed else f"Error of the {base_name(diagnosis)}",
        "recordings": diagnosis_sections(diagnosis),
        "cards": effect_cards(diagnosis.fit),
        "cards_heading": "The effects of the model" if diagnosis.given else "The effects added",
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
        "unknown_tool": diagnosis.tool_unknown,
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
