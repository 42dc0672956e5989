"""The points of a figure with an interval say their numbers under the mouse."""

from __future__ import annotations

from typing import Any

import numpy as np
from bokeh.models import HoverTool
from bokeh.models.renderers import GlyphRenderer

from truewrench.plots.bokeh_chart import bokeh_chart, figures_of
from truewrench.plots.chart import Chart, Panel, Points
from truewrench.workbench.page import add_point_hover


def test_points_with_an_interval_say_it() -> None:
    x = np.array([1.0, 2.0])
    plain = Points(x=x + 5, y=x, colour="#000000")
    points = Points(x=x, y=x, low=x - 0.5, high=x + 0.5, colour="#000000")
    chart = Chart(rows=((Panel(marks=(plain, points)),),))
    layout = bokeh_chart(chart)
    add_point_hover(layout, chart)
    (drawn,) = figures_of(layout)
    (hover,) = [tool for tool in drawn.tools if isinstance(tool, HoverTool)]
    assert not isinstance(hover.renderers, str)
    (said,) = hover.renderers
    assert isinstance(said, GlyphRenderer)
    source: Any = said.data_source
    assert source.data["interval"] == ["0.500 to 1.50", "1.50 to 2.50"]
