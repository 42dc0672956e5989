"""HTML page of a survey."""

from __future__ import annotations

from base64 import b64encode
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from enum import Enum
from hashlib import sha256
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter, date2num
from matplotlib.figure import Figure
from numpy.typing import NDArray

from estimation.multiplicity import f_sf
from modeling.number_format import NO_VALUE, FormattedQuantity, axis_label, format_number, format_p_value, format_unit
from modeling.significance import LEVELS
from truewrench.files.output import atomic_write
from truewrench.plots.style import ADEQUATE_COLOUR, FAINT, INK, LEGEND, MISFIT_COLOUR, PanelGrid, panel_title
from truewrench.plots.svg_image import SvgImage
from truewrench.reports.effect_row import MAX_SHOWN_PARAMETERS, quantities
from truewrench.reports.page_templates import page_templates
from truewrench.surveying.survey_task import DiagnosisOutcome, StoredEstimate, SurveyRow, TimeSource, write_parquet
from truewrench.text.diagnosis_text import RECORD_VERDICT_LABELS

Array = NDArray[np.float64]

# Time series of one quantity over recordings.


ADEQUATE_VERDICTS = ("nothing_missing", "explained")
"""Verdicts of an adequate model, whose stds are the whole uncertainty; with others there is systematic error too."""
DAY = 86400.0


@dataclass(frozen=True, eq=False)
class QuantitySeries:
    """One quantity over the times of the recordings, in time order.

    name, unit  such as `viscous_drag.c` and `N s/m`, or `m` and `kg`
    effect      id of its effect, empty for tool parameters
    moments     n local times
    value, std  (n,), in `unit`; the std inf where it is not identifiable
    trusted     (n,) whether the model was adequate, so that the std is the whole uncertainty
    """

    name: str
    unit: str
    effect: str
    moments: tuple[datetime, ...]
    value: Array
    std: Array
    trusted: NDArray[np.bool_]

    @property
    def days(self) -> Array:
        """Times in days since the first, (n,)."""
        return np.array([(moment - self.moments[0]).total_seconds() / DAY for moment in self.moments])


def rows_in_time_order(rows: Sequence[SurveyRow]) -> list[SurveyRow]:
    """Rows whose time is of the most frequent source, in time order; equal times in the given order.

    Times of different sources are not compared: copying a file changes its modification time.
    """
    sources = Counter(row.time.source for row in rows if row.time is not None)
    chosen = max(TimeSource, key=lambda source: sources[source])  # on a tie the file name
    return sorted((r for r in rows if r.time is not None and r.time.source is chosen), key=lambda row: row.moment)


def quantity_series(rows: Sequence[SurveyRow]) -> list[QuantitySeries]:
    """Quantities of at least two recordings: effects' parameters first, those of most recordings first.

    Parameters of a tool that is not known are left out. A recording given twice, or a copy of it, is one measurement.
    """
    measured: dict[DiagnosisOutcome, SurveyRow] = {}
    for row in rows_in_time_order(rows):
        measured.setdefault(replace(row.outcome, seconds=None), row)
    by_quantity: dict[tuple[str, str, str], list[tuple[SurveyRow, StoredEstimate]]] = {}
    for row in measured.values():
        tool = () if row.outcome.tool_unknown else row.outcome.parameters
        for size in (*row.outcome.sizes, *tool):
            if size.value is not None:
                by_quantity.setdefault((size.effect, size.parameter, size.unit), []).append((row, size))
    several = sorted(
        (pairs for pairs in by_quantity.values() if len(pairs) > 1), key=lambda p: (not p[0][1].effect, -len(p))
    )
    return [_series(pairs) for pairs in several]


def _series(pairs: Sequence[tuple[SurveyRow, StoredEstimate]]) -> QuantitySeries:
    first = pairs[0][1]
    return QuantitySeries(
        name=first.name,
        unit=first.unit,
        effect=first.effect,
        moments=tuple(row.moment for row, _ in pairs),
        value=np.array([size.value for _, size in pairs], dtype=np.float64),
        std=np.array([np.inf if size.std is None else size.std for _, size in pairs]),
        trusted=np.array([row.outcome.verdict in ADEQUATE_VERDICTS for row, _ in pairs]),
    )


# Trend and step tests of a quantity over recordings (weighted F test, Bonferroni).


MIN_RECORDINGS = 5
"""Recordings needed: a trend or a step has two parameters, and the scatter about it is estimated."""
CHANGE_KINDS = 2
"""Number of kinds of change tested: trend and step."""


class ChangeKind(Enum):
    """Kind of a change."""

    TREND = "trend"
    STEP = "step"


