"""What a simulated rig hides is found, alone and in the right amount, and nothing is made up for what has no name.

The simulator shares no equation with the models. A right model's parameter lies within 4 standard deviations of the
truth but for 1 in 16 000; seeds are fixed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache

import pytest

from diagnosis.diagnosis import Diagnosis, diagnose
from diagnosis.verdict_rule import RecordVerdict
from modeling.chain.model import planar, spatial
from modeling.number_format import estimate_text
from tests.shared.recordings import recording_of
from tests.shared.rigs import RIG, described
from truewrench import simulated_rig
from truewrench.simulated_rig import (
    BaseForce,
    Buoyancy,
    CentreOfMassOffset,
    ContactEvent,
    CoulombFriction,
    GravityTilt,
    HiddenEffect,
    JointOffset,
    LineInterference,
    PlanarRig,
    QuadraticDrag,
    SensorCrosstalk,
    SensorHysteresis,
    SensorLag,
    SpatialRig,
    SpinningRotor,
    TimeDelay,
    TipFlexibility,
    TranslationalFriction,
    ViscousDrag,
    simulate,
)
from truewrench.text.diagnosis_text import diagnosis_text

pytest.importorskip("mujoco")

STANDARD_DEVIATIONS = 4.0
REPEATS, SAMPLES = 4, 250


@dataclass(frozen=True, eq=False)
class Hidden:
    """An effect in the rig, and the parameters by which the catalogue should describe it."""

    rig: simulated_rig.SimulatedRig
    effect: HiddenEffect
    truth: Mapping[str, float] = field(default_factory=dict)
    seed: int = 1
    beside: tuple[HiddenEffect, ...] = ()


@cache
def diagnosed(hidden: Hidden) -> Diagnosis:
    """Diagnosed from one motion and validated on another, on which nobody pushes."""
    rig, seed = hidden.rig, hidden.seed
    lasting = () if isinstance(hidden.effect, ContactEvent) else (hidden.effect,)
    recordings = [
        recording_of(
            simulate(
                rig,
                rig.random_motion(seed=motion),
                hidden=effects,
                repeats=REPEATS,
                samples_per_period=SAMPLES,
                seed=1000 + motion,
            ),
            name=name,
            rig=described(rig),
        )
        for name, motion, effects in (
            ("train", seed, (hidden.effect, *hidden.beside)),
            ("validate", seed + 500, (*lasting, *hidden.beside)),
        )
    ]
    model = planar(RIG) if isinstance(rig, PlanarRig) else spatial()
    return diagnose(model, recordings[0], validate=recordings[1])


FOUND = {
    "com_offset": Hidden(PlanarRig(), CentreOfMassOffset(mlx=0.008), {"mlx": 0.008}),
    "gravity_tilt": Hidden(PlanarRig(), GravityTilt(tilt_y=0.03), {"angle": 0.03}),
    "viscous_drag": Hidden(PlanarRig(), ViscousDrag(c=0.15, d=0.12), {"c": 0.15, "d": 0.12}),
    "quadratic_drag": Hidden(PlanarRig(), QuadraticDrag(c=0.08, d=0.12), {"c": 0.08, "d": 0.12}),
    "sensor_crosstalk": Hidden(PlanarRig(), SensorCrosstalk(leaks=(("fy", "fx", 0.04),)), {"fy_fx": 0.04}),
    "sensor_lag": Hidden(PlanarRig(), SensorLag(time_constant=0.02), {"time_constant": 0.02}),
    "joint_offset": Hidden(PlanarRig(), JointOffset(joint=2, offset=0.02), {"offset_2": 0.02, "offset_3": 0.0}),
    "tip_flexibility": Hidden(PlanarRig(), TipFlexibility(stiffness=50.0), {"stiffness": 50.0}),
    "sensor_hysteresis": Hidden(
        PlanarRig(), SensorHysteresis(force=0.25, torque=0.01), {"fx": 0.25, "fy": 0.25, "tau": 0.01}
    ),
    "sensor_hysteresis, begun off the load": Hidden(
        PlanarRig(), SensorHysteresis(force=1.5, torque=0.06, start=-0.9), {"fx": 1.5, "fy": 1.5, "tau": 0.06}
    ),
    "line_interference": Hidden(PlanarRig(), LineInterference(frequency=17.317), {"frequency": 17.317}),
    "contact_event": Hidden(PlanarRig(), ContactEvent(), {"fcx": 4.0, "fcy": 2.0, "tauc": 0.3}),
    "gravity_tilt, six axes": Hidden(
        SpatialRig(), GravityTilt(tilt_x=0.02, tilt_y=0.03), {"tilt_x": 0.02, "tilt_y": 0.03}
    ),
    "translational_friction": Hidden(PlanarRig(), TranslationalFriction(level=0.4), {"level": 0.4, "d": 0.12}),
    "translational_friction, six axes": Hidden(SpatialRig(), TranslationalFriction(level=0.2), {"level": 0.2}),
    "coulomb_friction": Hidden(PlanarRig(), CoulombFriction(level=0.05), {"level": 0.05}),
    "coulomb_friction, wide": Hidden(
        PlanarRig(), CoulombFriction(level=0.15, width=0.03), {"level": 0.15, "width": 0.03}
    ),
    "base_force": Hidden(PlanarRig(), BaseForce(), {"force_x": 0.9, "force_y": -1.2, "d": 0.12}),
    "base_force, downwards": Hidden(
        SpatialRig(), BaseForce(force=(0.0, 0.0, -1.5)), {"force_x": 0.0, "force_y": 0.0, "force_z": -1.5, "d": 0.12}
    ),
    "base_force, a zero taken in base axes": Hidden(
        SpatialRig(),
        BaseForce(force=(0.6, -0.3, 0.5), torque=(0.05, -0.04, 0.02), d=0.0),
        {"force_z": 0.5, "torque_x": 0.05, "torque_y": -0.04, "torque_z": 0.02, "x": 0.0, "y": 0.0, "d": 0.0},
    ),
    "spinning_rotor": Hidden(
        SpatialRig(), SpinningRotor(momentum=(0.0, 0.01, 0.04)), {"h_x": 0.0, "h_y": 0.01, "h_z": 0.04}
    ),
    "time_delay, six axes": Hidden(SpatialRig(), TimeDelay(delay=0.012), {"delay": 0.012}),
}

DAILY = ("viscous_drag", "sensor_lag", "contact_event")
"""Of three kinds: load, dynamics, transient; the others are in the long tier, as are those in six axes, of which daily
tests of single runs are."""


def test_an_onset_is_printed_no_finer_than_the_sampling_step() -> None:
    found = diagnosed(FOUND["contact_event"])
    start, step = found.fit.parameters["contact_event.start"], found.fit.recordings[0].dt
    assert step is not None
    assert start.std == pytest.approx(step)
    assert start.resolution == step
    assert f" start = {estimate_text(start.value, start.std, 's')} " in diagnosis_text(found)
    assert "when the contact begins, from the first row" in diagnosis_text(found)
    assert found.to_data()["parameters"]["contact_event.start"]["std"] == start.std


@pytest.mark.parametrize("case", [pytest.param(c, marks=[] if c in DAILY else pytest.mark.long) for c in FOUND])
def test_hidden_effect_is_found_alone_with_its_amount(case: str) -> None:
    hidden = FOUND[case]
    result = diagnosed(hidden)
    assert result.added == (hidden.effect.id,), str(result)
    assert result.verdict is RecordVerdict.EXPLAINED
    estimates = result.findings[0].parameters
    for name, value in hidden.truth.items():
        assert abs(estimates[name].value - value) < STANDARD_DEVIATIONS * estimates[name].std, (name, estimates[name])


@pytest.mark.long
@pytest.mark.parametrize("effect", [TranslationalFriction(level=0.4), BaseForce(), SpinningRotor()], ids=lambda e: e.id)
def test_beside_a_drag_both_are_found(effect: HiddenEffect) -> None:
    rig = SpatialRig() if effect.spatial_only else PlanarRig()
    drag = ViscousDrag(c=0.5 if effect.spatial_only else 0.25, d=0.05)
    result = diagnosed(Hidden(rig, effect, beside=(drag,)))
    assert set(result.added) == {effect.id, "viscous_drag"}, str(result)
    assert result.verdict is RecordVerdict.EXPLAINED


@pytest.mark.parametrize("case", ["com_offset", "viscous_drag", "sensor_lag"])
def test_error_that_can_be_explained_falls_on_another_motion(case: str) -> None:
    """Its power ends below (a tenth of the noise floor)² and two standard errors of itself, in every channel."""
    result = diagnosed(FOUND[case])
    (before,), (after,) = result.steps[0].validation, result.steps[-1].validation
    assert before.explainable_rms is not None
    assert after.explainable_rms is not None
    assert after.explainable_std is not None
    for channel, rms in after.explainable_rms.items():
        limit = (after.noise_floor[channel] / 10) ** 2 + 2 * after.explainable_std[channel]
        assert rms**2 <= limit, channel
    assert max(before.explainable_rms[c] / before.noise_floor[c] for c in before.explainable_rms) > 1


def test_offset_of_the_first_joint_is_a_tilted_base() -> None:
    """No motion of a planar arm tells them apart: the simpler one is named, the other said to do as well."""
    result = diagnosed(Hidden(PlanarRig(), JointOffset(joint=1, offset=0.02)))
    assert result.added == ("gravity_tilt",), str(result)
    assert "joint_offset" in result.findings[0].confusable_with
    tilt = result.findings[0].parameters["angle"]
    assert abs(tilt.value + 0.02) < STANDARD_DEVIATIONS * tilt.std


@pytest.mark.long(seconds=35)
def test_what_has_no_name_is_not_given_one() -> None:
    result = diagnosed(Hidden(PlanarRig(), Buoyancy()))
    assert result.added == (), str(result)
    assert result.verdict is RecordVerdict.UNEXPLAINED
    assert result.unexplained is not None
    assert result.unexplained.where
