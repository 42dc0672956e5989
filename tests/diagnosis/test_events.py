"""Events of repeats, of any shape: one contact each, and noise, tool and onsets as if the shape were known."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray

from diagnosis.diagnosis import Diagnosis, diagnose
from diagnosis.verdict_rule import RecordVerdict
from estimation.noise.transient_windows import EventShape, event_shapes
from modeling.chain.model import planar
from modeling.effects import named
from tests.shared.recordings import recording_of
from tests.shared.rigs import RIG
from truewrench.simulated_rig import HiddenEffect, PayloadChange, PlanarRig, ThermalDrift, simulate

pytest.importorskip("mujoco")

Array = NDArray[np.float64]
TRUTH = {"m": 0.9, "mlg": 0.063, "I": 0.0129}
START, END = 11.3, 14.1
"""Of a push, s, within one repeat."""
FEW = tuple(map(named, ("contact_event", "payload_change", "line_interference")))
"""Candidates of daily tests: with these a push of half sine was explained by a contact and a tone."""


def half_sine(t: Array) -> Array:
    return np.where((t > START) & (t < END), np.sin(np.pi * (t - START) / (END - START)), 0.0)


def decay(t: Array) -> Array:
    return np.where((t > START) & (t < END), np.exp(-(t - START) / 0.8), 0.0)


def trapezium(t: Array) -> Array:
    return np.clip((t - START) / 0.7, 0, 1) * np.clip((END - t) / 0.4, 0, 1)


def two_levels(t: Array) -> Array:
    return np.where((t > START) & (t < 12.4), 1.0, 0.0) + np.where((t >= 12.4) & (t < END), 0.4, 0.0)


def hump(t: Array) -> Array:
    return np.asarray(np.exp(-0.5 * ((t - 12.7) / 0.6) ** 2))


SHAPES = (half_sine, decay, trapezium, two_levels, hump)


def frame(*pushes: Callable[[Array], Array], seed: int = 1, hidden: tuple[HiddenEffect, ...] = ()) -> pd.DataFrame:
    """Six repeats of 5 s at 30 Hz in white noise, with a push of 6 N of each shape."""
    motion = PlanarRig().random_motion(seed=seed)
    table = simulate(PlanarRig(), motion, hidden=hidden, repeats=6, samples_per_period=150, seed=seed)
    time = table["time"].to_numpy(dtype=float)
    for push in pushes:
        for channel, size in (("fx", 6.0), ("fy", 3.0), ("tau", 0.3)):
            table[channel] += size * push(time)
    return table


def diagnosed(table: pd.DataFrame, *, few: bool = True) -> Diagnosis:
    return diagnose(planar(RIG), recording_of(table, rig=RIG), effects=FEW if few else None)


def assert_tool(found: Diagnosis) -> None:
    """Within four std, which three of a hundred thousand recordings exceed."""
    for name, value in TRUTH.items():
        estimate = found.fit.parameters[name]
        assert abs(estimate.value - value) < 4 * estimate.std < 0.02 * value if name != "I" else True


def assert_contact(found: Diagnosis, begin: float, end: float) -> None:
    """A contact alone, with times of finite std that are right within three of them, and at least a sample."""
    assert found.verdict is RecordVerdict.EXPLAINED
    assert found.added == ("contact_event",)
    for name, time in (("start", begin), ("end", end)):
        estimate = found.fit.parameters[f"contact_event.{name}"]
        assert 1 / 30 <= estimate.std < 1
        assert abs(estimate.value - time) < 3 * estimate.std
    assert not any("not identifiable" in remark for remark in found.fit.remarks())


def test_a_push_of_half_sine_is_one_contact() -> None:
    found = diagnosed(frame(half_sine))
    assert_contact(found, START, END)
    assert_tool(found)
    assert any("is not constant" in remark for remark in found.fit.remarks())


def test_a_second_push_is_left_out_and_said() -> None:
    found = diagnosed(frame(half_sine, lambda t: -0.8 * half_sine(2 * (t - 15.4))))
    assert_contact(found, START, END)
    assert_tool(found)
    assert any("is left out" in remark for remark in found.fit.remarks())


def test_a_load_is_taken_up_when_it_was() -> None:
    """The onset is off the grid by 50 samples, and by a third of one."""
    found = diagnosed(frame(hidden=(PayloadChange(time=13.0),)))
    onset = found.fit.parameters["payload_change.time"]
    assert found.added == ("payload_change",)
    assert 1 / 30 <= onset.std < 0.2
    assert abs(onset.value - 13.0) < 3 * onset.std
    assert_tool(found)


def test_a_load_taken_up_where_repeats_meet_is_not_put_beside() -> None:
    """The score has other maxima a third of a second away: 20.35 s was found, with a std of a sample."""
    rig = PlanarRig()
    motion, load = rig.random_motion(seed=3), (PayloadChange(time=20.0),)
    found = diagnosed(simulate(rig, motion, hidden=load, repeats=10, samples_per_period=600, seed=3))
    onset = found.fit.parameters["payload_change.time"]
    assert abs(onset.value - 20.0) < 3 * onset.std


@pytest.mark.long(4)
@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: shape.__name__)
def test_any_shape_is_one_contact(shape: Callable[[Array], Array]) -> None:
    """Beside the whole catalogue."""
    found = diagnosed(frame(shape, seed=2), few=False)
    assert found.verdict is RecordVerdict.EXPLAINED
    assert found.added == ("contact_event",)
    assert_tool(found)


@pytest.mark.long(3)
def test_a_load_is_taken_up_in_a_single_run_beside_drift() -> None:
    """Off the edges of the blocks that events are looked for in."""
    motion = PlanarRig().random_motion(seed=2, period=180.0, harmonics=60)
    hidden = (PayloadChange(mass=0.2, d=0.1, time=117.4), ThermalDrift())
    table = simulate(PlanarRig(), motion, hidden=hidden, repeats=1, samples_per_period=1800, seed=2)
    found = diagnose(planar(RIG), recording_of(table, without=("repeat",), rig=RIG), effects=FEW)
    assert found.added == ("payload_change",)
    mass, onset = (found.fit.parameters[f"payload_change.{name}"] for name in ("mass", "time"))
    assert abs(mass.value - 0.2) < 4 * mass.std < 0.4
    assert 0.099 < onset.std < 1
    assert abs(onset.value - 117.4) < 3 * onset.std


def test_a_shape_leaves_the_mean_alone() -> None:
    """Its columns span a half sine and a jump at an edge; without the mean of a judged one they leave only that."""
    time = np.arange(1000) / 50
    shape = EventShape((4.0, 5.0, 7.0), judged=True)
    columns, free = shape.columns(time), shape.unjudged_columns(time)
    np.testing.assert_allclose(columns.T @ columns, np.eye(columns.shape[1]), atol=1e-12)
    np.testing.assert_allclose(free.T @ free, np.eye(free.shape[1]), atol=1e-9)
    mean = ((time >= 4.0) & (time < 7.0)).astype(float)
    jump = ((time >= 5.0) & (time < 7.0)).astype(float)
    for series in (mean, jump):
        np.testing.assert_allclose(columns @ (columns.T @ series), series, atol=1e-12)
    left = mean - free @ (free.T @ mean)
    assert left @ left > 0.9 * mean @ mean
    beside = jump - mean * (jump @ mean) / (mean @ mean)
    np.testing.assert_allclose(free @ (free.T @ beside), beside, atol=0.02)


def test_events_join_what_they_touch() -> None:
    contact = (10.0, 12.0)
    assert event_shapes((), contact, [], [], 20.0) == ()
    judged, other = event_shapes((), contact, [(11.5, 12.5), (20.0, 21.0)], [(9.8, 11.0)], 20.0)
    assert judged == EventShape((9.8, 10.0, 11.5, 12.0, 12.5), judged=True)
    assert other == EventShape((20.0, 21.0), judged=False)
    assert event_shapes((judged, other), contact, [(12.6, 20.1)], [], 20.0) == (
        EventShape((9.8, 10.0, 11.5, 12.0, 12.5, 12.6, 20.0, 20.1, 21.0), judged=True),
    )
    assert event_shapes((), contact, [(11.0, 40.0)], [], 20.0) == ()
