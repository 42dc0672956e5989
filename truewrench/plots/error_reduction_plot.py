"""Error / noise floor of each channel over a series of models, such as the steps of a diagnosis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from diagnosis.comparison.error_table import (
    ComparedStep,
    RecordingErrors,
    recording_errors,
    systematic_error,
    systematic_error_text,
)
from modeling.number_format import format_number, format_unit
from truewrench.plots.style import (
    ADEQUATE_COLOUR,
    HELD_OUT,
    INK,
    LEGEND,
    MISFIT_COLOUR,
    MUTED,
    NOISE,
    SMALL,
    PanelGrid,
    label_y_axis,
    panel_title,
)
from truewrench.plots.svg_image import SvgImage, svg_image

COLUMNS = 3
MARKERS = "osD^vPX"


def error_reduction_figure(
    steps: Sequence[ComparedStep], names: Sequence[str], tolerance: Mapping[str, float]
) -> Figure:
    """A panel for each channel: error over noise floor, logarithmic, for every recording; tolerance shaded.

    `names` label the steps; the tolerance is by channel, in its unit.
    """
    first = steps[0].training[0]
    channels, units = first.recording.channels, first.space.units
    rows = -(-len(channels) // COLUMNS)
    sheet = PanelGrid(rows=rows, columns=COLUMNS, panel_height=165, top=46, bottom=34, between_rows=34)
    figure, panels = sheet.panels(sharex=True, sharey=True)
    shown = recording_errors(steps)
    bottom, top = _limits(tolerance, shown)
    for axes, channel, unit in zip(panels.flat, channels, units, strict=True):
        panel_title(axes, f"{channel} ({format_unit(unit)})")
        _reference_lines(axes, tolerance[channel] / max(first.noise_floor[channel], 1e-300), bottom)
        for number, errors in enumerate(shown):
            _draw_steps(axes, errors, channel, number, len(shown), bottom)
        _write_errors(axes, shown[0], channel, len(shown), bottom)
    panels[0, 0].set_yscale("log")
    panels[0, 0].set_ylim(bottom, top)
    panels[0, 0].set_xlim(-0.5, len(names) - 0.5)
    panels[0, 0].set_xticks(range(len(names)), [n.replace(" ", "\n") if len(names) > 3 else n for n in names])
    for axes in panels[:, 0]:
        label_y_axis(axes, "error / noise floor")
    figure.legend(*panels[0, 0].get_legend_handles_labels(), **LEGEND, ncols=4, loc="upper right", borderaxespad=0.2)
    return figure


def _limits(tolerance: Mapping[str, float], shown: Sequence[RecordingErrors]) -> tuple[float, float]:
    floor = shown[0].comparisons[0].noise_floor
    tolerances = [tolerance[c] / max(floor[c], 1e-300) for c in floor]
    sizes = [v / f.floor(k) for f in shown for c in f.comparisons for k, v in systematic_error(c).items()]
    lowest = min([*tolerances, *(s for s in sizes if s > 0), 1.0])
    return max(lowest, min(tolerances) / 10) / 2.5, 3 * max([*sizes, 1.0])


def _reference_lines(axes: Axes, tolerance: float, bottom: float) -> None:
    axes.axhspan(bottom / 10, tolerance, color=NOISE, lw=0, zorder=0)
    axes.axhline(1.0, color=INK, lw=0.9, ls="--", zorder=0.5)
    edge: dict[str, Any] = {"ha": "right", "fontsize": SMALL - 0.5, "color": MUTED, "zorder": 0.6}
    axes.annotate("noise floor", (0.995, 1.0), (0, 2), axes.get_yaxis_transform(), "offset points", va="bottom", **edge)
    axes.annotate(
        "tolerance", (0.995, tolerance), (0, -2), axes.get_yaxis_transform(), "offset points", va="top", **edge
    )


def point_spacing(count: int) -> float:
    """Horizontal distance between the points of `count` recordings, in steps."""
    return min(0.14, 0.5 / count)


def _draw_steps(axes: Axes, errors: RecordingErrors, channel: str, number: int, count: int, bottom: float) -> None:
    """Points of one recording, offset from the others; below the axis an arrow, the upper limit as a bar."""
    place = np.arange(len(errors.comparisons)) + (number - (count - 1) / 2) * point_spacing(count)
    floor = errors.floor(channel)
    ratio = np.array([systematic_error(c)[channel] for c in errors.comparisons]) / floor
    limit = np.array([(c.explainable_limit or systematic_error(c))[channel] for c in errors.comparisons]) / floor
    colour = ADEQUATE_COLOUR if errors.fitted else HELD_OUT
    drawn = np.maximum(ratio, bottom * 1.35)
    axes.plot(place, drawn, color=colour, lw=1.2, alpha=0.6, zorder=2)
    axes.vlines(place, drawn, np.maximum(limit, drawn), color=colour, lw=1.0, alpha=0.8, zorder=2)
    style: dict[str, Any] = {
        "color": colour,
        "mfc": colour if errors.fitted else "white",
        "mew": 1.4,
        "ls": "none",
        "zorder": 3,
    }
    axes.plot(
        place,
        np.where(ratio >= bottom, drawn, np.nan),
        MARKERS[number % len(MARKERS)],
        ms=6,
        label=errors.label,
        **style,
    )
    axes.plot(place, np.where(ratio < bottom, drawn, np.nan), "v", ms=6, **style)


def _write_errors(axes: Axes, errors: RecordingErrors, channel: str, count: int, bottom: float) -> None:
    """The error in the channel's unit next to each point of the first recording."""
    for place, comparison in enumerate(errors.comparisons):
        ratio = max(systematic_error(comparison)[channel] / errors.floor(channel), bottom * 1.35)
        axes.annotate(
            systematic_error_text(comparison, channel, 2),
            (place - (count - 1) / 2 * point_spacing(count), ratio),
            (-8, 0),
            textcoords="offset points",
            ha="right",
            va="center",
            bbox={"facecolor": "white", "alpha": 0.6, "linewidth": 0, "pad": 0.6},
            fontsize=SMALL,
            color=MISFIT_COLOUR if ratio > 1 else INK,
        )


def error_reduction_image(
    steps: Sequence[ComparedStep], names: Sequence[str], tolerance: Mapping[str, float]
) -> SvgImage:
    """Figure of the errors of all recordings after each step, per channel."""
    sizes = [f"{n} {format_number(_largest_error_ratio(s), 2)}" for n, s in zip(names, steps, strict=True)]
    alt = f"Error / noise floor after each step, worst channel: {', '.join(sizes)}."
    return svg_image(error_reduction_figure(steps, names, tolerance), alt)


def _largest_error_ratio(step: ComparedStep) -> float:
    comparison = step.training[0]
    return max(v / max(comparison.noise_floor[c], 1e-300) for c, v in systematic_error(comparison).items())
