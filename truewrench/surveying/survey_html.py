"""HTML page of a survey."""

from __future__ import annotations

from base64 import b64encode
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from hashlib import sha256
from math import inf
from pathlib import Path
from typing import Any

from modeling.number_format import NO_VALUE, FormattedQuantity, format_number, format_unit
from truewrench.files.output import atomic_write
from truewrench.reports.effect_row import MAX_SHOWN_PARAMETERS, quantities
from truewrench.reports.page_templates import page_templates
from truewrench.surveying.change_detection import significant_changes
from truewrench.surveying.diagnosis_outcome import DiagnosisOutcome
from truewrench.surveying.parquet_table import write_parquet
from truewrench.surveying.quantity_series import rows_in_time_order
from truewrench.surveying.recording_time import TimeSource
from truewrench.surveying.survey_row import SurveyRow
from truewrench.surveying.time_images import survey_image
from truewrench.text.verdict_words import RECORD_VERDICT_LABELS

ERROR = "error"
VERDICT_LABELS: Mapping[str, str] = {verdict.value: label for verdict, label in RECORD_VERDICT_LABELS.items()} | {
    ERROR: "Error"
}
"""Label of each verdict, in order from nothing missing to error."""
COLUMNS = ("file", "recorded", "verdict", "added", "misfit", "error", "seconds")
"""Sortable columns, in order."""
MAX_SHOWN_CHANGES = 8
"""Changes shown; the rest is collapsed."""


@dataclass(frozen=True)
class TableLine:
    """Table line of one recording, as text."""

    file: str
    recorded: str
    by_name: bool
    verdict: str
    label: str
    sizes: tuple[FormattedQuantity, ...]
    more_sizes: tuple[FormattedQuantity, ...]
    misfit: str
    fall: str
    seconds: str
    error: str


def write_survey(rows: Sequence[SurveyRow], table: Path, page: Path) -> None:
    """Write the Parquet table and the page atomically, both or neither.

    Raises InputError when they cannot be written.
    """
    with ExitStack() as files:
        parquet, html = (files.enter_context(atomic_write(path)) for path in (table, page))
        write_parquet(rows, parquet)
        html.write_text(survey_page(rows), encoding="utf-8")


def survey_page(rows: Sequence[SurveyRow]) -> str:
    """The page as HTML text; file names are escaped, and the rows are embedded as JSON.

    Its content security policy allows only its own script, by hash.
    """
    templates = page_templates()
    template = templates.get_template("survey.html")
    script = templates.loader.get_source(templates, "survey.js")[0] if templates.loader else ""
    counts = Counter(row.outcome.verdict or ERROR for row in rows)
    changes = significant_changes(rows)
    return template.render(
        script=script,
        script_hash=b64encode(sha256(script.encode()).digest()).decode(),
        title=survey_headline(rows),
        counts=[(v, label, counts[v]) for v, label in VERDICT_LABELS.items() if counts[v]],
        effects=Counter(effect for row in rows for effect in row.outcome.added).most_common(),
        changes=[str(change) for change in changes[:MAX_SHOWN_CHANGES]],
        more_changes=[str(change) for change in changes[MAX_SHOWN_CHANGES:]],
        picture=survey_image(rows, changes, VERDICT_LABELS),
        times=time_sentence(rows),
        lines=[table_line(row) for row in rows],
        data=page_data(rows),
    )


def page_data(rows: Sequence[SurveyRow]) -> dict[str, Any]:
    """JSON of the page: the rows, and the sort keys by column; None sorts last."""
    keys = [_sort_keys(row) for row in rows]
    return {"rows": [row.to_data() for row in rows], "keys": {c: [k[c] for k in keys] for c in COLUMNS}}


def survey_headline(rows: Sequence[SurveyRow]) -> str:
    """Number of recordings, and of those with an adequate model."""
    explained = sum(row.outcome.verdict in ("nothing_missing", "explained") for row in rows)
    return f"{len(rows)} recording{'' if len(rows) == 1 else 's'}; {explained} with nothing missing or explained"


def time_sentence(rows: Sequence[SurveyRow]) -> str:
    """Sources of the recording times."""
    known = [row.time.source for row in rows if row.time is not None]
    sources = {source: known.count(source) for source in TimeSource if source in known}
    sources_text = {
        TimeSource.FILE_NAME: "from the file name",
        TimeSource.MODIFICATION: "from the modification time of the file, as its name has none (marked ~)",
    }
    parts = [f"{count} {sources_text[source]}" for source, count in sources.items()]
    without = len(rows) - len(known)
    parts += [f"{without} unknown, no file"] if without else []
    excluded = len(known) - len(rows_in_time_order(rows))
    note = f" Not compared with these, nor plotted: {excluded} of the other source." if excluded else ""
    return f"Local times: {'; '.join(parts)}.{note}"


def table_line(row: SurveyRow) -> TableLine:
    """One recording as text."""
    outcome, time = row.outcome, row.time
    verdict = outcome.verdict or ERROR
    without_parameters = [
        FormattedQuantity(e, "", "") for e in outcome.added if all(size.effect != e for size in outcome.sizes)
    ]
    known = ((s.name, s.value, inf if s.std is None else s.std, s.unit) for s in outcome.sizes)
    sizes = [*without_parameters, *quantities(known)]
    return TableLine(
        file=row.file,
        recorded=NO_VALUE if time is None else f"{time.moment:%Y-%m-%d %H:%M:%S}",
        by_name=time is None or time.source is TimeSource.FILE_NAME,
        verdict=verdict,
        label=VERDICT_LABELS[verdict],
        sizes=tuple(sizes[:MAX_SHOWN_PARAMETERS]),
        more_sizes=tuple(sizes[MAX_SHOWN_PARAMETERS:]),
        misfit=_before_and_after(outcome.misfit_before, outcome.misfit, changed=bool(outcome.added)),
        fall=_error_text(outcome),
        seconds=NO_VALUE if outcome.seconds is None else f"{outcome.seconds:.1f}",
        error=outcome.error,
    )


def _error_text(outcome: DiagnosisOutcome) -> str:
    channel = outcome.loudest
    if channel is None:
        return NO_VALUE
    errors = _before_and_after(channel.before, channel.after, changed=bool(outcome.added))
    return f"{channel.channel}: {errors} {format_unit(channel.unit)}"


def _before_and_after(before: float | None, after: float | None, *, changed: bool) -> str:
    return f"{format_number(before)} → {format_number(after)}" if changed else format_number(after)


def _sort_keys(row: SurveyRow) -> dict[str, str | float | None]:
    outcome, channel = row.outcome, row.outcome.loudest
    after = None if channel is None else channel.after
    return {
        "file": row.file,
        "recorded": None if row.time is None else row.time.moment.isoformat(),
        "verdict": list(VERDICT_LABELS).index(outcome.verdict or ERROR),
        "added": " ".join(outcome.added) or None,
        "misfit": outcome.misfit,
        "error": None if channel is None or after is None else after / (channel.noise_floor or 1.0),
        "seconds": outcome.seconds,
    }