@dataclass(frozen=True, eq=False)
class QuantityChange:
    """A significant change of a quantity over recordings.

    before, after  level at the first and the last of the recordings used
    start, end     their times; of a step, the times of the recordings around it
    p_value        Bonferroni-corrected for both kinds, every location of a step, and the number of series tested
    """

    series: QuantitySeries
    kind: ChangeKind
    before: float
    after: float
    start: datetime
    end: datetime
    p_value: float

    def __str__(self) -> str:
        unit = format_unit(self.series.unit)
        verb = {
            (ChangeKind.TREND, True): "increases",
            (ChangeKind.TREND, False): "decreases",
            (ChangeKind.STEP, True): "steps up",
            (ChangeKind.STEP, False): "steps down",
        }[self.kind, self.after > self.before]
        levels = f"from {format_number(self.before)} to {format_number(self.after)}{' ' + unit if unit else ''}"
        return (
            f"{self.series.name} {verb} {levels} between {self.start:%Y-%m-%d %H:%M} and {self.end:%Y-%m-%d %H:%M} "
            f"(p = {format_p_value(self.p_value)})"
        ).replace("p = <", "p <")


def significant_changes(rows: Sequence[SurveyRow]) -> list[QuantityChange]:
    """Significant changes over the recordings with an adequate model, most significant first."""
    testable = [series for series in quantity_series(rows) if _usable(series).sum() >= MIN_RECORDINGS]
    changes = [change for series in testable if (change := significant_change(series, tests=len(testable))) is not None]
    return sorted(changes, key=lambda c: c.p_value)


def significant_change(series: QuantitySeries, *, tests: int = 1) -> QuantityChange | None:
    """The trend or step of a series if significant among `tests` series, else None.

    With weights 1/s_i² the chi-square of a constant is X_0, that of a line or a step X_1 with n - 2 degrees of freedom.
    The scatter between recordings may exceed the stds, which are those of one recording's noise alone: so
    F = (X_0 - X_1) / max(1, X_1 / (n - 2)) against F(1, n - 2). The kind with the smaller p-value is returned.
    """
    usable = _usable(series)
    count = int(usable.sum())
    if count < MIN_RECORDINGS:
        return None
    days, value, weight = series.days[usable], series.value[usable], series.std[usable] ** -2
    moments = [m for m, used in zip(series.moments, usable, strict=True) if used]
    fits = [_trend(days, value, weight), *(_step(days, value, weight, k) for k in range(1, count))]
    p_values = np.array([1.0 if fit is None else _p_value(value, weight, fit) for fit in fits])
    p_values[1:] *= count - 1
    best = int(p_values.argmin())
    p_value, levels = min(1.0, float(p_values[best]) * CHANGE_KINDS * tests), fits[best]
    if p_value >= LEVELS.drift_of_survey or levels is None:
        return None
    kind, place = (ChangeKind.STEP, (best - 1, best)) if best else (ChangeKind.TREND, (0, -1))
    start, end = (moments[i] for i in place)
    return QuantityChange(series, kind, float(levels[0]), float(levels[-1]), start, end, p_value)


def _usable(series: QuantitySeries) -> NDArray[np.bool_]:
    return np.asarray(series.trusted & np.isfinite(series.std) & (series.std > 0))


def _trend(days: Array, value: Array, weight: Array) -> Array | None:
    """Weighted regression line at the times, (n,); None where all times are equal."""
    centred = days - np.average(days, weights=weight)
    spread = (weight * centred**2).sum()
    if spread <= 0:
        return None
    return np.asarray(np.average(value, weights=weight) + centred * (weight * centred * value).sum() / spread)


def _step(days: Array, value: Array, weight: Array, place: int) -> Array | None:
    """Weighted means before and from recording `place` on, (n,); None where its time equals that of the one before."""
    if days[place] == days[place - 1]:
        return None
    means = [np.average(value[side], weights=weight[side]) for side in (slice(place), slice(place, None))]
    return np.repeat(means, [place, len(value) - place])


def _p_value(value: Array, weight: Array, levels: Array) -> float:
    freedom = len(value) - 2
    constant = (weight * (value - np.average(value, weights=weight)) ** 2).sum()
    residual = (weight * (value - levels) ** 2).sum()
    return float(f_sf(max(0.0, constant - residual) / max(1.0, residual / freedom), 1, freedom))


# Verdicts, errors and effect parameters of many recordings over time, one panel below the other.


