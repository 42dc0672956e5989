"""Estimated contact wrench of several models over the recording, with detected contacts and the true one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from estimation.contact.contact_wrench import ContactWrench
from modeling.errors import InputError, quoted, suggestion
from modeling.number_format import axis_label
from truewrench.plots.chart import Band, Chart, Level, Line, Mark, Panel, Span
from truewrench.plots.matplotlib_chart import matplotlib_figure
from truewrench.plots.style import HELD_OUT, INK, QUIET_NOISE

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LabelledContact:
    """Contact wrench estimated with one model, with label and colour."""

    label: str
    colour: str
    contact: ContactWrench


def contact_figure(sides: Sequence[LabelledContact], true: Array | None = None) -> Figure:
    """Contact wrench over the recording, a column per model, a row per component, with the `true` one (n, p)."""
    return matplotlib_figure(contact_chart(sides, true))


def contact_chart(sides: Sequence[LabelledContact], true: Array | None = None, component: str | None = None) -> Chart:
    """Contact wrench over the recording, a column per model, a row per component, with the `true` one (n, p).

    Repeats follow each other in time, as a contact does not repeat with the motion. The band about zero, or about the
    true wrench, is ± 2 std of the sensor's noise of one sample. Detected contacts are shaded, with ± 2 std of the
    estimate (noise, parameters and zero). Models share the scale of a component. A single axes shows `component`, by
    default the one with the largest force.
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
        title="" if row else f"{side.label}, {contact.axes.words(contact.space)}",
        title_colour=side.colour,
        x_label=_time_label(contact),
        y_label=axis_label(name, unit),
        note=note,
    )


def _marks(contact: ContactWrench, row: int, colour: str, true: Array | None) -> Iterator[Mark]:
    time, noise = _time(contact), 2 * float(contact.floor[row])
    label = "± 2 std of the noise of one sample"
    if true is None:
        yield Band(low=-noise, high=noise, colour=QUIET_NOISE, label=label)
        yield Level(y=0)
    else:
        yield Band(x=time, low=true[:, row] - noise, high=true[:, row] + noise, colour=QUIET_NOISE, label=label)
    for interval in contact.intervals:
        inside = slice(interval.first, interval.last)
        across, estimated, std = time[inside], contact.wrench[inside, row], contact.std[inside, row]
        start, end = float(across[0]), float(across[-1])
        yield Span(start=start, end=end, colour=HELD_OUT, opacity=0.2, label="detected contact")
        low, high = estimated - 2 * std, estimated + 2 * std
        yield Band(x=across, low=low, high=high, colour=colour, opacity=0.3, label="± 2 std of its estimate")
    yield Line(x=time, y=contact.wrench[:, row], colour=colour, width=1.0, label="estimated contact")
    if true is not None:
        yield Line(x=time, y=true[:, row], colour=INK, width=0.9, dashed=True, label="true contact")


def _time(contact: ContactWrench) -> Array:
    """Time (n,) from the start of the recording, s, separate runs one after the other; the number of static poses."""
    recording = contact.recording
    if recording.dt is None or recording.time is None:
        return np.arange(recording.samples, dtype=float)
    once = recording.samples_per_repeat
    runs = 0 if recording.continuous else np.arange(recording.samples) // once
    return np.asarray(recording.time + runs * once * recording.dt)


def _time_label(contact: ContactWrench) -> str:
    if contact.recording.at_rest:
        return "pose, in the order of recording"
    return "time (s)" if contact.recording.continuous else "time (s), separate runs one after the other"
