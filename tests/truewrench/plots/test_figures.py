"""Figures of results: one description for two libraries, true, labelled, nothing cut off, on a user's axes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from itertools import chain, product
from typing import Any

import numpy as np
import pytest
from bokeh.document import Document
from matplotlib.axes import Axes
from matplotlib.axis import Axis, Tick
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import BboxBase

import truewrench as tw
from modeling.table import Table
from tests.shared.recordings import drag_and_leak
from tests.shared.results import RESULTS, fitted
from truewrench.plots.bokeh_chart import SYMBOLS, bokeh_chart, figures_of, legend_html, log_ticks
from truewrench.plots.chart import (
    Array,
    Band,
    Chart,
    Level,
    Line,
    Panel,
    Points,
    decimated,
    in_rows,
    legend_labels,
    thinned,
)
from truewrench.plots.interactive_figure import InteractiveFigure
from truewrench.plots.matplotlib_chart import draw_on, matplotlib_figure, typeset
from truewrench.plots.result_figure import FIGURES, PAGES, _sides, result_chart
from truewrench.plots.style import DARK
from truewrench.plots.svg_image import Drawing
from truewrench.plots.time_series_plot import nonperiodic_residual_figure, worst_channel, worst_channel_figure

pytest.importorskip("mujoco")

NAMES = [
    "study", "suspects", "contact", "recording", "intervals", "bands",
    *(pytest.param(name, marks=pytest.mark.long) for name in (
        "fit", "comparison", "diagnosis", "model comparison", "location", "robust", "loaded model"
    )),
]  # fmt: skip
"""A study has every kind of figure that a fit has; the long tier draws those of the others."""


def test_the_stairs_of_a_study_are_drawn_as_those_of_the_study() -> None:
    study = RESULTS["study"]()
    drawn, stairs = study.stairs().plot(backend="bokeh"), study.plot("stairs", backend="bokeh")
    assert [numbers.tolist() for numbers in bokeh_series(drawn.chart)] == [
        numbers.tolist() for numbers in bokeh_series(stairs.chart)
    ]


def kinds(name: str) -> list[str]:
    """The kinds of figures of a result."""
    result = RESULTS[name]()
    own = next((figures for known, figures in FIGURES.items() if isinstance(result, known)), {"table": None})
    return [kind for kind in own if kind not in PAGES]


def texts(figure: Figure) -> list[Text]:
    """Every text that is drawn; of ticks those within the limits of their axis."""
    every = {text for axes in figure.axes if axes.get_visible() for text in axes.findobj(Text)}
    every |= {text for part in (*figure.texts, *figure.legends) for text in part.findobj(Text)}
    every -= {text for axis in figure.findobj(Axis) for tick in axis.findobj(Tick) for text in tick.findobj(Text)}
    shown = (tick for axes in figure.axes if axes.get_visible() for axis in axes_of(axes) for tick in ticks_of(axis))
    every |= {text for tick in shown for text in (tick.label1, tick.label2)}
    return [text for text in every if text.get_visible() and text.get_text().strip()]


def axes_of(axes: Axes) -> tuple[Axis, ...]:
    return axes.xaxis, axes.yaxis


def ticks_of(axis: Axis) -> list[Tick]:
    """The major ticks within the limits."""
    low, high = sorted(axis.get_view_interval())
    return [tick for tick in axis.get_major_ticks() if low <= tick.get_loc() <= high]


def is_whole(figure: Figure) -> None:
    """Every text lies within the figure, and none overlaps another one."""
    figure.draw_without_rendering()
    boxes = {text: text.get_window_extent() for text in texts(figure)}
    page = figure.bbox
    for text, box in boxes.items():
        assert box.x0 >= 0, text
        assert box.y0 >= 0, text
        assert box.x1 <= page.x1, text
        assert box.y1 <= page.y1, text
    over = [
        (a.get_text(), b.get_text())
        for a, b in near_pairs(boxes)
        if boxes[a].overlaps(boxes[b]) and a.get_rotation() % 90 + b.get_rotation() % 90 == 0
    ]  # slanted ones side by side are clear of each other
    assert not over, over[:3]


def near_pairs(boxes: Mapping[Text, BboxBase]) -> list[tuple[Text, Text]]:
    """The pairs whose boxes touch: a few of ten thousand."""
    drawn, sides = list(boxes), np.array([box.extents for box in boxes.values()]).reshape(-1, 2, 2)
    low, high = sides.min(axis=1), sides.max(axis=1)
    touch = (low[:, None] <= high).all(axis=2)
    return [(drawn[i], drawn[j]) for i, j in np.argwhere(touch & touch.T) if i < j]


@cache
def chart_of(name: str, kind: str) -> Chart:
    return result_chart(RESULTS[name](), kind=kind)


@pytest.mark.parametrize("name", NAMES)
def test_nothing_is_cut_off_nor_written_over(name: str) -> None:
    for kind in kinds(name):
        is_whole(matplotlib_figure(chart_of(name, kind)))


def test_figures_of_reports_alone() -> None:
    """Those that are no chart, with models whose names are long."""
    sides = [replace(side, label=LONG_NAME) for side in _sides(RESULTS["study"]())]
    is_whole(worst_channel_figure(sides, worst_channel(sides[0])))
    is_whole(nonperiodic_residual_figure(sides))


LONG_NAME = "4: rigid tool + com_offset + sensor_hysteresis + a name without any end + quadratic_drag"


@pytest.mark.parametrize("columns", [1, 2, 3])
@pytest.mark.parametrize("kind", ["residual", "stairs", "map", "parameters"])
def test_long_names_are_wrapped_or_turned(kind: str, columns: int) -> None:
    """Titles, names of steps and of parameters far longer than their panels."""
    shown = chart_of("study", kind)
    panels = [
        replace(p, title=LONG_NAME if n else "short", x_ticks=tuple(f"{t} + sensor_hysteresis" for t in p.x_ticks))
        for n, p in enumerate(shown.panels[:3])
    ]
    is_whole(matplotlib_figure(replace(shown, rows=in_rows(panels, columns), heights=(), shared_x=False)))


@pytest.mark.parametrize("kind", ["residual", "stairs", "map", "spectrum"])
@pytest.mark.parametrize(("rows", "columns"), [(1, 1), (2, 2)])
def test_users_axes_make_room_once(kind: str, rows: int, columns: int) -> None:
    """On flat figures too; the legend is beside the data, and a layout of the user's still works afterwards."""
    from matplotlib.pyplot import close, subplots

    figure, axes = subplots(rows, columns, figsize=(5 * columns, 2.3 * rows), squeeze=False)
    for place in axes.flat:
        RESULTS["study"]().plot(kind=kind, ax=place)
    figure.draw_without_rendering()
    for place in axes.flat:
        legend = place.get_legend()
        assert legend is None or not legend.get_window_extent().overlaps(place.get_window_extent().shrunk(1, 0.99))
    is_whole(figure)
    figure.tight_layout()
    close(figure)