COLOURS = {
    "nothing_missing": "#00619a",
    "explained": "#00724f",
    "partly_explained": "#9a6200",
    "unexplained": "#b03a00",
    "error": "#646c76",
}
"""Colour of each verdict, as in the report."""
MAX_PANELS = 8
"""Quantities plotted; those that change first."""
ALWAYS = ("m",)
"""Tool parameters plotted even without a change: the mass."""
PANEL = 92
"""Height of a panel in CSS pixels."""
MARGIN = 0.02
"""Share of the time span kept free at both ends."""
FORMATS = ["%Y", "%b %Y", "%d %b", "%H:%M", "%H:%M", "%H:%M:%S"]
ZERO_FORMATS = ["%Y", "%b %Y", "%d %b", "%d %b", "%H:%M", "%H:%M:%S"]
"""Of ticks at years, months, days, hours, minutes, seconds; and of those that begin the next larger unit."""


def survey_image(
    rows: Sequence[SurveyRow], changes: Sequence[QuantityChange], labels: Mapping[str, str]
) -> SvgImage | None:
    """Verdicts, errors and quantities over time; None for fewer than two recordings with a time."""
    shown = rows_in_time_order(rows)
    if len(shown) < 2:
        return None
    by_name = {change.series.name: change for change in changes}
    chosen = series_to_draw(quantity_series(rows), by_name)
    omitted = max(0, len(chosen) - MAX_PANELS)
    caption = "Bars: ± one standard deviation. Hollow: the model is not adequate, so that the bar is too short."
    caption += f" {omitted} more quantities without a change are in the table only." if omitted else ""
    quantities = [(s, by_name.get(s.name)) for s in chosen[:MAX_PANELS]]
    alt = "Verdicts, errors and quantities over the times of the recordings."
    return SvgImage(lambda: _survey_figure(shown, quantities, labels), alt, caption)


def series_to_draw(candidates: Sequence[QuantitySeries], changed: Collection[str]) -> list[QuantitySeries]:
    """Series with a change, then the mass, then each effect's first parameter (its amplitude), then the others."""
    first = {series.effect: series.name for series in reversed(candidates)}
    ranks = [
        [s for s in candidates if s.name in changed],
        [s for s in candidates if s.name in ALWAYS],
        [s for s in candidates if s.effect and s.name == first[s.effect]],
        [s for s in candidates if s.effect],
    ]
    return list(dict.fromkeys(series for rank in ranks for series in rank))


def _survey_figure(
    rows: Sequence[SurveyRow],
    quantities: Sequence[tuple[QuantitySeries, QuantityChange | None]],
    labels: Mapping[str, str],
) -> Figure:
    """The panels, on one axis of time."""
    verdicts = [v for v in labels if any(_verdict(row) == v for row in rows)]
    panels: list[Callable[[Axes], None]] = [lambda axes: _draw_verdicts(axes, rows, {v: labels[v] for v in verdicts})]
    worst = Counter(row.outcome.loudest.channel for row in rows if row.outcome.loudest is not None)
    panels += [lambda axes: _draw_errors(axes, rows, worst.most_common(1)[0][0])] if worst else []
    panels += [lambda axes, pair=pair: _draw_quantity(axes, *pair) for pair in quantities]  # type: ignore[misc]
    heights = [max(0.35, 0.22 * len(verdicts)), *[1.0] * (len(panels) - 1)]
    sheet = PanelGrid(rows=len(panels), columns=1, panel_height=PANEL, left=128, between_rows=34)
    figure, grid = sheet.panels(heights=heights, sharex=True)
    for draw, axes in zip(panels, grid[:, 0], strict=True):
        draw(axes)
    _date_axis(grid[-1, 0], [row.moment for row in rows])
    return figure


def _verdict(row: SurveyRow) -> str:
    return row.outcome.verdict or "error"


def _draw_verdicts(axes: Axes, rows: Sequence[SurveyRow], labels: Mapping[str, str]) -> None:
    panel_title(axes, "verdict")
    moments = {v: [row.moment for row in rows if _verdict(row) == v] for v in labels}
    for line, (verdict, times) in enumerate(moments.items()):
        axes.plot(date2num(times), [line] * len(times), "|", color=COLOURS[verdict], ms=9, mew=2.0)
    axes.set_yticks(range(len(labels)), [f"{labels[v]} ({len(times)})" for v, times in moments.items()])
    for label, verdict in zip(axes.get_yticklabels(), labels, strict=True):
        label.set_color(COLOURS[verdict])
    axes.set_ylim(len(labels) - 0.4, -0.6)
    axes.spines["left"].set_visible(False)
    axes.tick_params(axis="y", length=0)


