"""Staircase plot: the error per channel after each step, against the noise floor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from diagnosis.comparison import Comparison
from diagnosis.diagnosis import Diagnosis
from truewrench.plots.number import figures, unit_text
from truewrench.plots.style import FAILING, HELD_OUT, HOLDING, INK, LEGEND, MUTED, NOISE, SMALL, Sheet, heading, name_y

COLUMNS = 3
MARKERS = "osD^vPX"


@dataclass(frozen=True, eq=False)
class Flight:
    """One recording over all steps, and whether it was fitted."""

    name: str
    comparisons: tuple[Comparison, ...]
    fitted: bool

    def floor(self, channel: str) -> float:
        """The noise floor at the first step: one taken from the residual falls with it."""
        return max(self.comparisons[0].noise_floor[channel], 1e-300)


def flights(diagnosis: Diagnosis) -> tuple[Flight, ...]:
    """Training recordings, then held-out ones."""
    first = diagnosis.steps[0]
    trained = [
        Flight(c.recording.name, tuple(s.training[i] for s in diagnosis.steps), True)
        for i, c in enumerate(first.training)
    ]
    held_out = [
        Flight(c.recording.name, tuple(s.validation[i] for s in diagnosis.steps), False)
        for i, c in enumerate(first.validation)
    ]
    return (*trained, *held_out)


def size_of(comparison: Comparison) -> Mapping[str, float]:
    """RMS that can be explained, or the whole RMS where no repeats tell the two apart."""
    return comparison.explainable_rms if comparison.explainable_rms is not None else comparison.rms


def size_text(comparison: Comparison, channel: str, digits: int = 3) -> str:
    """Size of a channel's error; where noise leaves nothing to see of it, what it is below."""
    size, limit = size_of(comparison)[channel], comparison.explainable_limit
    if size > 0 or limit is None:
        return figures(size, digits)
    return f"< {figures(limit[channel], 2)}"


def step_names(diagnosis: Diagnosis) -> list[str]:
    """What each step is called."""
    return ["rigid tool" if s.effect is None else f"+ {s.effect.replace('_', ' ')}" for s in diagnosis.steps]


def staircase_figure(diagnosis: Diagnosis) -> Figure:
    """A panel for each channel: error over noise floor, logarithmic, for every recording; tolerance shaded."""
    channels = diagnosis.steps[0].training[0].recording.channels
    units = diagnosis.steps[0].training[0].space.units
    rows = -(-len(channels) // COLUMNS)
    sheet = Sheet(rows=rows, columns=COLUMNS, panel_height=165, top=46, bottom=34, between_rows=34)
    figure, panels = sheet.panels(sharex=True, sharey=True)
    shown = flights(diagnosis)
    bottom, top = _limits(diagnosis, shown)
    for axes, channel, unit in zip(panels.flat, channels, units, strict=True):
        heading(axes, f"{channel} ({unit_text(unit)})")
        _reference_lines(axes, diagnosis, channel, bottom)
        for number, flight in enumerate(shown):
            _stairs(axes, flight, channel, number, len(shown), bottom)
        _write_sizes(axes, shown[0], channel, len(shown), bottom)
    panels[0, 0].set_yscale("log")
    panels[0, 0].set_ylim(bottom, top)
    names = step_names(diagnosis)
    panels[0, 0].set_xlim(-0.5, len(names) - 0.5)
    panels[0, 0].set_xticks(range(len(names)), [n.replace(" ", "\n") if len(names) > 3 else n for n in names])
    for axes in panels[:, 0]:
        name_y(axes, "error / noise floor")
    figure.legend(*panels[0, 0].get_legend_handles_labels(), **LEGEND, ncols=4, loc="upper right", borderaxespad=0.2)
    return figure


def _limits(diagnosis: Diagnosis, shown: Sequence[Flight]) -> tuple[float, float]:
    floor = shown[0].comparisons[0].noise_floor
    tolerances = [diagnosis.tolerance[c] / max(floor[c], 1e-300) for c in floor]
    sizes = [v / f.floor(k) for f in shown for c in f.comparisons for k, v in size_of(c).items()]
    lowest = min([*tolerances, *(s for s in sizes if s > 0), 1.0])
    return max(lowest, min(tolerances) / 10) / 2.5, 3 * max([*sizes, 1.0])


def _reference_lines(axes: Axes, diagnosis: Diagnosis, channel: str, bottom: float) -> None:
    floor = diagnosis.steps[0].training[0].noise_floor[channel]
    tolerance = diagnosis.tolerance[channel] / max(floor, 1e-300)
    axes.axhspan(bottom / 10, tolerance, color=NOISE, lw=0, zorder=0)
    axes.axhline(1.0, color=INK, lw=0.9, ls="--", zorder=0.5)
    edge: dict[str, Any] = {"ha": "right", "fontsize": SMALL - 0.5, "color": MUTED, "zorder": 0.6}
    axes.annotate("noise floor", (0.995, 1.0), (0, 2), axes.get_yaxis_transform(), "offset points", va="bottom", **edge)
    axes.annotate(
        "tolerance", (0.995, tolerance), (0, -2), axes.get_yaxis_transform(), "offset points", va="top", **edge
    )


def beside(count: int) -> float:
    """How far apart the points of so many recordings stand, in steps."""
    return min(0.14, 0.5 / count)


def _stairs(axes: Axes, flight: Flight, channel: str, number: int, count: int, bottom: float) -> None:
    """One recording's steps, set beside the others'; below the axis an arrow down, the limit as a bar."""
    place = np.arange(len(flight.comparisons)) + (number - (count - 1) / 2) * beside(count)
    floor = flight.floor(channel)
    ratio = np.array([size_of(c)[channel] for c in flight.comparisons]) / floor
    limit = np.array([(c.explainable_limit or size_of(c))[channel] for c in flight.comparisons]) / floor
    colour = HOLDING if flight.fitted else HELD_OUT
    drawn = np.maximum(ratio, bottom * 1.35)
    axes.plot(place, drawn, color=colour, lw=1.2, alpha=0.6, zorder=2)
    axes.vlines(place, drawn, np.maximum(limit, drawn), color=colour, lw=1.0, alpha=0.8, zorder=2)
    style: dict[str, Any] = {
        "color": colour,
        "mfc": colour if flight.fitted else "white",
        "mew": 1.4,
        "ls": "none",
        "zorder": 3,
    }
    label = f"{flight.name} ({'fitted' if flight.fitted else 'held out'})"
    axes.plot(
        place, np.where(ratio >= bottom, drawn, np.nan), MARKERS[number % len(MARKERS)], ms=6, label=label, **style
    )
    axes.plot(place, np.where(ratio < bottom, drawn, np.nan), "v", ms=6, **style)


def _write_sizes(axes: Axes, flight: Flight, channel: str, count: int, bottom: float) -> None:
    """The size in the channel's own unit beside each point of the first recording."""
    for place, comparison in enumerate(flight.comparisons):
        ratio = max(size_of(comparison)[channel] / flight.floor(channel), bottom * 1.35)
        axes.annotate(
            size_text(comparison, channel, 2),
            (place - (count - 1) / 2 * beside(count), ratio),
            (-8, 0),
            textcoords="offset points",
            ha="right",
            va="center",
            bbox={"facecolor": "white", "alpha": 0.6, "linewidth": 0, "pad": 0.6},
            fontsize=SMALL,
            color=FAILING if ratio > 1 else INK,
        )