def test_notes_are_off_the_lines() -> None:
    """The word on a level, and values beside points, where a place is free."""
    x = np.linspace(0.0, 1.0, 200)
    rising = Line(x=x, y=2 * x, colour="#000000")
    values = Points(x=np.array([0.5]), y=np.array([1.0]), colour="#000000", notes=("1.0",))
    chart = Chart(rows=((Panel(marks=(Level(y=1.9, note="a level"), rising, values), y_limits=(0, 2)),),))
    (axes,) = matplotlib_figure(chart).axes
    curve = axes.lines[1].get_transform().transform(axes.lines[1].get_xydata())
    for text in axes.texts:
        box = text.get_window_extent()
        assert not any(box.contains(*point) for point in curve), text


def test_legends_of_a_kind_are_in_one_order() -> None:
    """Whatever a panel happens to show; what has no data is not in it."""
    some, none = np.ones(1), np.empty(0)
    first = Panel(
        marks=tuple(Points(x=x, y=x, colour="#000000", label=n) for n, x in zip("abc", (some, none, some), strict=True))
    )
    second = Panel(
        marks=tuple(Points(x=x, y=x, colour="#000000", label=n) for n, x in zip("abc", (some, some, none), strict=True))
    )
    assert legend_labels([first]) == ["a", "c"]
    assert legend_labels([first, second]) == legend_labels([second, first]) == ["a", "b", "c"]


def test_different_scales_of_one_quantity_are_said() -> None:
    wide = Panel(marks=(), y_label="residual (N)", y_limits=(-1.0, 1.0))
    narrow, log = replace(wide, y_limits=(-0.025, 0.025)), replace(wide, y_log=True, y_limits=(1.0, 10.0))
    notes = [p.note for p in chain(*Chart(rows=((wide, narrow, log),)).labelled_rows) if p is not None]
    assert notes == ["", "y axis enlarged 40 times", ""]
    shared = Chart(rows=((wide, wide), (narrow, narrow)), shared_y=True)
    assert [[p.note[-8:] for p in row if p is not None] for row in shared.labelled_rows] == [["", ""], ["40 times", ""]]


