"""Page: a diagnosis as one page that shows where the model fails before it says so, and needs no network."""

from __future__ import annotations

import os
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined

from diagnosis.diagnosis import Diagnosis
from diagnosis.verdict import RecordVerdict
from truewrench.plots.number import figures, labelled, unit_text, with_std
from truewrench.plots.staircase_plot import flights
from truewrench.report.effect_row import effect_row
from truewrench.report.left import left_of
from truewrench.report.opening import LABELS, opening_of
from truewrench.report.quantity import Quantity
from truewrench.report.recording_section import held_out_sections, trained_sections
from truewrench.report.stair_table import stair_table, staircase_image


def write_report(diagnosis: Diagnosis, path: str | Path) -> Path:
    """Write the diagnosis as one HTML file, beside its place first and then renamed into it; its path.

    Pictures, style and text are all inside; nothing is fetched when it is opened. Raises OSError when the
    place cannot be written.
    """
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    beside = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        beside.write_text(report_page(diagnosis), encoding="utf-8")
        beside.replace(target)
    finally:
        beside.unlink(missing_ok=True)
    return target


def report_page(diagnosis: Diagnosis) -> str:
    """The report as HTML text. Names that users gave are escaped."""
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
        opening=opening_of(diagnosis, rows),
        channels=_channel_headings(diagnosis),
        tolerance=[figures(v, 2) for v in diagnosis.tolerance.values()],
        staircase=staircase_image(diagnosis) if diagnosis.added or has_repeats else None,
        stairs=[stair_table(diagnosis, flight) for flight in flights(diagnosis)],
        has_repeats=has_repeats,
        steps_heading="How the error falls" if diagnosis.added else "How large the error is",
        recordings=[*trained_sections(diagnosis), *held_out_sections(diagnosis)],
        leading=leading,
        others=[r for r in rows if r not in leading],
        unfolded=diagnosis.verdict in (RecordVerdict.UNEXPLAINED, RecordVerdict.PARTLY_EXPLAINED),
        parameters=parameter_groups(diagnosis),
        zero_shift=_zero_shift(diagnosis),
        left=left_of(diagnosis),
    )


def _title(diagnosis: Diagnosis) -> str:
    names = ", ".join(c.recording.name for c in diagnosis.steps[0].training)
    return f"{LABELS[diagnosis.verdict]}: {names}"


def _rig_name(diagnosis: Diagnosis) -> str:
    rig = diagnosis.steps[0].training[0].recording.rig
    return rig.name if rig is not None else ""


def _channel_headings(diagnosis: Diagnosis) -> list[str]:
    space = diagnosis.model.space
    return [labelled(c, u) for c, u in zip(space.channels, space.units, strict=True)]


def _zero_shift(diagnosis: Diagnosis) -> list[Quantity]:
    units = dict(zip(diagnosis.model.space.channels, diagnosis.model.space.units, strict=True))
    return [Quantity(c, figures(v), unit_text(units[c])) for c, v in (diagnosis.zero_shift or {}).items()]


def parameter_groups(diagnosis: Diagnosis) -> list[tuple[str, list[Quantity]]]:
    """Parameters of the last fit: the tool's, each effect's, and the zeros of further recordings."""
    estimates = diagnosis.fit.parameters
    titles = {e.id: e.title for e in diagnosis.model.effects}
    groups: dict[str, list[Quantity]] = {}
    for name, e in estimates.items():
        effect, dot, own = name.partition(".")
        zero, at, recording = name.partition("@")
        group = f"Zero in {recording}" if at else titles.get(effect, effect) if dot else "Tool and zero"
        shown = zero if at else own if dot else name
        groups.setdefault(group, []).append(Quantity(shown, with_std(e.value, e.std), unit_text(e.unit)))
    return list(groups.items())
