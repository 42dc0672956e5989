"""Wrench and motion before and after alignment of their clocks, and the scan that gave the offset."""

from __future__ import annotations

from matplotlib.axes import Axes

from estimation.recordings.reports.reading_report import OffsetReading, ReadingReport
from modeling.number_format import axis_label
from modeling.rig.rig import SPATIAL_CHANNELS
from truewrench.plots.style import ADEQUATE_COLOUR, LEGEND, MEASURED, MISFIT_COLOUR, MUTED, SMALL, panel_title

INTERVAL_COLOUR = "#CFE3F1"


def draw_alignment(before: Axes, after: Axes, offset: OffsetReading, report: ReadingReport) -> None:
    """One channel and what weight and inertia force explain of it, by the stamps as read, and by the offset."""
    curves = offset.curves
    assert curves is not None
    channel = SPATIAL_CHANNELS[curves.channel]
    panel_title(before, "wrench and motion by their stamps, as read")
    moved = f"with the offset of {offset.offset * 1e3:.3g} ms"
    panel_title(after, f"{moved} taken out" if offset.applied else f"{moved}, which is not applied")
    for axes, explained in ((before, curves.as_stamped), (after, curves.aligned)):
        time = curves.instants - curves.instants[0]
        axes.plot(time, curves.measured, color=MEASURED, lw=2.2, alpha=0.75, label="measured")
        axes.plot(time, explained, color=ADEQUATE_COLOUR, lw=1.0, label="explained by the motion")
        axes.set_ylabel(axis_label(channel, "N"))
        axes.set_xlabel("time in the fastest part of the recording (s)")
        axes.margins(x=0.01)
    before.legend(**LEGEND, loc="best")


def draw_scan(axes: Axes, offset: OffsetReading) -> None:
    """Share of the wrench's variance that the motion explains, over the offset."""
    curves = offset.curves
    assert curves is not None
    panel_title(axes, "variance of the wrench that the motion explains")
    axes.plot(curves.offsets * 1e3, curves.share, color=ADEQUATE_COLOUR, lw=1.0)
    axes.axvline(offset.offset * 1e3, color=MISFIT_COLOUR, lw=0.9)
    for other in offset.alternatives:
        axes.axvline(other * 1e3, color=MUTED, lw=0.7, ls=":")
    axes.set(xlabel="clock offset: wrench's stamp minus motion's (ms)", ylabel="share", ylim=(None, 1.02))
    axes.margins(x=0.01)


def draw_chi_square(axes: Axes, offset: OffsetReading) -> None:
    """Chi-square of the whole model near the estimate, with the 95 % interval."""
    curves = offset.curves
    assert curves is not None
    low, high = (bound * 1e3 for bound in offset.interval)
    text = f"offset {offset.offset * 1e3:.2f} ms, 95 % interval {low:.2f} to {high:.2f} ms"
    panel_title(axes, text)
    axes.axvspan(low, high, color=INTERVAL_COLOUR, lw=0, zorder=0)
    axes.plot(curves.near * 1e3, curves.chi_square, color=ADEQUATE_COLOUR, lw=1.0, marker="o", ms=2.5)
    axes.axvline(offset.offset * 1e3, color=MISFIT_COLOUR, lw=0.9)
    axes.set(xlabel="clock offset (ms)", ylabel="chi-square, rise")
    axes.yaxis.label.set_fontsize(SMALL)
    axes.ticklabel_format(axis="x", useOffset=False)