@pytest.mark.parametrize("text", ["p 10⁻¹²⁴", "1.2·10⁻⁷ N m²", "$5 and 10⁻³"])
def test_exponents_are_typeset_in_one_size(text: str) -> None:
    shown = Text(text=typeset(text), figure=Figure())
    assert not set("⁻⁰¹³⁴⁵⁶⁷⁸⁹") & set(shown.get_text())
    assert typeset("m/s²") == "m/s²"


def bokeh_series(chart: Chart) -> list[Array]:
    """The y of each glyph of Bokeh's figures."""
    shown = bokeh_chart(chart)
    assert len(figures_of(shown)) == len(chart.panels)
    Document().add_root(shown)
    glyphs: list[Any] = [renderer for drawn in figures_of(shown) for renderer in drawn.renderers]
    assert legend_html(chart).count("<li ") >= len(legend_labels(chart.panels)) * chart.legend
    drawn = [g for g in glyphs if isinstance(getattr(g.glyph, "y", None), str)]
    return [np.asarray(g.data_source.data[g.glyph.y]) for g in drawn]


@pytest.mark.parametrize("name", NAMES)
def test_bokeh_shows_the_numbers_of_the_chart(name: str) -> None:
    """Every line of the description is in a figure, short ones as they are."""
    for kind in kinds(name):
        chart = chart_of(name, kind)
        traces = bokeh_series(chart)
        for panel in chart.panels:
            for line in (mark for mark in panel.marks if isinstance(mark, Line)):
                assert any(len(y) == len(line.y) and np.array_equal(y, line.y) for y in traces), kind


@pytest.mark.parametrize("name", ["study", "suspects", "contact"])
def test_bokeh_draws_in_the_dark(name: str) -> None:
    """These have every kind of mark that results have, and dark paper changes nothing but the colours of marks."""
    for kind in kinds(name):
        chart = chart_of(name, kind)
        drawn = figures_of(bokeh_chart(chart, DARK))
        assert len(drawn) == len(chart.panels)
        assert {figure.background_fill_color for figure in drawn} == {DARK.paper}


@pytest.mark.parametrize("name", NAMES)
def test_axes_are_labelled_with_units(name: str) -> None:
    """A unit in brackets on each axis of a quantity; bars and ratios have a name."""
    for kind in kinds(name):
        for panel in chart_of(name, kind).panels:
            named = " ".join((panel.title, panel.x_label, panel.y_label))
            assert named.strip(), kind
            if kind in ("residual", "measured", "spectrum", "map", "contact", "recording"):
                assert "(" in panel.y_label, kind


def test_symbols_and_lines_are_in_the_legend_as_they_are_drawn() -> None:
    """A square is a square there; what is not explained is not drawn."""
    for kind in ("residual", "stairs"):
        chart = chart_of("study", kind)
        legend = legend_html(chart)
        for mark in (mark for panel in chart.panels for mark in panel.drawn if isinstance(mark, Points | Line)):
            if isinstance(mark, Points):
                assert f">{SYMBOLS[mark.symbol][mark.hollow]}</i>" in legend, kind
        lines = [m for panel in chart.panels for m in panel.marks if isinstance(m, Line) and kind == "residual"]
        assert all(line.label for line in lines)


def test_spectra_of_all_channels_span_the_same_frequencies() -> None:
    assert len({panel.x_limits for panel in chart_of("study", "spectrum").panels} - {None}) == 1


@pytest.mark.parametrize("decades", [0.2, 1.0, 2.0, 4.0, 9.0])
def test_a_logarithmic_axis_has_a_few_ticks(decades: float) -> None:
    """Two to eight on the axis, wherever it begins, and others for who moves it by its length."""
    for start in np.linspace(-5.0, 3.0, 33):
        low, high = 10.0**start, 10.0 ** (start + decades)
        ticks = np.array(log_ticks(low, high))
        assert (np.diff(ticks) > 0).all()
        inside = ((ticks >= low) & (ticks <= high)).sum()
        assert (1 if decades < 1 else 2) * (decades > 0.4) <= inside <= 8
        assert ticks[0] < low
        assert ticks[-1] > high


def test_each_panel_has_the_scale_of_what_it_shows() -> None:
    """The residual after is a tenth of that before, and its panel a tenth as high."""
    before = tw.fit(tw.planar(fitted().recordings[0].rig), drag_and_leak(1))
    chart = result_chart(tw.compare([before, RESULTS["study"]().fit], drag_and_leak(1)), kind="residual")
    heights = [np.ptp(panel.y_limits) for panel in chart.rows[1] if panel is not None and panel.y_limits]
    for panel, height in zip(chart.rows[1], heights, strict=True):
        assert panel is not None
        largest = max(float(np.abs(mark.y).max()) for mark in panel.marks if isinstance(mark, Line))
        assert 0.3 * height < largest <= height / 2 or height / 2 < 1.3 * fitted().noise[0].floor.max()


