"""Templates of the reports, as HTML and as Markdown."""

from __future__ import annotations

import gzip
import json
import re
from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from importlib.resources import files
from itertools import pairwise
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from numpy.typing import NDArray

from modeling.number_format import axis_label, format_percentage, typeset_text
from modeling.table import Table
from truewrench.effect_description import SKETCH_STYLE
from truewrench.effect_description.formula_mathml import formula_mathml
from truewrench.plots.residual_plots import residual_spectrum
from truewrench.plots.style import ADEQUATE_COLOUR, HELD_OUT, MEASURED, MISFIT_COLOUR, NOISE, QUIET_NOISE
from truewrench.plots.time_series_plot import LabelledComparison, channel_labels

# Markdown of a report: escaped text, and tables.


_SPECIAL = re.compile(r"([\\`*_{}\[\]<>#|~!$&])")
_LINE_BREAKS = re.compile(r"[\s\x00-\x1f\x85\u2028\u2029]+")


def markdown_text(value: Any) -> Any:
    """A value as Markdown that shows it as it is: special characters are escaped, line breaks are spaces.

    What is Markdown already, a `Markup`, stays.
    """
    if isinstance(value, Markup) or not isinstance(value, str):
        return value
    return _SPECIAL.sub(r"\\\1", _LINE_BREAKS.sub(" ", value))


def markdown_table(table: Table) -> Markup:
    """The table in Markdown, with an empty heading where it has none."""
    columns = table.filled.columns
    headings = [markdown_text(c.typeset_heading) for c in columns]
    rules = ["---:" if c.format else "---" for c in columns]
    rows = [[markdown_text(c.typeset(v)) for c, v in zip(columns, row, strict=True)] for row in table.filled.rows]
    return Markup("\n".join(f"| {' | '.join(cells)} |" for cells in [headings, rules, *rows]))  # escaped


# Figure that plotly.js draws when a reader asks for it: its traces as numbers, in place of a picture.


Array = NDArray[np.float64]

MOST_VALUES = 250_000
"""Numbers that the zoomable figures of a report share: 1.3 MB. Every sample is there, up to this many."""
FEWEST_POINTS = 500
"""Of a line, however long the report."""
BAND = "rgba(128,128,128,0.2)"
"""Of the noise: seen on light and on dark paper."""
MARGIN = {"l": 70, "r": 12, "t": 28, "b": 44}


