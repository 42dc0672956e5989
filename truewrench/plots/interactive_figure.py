"""A chart that a browser draws with BokehJS, to zoom and to read values off, in a page that needs no network."""

from __future__ import annotations

import gzip
import json
from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from hashlib import sha256
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader

from modeling.errors import InputError, missing_package
from truewrench.files.output import atomic_write
from truewrench.plots.chart import Chart, Line
from truewrench.plots.style import DARK, LIGHT

MOST_VALUES = 250_000
"""Numbers that the lines of the figures of a page share: 1.3 MB. Every sample is there, up to this many."""
SCREEN_SCALE = 1.5
"""Of a panel's height: a screen has more room than a page."""
ON_ANY_PAPER = replace(LIGHT, paper="rgba(0, 0, 0, 0)")
"""Colours as in print, through which the page's paper is seen; its script changes them where that is dark."""
FEWEST_COLUMNS = 250
"""Intervals of a line, however many lines share a page: a quarter of a screen's width, so that no peak is displaced."""


@dataclass(frozen=True, eq=False)
class InteractiveFigure:
    """A chart to zoom, to read values off, and to hide what its legend names.

    columns   intervals of a long line, each with its smallest and largest sample: what zooming in can show; None for
              as many as a page of this figure alone holds
    """

    chart: Chart
    columns: int | None = None

    @property
    def layout(self) -> Any:
        """The figures of Bokeh, a column of rows, for who wants to change them; they are made anew each time."""
        enlarged = replace(self.chart, row_height=SCREEN_SCALE * self.chart.row_height)
        return drawing().bokeh_chart(enlarged, ON_ANY_PAPER, columns=self.columns or shared_columns([self.chart]))

    @property
    def json(self) -> str:
        """Legend and Bokeh's document as JSON that is safe inside a `<script>` element."""
        data = {"legend": drawing().legend_html(self.chart), "item": drawing().document_item(self.layout)}
        text = json.dumps(data, allow_nan=False, separators=(",", ":"))
        return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")

    @property
    def html(self) -> str:
        """A page with this figure alone; nothing is fetched."""
        environment = Environment(loader=PackageLoader("truewrench"), autoescape=True)
        title = self.chart.title or next((p.title or p.y_label for p in self.chart.panels), "")
        return environment.get_template("figure.html").render(title=title, figure=self, **library())

    def write_html(self, path: str | Path) -> Path:
        """Write the page as one file, atomically; return its path.

        Raises InputError when it cannot be written.
        """
        with atomic_write(Path(path)) as temporary:
            temporary.write_text(self.html, encoding="utf-8")
        return Path(path)

    def _repr_html_(self) -> str:
        """The page in a frame, which a notebook asks for."""
        height = int(120 + SCREEN_SCALE * len(self.chart.rows) * (self.chart.row_height + 40))
        return f'<iframe srcdoc="{escape(self.html)}" style="width: 100%; height: {height}px; border: 0"></iframe>'


def drawing() -> Any:
    """The module that draws with Bokeh; InputError where that is not installed."""
    try:
        from truewrench.plots import bokeh_chart
    except ModuleNotFoundError as error:
        raise missing_package(error) or error from None
    return bokeh_chart


@cache
def can_zoom() -> bool:
    """Whether figures can be drawn in a browser: without Bokeh a page has its pictures alone, and says so."""
    try:
        drawing()
    except InputError:
        return False
    return True


def shared_columns(charts: Sequence[Chart]) -> int:
    """Intervals of each line, where the lines of so many charts share the numbers of a page."""
    lines = [sum(isinstance(mark, Line) for mark in panel.marks) for chart in charts for panel in chart.panels]
    values_a_column = sum(2 * count * (count + 1) for count in lines)
    return max(FEWEST_COLUMNS, MOST_VALUES // max(values_a_column, 1))


# BokehJS inside a page: compressed, unpacked by the browser at the first zoom, so that nothing is fetched.


@cache
def packed_bokeh() -> str:
    """BokehJS, gzipped, in base64: 0.5 MB."""
    script = files("bokeh") / "server" / "static" / "js" / "bokeh.min.js"
    return b64encode(gzip.compress(script.read_bytes(), 9, mtime=0)).decode()


@cache
def loader_script() -> str:
    """The script that draws a figure when its button is pressed, in the colours of a light or a dark page."""
    dark = {LIGHT.grid: DARK.grid, **DARK.instead}
    script = (files("truewrench") / "templates" / "zoom.js").read_text(encoding="utf-8").strip()
    return f"const DARK = {json.dumps({light.lower(): colour for light, colour in dark.items()})};\n{script}"


def script_hash(script: str) -> str:
    """Hash by which the page's security policy knows the script; no other runs."""
    return f"sha256-{b64encode(sha256(script.encode()).digest()).decode()}"


def library() -> dict[str, str]:
    """What a template needs to draw figures: BokehJS, the script that draws, and the script's hash."""
    script = loader_script()
    return {"packed_bokeh": packed_bokeh(), "script": script, "script_hash": script_hash(script)}
