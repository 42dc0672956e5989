"""A figure to zoom: what the mouse shows, what a page of it holds, and that a browser draws it without a network."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bokeh.models import HoverTool
from hypothesis import given, settings
from hypothesis import strategies as st

import truewrench as tw
from tests.shared.results import fitted
from tests.truewrench.workbench.browser import browser
from truewrench.plots.bokeh_chart import bokeh_chart, figures_of
from truewrench.plots.chart import Band, Chart, Line, Panel, Points
from truewrench.plots.interactive_figure import MOST_VALUES, InteractiveFigure, shared_columns
from truewrench.plots.style import DARK, LIGHT

X = np.array([1.0, 2.0])


def lines(count: int, *, number: int = 2, seed: int = 0) -> tuple[Line, ...]:
    y = np.random.default_rng(seed).standard_normal((number, count))
    return tuple(
        Line(x=np.linspace(0.0, 1.0, count), y=row, colour="#0072B2", label=f"line {n}") for n, row in enumerate(y)
    )


def one_panel(*marks: Any, **labels: Any) -> Chart:
    return Chart(rows=((Panel(marks=marks, **labels),),))


def hovers(chart: Chart) -> list[Any]:
    return [tool for drawn in figures_of(bokeh_chart(chart)) for tool in drawn.tools if isinstance(tool, HoverTool)]


def first_data(chart: Chart, columns: int) -> dict[str, Any]:
    """Data of the first line and of those over its x."""
    drawn: Any = figures_of(bokeh_chart(chart, columns=columns))[0]
    return dict(drawn.renderers[0].data_source.data)


def test_lines_over_one_x_say_their_values_together_and_with_their_unit() -> None:
    alone = Line(x=X, y=X, colour="#000000", label="alone")
    (together, apart) = hovers(one_panel(*lines(9), alone, x_label="time (s)", y_label="fx (N)"))
    assert together.tooltips == [
        ("time (s)", "@x{%.5g}"), ("line 0", "@y0{%.5g} N"), ("line 1", "@y1{%.5g} N")
    ]  # fmt: skip
    assert apart.tooltips[1] == ("alone", "@y0{%.5g} N")


def test_points_with_an_interval_say_it() -> None:
    bars = Points(x=X + 5, y=X, low=X, high=X + 1, colour="#000000", label="no intervals")
    points = Points(x=X, y=X, low=X - 0.5, high=X + 0.5, interval="95 %", colour="#000000")
    plain, with_interval = hovers(one_panel(bars, points, x_label="angle (rad)", y_label="residual of fx (N)"))
    assert plain.tooltips == [("angle (rad)", "@x{%.5g}"), ("no intervals", "@y{%.5g} N")]
    assert with_interval.tooltips[2] == ("95 %", "@low{%.4g} to @high{%.4g} N")
    (renderer,) = with_interval.renderers
    assert renderer.data_source.data["low"].tolist() == [0.5, 1.5]


@settings(deadline=None)
@given(count=st.integers(2, 4000), columns=st.integers(4, 300), number=st.integers(1, 4), seed=st.integers(0, 99))
def test_long_lines_keep_every_extreme(count: int, columns: int, number: int, seed: int) -> None:
    shown = lines(count, number=number, seed=seed)
    data = first_data(one_panel(*shown), columns)
    assert len(data["x"]) <= max(2 * columns * number, 2)
    assert (np.diff(data["x"]) > 0).all()
    for n, line in enumerate(shown):
        assert data[f"y{n}"].max() == line.y.max()
        assert data[f"y{n}"].min() == line.y.min()


@pytest.mark.parametrize("number", [1, 3, 8])
def test_lines_of_a_page_share_its_numbers(number: int) -> None:
    charts = [one_panel(*lines(300_000, number=number))] * 5
    columns = shared_columns(charts)
    assert 5 * sum(len(values) for values in first_data(charts[0], columns).values()) <= 1.01 * MOST_VALUES


def test_data_of_a_figure_cannot_end_its_script() -> None:
    hostile = "</script><script>alert(1)</script>&"
    figure = InteractiveFigure(one_panel(Line(x=X, y=X, colour="#000000", label=hostile), y_label=hostile))
    assert "<" not in figure.json
    data = json.loads(figure.json)
    assert hostile in json.dumps(data["item"])
    assert "<script>" not in data["legend"]
    assert figure.html.count("<script") == 3


def test_any_other_backend_draws_with_the_interactive_library(tmp_path: Path) -> None:
    drawn = [fitted().plot("measured", backend=name) for name in ("bokeh", "plotly", "interactive")]
    assert [type(figure) for figure in drawn] == [InteractiveFigure] * 3
    assert len(figures_of(drawn[0].layout)) == 1
    path = drawn[0].write_html(tmp_path / "measured.html")
    assert path.stat().st_size < 1_000_000
    with pytest.raises(tw.InputError, match="missing"):
        drawn[0].write_html(tmp_path / "measured.html" / "missing")


def test_a_browser_draws_it_from_the_page_alone(tmp_path: Path) -> None:
    """In the colours of light and dark paper; the mouse reads values off, a click on a name hides it."""
    band = Band(low=-1.0, high=1.0, label="noise")
    chart = one_panel(band, *lines(5000), x_label="time (s)", y_label="fx (N)")
    path = InteractiveFigure(chart).write_html(tmp_path / "figure.html")
    wrong: list[str] = []
    with browser() as opened:
        for scheme, colours in (("light", LIGHT), ("dark", DARK)):
            page = opened.new_page(color_scheme=scheme)  # type: ignore[arg-type]
            page.on("pageerror", lambda error: wrong.append(str(error)))
            page.on("console", lambda said: wrong.append(said.text) if said.type in ("error", "warning") else None)
            page.on("request", lambda sent: wrong.append(sent.url) if sent.url.startswith("http") else None)
            page.goto(path.as_uri())
            page.get_by_text("Drag to zoom in").wait_for()
            canvas = page.locator(".bk-Figure").bounding_box()
            assert canvas is not None
            page.mouse.move(canvas["x"] + canvas["width"] / 2, canvas["y"] + 60)
            page.get_by_text("line 1:").wait_for()
            assert page.get_by_text(" N", exact=False).count() >= 2
            page.locator("li[data-label='line 0']").click()
            visible = "() => [...Bokeh.documents[0].all_models].filter(m => m.name == 'line 0').map(m => m.visible)"
            assert page.evaluate(visible) == [False]
            ink = "() => [...Bokeh.documents[0].all_models].find(m => m.type == 'LinearAxis').axis_label_text_color"
            assert page.evaluate(ink) == colours.ink
            page.close()
    assert not wrong


def test_the_page_of_a_long_recording_is_of_moderate_size() -> None:
    assert len(InteractiveFigure(one_panel(*lines(1_000_000, number=6))).json) < 2_000_000