@dataclass(frozen=True)
class ZoomableFigure:
    """A figure as data for plotly.js: traces and layout."""

    traces: tuple[Mapping[str, Any], ...]
    layout: Mapping[str, Any]

    @property
    def json(self) -> str:
        """As JSON that is safe inside a `<script>` element."""
        text = json.dumps({"data": self.traces, "layout": self.layout}, allow_nan=False, separators=(",", ":"))
        return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def points_of_line(lines: int) -> int:
    """Points of each line, where so many lines share the numbers of a report."""
    return max(FEWEST_POINTS, MOST_VALUES // max(1, lines))


def zoomable_series(sides: Sequence[LabelledComparison], channel: int, points: int) -> ZoomableFigure:
    """Measured and predicted above, the residual of each model below, over one repeat; its noise as a band."""
    first, (name, unit) = sides[0], channel_labels(sides)[channel]
    index = kept_samples([first.measured[:, channel], *(s.residual[:, channel] for s in sides)], points)
    across = first.instants[index]
    mode = "markers" if first.recording.at_rest else "lines"
    traces = [_trace(across, first.measured[index, channel], "measured", MEASURED, mode=mode)]
    for side in sides:
        traces.append(
            _trace(across, side.predicted[index, channel], f"predicted, {side.label}", side.colour, mode=mode)
        )
        residual = side.residual[index, channel]
        traces.append(_trace(across, residual, f"residual, {side.label}", side.colour, mode=mode, yaxis="y2"))
    floor = float(first.floor[channel])
    layout = {
        "height": 460,
        "xaxis": {"title": {"text": _across_label(first)}, "anchor": "y2"},
        "yaxis": {"title": {"text": axis_label(name, unit)}, "domain": [0.55, 1.0]},
        "yaxis2": {"title": {"text": axis_label(f"residual of {name}", unit)}, "domain": [0.0, 0.45]},
        "shapes": [_band(floor)],
    }
    return ZoomableFigure(tuple(traces), _completed(layout))


def zoomable_spectrum(sides: Sequence[LabelledComparison], channel: int) -> ZoomableFigure:
    """Amplitude of the residual of each model by frequency, and of its noise."""
    name, unit = channel_labels(sides)[channel]
    traces = []
    for side in sides:
        lines = residual_spectrum(side)
        shown = lines.motion if lines.motion.any() else np.ones(len(lines.frequency), dtype=bool)
        index = np.flatnonzero(shown)[: MOST_VALUES // 100]
        label = f"excited lines, {side.label}" if lines.motion.any() else side.label
        traces.append(_trace(lines.frequency[index], lines.amplitude[index, channel], label, side.colour))
        if lines.noise is not None and side is sides[-1]:
            traces.append(_trace(lines.frequency[index], lines.noise[index, channel], "noise", MEASURED))
    layout = {
        "height": 320,
        "xaxis": {"type": "log", "title": {"text": "frequency (Hz)"}},
        "yaxis": {"type": "log", "title": {"text": axis_label(f"{name} amplitude", unit)}, "exponentformat": "power"},
    }
    return ZoomableFigure(tuple(traces), _completed(layout))


def kept_samples(series: Sequence[Array], points: int) -> NDArray[np.intp]:
    """Indices of about so many samples: all, or the smallest and largest of each series in equal intervals."""
    count = len(series[0])
    if count <= points:
        return np.arange(count)
    edges = np.linspace(0, count, max(1, points // (2 * len(series))) + 1).astype(int)
    found = [
        start + extreme(part[start:end])
        for part in series
        for extreme in (np.argmin, np.argmax)
        for start, end in pairwise(edges)
    ]
    return np.unique(np.array(found, dtype=np.intp))


def _trace(x: Array, y: Array, name: str, colour: str, **options: Any) -> dict[str, Any]:
    line = {"x": _packed(x), "y": _packed(y), "name": name, "type": "scatter"}
    return line | {"mode": "lines", "line": {"color": colour, "width": 1.2}, "marker": {"color": colour}} | options


def _packed(values: Array) -> dict[str, str]:
    """Numbers in single precision, which plotly.js reads as they are."""
    return {"dtype": "f4", "bdata": b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode()}


def _band(floor: float) -> dict[str, Any]:
    """± noise of one sample about the zero of the residual."""
    edges = {"xref": "paper", "x0": 0, "x1": 1, "yref": "y2", "y0": -floor, "y1": floor}
    return {"type": "rect", **edges, "layer": "below", "line": {"width": 0}, "fillcolor": BAND}


def _completed(layout: Mapping[str, Any]) -> dict[str, Any]:
    """With what all figures have: margins, legend above, no background of their own."""
    clear = "rgba(0,0,0,0)"
    legend = {"orientation": "h", "x": 0, "y": 1.02, "yanchor": "bottom"}
    return {"margin": MARGIN, "legend": legend, "paper_bgcolor": clear, "plot_bgcolor": clear, **layout}


def _across_label(side: LabelledComparison) -> str:
    if side.recording.at_rest:
        return "pose, in the order of recording"
    return "time in one repeat (s)" if side.recording.repeats > 1 else "time (s)"


# plotly.js inside the page: compressed, unpacked by the browser at the first zoom, so that nothing is fetched.
#
# The whole library is 4.8 MB, compressed and as text 2.0 MB; its smaller bundles are not in the Python package.


@cache
def packed_plotly() -> str:
    """plotly.js, gzipped, in base64."""
    from plotly.offline import get_plotlyjs

    return b64encode(gzip.compress(get_plotlyjs().encode(), 6, mtime=0)).decode()


@cache
def loader_script() -> str:
    """The script that draws a zoomable figure when its button is pressed."""
    return (files("truewrench") / "templates" / "zoom.js").read_text(encoding="utf-8").strip()


def script_hash(script: str) -> str:
    """Hash by which the page's security policy knows the script; no other runs."""
    return f"sha256-{b64encode(sha256(script.encode()).digest()).decode()}"


LEGEND = (
    (MEASURED, "measured"),
    (MISFIT_COLOUR, "a model that does not fit; cells of a residual map above tolerance"),
    (ADEQUATE_COLOUR, "a model that fits, or the better one; errors of fitted recordings"),
    (HELD_OUT, "errors of held-out recordings; a transient event"),
    (NOISE, "noise of one sample; tolerance"),
    (QUIET_NOISE, "noise of the mean over the repeats"),
)
"""Colours of all pictures and what they stand for."""


def page_templates() -> Environment:
    """Templates of `truewrench/templates`; values are escaped, a missing one is an error."""
    environment = Environment(
        loader=PackageLoader("truewrench"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"percentage": format_percentage, "typeset": typeset_text, "formula": _formula}
    environment.globals |= {"legend": LEGEND, "sketch_style": Markup(SKETCH_STYLE), "packed_plotly": packed_plotly}
    return environment


def _formula(text: str) -> Markup:
    """A formula of the catalogue or of a user, typeset."""
    return Markup(formula_mathml(text))  # escaped there


def html_page(template: str, values: Mapping[str, Any]) -> str:
    """A page of these values, with the script that zooms its figures where it has any."""
    script = loader_script()
    found = page_templates().get_template(template)
    return found.render(**values, zooms=True, script=script, script_hash=script_hash(script))


def markdown_page(template: str, values: Mapping[str, Any]) -> str:
    """A Markdown text of these values, in which the text of users is escaped."""
    environment = page_templates().overlay(autoescape=False, finalize=markdown_text)
    environment.filters["table"] = markdown_table
    text = environment.get_template(template).render(**values)
    lines = text.splitlines()
    kept = [line for i, line in enumerate(lines) if line.strip() or (i and lines[i - 1].strip())]
    return "\n".join(kept).strip() + "\n"
