"""Colours safe for colour blindness (Okabe and Ito), sizes, and the style of axes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from io import StringIO
from textwrap import wrap
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.transforms import ScaledTranslation, blended_transform_factory
from numpy.typing import NDArray

MISFIT_COLOUR = "#D55E00"
"""An inadequate model, and significant cells of a residual map."""
ADEQUATE_COLOUR = "#0072B2"
"""An adequate model."""
MEASURED = "#8A8F98"
INK = "#24292F"
MUTED = "#6B7280"
FAINT = "#C9CED6"
NOISE = "#E9ECF0"
QUIET_NOISE = "#D3D9E1"
HELD_OUT = "#E69F00"


@dataclass(frozen=True)
class Scheme:
    """Colours of a page: paper and lines of axes, and what other colours become on this paper."""

    paper: str
    ink: str
    muted: str
    grid: str
    instead: Mapping[str, str] = field(default_factory=dict)

    def colour(self, colour: str) -> str:
        """The colour on this paper."""
        return self.instead.get(colour, colour)


LIGHT = Scheme(paper="#ffffff", ink=INK, muted=MUTED, grid="#e9ecf0")
DARK = Scheme(
    paper="#14171b", ink="#e6e9ed", muted="#9aa4b0", grid="#272c33",
    instead={
        INK: "#e6e9ed", MUTED: "#9aa4b0", FAINT: "#4a525c", NOISE: "#262b31", QUIET_NOISE: "#3a424c",
        MEASURED: "#a7adb6", "#0072B2": "#56B4E9", "#D55E00": "#F0803C",
    },
)  # fmt: skip

WIDTH = 1080
"""Width of a figure on the page, in CSS pixels."""
PIXELS_PER_INCH = 96
SMALL, NORMAL = 7.5, 8.5
"""Font sizes in points."""
EDGE = 5
"""CSS pixels between any text and the edge of the figure."""
TITLE_CHARACTER = 7.6
"""CSS pixels of a character of a panel's title."""
NO_BREAK_SPACE = "\N{NO-BREAK SPACE}"


LEGEND: dict[str, Any] = {
    "frameon": False,
    "fontsize": SMALL,
    "labelcolor": INK,
    "handlelength": 1.4,
    "columnspacing": 1.2,
}


class NotebookFigure(Figure):
    """A figure that a notebook shows without pyplot; its canvas keeps the renderer that measures the texts."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        FigureCanvasAgg(self)

    def _repr_svg_(self) -> str:
        """The figure as SVG, which a notebook asks for."""
        stream = StringIO()
        self.savefig(stream, format="svg")
        return stream.getvalue()


@dataclass(frozen=True, kw_only=True)
class PanelGrid:
    """Sizes of a grid of panels in CSS pixels: fixed, so that panels align between figures."""

    rows: int
    columns: int
    panel_height: float
    width: float = WIDTH
    left: float = 66
    right: float = 8
    top: float = 24
    bottom: float = 40
    between_columns: float = 22
    between_rows: float = 16

    @property
    def height(self) -> float:
        """Height of the whole figure."""
        rows = self.rows * self.panel_height + (self.rows - 1) * self.between_rows
        return self.top + rows + self.bottom

    @property
    def panel_width(self) -> float:
        """Width of one panel."""
        return (self.width - self.left - self.right - (self.columns - 1) * self.between_columns) / self.columns

    def panels(self, *, heights: Sequence[float] | None = None, **shared: Any) -> tuple[Figure, NDArray[Any]]:
        """The empty figure and its styled axes (rows, columns); `heights` are relative."""
        figure = NotebookFigure()
        figure.patch.set_alpha(0.0)
        self.place(figure)
        panels = figure.subplots(
            self.rows, self.columns, squeeze=False, gridspec_kw={"height_ratios": heights}, **shared
        )
        for axes in panels.flat:
            style_axes(axes)
        return figure, panels

    def place(self, figure: Figure) -> None:
        """Give the figure and its panels the sizes of this grid."""
        figure.set_size_inches(self.width / PIXELS_PER_INCH, self.height / PIXELS_PER_INCH)
        figure.subplots_adjust(
            left=self.left / self.width,
            right=1 - self.right / self.width,
            top=1 - self.top / self.height,
            bottom=self.bottom / self.height,
            wspace=self.between_columns / self.panel_width,
            hspace=self.between_rows / self.panel_height,
        )


@dataclass(frozen=True)
class PixelLayout:
    """An empty figure whose panels are placed in CSS pixels from its top left corner."""

    height: float
    figure: Figure

    @classmethod
    def of(cls, height: float) -> PixelLayout:
        """An empty figure of the common width."""
        figure = NotebookFigure(figsize=(WIDTH / PIXELS_PER_INCH, height / PIXELS_PER_INCH))
        figure.patch.set_alpha(0.0)
        return cls(height, figure)

    def panel(self, left: float, top: float, width: float, height: float) -> Axes:
        """Styled axes."""
        place = (left / WIDTH, 1 - (top + height) / self.height, width / WIDTH, height / self.height)
        return style_axes(self.figure.add_axes(place))


def style_axes(axes: Axes) -> Axes:
    """The axes with two thin spines, small ticks and no frame."""
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(FAINT)
        axes.spines[side].set_linewidth(0.8)
    axes.tick_params(which="both", colors=MUTED, labelsize=SMALL, length=2.5, width=0.6)
    axes.xaxis.label.set(color=INK, fontsize=NORMAL)
    axes.yaxis.label.set(color=INK, fontsize=NORMAL)
    return axes


def panel_title(axes: Axes, text: str, colour: str = INK, *, pad: float | None = None, room: float = 1.0) -> None:
    """Left-aligned title of the axes, on as many lines as their width asks for.

    `pad` is its distance in points, and `room` the width that it may take, in widths of the axes.
    """
    width = room * axes.get_window_extent().width * PIXELS_PER_INCH / axes.figure.dpi
    style: dict[str, Any] = {"fontsize": NORMAL + 0.5, "fontweight": "bold", "color": colour}
    axes.set_title(wrapped(text, width), loc="left", pad=pad, **style)


def wrapped(text: str, width: float) -> str:
    """A title on lines of at most so many CSS pixels, if possible broken before a plus."""
    kept = text.replace(" + ", f" +{NO_BREAK_SPACE}")
    lines = wrap(kept, max(int(width / TITLE_CHARACTER), 8), break_on_hyphens=False)
    return "\n".join(lines).replace(NO_BREAK_SPACE, " ")


def label_y_axis(axes: Axes, text: str, size: float = NORMAL) -> None:
    """Label of the y axis at a fixed distance from the figure's edge."""
    axes.set_ylabel(text, fontsize=size, va="top")
    figure = axes.get_figure(root=True)
    if figure is not None:
        inside = ScaledTranslation(EDGE / PIXELS_PER_INCH, 0, figure.dpi_scale_trans)
        place = blended_transform_factory(figure.transSubfigure + inside, axes.transAxes)
        axes.yaxis.set_label_coords(0.0, 0.5, place)
