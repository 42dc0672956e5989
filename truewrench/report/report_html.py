"""HTML report of a diagnosis, self-contained."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined

from diagnosis.diagnosis import Diagnosis
from diagnosis.verdict.verdict import RecordVerdict
from truewrench.plots.error_reduction_plot import recording_errors
from truewrench.report.effect_row import effect_row
from truewrench.report.error_table import error_reduction_image, error_reduction_table
from truewrench.report.recording_section import fitted_sections, held_out_sections
from truewrench.report.verdict_section import RECORD_VERDICT_LABELS, verdict_section
from truewrench.text.number_format import (
    FormattedQuantity,
    axis_label,
    format_number,
    format_percentage,
    format_unit,
    format_with_std,
)


@dataclass(frozen=True)
class UnexplainedSection:
    """Unexplained residual: where significant, generic terms that resemble it, systematic error."""

    where: str
    looks_like: tuple[str, ...]
    share: str
    sizes: tuple[FormattedQuantity, ...]


def unexplained_section(diagnosis: Diagnosis) -> UnexplainedSection | None:
    """Section on the unexplained residual; None without one."""
    residual = diagnosis.remainder
    if residual is None:
        return None
    units = dict(zip(diagnosis.model.space.channels, diagnosis.model.space.units, strict=True))
    known = {c: v for c, v in residual.explainable_rms.items() if v is not None}
    sizes = [FormattedQuantity(c, format_number(v), format_unit(units[c])) for c, v in known.items()]
    return UnexplainedSection(residual.where, residual.looks_like, format_percentage(residual.share), tuple(sizes))


def write_report(diagnosis: Diagnosis, path: str | Path) -> Path:
    """Write the diagnosis as one HTML file, atomically; return its path.

    Figures and styles are embedded, nothing is fetched. Raises OSError when it cannot be written.
    """
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        temporary.write_text(report_page(diagnosis), encoding="utf-8")
        temporary.replace(target)
    finally:
        temporary.unlink(missing_ok=True)
    return target


def report_page(diagnosis: Diagnosis) -> str:
    """The report as HTML text; names given by users are escaped."""
    environment = Environment(
        loader=PackageLoader("truewrench"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    rows = [effect_row(f, diagnosis.model.space) for f in diagnosis.findings]
    has_repeats = all(c.explainable_rms is not None for c in diagnosis.steps[0].training)
    leading = [r for r in rows if r.verdict in ("supported", "confusable")]
    return environment.get_template("report.html").render(
        title=_title(diagnosis),
        rig=_rig_name(diagnosis),
        head=verdict_section(diagnosis, rows),
        channels=_channel_headings(diagnosis),
        tolerance=[format_number(v, 2) for v in diagnosis.tolerance.values()],
        error_image=error_reduction_image(diagnosis) if diagnosis.added or has_repeats else None,
        error_tables=[error_reduction_table(diagnosis, errors) for errors in recording_errors(diagnosis)],
        has_repeats=has_repeats,
        steps_heading="Error after each selection step" if diagnosis.added else "Error of the rigid tool",
        recordings=[*fitted_sections(diagnosis), *held_out_sections(diagnosis)],
        leading=leading,
        others=[r for r in rows if r not in leading],
        expanded=diagnosis.verdict in (RecordVerdict.UNEXPLAINED, RecordVerdict.PARTLY_EXPLAINED),
        parameters=parameter_groups(diagnosis),
        zero_shift=_zero_shift(diagnosis),
        unexplained=unexplained_section(diagnosis),
    )


def _title(diagnosis: Diagnosis) -> str:
    names = ", ".join(c.recording.name for c in diagnosis.steps[0].training)
    return f"{RECORD_VERDICT_LABELS[diagnosis.verdict]}: {names}"


def _rig_name(diagnosis: Diagnosis) -> str:
    rig = diagnosis.steps[0].training[0].recording.rig
    return rig.name if rig is not None else ""


def _channel_headings(diagnosis: Diagnosis) -> list[str]:
    space = diagnosis.model.space
    return [axis_label(c, u) for c, u in zip(space.channels, space.units, strict=True)]


def _zero_shift(diagnosis: Diagnosis) -> list[FormattedQuantity]:
    units = dict(zip(diagnosis.model.space.channels, diagnosis.model.space.units, strict=True))
    return [
        FormattedQuantity(c, format_number(v), format_unit(units[c])) for c, v in (diagnosis.zero_shift or {}).items()
    ]


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
        groups.setdefault(group, []).append(
            FormattedQuantity(shown, format_with_std(e.value, e.std), format_unit(e.unit))
        )
    return list(groups.items())
