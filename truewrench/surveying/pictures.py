"""Pictures: what a survey draws over the recordings' times, chosen from its rows."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from datetime import datetime

import numpy as np

from truewrench.plots.image import Image, image_of
from truewrench.plots.survey_plot import Course, Fall, Marks, survey_figure
from truewrench.surveying.change import Change, Kind
from truewrench.surveying.row import Row
from truewrench.surveying.series import Series, dated, series_of

COLOURS = {
    "nothing_missing": "#00619a",
    "explained": "#00724f",
    "partly_explained": "#9a6200",
    "unexplained": "#b03a00",
    "error": "#646c76",
}
"""Of the verdicts, as in the report."""
PANELS = 8
"""Sizes drawn; those that change come first."""
ALWAYS = ("m",)
"""Parameters of the tool drawn whether they change or not: the payload."""


def time_image(rows: Sequence[Row], changes: Sequence[Change], labels: Mapping[str, str]) -> Image | None:
    """Verdicts, errors and sizes over the times; None where fewer than two recordings have one."""
    shown = dated(rows)
    if len(shown) < 2:
        return None
    by_name = {change.series.name: change for change in changes}
    chosen = worth_drawing(series_of(rows), by_name)
    courses = [_course(series, by_name.get(series.name)) for series in chosen[:PANELS]]
    left = len(chosen) - len(courses)
    caption = "Bars: ± one standard deviation. Hollow: the recording is not explained, so that its bar is too short."
    caption += f" {left} more sizes, which do not change, stand in the table only." if left else ""
    figure = survey_figure(_marks(shown, labels), _fall(shown), courses)
    return image_of(figure, "Verdicts, errors and sizes over the times of the recordings.", caption)


def worth_drawing(every: Sequence[Series], changed: Collection[str]) -> list[Series]:
    """What changes, then the payload, then of each effect its first parameter, its amplitude, then the others."""
    first = {series.effect: series.name for series in reversed(every)}
    ranks = [
        [s for s in every if s.name in changed],
        [s for s in every if s.name in ALWAYS],
        [s for s in every if s.effect and s.name == first[s.effect]],
        [s for s in every if s.effect],
    ]
    return list(dict.fromkeys(series for rank in ranks for series in rank))


def _marks(rows: Sequence[Row], labels: Mapping[str, str]) -> list[Marks]:
    moments: dict[str, list[datetime]] = {verdict: [] for verdict in labels}
    for row in rows:
        if row.time is not None:
            moments[row.outcome.verdict or "error"].append(row.time.moment)
    return [Marks(label=labels[v], colour=COLOURS[v], moments=m) for v, m in moments.items() if m]


def _fall(rows: Sequence[Row]) -> Fall | None:
    """The error of the channel that is loudest in most recordings; None where no recording has any."""
    loudest = Counter(row.outcome.loudest.channel for row in rows if row.outcome.loudest is not None)
    if not loudest:
        return None
    ((channel, _),) = loudest.most_common(1)
    pairs = [(r.time.moment, c) for r in rows if r.time for c in r.outcome.channels if c.channel == channel]
    errors = [(m, c.before, c.after) for m, c in pairs if c.before is not None and c.after is not None]
    kind = "systematic error" if all(c.systematic_after is not None for _, c in pairs) else "error"
    return Fall(
        title=f"{kind} in {channel}",
        unit=pairs[0][1].unit,
        moments=[moment for moment, _, _ in errors],
        before=np.array([before for _, before, _ in errors], dtype=np.float64),
        after=np.array([after for _, _, after in errors], dtype=np.float64),
    )


def _course(series: Series, change: Change | None) -> Course:
    return Course(
        title=f"{series.name}, the tool's mass" if series.name == "m" else series.name,
        unit=series.unit,
        moments=series.moments,
        value=series.value,
        std=series.std,
        sure=series.trusted,
        levels=() if change is None else _levels(change),
    )


def _levels(change: Change) -> list[tuple[datetime, float]]:
    """Corners of the line drawn through a change."""
    if change.kind is Kind.TREND:
        return [(change.start, change.before), (change.end, change.after)]
    middle, moments = change.start + (change.end - change.start) / 2, change.series.moments
    return [(moments[0], change.before), (middle, change.before), (middle, change.after), (moments[-1], change.after)]
