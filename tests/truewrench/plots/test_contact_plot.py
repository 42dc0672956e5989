"""The figure of a contact: over the recording's time, with what was detected."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.patches import Polygon

import truewrench as tw
from estimation.contact.contact_wrench import ContactWrench
from truewrench.plots.chart import Band, Chart, Line, Panel, Span
from truewrench.plots.matplotlib_chart import LINE_COLUMNS, matplotlib_figure
from truewrench.plots.result_figure import result_chart
from truewrench.simulated_rig import ContactEvent, PlanarRig, simulate

pytest.importorskip("mujoco")

PUSH = ContactEvent(force=(3.0, 0.0, 0.0), torque=(0.0, 0.0, 0.3), start=7.0, end=8.0)
"""In the second of four repeats of five seconds."""
RIG = {"robot": {"link_lengths": [1.0, 0.97, 0.4], "tip_length": 0.2}}


@cache
def pushed() -> ContactWrench:
    arm, rig = PlanarRig(), tw.Rig.from_data(RIG)
    frames = [
        simulate(arm, arm.random_motion(seed=seed), hidden=hidden, repeats=4, samples_per_period=250, seed=seed)
        for seed, hidden in ((1, []), (2, [PUSH]))
    ]
    training, other = (tw.from_dataframe(frame, rig=rig) for frame in frames)
    return tw.compensate(tw.fit(tw.planar(rig), training), other)


def test_a_contact_in_one_repeat_is_drawn_where_it_was_and_as_large() -> None:
    """3 N, not the mean over the repeats; the shaded interval is the detected one."""
    contact = pushed()
    panel = result_chart(contact, kind="contact").panels[0]
    (line,) = (mark for mark in panel.marks if isinstance(mark, Line))
    assert contact.recording.time is not None
    np.testing.assert_array_equal(line.x, contact.recording.time)
    np.testing.assert_array_equal(line.y, contact.wrench[:, 0])
    assert line.y[(line.x > 7.1) & (line.x < 7.9)].mean() == pytest.approx(3.0, abs=0.15)
    (span,), (interval,) = (mark for mark in panel.marks if isinstance(mark, Span)), contact.intervals
    assert (span.start, span.end) == pytest.approx((7.0, 8.0), abs=0.1)
    assert span.start == contact.time_of(interval.first)
    floor, estimate = (mark for mark in panel.marks if isinstance(mark, Band))
    assert floor.high == pytest.approx(2 * contact.floor[0])
    inside = slice(interval.first, interval.last)
    assert estimate.high - line.y[inside] == pytest.approx(2 * contact.std[inside, 0])
    assert panel.x_label == "time (s)"


def test_a_long_band_is_decimated_as_a_line_is() -> None:
    x = np.arange(20_000.0)
    panel = Panel(marks=(Band(x=x, low=np.sin(x), high=np.sin(x) + 1),), x_label="x", y_label="y")
    (axes,) = (a for a in matplotlib_figure(Chart(rows=((panel,),))).axes if isinstance(a, Axes))
    (shape,) = axes.patches
    assert isinstance(shape, Polygon)
    assert len(shape.get_xy()) <= 4 * LINE_COLUMNS + 5
    assert not [c for c in axes.collections if isinstance(c, PolyCollection)]
    assert shape.get_xy()[:, 1].max() == pytest.approx(2.0, abs=1e-4)
