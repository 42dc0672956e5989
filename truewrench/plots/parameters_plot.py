"""Parameters of one model or several, with their intervals, and the correlation of their estimates."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from estimation.confidence_intervals import Intervals
from estimation.fit import Fit
from estimation.least_squares.estimates import Estimate
from modeling.number_format import NO_VALUE, axis_label, estimate_text
from modeling.significance import LEVELS
from truewrench.plots.charts.chart import Chart, Heat, Panel, Points, in_rows, value_limits
from truewrench.plots.style import ADEQUATE_COLOUR, HELD_OUT, MISFIT_COLOUR

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
    def of(cls, label: str, found: Intervals) -> LabelledParameters:
        """Of intervals with the effective degrees of freedom of the noise."""
        known = zip(found.fit.unknowns, found.fit.theta.tolist(), found.std.tolist(), strict=True)
        estimates = {p.name: Estimate(p.name, value, std, p.unit) for p, value, std in known if not p.fixed}
        names = [p.name for p in found.fit.unknowns]
        ends = zip(found.low.tolist(), found.high.tolist(), strict=True)
        return cls(label, estimates, dict(zip(names, ends, strict=True)))

    @classmethod
    def known(cls, label: str, estimated: Any) -> LabelledParameters:
        """Of anything with parameters; where the noise is a given one, 95 % of a normal distribution."""
        if isinstance(estimated, Fit):
            return cls.of(label, estimated.intervals())
        fixed = {p.name for p in estimated.model.parameters if p.fixed}
        known = {name: e for name, e in estimated.parameters.items() if name not in fixed}
        return cls(label, known, {n: normal_ends(e) for n, e in known.items()})


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
    found = model.estimates.get(name)
    if found is None or not np.isfinite(found.std):
        return NO_VALUE
    return estimate_text(found.value, found.std, "1").replace(" ± ", "\n± ", 1).replace("-", "−")


def _points(models: Sequence[LabelledParameters], name: str) -> Iterator[Points]:
    several = len(models) > 1
    for number, model in enumerate(models):
        found = model.estimates.get(name)
        if found is not None and np.isfinite(found.std):
            low, high = model.ends[name]
            yield Points(
                x=np.array([float(number)]), y=np.array([found.value]), low=np.array([low]), high=np.array([high]),
                colour=COLOURS[number % len(COLOURS)] if several else ADEQUATE_COLOUR, size=5,
                symbol=SYMBOLS[number // len(COLOURS) % len(SYMBOLS)],
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
