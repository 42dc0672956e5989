"""Estimated contact wrench of several models, with the true one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from estimation.contact.contact_wrench import ContactWrench
from modeling.number_format import axis_label
from truewrench.plots.style import INK, LEGEND, MUTED, QUIET_NOISE, SMALL, PanelGrid, label_y_axis, panel_title

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LabelledContact:
    """Contact wrench estimated with one model, with label and colour."""

    label: str
    colour: str
    contact: ContactWrench


def contact_figure(sides: Sequence[LabelledContact], true: Array | None = None) -> Figure:
    """Contact wrench averaged over the repeats, a column per model, a row per component, with the `true` one (n, p).

    The band is ± 2 std of the noise of that mean; a line outside it is model error.
    """
    names, space = sides[0].contact.names, sides[0].contact.space
    sheet = PanelGrid(rows=len(names), columns=len(sides), panel_height=110, between_rows=14, top=48)
    figure, panels = sheet.panels(sharex=True, sharey="row")
    for column, side in enumerate(sides):
        panel_title(panels[0, column], side.label, side.colour)
        for row in range(len(names)):
            _panel(panels[row, column], side, row, true)
        panels[-1, column].set_xlabel(_time_label(side.contact))
    for row, (name, unit) in enumerate(zip(names, space.units, strict=True)):
        label_y_axis(panels[row, 0], axis_label(name, unit))
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, **LEGEND, ncols=4, loc="upper left", bbox_to_anchor=(sheet.left / sheet.width, 1.0))
    return figure


def _panel(axes: Axes, side: LabelledContact, row: int, true: Array | None) -> None:
    contact = side.contact
    repeats, once = contact.recording.repeats, contact.recording.samples_per_repeat
    time = contact.recording.time
    across = np.arange(once, dtype=float) if time is None else time[:once]
    base = np.zeros(once) if true is None else _mean(true[:, row], repeats)
    noise = float(contact.floor[row] / np.sqrt(repeats))
    axes.fill_between(across, base - 2 * noise, base + 2 * noise, color=QUIET_NOISE, lw=0, label=_noise_label(repeats))
    axes.plot(across, _mean(contact.wrench[:, row], repeats), color=side.colour, lw=1.0, label="estimated contact")
    if true is None:
        axes.axhline(0, color=MUTED, lw=0.5)
        return
    axes.plot(across, base, color=INK, lw=0.9, ls=(0, (4, 2)), label="true contact")
    error, unit = contact.systematic_contact_error(true)[row], contact.space.units[row]
    tenth = float(contact.floor[row]) / 10
    text = f"error {error:.2g} {unit}" if error > tenth else f"error below {tenth:.2g} {unit}"
    axes.text(0.995, 0.93, text, transform=axes.transAxes, ha="right", va="top", color=side.colour, fontsize=SMALL)


def _noise_label(repeats: int) -> str:
    return f"± 2 std of the noise of the mean of {repeats}" if repeats > 1 else "± 2 std of the noise of one sample"


def _mean(series: Array, repeats: int) -> Array:
    return np.asarray(series.reshape(repeats, -1).mean(axis=0))


def _time_label(contact: ContactWrench) -> str:
    if contact.recording.at_rest:
        return "pose, in the order of recording"
    repeats = contact.recording.repeats
    return f"time in the motion, s (mean of {repeats} repeats)" if repeats > 1 else "time, s"
