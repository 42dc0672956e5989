"""Numbers of a figure's points that are shown under the mouse: value and interval."""

from __future__ import annotations

from typing import Any

import numpy as np
from bokeh.models import HoverTool, Scatter
from bokeh.models.renderers import GlyphRenderer

from modeling.number_format import format_number
from truewrench.plots.charts.bokeh_chart import figures_of
from truewrench.plots.charts.chart import Chart, Points


def add_point_hover(layout: Any, chart: Chart) -> None:
    """Let the points with an interval of a chart that is drawn say their numbers."""
    for panel, drawn in zip(chart.panels, figures_of(layout), strict=True):
        with_interval = [m for m in panel.marks if isinstance(m, Points) and m.low is not None and len(m.x)]
        scatters = [r for r in drawn.renderers if isinstance(r, GlyphRenderer) and isinstance(r.glyph, Scatter)]
        for renderer in scatters:
            source: Any = renderer.data_source
            mark = next((m for m in with_interval if np.array_equal(source.data["x"], m.x)), None)
            if mark is not None:
                source.data = dict(source.data) | _texts(mark)
                rows = [("x", "@at"), ("mean", "@mean"), ("95 %", "@interval")]
                drawn.add_tools(HoverTool(renderers=[renderer], tooltips=rows))


def _texts(points: Points) -> dict[str, list[str]]:
    low, high = points.low, points.high
    assert low is not None  # as the caller has seen
    assert high is not None
    return {
        "at": [format_number(float(x)) for x in points.x],
        "mean": [format_number(float(y)) for y in points.y],
        "interval": [f"{format_number(float(a))} to {format_number(float(b))}" for a, b in zip(low, high, strict=True)],
    }