def _draw_errors(axes: Axes, rows: Sequence[SurveyRow], channel: str) -> None:
    """Error with the rigid tool and with the effects added, of the channel that is the worst in most recordings."""
    pairs = [(row.moment, c) for row in rows for c in row.outcome.channels if c.channel == channel]
    measured = [(m, c.before, c.after) for m, c in pairs if c.before is not None and c.after is not None]
    kind = "systematic error" if all(c.systematic_after is not None for _, c in pairs) else "error"
    panel_title(axes, axis_label(f"{kind} in {channel}", pairs[0][1].unit))
    time = date2num([moment for moment, _, _ in measured])
    axes.plot(time, [before for _, before, _ in measured], "o", color=MISFIT_COLOUR, ms=3.6, label="rigid tool")
    added = [after for _, _, after in measured]
    axes.plot(time, added, "o", color=ADEQUATE_COLOUR, ms=3.6, label="with the effects added")
    axes.set_ylim(bottom=0)
    axes.legend(**LEGEND, ncols=2, loc="lower right", bbox_to_anchor=(1.0, 0.96))


def _draw_quantity(axes: Axes, series: QuantitySeries, change: QuantityChange | None) -> None:
    """A quantity with its std, hollow where the model is not adequate, and the line of its change."""
    panel_title(axes, axis_label("m, the tool's mass" if series.name == "m" else series.name, series.unit))
    time, has_std = date2num(series.moments), np.isfinite(series.std)
    for adequate, face in ((True, INK), (False, "white")):
        of_kind = series.trusted == adequate
        shown = of_kind & has_std
        axes.errorbar(time[shown], series.value[shown], series.std[shown], fmt="none", ecolor=FAINT, elinewidth=1.6)
        axes.plot(time[of_kind], series.value[of_kind], "o", color=INK, mfc=face, ms=3.6, mew=0.8)
    if change is not None:
        moments, levels = zip(*_levels(change), strict=True)
        axes.plot(date2num(moments), levels, color=MISFIT_COLOUR, lw=1.4, zorder=3)
    axes.set_ylim(*_limits(series))


def _levels(change: QuantityChange) -> list[tuple[datetime, float]]:
    """Vertices of the line of a change."""
    if change.kind is ChangeKind.TREND:
        return [(change.start, change.before), (change.end, change.after)]
    middle, moments = change.start + (change.end - change.start) / 2, change.series.moments
    return [(moments[0], change.before), (middle, change.before), (middle, change.after), (moments[-1], change.after)]


def _limits(series: QuantitySeries) -> tuple[float, float]:
    """Limits that contain the values, and their bars up to the span of the values."""
    low, high = float(series.value.min()), float(series.value.max())
    span = high - low or 0.1 * abs(high) or 1.0
    bar = np.minimum(np.where(np.isfinite(series.std), series.std, 0.0), span)
    low, high = float((series.value - bar).min()), float((series.value + bar).max())
    return low - 0.08 * span, high + 0.08 * span


def _date_axis(axes: Axes, moments: Sequence[datetime]) -> None:
    first, last = min(moments), max(moments)
    margin = MARGIN * (last - first) or timedelta(hours=1)
    axes.set_xlim(*date2num([first - margin, last + margin]))
    locator = AutoDateLocator(minticks=3, maxticks=9)
    axes.xaxis.set_major_locator(locator)
    axes.xaxis.set_major_formatter(
        ConciseDateFormatter(locator, formats=FORMATS, zero_formats=ZERO_FORMATS, show_offset=False)
    )
    axes.set_xlabel(f"{first:%Y-%m-%d %H:%M} to {last:%Y-%m-%d %H:%M}")


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
    timed = [row.time.source for row in rows if row.time is not None]
    sources = {source: timed.count(source) for source in TimeSource if source in timed}
    sources_text = {
        TimeSource.FILE_NAME: "from the file name",
        TimeSource.MODIFICATION: "from the modification time of the file, as its name has none (marked ~)",
    }
    parts = [f"{count} {sources_text[source]}" for source, count in sources.items()]
    without = len(rows) - len(timed)
    parts += [f"{without} unknown, no file"] if without else []
    excluded = len(timed) - len(rows_in_time_order(rows))
    note = f" Not compared with these, nor plotted: {excluded} of the other source." if excluded else ""
    return f"Local times: {'; '.join(parts)}.{note}"


def table_line(row: SurveyRow) -> TableLine:
    """One recording as text."""
    outcome, time = row.outcome, row.time
    verdict = outcome.verdict or ERROR
    without_parameters = [
        FormattedQuantity(e, "", "") for e in outcome.added if all(size.effect != e for size in outcome.sizes)
    ]
    estimates = ((s.name, s.value, inf if s.std is None else s.std, s.unit) for s in outcome.sizes)
    sizes = [*without_parameters, *quantities(estimates)]
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
