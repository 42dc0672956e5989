"""Charts of a study: measured, predicted and residual over time, residual maps, error after each step, spectra."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.comparison.residual_map import ResidualMap, residual_maps, samples_of_cell
from diagnosis.study import Study, StudyStep
from modeling.errors import InputError
from modeling.significance import LEVELS
from truewrench.plots.chart import Chart, Panel, Points, Span
from truewrench.plots.parameters_plot import error_reduction_chart
from truewrench.plots.residual_plots import residual_map_chart, residual_spectrum_chart
from truewrench.plots.style import ADEQUATE_COLOUR, HELD_OUT, MISFIT_COLOUR
from truewrench.plots.time_series_plot import LabelledComparison, measured_panel, residual_limits, residual_panel
from truewrench.workbench.page_update import PageUpdate
from truewrench.workbench.study_words import view_words
from truewrench.workbench.view import View, comparisons_of

MOST_MAPS = 4
MOST_SPANS = 200
"""Intervals of a cell's samples that are marked."""


def view_at_cell(view: View, study: Study, number: int, x: float) -> View:
    """The samples of a cell of a residual map, over time; InputError for a map that is not shown."""
    shown = maps_of(view, study)
    if not 0 <= number < len(shown):
        raise InputError(what="there is no such map", where="workbench", remedy="reload the page")
    residual_map = shown[number]
    centre = float(residual_map.centre[_nearest(residual_map, x)])
    return replace(view, name="time", steps=(), cell=(residual_map.variable, centre, residual_map.variable_unit))


def _nearest(shown: ResidualMap, x: float) -> int:
    """The cell nearest to a value of the variable."""
    return int(np.abs(shown.centre - x).argmin())


def view_of(view: View, study: Study) -> PageUpdate:
    """Charts and words of a view."""
    if view.name == "map":
        maps = maps_of(view, study)
        words = {"view": view_words(view, study, maps), "table": ""}
        return PageUpdate(words, {"plots": map_chart(maps, view.cell)}, {"plots": {"do": "cell"}})
    words = {"view": view_words(view, study, ()), "table": ""}
    return PageUpdate(words, {"plots": CHARTS[view.name](view, study)})


def _sides(view: View, study: Study) -> list[LabelledComparison]:
    """The current model, or two steps side by side."""
    if not view.steps:
        return [_side(study.steps[-1], view.recording)]
    first, second = (_side(study.steps[i], view.recording, f"{i}: ") for i in view.steps)
    colours = (MISFIT_COLOUR, ADEQUATE_COLOUR)
    return [replace(side, colour=colour) for side, colour in zip((first, second), colours, strict=True)]


def _side(step: StudyStep, recording: int, number: str = "") -> LabelledComparison:
    comparison = comparisons_of(step)[recording]
    level = LEVELS.effect if recording < len(step.training) else LEVELS.held_out
    colour = ADEQUATE_COLOUR if comparison.lack_of_fit >= level else MISFIT_COLOUR
    return LabelledComparison(f"{number}{step.label}", colour, comparison)


def time_chart(view: View, study: Study) -> Chart:
    """Measured, predicted and residual of the channels; a cell's samples are marked."""
    sides = _sides(view, study)
    marked = _cell_spans(view, sides[0])
    rows: list[tuple[Panel, ...]] = []
    for place, channel in enumerate(sorted(view.channels)):
        limits = residual_limits(sides, channel)
        rows.append(tuple(measured_panel(side, channel, titled=not place and len(sides) > 1) for side in sides))
        below = (residual_panel(side, channel, limits) for side in sides)
        rows.append(tuple(replace(panel, marks=(*panel.marks, *marked)) for panel in below))
    return Chart(
        rows=tuple(rows), heights=(1.0, 1.15) * len(view.channels), row_height=150 if len(rows) > 2 else 230,
        shared_x=True,
    )  # fmt: skip


def _cell_spans(view: View, side: LabelledComparison) -> tuple[Span, ...]:
    if view.cell is None:
        return ()
    inside = samples_of_cell(side.comparison, *view.cell[:2])
    recording = side.recording
    often = inside.reshape(recording.repeats, -1).mean(axis=0) >= 0.5 if recording.repeats > 1 else inside
    at = side.instants
    step = float(at[1] - at[0]) if len(at) > 1 else 1.0
    edges = _runs(often)
    return tuple(
        Span(start=at[a] - step / 2, end=at[b] + step / 2, colour=HELD_OUT, opacity=0.3, label="samples of the cell")
        for a, b in edges[:MOST_SPANS]
    )


def _runs(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and last index of each run of True."""
    change = np.diff(np.concatenate([[False], mask, [False]]).astype(int))
    return list(zip(np.flatnonzero(change == 1), np.flatnonzero(change == -1) - 1, strict=True))


def maps_of(view: View, study: Study) -> tuple[ResidualMap, ...]:
    """Residual maps of the first channel, those that explain most, or all."""
    channel = study.model.channels[view.channels[0]]
    comparison = comparisons_of(study.steps[-1])[view.recording]
    every = tuple(m for m in residual_maps(comparison, study.tolerance) if m.channel == channel)
    return every if view.every_map else every[:MOST_MAPS]


def map_chart(maps: Sequence[ResidualMap], marked: tuple[str, float, str] | None = None) -> Chart:
    """Residual maps of one channel, two in a row; a ring about the cell whose samples are marked in time."""
    if not maps:
        raise InputError(
            what="no variable is visited often enough for a map", where="residual map", remedy="look at the time"
        )
    chart = residual_map_chart([("", maps)])
    drawn = [p and _with_ring(p, m, marked) for p, m in zip(chart.rows[0], maps, strict=True)]
    pairs = tuple(tuple(drawn[i : i + 2]) for i in range(0, len(drawn), 2))
    return replace(chart, rows=pairs, row_height=210, shared_x=False)


def _with_ring(panel: Panel, shown: ResidualMap, marked: tuple[str, float, str] | None) -> Panel:
    """The panel of a map with a ring about the marked cell, if it is in this map."""
    if marked is None or marked[0] != shown.variable:
        return panel
    at = [_nearest(shown, marked[1])]
    ring = Points(x=shown.centre[at], y=shown.mean[at], colour=HELD_OUT, size=9, hollow=True, label="marked in time")
    return replace(panel, marks=(*panel.marks[:2], ring, *panel.marks[2:]))


def stairs_chart(_view: View, study: Study) -> Chart:
    """Error over noise floor after each step, on training and validation."""
    numbers = [str(number) for number in range(len(study.steps))]
    return error_reduction_chart(study.steps, numbers, study.tolerance, x_label="step")


def spectrum_chart(view: View, study: Study) -> Chart:
    """Spectrum of the residual."""
    sides = _sides(view, study)
    if sides[0].recording.at_rest:
        raise InputError(what="static poses have no spectrum", where="spectrum", remedy="look at the residual")
    return replace(residual_spectrum_chart(sides, None), row_height=130)


CHARTS = {"time": time_chart, "stairs": stairs_chart, "spectrum": spectrum_chart}
"""What a view shows, other than maps."""
