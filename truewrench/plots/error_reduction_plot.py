"""Error / noise floor of each channel over a series of models, such as the steps of a diagnosis."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from diagnosis.comparison.error_table import (
    ComparedStep,
    RecordingErrors,
    recording_errors,
    systematic_error,
    systematic_error_text,
)
from modeling.number_format import axis_label, format_number
from truewrench.plots.charts.chart import Band, Chart, Level, Line, Mark, Panel, Points, in_rows
from truewrench.plots.charts.matplotlib_chart import matplotlib_figure
from truewrench.plots.style import ADEQUATE_COLOUR, HELD_OUT, INK, NOISE
from truewrench.plots.svg_image import SvgImage

COLUMNS = 3
NOTE_SHARE = 0.25
"""Of the steps: room for the notes left of the first points."""
MOST_NOTES = 3
"""Steps that all have notes; of more the first and the last have."""
BELOW = "smaller than the axis shows; bars end at the upper limit"
MARKERS = "osD^vPX"


def error_reduction_figure(
    steps: Sequence[ComparedStep], names: Sequence[str], tolerance: Mapping[str, float]
) -> Figure:
    """A panel for each channel: error over noise floor, logarithmic, for every recording; tolerance shaded."""
    return matplotlib_figure(error_reduction_chart(steps, names, tolerance))


def error_reduction_chart(
    steps: Sequence[ComparedStep],
    names: Sequence[str],
    tolerance: Mapping[str, float],
    channel: str | None = None,
    x_label: str = "",
) -> Chart:
    """A panel for each channel: error over noise floor, logarithmic, for every recording; tolerance shaded.

    `names` label the steps, and `x_label` says what they are; the tolerance is by channel, in its unit. A single axes
    shows `channel`, by default the one with the largest error of the first model.
    """
    first = steps[0].training[0]
    shown = recording_errors(steps)
    limits = _limits(tolerance, shown)
    channels = first.recording.channels
    panels = [
        Panel(
            marks=tuple(_marks(shown, name, tolerance[name], limits[0])),
            title=axis_label(name, unit),
            x_ticks=tuple(names),
            x_label=x_label,
            x_limits=(-0.4 - NOTE_SHARE * len(names), len(names) - 0.5),
            y_label="error / noise floor",
            y_log=True,
            y_limits=limits,
        )
        for name, unit in zip(channels, first.space.units, strict=True)
    ]
    ratio = {c: v / shown[0].floor(c) for c, v in systematic_error(first).items()}
    main = channels.index(channel or max(ratio, key=lambda c: ratio[c]))
    return Chart(
        rows=in_rows(panels, COLUMNS), row_height=165, main=divmod(main, min(COLUMNS, len(panels))), shared_y=True,
        between_rows=60,
    )  # fmt: skip


def _limits(tolerance: Mapping[str, float], shown: Sequence[RecordingErrors]) -> tuple[float, float]:
    tolerances = [size / shown[0].floor(c) for c, size in tolerance.items()]
    sizes = [v / f.floor(k) for f in shown for c in f.comparisons for k, v in systematic_error(c).items()]
    lowest = min([*tolerances, *(s for s in sizes if s > 0), 1.0])
    return max(lowest, min(tolerances) / 10) / 2.5, 3 * max([*sizes, 1.0])


def point_spacing(count: int) -> float:
    """Horizontal distance between the points of `count` recordings, in steps."""
    return min(0.14, 0.5 / count)


def _marks(shown: Sequence[RecordingErrors], channel: str, tolerance: float, bottom: float) -> Iterator[Mark]:
    share = tolerance / shown[0].floor(channel)
    yield Band(low=bottom / 10, high=share, colour=NOISE, label="tolerance")
    yield Level(y=1.0, colour=INK, dashed=True, note="noise floor")
    for number, errors in enumerate(shown):
        yield from _recording_marks(errors, channel, number, len(shown), bottom)


def _recording_marks(errors: RecordingErrors, channel: str, number: int, count: int, bottom: float) -> Iterator[Mark]:
    """Points of one recording, offset from the others; below the axis an arrow, the upper limit as a bar."""
    place = np.arange(len(errors.comparisons), dtype=np.float64) + (number - (count - 1) / 2) * point_spacing(count)
    floor = errors.floor(channel)
    ratio = np.array([systematic_error(c)[channel] for c in errors.comparisons]) / floor
    limit = np.array([(c.explainable_limit or systematic_error(c))[channel] for c in errors.comparisons]) / floor
    colour = ADEQUATE_COLOUR if errors.fitted else HELD_OUT
    drawn = np.maximum(ratio, bottom * 1.35)
    yield Line(x=place, y=drawn, colour=colour, width=1.2, opacity=0.6)
    texts = _notes(errors, channel) if not number else []
    shown = ratio >= bottom
    below = BELOW if shown.any() else f"{errors.label}, {BELOW}"
    for inside, symbol, label in ((shown, MARKERS[number % len(MARKERS)], errors.label), (~shown, "v", below)):
        yield Points(
            x=place[inside], y=drawn[inside], low=drawn[inside], high=np.maximum(limit, drawn)[inside],
            colour=colour, size=6, hollow=not errors.fitted, symbol=symbol, label=label,
            notes=tuple(text for text, keep in zip(texts, inside, strict=False) if keep),
        )  # fmt: skip


def _notes(errors: RecordingErrors, channel: str) -> list[str]:
    """The error after each step, in words; of many steps the first and the last."""
    texts = [systematic_error_text(c, channel, 2) for c in errors.comparisons]
    return texts if len(texts) <= MOST_NOTES else [texts[0], *[""] * (len(texts) - 2), texts[-1]]


def error_reduction_image(
    steps: Sequence[ComparedStep], names: Sequence[str], tolerance: Mapping[str, float]
) -> SvgImage:
    """Figure of the errors of all recordings after each step, per channel."""
    sizes = [f"{n} {format_number(_largest_error_ratio(s), 2)}" for n, s in zip(names, steps, strict=True)]
    alt = f"Error / noise floor after each step, worst channel: {', '.join(sizes)}."
    return SvgImage(lambda: error_reduction_figure(steps, names, tolerance), alt)


def _largest_error_ratio(step: ComparedStep) -> float:
    comparison = step.training[0]
    return max(v / max(comparison.noise_floor[c], 1e-300) for c, v in systematic_error(comparison).items())
