"""Secants: of an effect that is linear they are its tangents, and of one that has none they are what it does."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from math import inf

import numpy as np
import pytest

from diagnosis.screening import whitened_sensitivity as secants
from diagnosis.screening.grid_search import grid_points
from diagnosis.screening.null_model import RowSet
from diagnosis.screening.score_test import screen
from diagnosis.screening.whitened_sensitivity import GridPoint, score_columns
from estimation.fit import Fit, fit
from estimation.recordings.reading import from_columns
from modeling.chain.effect import NuisanceValues, SearchDomain
from modeling.chain.model import planar
from modeling.dynamics.equation_of_motion import DEFLECTION_TOLERANCE
from modeling.effects import named
from modeling.effects.geometry import TipFlexibility
from modeling.effects.loads import ViscousDrag
from modeling.effects.sensor import Saturation, SensorGain
from modeling.parameter import Parameter
from tests.shared.recordings import recording_of
from tests.shared.rigs import RIG
from truewrench import simulated_rig
from truewrench.simulated_rig import PlanarRig, simulate

pytest.importorskip("mujoco")


@cache
def fitted() -> Fit:
    """The rigid tip, where the tool drags and a gain is wrong."""
    hidden = (simulated_rig.ViscousDrag(), simulated_rig.SensorGain())
    motion = PlanarRig().random_motion(seed=1)
    frame = simulate(PlanarRig(), motion, hidden=hidden, repeats=4, samples_per_period=250, seed=1)
    return fit(planar(RIG), recording_of(frame, rig=RIG))


@dataclass(frozen=True)
class NamedGain(SensorGain):
    """Its gains, which the readings are linear in, named by the grid: secants from 1 to 1.2 and 0.9."""

    def nuisance_grid(self, extent: SearchDomain) -> tuple[NuisanceValues, ...]:
        return ({"fy": 1.2, "tau": 0.9},)


@dataclass(frozen=True)
class NamedDrag(ViscousDrag):
    """Its amount named, at every d of the plain grid."""

    def nuisance_grid(self, extent: SearchDomain) -> tuple[NuisanceValues, ...]:
        return tuple({**values, "c": 0.3} for values in super().nuisance_grid(extent))


@pytest.mark.parametrize(("plain", "secant"), [(SensorGain(), NamedGain()), (ViscousDrag(), NamedDrag())])
def test_secant_of_a_linear_effect_is_its_tangent(plain: SensorGain, secant: SensorGain) -> None:
    """Two routes to the same numbers; both are exact but for rounding."""
    (by_slope,), (by_difference,) = (screen(fitted(), [effect]) for effect in (plain, secant))
    assert by_difference.statistic == pytest.approx(by_slope.statistic, rel=1e-6)
    assert by_difference.p_value == pytest.approx(by_slope.p_value, rel=1e-3)
    assert by_difference.start == pytest.approx(by_slope.start, rel=1e-6)
    assert by_difference.detectable == pytest.approx(by_slope.detectable, rel=1e-6)
    for name, (amount, std) in by_slope.amounts.items():
        assert by_difference.amounts[name] == pytest.approx((amount, std), rel=1e-6)


def test_amounts_count_from_the_nominal_value() -> None:
    """A gain's is 1: the start of the refit is not its amount."""
    (found,) = screen(fitted(), [SensorGain()])
    amount, _std = found.amounts["sensor_gain.fy"]
    assert found.start["sensor_gain.fy"] == pytest.approx(1 + amount)
    assert 0.01 < amount < 0.09  # 0.03 is hidden, and a drag that the gain is screened without


def test_column_of_a_clipped_channel_is_what_clipping_takes() -> None:
    model = fitted().model + Saturation()
    levels = {"fx": 20.0, "fy": 15.0, "tau": 2.0}
    (point,) = grid_points(model, model.effects[-1], [levels])
    columns = score_columns(fitted(), model, [point], (RowSet.WHOLE,))
    load = fitted().recordings[0].wrench - fitted().residuals[0]
    for place, level in enumerate(levels.values()):
        taken = np.zeros_like(load)
        taken[:, place] = np.clip(load[:, place], -level, level) - load[:, place]
        expected = fitted().noise[0].whitener.series(taken)
        assert np.abs(taken).max() > 0
        np.testing.assert_allclose(columns[:, 0, place], expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("stiffness", [4.0, 40.0])
def test_secants_of_a_bend_are_those_of_an_exact_one(stiffness: float, monkeypatch: pytest.MonkeyPatch) -> None:
    model = fitted().model + TipFlexibility()
    points = grid_points(model, model.effects[-1], [{"stiffness": stiffness, "damping": 0.05}])
    found = score_columns(fitted(), model, points, (RowSet.WHOLE,))
    monkeypatch.setattr(secants, "SCREENED", DEFLECTION_TOLERANCE)
    expected = score_columns(fitted(), model, points, (RowSet.WHOLE,))
    difference = np.linalg.norm(found - expected) / np.linalg.norm(expected)
    # What the last correction of 1e-8 leaves, and ten times that near a resonance.
    assert 0 < difference < 1e-7


def test_start_of_an_infinite_amplitude_is_the_point_itself() -> None:
    stiffness = Parameter(name="k", unit="N m/rad", nominal=inf, bounds=(1.0, inf))
    width = Parameter(name="w", unit="N", bounds=(0.0, inf))
    slope = Parameter(name="g", unit="1", nominal=1.0)
    point = GridPoint({"k": 80.0, "w": 0.5, "d": 0.1}, (stiffness, width, slope))
    assert point.start(np.array([0.7, 0.6, 0.02])) == pytest.approx({"k": 80.0, "w": 0.3, "g": 1.02, "d": 0.1})
    assert point.start(np.array([0.7, -0.6, 0.02]))["w"] == 0.0
    assert point.nuisances == {"d": 0.1}


def test_effects_of_joints_name_what_a_recording_without_them_lacks() -> None:
    recording = fitted().recordings[0]
    pose = {"phi": "phi", "ax": "ax", "ay": "ay"}
    columns = {name: recording.signals[name] for name in pose} | {
        c: recording.wrench[:, i] for i, c in enumerate(recording.channels)
    }
    columns |= {"time": recording.signals["time"], "repeat": np.repeat(np.arange(4), recording.samples_per_repeat)}
    posed = fit(planar(), from_columns(columns, name="poses.csv"))
    joints = [named(i) for i in ("joint_offset", "joint_elasticity", "joint_backlash", "link_length_error")]
    for screening in screen(posed, joints):
        assert screening.reason == "no joint angles in poses.csv"
