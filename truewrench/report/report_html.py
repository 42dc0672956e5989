"""HTML report of a diagnosis, self-contained."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from diagnosis.comparison.error_table import error_table
from diagnosis.diagnosis import Diagnosis
from diagnosis.verdict.verdict import EffectVerdict, RecordVerdict
from modeling.number_format import (
    FormattedQuantity,
)
from truewrench.files.output import atomic_write
from truewrench.plots.error_reduction_plot import error_reduction_image
from truewrench.report.effect_row import effect_row
from truewrench.report.page_templates import page_templates
from truewrench.report.recording_section import fitted_sections, held_out_sections
from truewrench.report.verdict_section import verdict_section
from truewrench.text.step_names import base_name, step_names
from truewrench.text.verdict_words import RECORD_VERDICT_LABELS


def write_report(diagnosis: Diagnosis, path: str | Path) -> Path:
    """Write the diagnosis as one HTML file, atomically; return its path.

    Figures and styles are embedded, nothing is fetched. Raises InputError when it cannot be written.
    """
    target = Path(path)
    with atomic_write(target) as temporary:
        temporary.write_text(report_page(diagnosis), encoding="utf-8")
    return target


def report_page(diagnosis: Diagnosis) -> str:
    """The report as HTML text; names given by users are escaped."""
    rows = [effect_row(f, diagnosis.model.space) for f in diagnosis.findings]
    has_repeats = all(c.explainable_rms is not None for c in diagnosis.steps[0].training)
    series = diagnosis.steps, step_names(diagnosis), diagnosis.tolerance
    leading = [r for r in rows if r.finding.verdict in (EffectVerdict.SUPPORTED, EffectVerdict.CONFUSABLE)]
    return (
        page_templates()
        .get_template("report.html")
        .render(
            title=_title(diagnosis),
            rig=_rig_name(diagnosis),
            head=verdict_section(diagnosis, rows),
            error_image=error_reduction_image(*series) if diagnosis.added or has_repeats else None,
            error_table=error_table(*series),
            has_repeats=has_repeats,
            steps_heading="Error after each selection step"
            if diagnosis.added
            else f"Error of the {base_name(diagnosis)}",
            recordings=[*fitted_sections(diagnosis), *held_out_sections(diagnosis)],
            leading=leading,
            others=[r for r in rows if r not in leading],
            expanded=diagnosis.verdict in (RecordVerdict.UNEXPLAINED, RecordVerdict.PARTLY_EXPLAINED),
            parameters=parameter_groups(diagnosis),
            zero_shift=_by_channel(diagnosis, diagnosis.zero_shift or {}),
            unexplained=diagnosis.unexplained,
            unexplained_sizes=_by_channel(
                diagnosis, diagnosis.unexplained.explainable_rms if diagnosis.unexplained else {}
            ),
        )
    )


def _title(diagnosis: Diagnosis) -> str:
    names = ", ".join(c.recording.name for c in diagnosis.steps[0].training)
    return f"{RECORD_VERDICT_LABELS[diagnosis.verdict]}: {names}"


def _rig_name(diagnosis: Diagnosis) -> str:
    rig = diagnosis.steps[0].training[0].recording.rig
    return rig.name if rig is not None else ""


def _by_channel(diagnosis: Diagnosis, values: Mapping[str, float | None]) -> list[FormattedQuantity]:
    units = diagnosis.model.space.channel_units
    return [FormattedQuantity.of(c, v, units[c]) for c, v in values.items() if v is not None]


def parameter_groups(diagnosis: Diagnosis) -> list[tuple[str, list[FormattedQuantity]]]:
    """Estimates of the final model: tool, each effect, and the biases of further recordings."""
    estimates = diagnosis.fit.parameters
    titles = {e.id: e.title for e in diagnosis.model.effects}
    groups: dict[str, list[FormattedQuantity]] = {}
    for name, e in estimates.items():
        effect, dot, short = name.partition(".")
        zero, at, recording = name.partition("@")
        group = f"Zero in {recording}" if at else titles.get(effect, effect) if dot else "Tool and zero"
        shown = zero if at else short if dot else name
        groups.setdefault(group, []).append(FormattedQuantity.of(shown, e.value, e.unit, e.std))
    return list(groups.items())
