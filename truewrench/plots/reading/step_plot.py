"""Steps of a reading over time: a row each, with its sentence and when it happened."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from textwrap import wrap

from matplotlib.axes import Axes

from estimation.recordings.reports.reading_curves import Span
from estimation.recordings.reports.reading_report import ReadingStep, StepKind
from truewrench.plots.style import HELD_OUT, INK, MISFIT_COLOUR, MUTED, NOISE, SMALL, panel_title

LINE, BAR = 13.0, 14.0
"""CSS pixels of a line of a step's sentence, and of its instants below it."""
MOST_STEPS = 14
CHARACTERS = 165
"""Of a line."""
COLOURS: Mapping[StepKind, str] = {StepKind.MENDED: HELD_OUT, StepKind.SUSPICIOUS: MISFIT_COLOUR}
"""Of what was mended and of what is suspicious."""


def shown_steps(steps: Sequence[ReadingStep]) -> list[ReadingStep]:
    """Those that mended something or are suspicious; of very many the first."""
    return [step for step in steps if step.kind in COLOURS][:MOST_STEPS]


def steps_height(steps: Sequence[ReadingStep]) -> float:
    """Height of their panel in CSS pixels."""
    return max(sum(map(_height, steps)), LINE + BAR)


def draw_steps(axes: Axes, steps: Sequence[ReadingStep], limits: Span, *, timed: bool) -> None:
    """A row for each step, from top to bottom: its sentence, and a bar for each interval in which it happened."""
    axes.set(xlim=limits, ylim=(steps_height(steps), 0), yticks=[])
    axes.spines["left"].set_visible(False)
    if any(step.at for step in steps):
        axes.set_xlabel("time (s)" if timed else "pose, in the order of recording")
    else:
        axes.set_xticks([])
        axes.spines["bottom"].set_visible(False)
    panel_title(axes, "what was mended, and what is suspicious")
    if not steps:
        text = "nothing was mended, and nothing is suspicious"
        axes.text(0.0, LINE, text, transform=axes.get_yaxis_transform(), fontsize=SMALL, color=MUTED)
    top = 0.0
    for step in steps:
        _draw_step(axes, top, step)
        top += _height(step)


def _draw_step(axes: Axes, top: float, step: ReadingStep) -> None:
    """A step whose row begins at `top`, CSS pixels."""
    colour, lines, place = COLOURS[step.kind], _lines(step), axes.get_yaxis_transform()
    axes.plot([0.0], [top + LINE - 3], "s", ms=4, color=colour, transform=place, clip_on=False)
    for number, line in enumerate(lines):
        height = top + LINE * number + LINE - 3
        axes.text(0.008, height, line, transform=place, fontsize=SMALL, color=INK, va="center")
    if step.at:
        below = top + LINE * len(lines) + BAR / 2
        axes.hlines(below, *axes.get_xlim(), color=NOISE, lw=1.0, zorder=0)
        bars = [(start, end - start) for start, end in step.at]
        axes.broken_barh(bars, (below - 4, 8), facecolor=colour, edgecolor=colour, lw=1.2)


def _lines(step: ReadingStep) -> list[str]:
    return wrap(f"{step.kind.value}: {step}", CHARACTERS)


def _height(step: ReadingStep) -> float:
    return LINE * len(_lines(step)) + BAR
