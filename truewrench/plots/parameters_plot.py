"""Parameters of one model or several, with their intervals, and the correlation of their estimates."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from diagnosis.comparison.compared_step import (
    ComparedFit,
    RecordingErrors,
    recording_errors,
    systematic_error,
    systematic_error_text,
)
from diagnosis.screening.suspects import Suspects
from estimation.confidence_intervals import Intervals
from estimation.fit import Fit
from estimation.least_squares.estimates import Estimate
from modeling.errors import InputError
from modeling.number_format import NO_VALUE, axis_label, estimate_text, format_number, format_p_value
from modeling.significance import LEVELS
from modeling.table import Cell, Table, Value
from truewrench.plots.chart import Band, Bars, Chart, Heat, Level, Line, Mark, Panel, Points, in_rows, value_limits
from truewrench.plots.matplotlib_chart import matplotlib_figure
from truewrench.plots.style import ADEQUATE_COLOUR, FAINT, HELD_OUT, INK, MISFIT_COLOUR, NOISE
from truewrench.plots.svg_image import SvgImage

# Suspects ranked by the share of the error that each would remove.


ROW = 18
"""Height of a row, CSS pixels."""


def suspects_chart(suspects: Suspects) -> Chart:
    """A bar for each effect: the share of the excess chi-square that it would remove, its p-value beside it.

    Significant effects are coloured. Where the noise comes from the residual there is no excess: bars show the score.
    """
    tests = [test for test in suspects.tests if test.excited]
    whole = suspects.excess is not None
    shares = [suspects.share(test) for test in tests]
    bars = Bars(
        names=tuple(test.effect.id for test in tests),
        sizes=tuple(t.statistic if s is None else 100 * s for t, s in zip(tests, shares, strict=True)),
        colours=tuple(MISFIT_COLOUR if t.effect.id in suspects.ids else FAINT for t in tests),
        notes=tuple(f"p {format_p_value(suspects.p_values[t.effect.id])}" for t in tests),
    )
    panel = Panel(
        marks=(bars,),
        title="suspects, one at a time; coloured: significant",
        x_label="error that it would remove (%)" if whole else "drop of the whitened chi-square",
        x_limits=(0, 100) if whole else None,
    )
    return Chart(rows=((panel,),), row_height=ROW * max(len(tests), 1), left=170, right=90, width=760)


# The numbers of a table as bars: the figure of a result that has no other.


MOST_ROWS, MOST_COLUMNS, TABLE_ROW = 30, 8, 18
"""Rows and columns drawn, the first ones; height of a row in CSS pixels."""


def table_chart(table: Table) -> Chart:
    """A panel for each column of numbers, a bar for each row, named by the row's text.

    Raises InputError for a table without numbers.
    """
    rows = table.rows[:MOST_ROWS]
    kept = [i for i in range(len(table.columns)) if any(_number(row[i]) is not None for row in rows)][:MOST_COLUMNS]
    if not kept:
        raise InputError(what="there are no numbers to draw", where="plot", remedy="print it, or use to_frame()")
    names = _distinct([" ".join(_text(v) for v in row if _text(v))[:24] or str(n) for n, row in enumerate(rows, 1)])
    panels = [_table_panel(table, i, rows, names) for i in kept]
    height = max(TABLE_ROW * len(rows), 36)
    return Chart(rows=in_rows(panels, 2), row_height=height, left=160, right=70, between_rows=60,
                 legend=False, between_columns=240)  # fmt: skip


def _table_panel(table: Table, column: int, rows: tuple[tuple[Value, ...], ...], names: list[str]) -> Panel:
    numbers = [(name, _number(row[column])) for name, row in zip(names, rows, strict=True)]
    bars = Bars(
        names=tuple(name for name, _ in numbers),
        sizes=tuple(value or 0.0 for _, value in numbers),
        colours=(ADEQUATE_COLOUR,) * len(numbers),
        notes=tuple(format_number(value) for _, value in numbers),
    )
    return Panel(marks=(bars,), title=table.columns[column].heading)


def _number(value: Value) -> float | None:
    number = value.value if isinstance(value, Cell) else value
    return float(number) if isinstance(number, int | float) and isfinite(number) else None


def _text(value: Value) -> str:
    number = value.value if isinstance(value, Cell) else value
    return number if isinstance(number, str) else ""


def _distinct(names: list[str]) -> list[str]:
    """Names that differ: a bar is placed by its name."""
    return [name if names.count(name) == 1 else f"{name} ({number})" for number, name in enumerate(names, 1)]


# Error / noise floor of each channel over a series of models, such as the steps of a diagnosis.


COLUMNS = 3
NOTE_SHARE = 0.25
"""Of the steps: room for the notes left of the first points."""
MOST_NOTES = 3
"""Steps that all have notes; of more the first and the last have."""
BELOW = "smaller than the axis shows; bars end at the upper limit"
MARKERS = "osD^vPX"


def error_reduction_figure(
    steps: Sequence[ComparedFit], names: Sequence[str], tolerance: Mapping[str, float]
) -> Figure:
    """A panel for each channel: error over noise floor, logarithmic, for every recording; tolerance shaded."""
    return matplotlib_figure(error_reduction_chart(steps, names, tolerance))


def error_reduction_chart(
    steps: Sequence[ComparedFit],
    names: Sequence[str],
    tolerance: Mapping[str, float],
    channel: str | None = None,
    x_label: str = "",
) -> Chart:
    """A panel for each channel: error over noise floor, logarithmic, for every recording; tolerance shaded.

    `names` label the steps, and `x_label` says what they are; the tolerance is by channel, in its unit. A single axes
    shows `channel`, by default the one with the largest error of the first model.
    """
    first = steps[0].training[0]
    shown = recording_errors(steps)
    limits = _limits(tolerance, shown)
    channels = first.recording.channels
    panels = [
        Panel(
            marks=tuple(_marks(shown, name, tolerance[name], limits[0])),
            title=axis_label(name, unit),
            x_ticks=tuple(names),
            x_label=x_label,
            x_limits=(-0.4 - NOTE_SHARE * len(names), len(names) - 0.5),
            y_label="error / noise floor",
            y_log=True,
            y_limits=limits,
        )
        for name, unit in zip(channels, first.space.units, strict=True)
    ]
    ratio = {c: v / shown[0].floor(c) for c, v in systematic_error(first).items()}
    main = channels.index(channel or max(ratio, key=lambda c: ratio[c]))
    return Chart(
        rows=in_rows(panels, COLUMNS), row_height=165, main=divmod(main, min(COLUMNS, len(panels))), shared_y=True,
        between_rows=60,
    )  # fmt: skip


def _limits(tolerance: Mapping[str, float], shown: Sequence[RecordingErrors]) -> tuple[float, float]:
    tolerances = [size / shown[0].floor(c) for c, size in tolerance.items()]
    sizes = [v / f.floor(k) for f in shown for c in f.comparisons for k, v in systematic_error(c).items()]
    lowest = min([*tolerances, *(s for s in sizes if s > 0), 1.0])
    return max(lowest, min(tolerances) / 10) / 2.5, 3 * max([*sizes, 1.0])


def point_spacing(count: int) -> float:
    """Horizontal distance between the points of `count` recordings, in steps."""
    return min(0.14, 0.5 / count)


def _marks(shown: Sequence[RecordingErrors], channel: str, tolerance: float, bottom: float) -> Iterator[Mark]:
    share = tolerance / shown[0].floor(channel)
    yield Band(low=bottom / 10, high=share, colour=NOISE, label="tolerance")
    yield Level(y=1.0, colour=INK, dashed=True, note="noise floor")
    for number, errors in enumerate(shown):
        yield from _recording_marks(errors, channel, number, len(shown), bottom)


def _recording_marks(errors: RecordingErrors, channel: str, number: int, count: int, bottom: float) -> Iterator[Mark]:
    """Points of one recording, offset from the others; below the axis an arrow, the upper limit as a bar."""
    place = np.arange(len(errors.comparisons), dtype=np.float64) + (number - (count - 1) / 2) * point_spacing(count)
    floor = errors.floor(channel)
    ratio = np.array([systematic_error(c)[channel] for c in errors.comparisons]) / floor
    limit = np.array([(c.explainable_limit or systematic_error(c))[channel] for c in errors.comparisons]) / floor
    colour = ADEQUATE_COLOUR if errors.fitted else HELD_OUT
    drawn = np.maximum(ratio, bottom * 1.35)
    yield Line(x=place, y=drawn, colour=colour, width=1.2, opacity=0.6)
    texts = _notes(errors, channel) if not number else []
    shown = ratio >= bottom
    below = BELOW if shown.any() else f"{errors.label}, {BELOW}"
    for inside, symbol, label in ((shown, MARKERS[number % len(MARKERS)], errors.label), (~shown, "v", below)):
        yield Points(
            x=place[inside], y=drawn[inside], low=drawn[inside], high=np.maximum(limit, drawn)[inside],
            colour=colour, size=6, hollow=not errors.fitted, symbol=symbol, label=label,
            notes=tuple(text for text, keep in zip(texts, inside, strict=False) if keep),
        )  # fmt: skip


def _notes(errors: RecordingErrors, channel: str) -> list[str]:
    """The error after each step, in words; of many steps the first and the last."""
    texts = [systematic_error_text(c, channel, 2) for c in errors.comparisons]
    return texts if len(texts) <= MOST_NOTES else [texts[0], *[""] * (len(texts) - 2), texts[-1]]


def error_reduction_image(
    steps: Sequence[ComparedFit], names: Sequence[str], tolerance: Mapping[str, float]
) -> SvgImage:
    """Figure of the errors of all recordings after each step, per channel."""
    sizes = [f"{n} {format_number(_largest_error_ratio(s), 2)}" for n, s in zip(names, steps, strict=True)]
    alt = f"Error / noise floor after each step, worst channel: {', '.join(sizes)}."
    return SvgImage(lambda: error_reduction_figure(steps, names, tolerance), alt)


def _largest_error_ratio(step: ComparedFit) -> float:
    comparison = step.training[0]
    return max(v / max(comparison.noise_floor[c], 1e-300) for c, v in systematic_error(comparison).items())


PLACES = 9
"""Estimates side by side in a row of panels."""
CORRELATION_COLOURS = ("#D55E00", "#F3B98C", "#FFFFFF", "#86B9DC", "#0072B2")
"""Of -1 to 1."""
MOST_WRITTEN = 24
"""Parameters up to which the coefficients are written into their cells."""
COLOURS = (MISFIT_COLOUR, ADEQUATE_COLOUR, HELD_OUT)
SYMBOLS = "osD^"
"""Of the models in turn; the symbol changes when the colours begin again."""


@dataclass(frozen=True, eq=False)
class LabelledParameters:
    """Estimates of one model, and the ends of their intervals by name."""

    label: str
    estimates: Mapping[str, Estimate]
    ends: Mapping[str, tuple[float, float]]

    @classmethod
    def of(cls, label: str, intervals: Intervals) -> LabelledParameters:
        """Of intervals with the effective degrees of freedom of the noise."""
        unknowns = zip(intervals.fit.unknowns, intervals.fit.theta.tolist(), intervals.std.tolist(), strict=True)
        estimates = {p.name: Estimate(p.name, value, std, p.unit) for p, value, std in unknowns if not p.fixed}
        names = [p.name for p in intervals.fit.unknowns]
        ends = zip(intervals.low.tolist(), intervals.high.tolist(), strict=True)
        return cls(label, estimates, dict(zip(names, ends, strict=True)))

    @classmethod
    def known(cls, label: str, estimated: Any) -> LabelledParameters:
        """Of anything with parameters; where the noise is a given one, 95 % of a normal distribution."""
        if isinstance(estimated, Fit):
            return cls.of(label, estimated.intervals())
        fixed = {p.name for p in estimated.model.parameters if p.fixed}
        free = {name: e for name, e in estimated.parameters.items() if name not in fixed}
        return cls(label, free, {n: normal_ends(e) for n, e in free.items()})


def normal_ends(estimate: Estimate) -> tuple[float, float]:
    """95 % interval of a normal distribution."""
    half = LEVELS.upper_limit * estimate.std
    return estimate.value - half, estimate.value + half


def parameters_chart(models: Sequence[LabelledParameters]) -> Chart:
    """A panel for each parameter: estimate and 95 % interval in every model that has it, each in its own scale."""
    names = list(dict.fromkeys(name for model in models for name in model.estimates))
    panels = [_panel(models, name) for name in names]
    columns = min(4, max(1, PLACES // len(models)))
    title = "estimates with 95 % intervals" if len(models) > 1 else ""
    return Chart(rows=in_rows(panels, columns), title=title, row_height=96, between_rows=40, width=1080)


def _panel(models: Sequence[LabelledParameters], name: str) -> Panel:
    unit = next(m.estimates[name].unit for m in models if name in m.estimates)
    marks = tuple(_points(models, name))
    ends = [end for mark in marks for end in (mark.low, mark.high, mark.y) if end is not None]
    return Panel(
        marks=marks,
        title=axis_label(name, unit),
        x_ticks=tuple(_tick(m, name) for m in models),
        x_limits=(-0.6, len(models) - 0.4),
        y_limits=value_limits(ends) if ends else (-1.0, 1.0),
        note="" if marks else "not identifiable",
    )


def _tick(model: LabelledParameters, name: str) -> str:
    """The estimate on two lines; a dash where the model has none."""
    estimate = model.estimates.get(name)
    if estimate is None or not np.isfinite(estimate.std):
        return NO_VALUE
    return estimate_text(estimate.value, estimate.shown_std, "1").replace(" ± ", "\n± ", 1).replace("-", "−")


def _points(models: Sequence[LabelledParameters], name: str) -> Iterator[Points]:
    several = len(models) > 1
    for number, model in enumerate(models):
        estimate = model.estimates.get(name)
        if estimate is not None and np.isfinite(estimate.std):
            low, high = model.ends[name]
            yield Points(
                x=np.array([float(number)]), y=np.array([estimate.value]), low=np.array([low]), high=np.array([high]),
                colour=COLOURS[number % len(COLOURS)] if several else ADEQUATE_COLOUR, size=5,
                interval="95 %", symbol=SYMBOLS[number // len(COLOURS) % len(SYMBOLS)],
                label=model.label if several else "estimate with 95 % interval",
            )  # fmt: skip


def correlation_chart(fitted: Any) -> Chart:
    """Correlation of the estimates that are identifiable, from -1 to 1."""
    frame = fitted.correlation.dropna(axis=0, how="all").dropna(axis=1, how="all")
    names = list(frame.index)
    heat = Heat(
        values=frame.to_numpy(dtype=np.float64), rows=tuple(names), columns=tuple(names),
        limits=(-1.0, 1.0), colours=CORRELATION_COLOURS, scale="correlation", written=len(names) <= MOST_WRITTEN,
    )  # fmt: skip
    panel = Panel(marks=(heat,), title="correlation of the estimates")
    longest = 5.2 * max(len(name) for name in names)
    size = 34 * len(names) + 2 * longest
    return Chart(rows=((panel,),), row_height=24 * max(len(names), 3), left=24 + longest, right=76,
                 width=max(size, 420))  # fmt: skip
