"""Figure that plotly.js draws when a reader asks for it: its traces as numbers, in place of a picture."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modeling.number_format import axis_label
from truewrench.plots.residuals.labelled_comparison import LabelledComparison, channel_labels
from truewrench.plots.residuals.residual_spectrum_plot import residual_spectrum
from truewrench.plots.style import MEASURED

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
