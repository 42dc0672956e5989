"""Selection of the quantities plotted over time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from datetime import datetime

import numpy as np

from truewrench.plots.survey_plot import ErrorReduction, QuantityOverTime, VerdictTimes, survey_figure
from truewrench.plots.svg_image import SvgImage, svg_image
from truewrench.surveying.change_detection import ChangeKind, QuantityChange
from truewrench.surveying.quantity_series import QuantitySeries, quantity_series, rows_in_time_order
from truewrench.surveying.survey_row import SurveyRow

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


def survey_image(
    rows: Sequence[SurveyRow], changes: Sequence[QuantityChange], labels: Mapping[str, str]
) -> SvgImage | None:
    """Verdicts, errors and quantities over time; None for fewer than two recordings with a time."""
    shown = rows_in_time_order(rows)
    if len(shown) < 2:
        return None
    by_name = {change.series.name: change for change in changes}
    chosen = series_to_draw(quantity_series(rows), by_name)
    panels = [_quantity_over_time(series, by_name.get(series.name)) for series in chosen[:MAX_PANELS]]
    omitted = len(chosen) - len(panels)
    caption = "Bars: ± one standard deviation. Hollow: the model is not adequate, so that the bar is too short."
    caption += f" {omitted} more quantities without a change are in the table only." if omitted else ""
    figure = survey_figure(_verdict_times(shown, labels), _error_reduction(shown), panels)
    return svg_image(figure, "Verdicts, errors and quantities over the times of the recordings.", caption)


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


def _verdict_times(rows: Sequence[SurveyRow], labels: Mapping[str, str]) -> list[VerdictTimes]:
    moments: dict[str, list[datetime]] = {verdict: [] for verdict in labels}
    for row in rows:
        if row.time is not None:
            moments[row.outcome.verdict or "error"].append(row.time.moment)
    return [VerdictTimes(label=labels[v], colour=COLOURS[v], moments=m) for v, m in moments.items() if m]


def _error_reduction(rows: Sequence[SurveyRow]) -> ErrorReduction | None:
    """Error of the channel that is the worst in most recordings; None where there is none."""
    worst = Counter(row.outcome.loudest.channel for row in rows if row.outcome.loudest is not None)
    if not worst:
        return None
    ((channel, _),) = worst.most_common(1)
    pairs = [(r.time.moment, c) for r in rows if r.time for c in r.outcome.channels if c.channel == channel]
    errors = [(m, c.before, c.after) for m, c in pairs if c.before is not None and c.after is not None]
    kind = "systematic error" if all(c.systematic_after is not None for _, c in pairs) else "error"
    return ErrorReduction(
        title=f"{kind} in {channel}",
        unit=pairs[0][1].unit,
        moments=[moment for moment, _, _ in errors],
        before=np.array([before for _, before, _ in errors], dtype=np.float64),
        after=np.array([after for _, _, after in errors], dtype=np.float64),
    )


def _quantity_over_time(series: QuantitySeries, change: QuantityChange | None) -> QuantityOverTime:
    return QuantityOverTime(
        title=f"{series.name}, the tool's mass" if series.name == "m" else series.name,
        unit=series.unit,
        moments=series.moments,
        value=series.value,
        std=series.std,
        adequate=series.trusted,
        levels=() if change is None else _levels(change),
    )


def _levels(change: QuantityChange) -> list[tuple[datetime, float]]:
    """Vertices of the line of a change."""
    if change.kind is ChangeKind.TREND:
        return [(change.start, change.before), (change.end, change.after)]
    middle, moments = change.start + (change.end - change.start) / 2, change.series.moments
    return [(moments[0], change.before), (middle, change.before), (middle, change.after), (moments[-1], change.after)]
