"""Estimated contact wrench of several models, with the true one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from estimation.contact.contact_wrench import ContactWrench
from modeling.errors import InputError, quoted, suggestion
from modeling.number_format import axis_label
from truewrench.plots.charts.chart import Band, Chart, Level, Line, Mark, Panel, Span
from truewrench.plots.charts.matplotlib_chart import matplotlib_figure
from truewrench.plots.style import HELD_OUT, INK, QUIET_NOISE

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LabelledContact:
    """Contact wrench estimated with one model, with label and colour."""

    label: str
    colour: str
    contact: ContactWrench


def contact_figure(sides: Sequence[LabelledContact], true: Array | None = None) -> Figure:
    """Contact wrench averaged over the repeats, a column per model, a row per component, with the `true` one (n, p)."""
    return matplotlib_figure(contact_chart(sides, true))


def contact_chart(sides: Sequence[LabelledContact], true: Array | None = None, component: str | None = None) -> Chart:
    """Contact wrench averaged over the repeats, a column per model, a row per component, with the `true` one (n, p).

    The band is ± 2 std of the noise of that mean; a line outside it is contact or model error. Detected contact is
    shaded in a single run. Models share the scale of a component. A single axes shows `component`, by default the one
    with the largest force.
    """
    names = sides[0].contact.names
    count = len(names)
    rows = tuple(tuple(_panel(side, row, true) for side in sides) for row in range(count))
    if component is not None and component not in names:
        remedy = suggestion(component, names)
        raise InputError(what=f"no component is {quoted(component)}", where="plot", remedy=remedy)
    forces = [i for i, unit in enumerate(sides[0].contact.space.units) if unit == "N"]
    largest = max(forces, key=lambda i: float(np.abs(sides[0].contact.wrench[:, i]).max()))
    shown = largest if component is None else names.index(component)
    return Chart(rows=rows, row_height=110, main=(shown, len(sides) - 1), shared_x=True, shared_y=True,
                 between_rows=14)  # fmt: skip


def _panel(side: LabelledContact, row: int, true: Array | None) -> Panel:
    contact = side.contact
    name, unit = contact.names[row], contact.space.units[row]
    note = ""
    if true is not None:
        error, tenth = contact.systematic_contact_error(true)[row], float(contact.floor[row]) / 10
        note = f"error {error:.2g} {unit}" if error > tenth else f"error below {tenth:.2g} {unit}"
    return Panel(
        marks=tuple(_marks(contact, row, side.colour, true)),
        title="" if row else side.label,
        title_colour=side.colour,
        x_label=_time_label(contact),
        y_label=axis_label(name, unit),
        note=note,
    )


def _marks(contact: ContactWrench, row: int, colour: str, true: Array | None) -> Iterator[Mark]:
    repeats, once = contact.recording.repeats, contact.recording.samples_per_repeat
    time = contact.recording.time
    across = np.arange(once, dtype=float) if time is None else time[:once]
    base = np.zeros(once) if true is None else _mean(true[:, row], repeats)
    noise = 2 * float(contact.floor[row] / np.sqrt(repeats))
    label = _noise_label(repeats)
    if true is None:
        yield Band(low=-noise, high=noise, colour=QUIET_NOISE, label=label)
        yield Level(y=0)
    else:
        yield Band(x=across, low=base - noise, high=base + noise, colour=QUIET_NOISE, label=label)
    for interval in contact.intervals if repeats == 1 else ():
        start, end = contact.time_of(interval.first), contact.time_of(interval.last)
        yield Span(start=start, end=end, colour=HELD_OUT, opacity=0.2, label="detected contact")
    estimated = _mean(contact.wrench[:, row], repeats)
    yield Line(x=across, y=estimated, colour=colour, width=1.0, label="estimated contact")
    if true is not None:
        yield Line(x=across, y=base, colour=INK, width=0.9, dashed=True, label="true contact")


def _noise_label(repeats: int) -> str:
    return f"± 2 std of the noise of the mean of {repeats}" if repeats > 1 else "± 2 std of the noise of one sample"


def _mean(series: Array, repeats: int) -> Array:
    return np.asarray(series.reshape(repeats, -1).mean(axis=0))


def _time_label(contact: ContactWrench) -> str:
    if contact.recording.at_rest:
        return "pose, in the order of recording"
    repeats = contact.recording.repeats
    return f"time in the motion, s (mean of {repeats} repeats)" if repeats > 1 else "time (s)"
