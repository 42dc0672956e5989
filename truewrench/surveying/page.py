"""Page: a survey as one HTML file that sorts by click, shows what changed over time, and needs no network."""

from __future__ import annotations

from base64 import b64encode
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from truewrench.output import replacing
from truewrench.plots.number import NOTHING, figures, unit_text, with_std
from truewrench.report.effect_row import SIZES
from truewrench.report.opening import LABELS
from truewrench.report.quantity import Quantity
from truewrench.surveying.change import changes_of
from truewrench.surveying.outcome import Outcome, Size
from truewrench.surveying.pictures import time_image
from truewrench.surveying.recording_time import TimeSource
from truewrench.surveying.row import Row
from truewrench.surveying.series import dated
from truewrench.surveying.table import write_table

ERROR = "error"
VERDICT_LABELS: Mapping[str, str] = {verdict.value: label for verdict, label in LABELS.items()} | {ERROR: "Error"}
"""Label of each verdict, from the best to the worst."""
COLUMNS = ("file", "recorded", "verdict", "added", "misfit", "error", "seconds")
"""Columns that sort, in their order."""
CHANGES = 8
"""Changes told at once; the rest unfolds."""


@dataclass(frozen=True)
class Line:
    """One recording as the table shows it, as text."""

    file: str
    recorded: str
    by_name: bool
    verdict: str
    label: str
    sizes: tuple[Quantity, ...]
    more_sizes: tuple[Quantity, ...]
    misfit: str
    fall: str
    seconds: str
    error: str


def write_survey(rows: Sequence[Row], table: Path, page: Path) -> None:
    """Write the Parquet table and the page, both or none, beside their places first.

    Raises InputError when they cannot be written.
    """
    with ExitStack() as files:
        parquet, html = (files.enter_context(replacing(path)) for path in (table, page))
        write_table(rows, parquet)
        html.write_text(survey_page(rows), encoding="utf-8")


def survey_page(rows: Sequence[Row]) -> str:
    """The page as HTML text; names of files are escaped, and the rows stand in it as JSON too.

    The page allows no script but its own, which its policy names by hash.
    """
    environment = Environment(
        loader=PackageLoader("truewrench"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    template = environment.get_template("survey.html")
    script = environment.loader.get_source(environment, "survey.js")[0] if environment.loader else ""
    counts = Counter(row.outcome.verdict or ERROR for row in rows)
    changes = changes_of(rows)
    return template.render(
        script=script,
        script_hash=b64encode(sha256(script.encode()).digest()).decode(),
        title=headline(rows),
        counts=[(v, label, counts[v]) for v, label in VERDICT_LABELS.items() if counts[v]],
        effects=Counter(effect for row in rows for effect in row.outcome.added).most_common(),
        changes=[str(change) for change in changes[:CHANGES]],
        more_changes=[str(change) for change in changes[CHANGES:]],
        picture=time_image(rows, changes, VERDICT_LABELS),
        times=time_sentence(rows),
        lines=[line_of(row) for row in rows],
        data=page_data(rows),
    )


def page_data(rows: Sequence[Row]) -> dict[str, Any]:
    """What the page holds as JSON: the rows, and by column what each sorts by; None comes last."""
    keys = [_sort_keys(row) for row in rows]
    return {"rows": [row.to_data() for row in rows], "keys": {c: [k[c] for k in keys] for c in COLUMNS}}


def headline(rows: Sequence[Row]) -> str:
    """How many recordings, and of how many nothing is left to explain."""
    explained = sum(row.outcome.verdict in ("nothing_missing", "explained") for row in rows)
    return f"{len(rows)} recording{'' if len(rows) == 1 else 's'}; in {explained} nothing is left to explain"


def time_sentence(rows: Sequence[Row]) -> str:
    """Where the times are known from."""
    every = [row.time.source for row in rows if row.time is not None]
    sources = {source: every.count(source) for source in TimeSource if source in every}
    words = {
        TimeSource.FILE_NAME: "from the name of the file",
        TimeSource.MODIFICATION: "from when the file was last modified, as its name has none (marked ~)",
    }
    parts = [f"{count} {words[source]}" for source, count in sources.items()]
    without = len(rows) - len(every)
    parts += [f"{without} unknown, for want of a file"] if without else []
    away = len(every) - len(dated(rows))
    note = f" Not compared with these, nor drawn: {away} of the other kind." if away else ""
    return f"Times are local. Known: {'; '.join(parts)}.{note}"


def line_of(row: Row) -> Line:
    """One recording as text."""
    outcome, time = row.outcome, row.time
    verdict = outcome.verdict or ERROR
    bare = [Quantity(e, "", "") for e in outcome.added if all(size.effect != e for size in outcome.sizes)]
    sizes = [*bare, *(_quantity(size) for size in most_certain(outcome.sizes))]
    return Line(
        file=row.file,
        recorded=NOTHING if time is None else f"{time.moment:%Y-%m-%d %H:%M:%S}",
        by_name=time is None or time.source is TimeSource.FILE_NAME,
        verdict=verdict,
        label=VERDICT_LABELS[verdict],
        sizes=tuple(sizes[:SIZES]),
        more_sizes=tuple(sizes[SIZES:]),
        misfit=_fall(outcome.misfit_before, outcome.misfit, changed=bool(outcome.added)),
        fall=_error_text(outcome),
        seconds=NOTHING if outcome.seconds is None else f"{outcome.seconds:.1f}",
        error=outcome.error,
    )


def most_certain(sizes: Sequence[Size]) -> list[Size]:
    """The sizes in their order; of more than the table shows at once the surest first."""
    if len(sizes) <= SIZES:
        return list(sizes)
    return sorted(sizes, key=lambda s: -abs(s.value or 0.0) / s.std if s.std else 0.0)


def _quantity(size: Size) -> Quantity:
    std = float("inf") if size.std is None else size.std
    return Quantity(size.name, NOTHING if size.value is None else with_std(size.value, std), unit_text(size.unit))


def _error_text(outcome: Outcome) -> str:
    channel = outcome.loudest
    if channel is None:
        return NOTHING
    fall = _fall(channel.before, channel.after, changed=bool(outcome.added))
    return f"{channel.channel}: {fall} {unit_text(channel.unit)}"


def _fall(before: float | None, after: float | None, *, changed: bool) -> str:
    return f"{figures(before)} → {figures(after)}" if changed else figures(after)


def _sort_keys(row: Row) -> dict[str, str | float | None]:
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
