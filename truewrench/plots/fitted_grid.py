"""Margins of a grid of panels by what its texts need, so that nothing is cut off and no row is written over another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import FixedLocator
from matplotlib.transforms import Bbox
from numpy.typing import NDArray

from truewrench.plots.style import EDGE, PIXELS_PER_INCH, PanelGrid, label_y_axis

LEAST_GAP = 14.0
"""Between rows of panels, CSS pixels."""
GAP = 8.0
"""Between the texts of neighbouring panels."""
TICK_GAP = 12.0
"""Between the labels of neighbouring ticks; with less they are turned."""
TURN = 28
"""Degrees."""


@dataclass(frozen=True)
class Surroundings:
    """Room that texts and symbols take outside a panel, CSS pixels."""

    left: float = 0.0
    right: float = 0.0
    above: float = 0.0
    below: float = 0.0

    @classmethod
    def of(cls, axes: Axes) -> Surroundings:
        """As drawn, without the length of titles and labels; none of axes that are not shown."""
        whole, inside = axes.get_tightbbox(for_layout_only=True), axes.get_window_extent()
        if whole is None or not axes.get_visible():
            return cls()
        scale = PIXELS_PER_INCH / axes.figure.dpi
        ends = (inside.x0 - whole.x0, whole.x1 - inside.x1, whole.y1 - inside.y1, inside.y0 - whole.y0)
        return cls(*(max(scale * end, 0.0) for end in ends))


def fit_grid(figure: Figure, panels: NDArray[Any], grid: PanelGrid, *, head: float = 0.0) -> PanelGrid:
    """The grid with margins for all texts, after figure and panels were placed by it.

    `head` is the room for title and legend of the whole figure above the panels. Panels keep their height; where labels
    are long they become narrower, and it is done again. Labels of the first column are then aligned at the edge.
    """
    for _ in range(2):
        for axes in panels.flat:
            _turn_long_ticks(axes)
        width, grid = grid.panel_width, _with_room(panels, grid, head)
        grid.place(figure)
        if grid.panel_width == width:
            break
    for axes in panels[:, 0]:
        if axes.get_ylabel():
            label_y_axis(axes, axes.get_ylabel())
    return grid


def _with_room(panels: NDArray[Any], grid: PanelGrid, head: float) -> PanelGrid:
    around = [[Surroundings.of(axes) for axes in line] for line in panels]
    rows = [[s.below + t.above for s, t in zip(upper, lower, strict=True)] for upper, lower in pairwise(around)]
    columns = [[s.right + t.left for s, t in pairwise(line)] for line in around]
    between_rows = max((max(row) for row in rows), default=0.0) + GAP
    between_columns = max((max(row, default=0.0) for row in columns), default=0.0) + GAP
    return replace(
        grid,
        left=max(grid.left, max(line[0].left for line in around) + EDGE),
        right=max(grid.right, max(line[-1].right for line in around) + EDGE),
        top=head + max(s.above for s in around[0]) + EDGE,
        bottom=max(s.below for s in around[-1]) + EDGE,
        between_rows=max(between_rows, LEAST_GAP),
        between_columns=max(between_columns, grid.between_columns),
    )


def _turn_long_ticks(axes: Axes) -> None:
    """Turn the names below an axis where they would touch each other or the next panel."""
    if not isinstance(axes.xaxis.get_major_locator(), FixedLocator):
        return
    labels = [label for label in axes.get_xticklabels() if label.get_text() and not label.get_rotation()]
    if not labels:
        return
    boxes = sorted((label.get_window_extent() for label in labels), key=lambda box: box.x0)
    panel: Bbox = axes.get_window_extent()
    tight = any(b.x0 - a.x1 < TICK_GAP for a, b in pairwise(boxes))
    if tight or boxes[-1].x1 > panel.x1:
        axes.tick_params(axis="x", labelrotation=TURN)
        for label in labels:
            label.set(ha="right", rotation_mode="anchor")


def make_room(figure: Figure, drawn: Sequence[Axes]) -> None:
    """Move the axes of a user's figure once, if a text of those drawn is cut off or written over another panel.

    Nothing is done with a layout engine, which does so itself, and where axes were placed by hand.
    """
    gridded = all(axes.get_subplotspec() is not None for axes in figure.axes)
    if figure.get_layout_engine() is None and gridded and _is_crowded(figure, drawn):
        for axes in drawn:
            _turn_long_ticks(axes)
        ConstrainedLayoutEngine().execute(figure)


def _is_crowded(figure: Figure, drawn: Sequence[Axes]) -> bool:
    boxes = {axes: box for axes in figure.axes if (box := axes.get_tightbbox()) is not None}
    page = figure.bbox
    for axes in (axes for axes in drawn if axes in boxes):
        box = boxes[axes]
        if box.x0 < page.x0 or box.y0 < page.y0 or box.x1 > page.x1 or box.y1 > page.y1:
            return True
        if any(box.overlaps(other) for one, other in boxes.items() if one is not axes):
            return True
    return False