def test_a_long_line_keeps_its_peaks() -> None:
    y = np.random.default_rng(0).normal(size=1_000_000)
    y[123_456], y[765_432] = 99.0, -99.0
    line = Line(x=np.arange(1.0, 1e6 + 1), y=y, colour="#000000")
    for log, columns in product((False, True), (500, 2000)):
        across, found = decimated(line, columns, log=log)
        assert len(found) <= 2 * columns + 2
        assert {99.0, -99.0} <= set(found)
        assert (np.diff(across) > 0).all()


def test_many_points_keep_the_lowest_and_the_highest() -> None:
    rng = np.random.default_rng(0)
    x, y = rng.permutation(np.arange(1.0, 1e5 + 1)), rng.normal(size=100_000)
    y[[12_345, 76_543]] = 99.0, -99.0
    points = Points(x=x, y=y, low=y - 1, high=y + 1, colour="#000000")
    for log in (False, True):
        kept = thinned(points, 500, log=log)
        assert len(kept.x) <= 2 * 501
        assert {99.0, -99.0} <= set(kept.y)
        assert set(zip(kept.x, kept.y, strict=True)) <= set(zip(x, y, strict=True))
        assert kept.low is not None
        np.testing.assert_array_equal(kept.low, kept.y - 1)
    assert thinned(replace(points, x=np.ones(100_000)), 500, log=True).y.tolist() == [99.0, -99.0]
    assert thinned(replace(points, notes=("named",)), 500, log=False).x is points.x


@pytest.mark.parametrize("log", [False, True])
def test_a_picture_does_not_grow_with_what_it_shows(*, log: bool) -> None:
    """Of noise, at ten times the rows; more of them fill more of the first columns of a logarithmic axis."""
    sizes = []
    for count in (20_000, 200_000):
        x, y = np.arange(1.0, count + 1), np.random.default_rng(0).uniform(1, 2, count)
        marks = (
            Band(x=x, low=y - 1, high=y + 1),
            Line(x=x, y=y, colour="#000000"),
            Points(x=x, y=y, low=y - 0.5, high=y, colour="#000000"),
        )
        panel = Panel(marks=marks, x_log=log, x_limits=(1.0, float(count)), y_limits=(0.0, 3.0))
        chart = Chart(rows=((panel,),))
        sizes.append((len(Drawing.of(matplotlib_figure(chart)).source), len(InteractiveFigure(chart, 500).json)))
    np.testing.assert_allclose(sizes[1], sizes[0], rtol=0.2)


def test_axes_of_the_user() -> None:
    from matplotlib.pyplot import close, subplots

    fit = fitted()
    figure, axes = subplots(2, 2)
    assert fit.plot(kind="measured", channel="fx", ax=axes[0, 0]) is figure
    assert axes[0, 0].get_ylabel() == "fx (N)"
    fit.plot(kind="residual", ax=axes[1])
    assert [a.get_ylabel()[:8] for a in axes[1]] == ["tau (N·m", "residual"] or axes[1, 1].get_ylabel()
    assert not axes[0, 1].lines
    close(figure)


WRONG: dict[str, dict[str, Any]] = {
    "ax is a str, not axes of matplotlib": {"ax": "axes"},
    "3 axes for 2 panels; give 2 axes, or one": {"ax": Figure().subplots(3)},
    "an interactive figure has no axes of matplotlib": {"backend": "bokeh", "ax": Figure().subplots()},
    "no kind of figure is 'spectrumm'; did you mean spectrum": {"kind": "spectrumm"},
    "no channel is 'fz'": {"channel": "fz"},
}


@pytest.mark.parametrize("message", WRONG)
def test_a_wrong_figure_is_a_sentence(message: str) -> None:
    with pytest.raises(tw.InputError, match=message):
        fitted().plot(**WRONG[message])


def test_a_notebook_shows_it() -> None:
    assert "<svg" in fitted().plot()._repr_svg_()
    assert fitted().plot(backend="bokeh")._repr_html_().startswith("<iframe srcdoc=")
    with pytest.raises(tw.InputError, match="no numbers to draw"):
        Table.of(("name",), [("text",)]).plot()
    assert draw_on(Figure().subplots(), chart_of("fit", "correlation")).axes


def test_numbers_of_a_shared_axis_are_below_the_lowest_panel_alone() -> None:
    drawn: list[Any] = figures_of(bokeh_chart(chart_of("study", "residual")))
    assert [figure.xaxis[0].major_label_text_color is None for figure in drawn[:: len(drawn) - 1]] == [True, False]
