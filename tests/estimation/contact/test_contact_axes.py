"""Centre of mass, contact and payload of a sensor that is turned by any constant rotation against the logged pose.

The oracle is the simulated sensor's own point masses and push, turned by matrices.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from estimation.centre_of_mass import CentreOfMass, centres_of_mass
from estimation.contact.contact_wrench import CalibratedModel, ContactWrench, compensate
from estimation.fit import Fit, fit
from estimation.recordings.reading import from_columns
from modeling.chain.model import planar, spatial
from modeling.chain.sensor_axes import Axes, is_turned, sensor_to_pose
from modeling.codegen.tool_inertia import ALONG_POSE, SENSOR_FRAME, ToolInertia
from modeling.effects import sensor_rotation
from modeling.rig import Rig
from modeling.space import Space
from tests.shared.emitted import module
from tests.shared.recordings import recorded as simulated_recording
from tests.shared.turned_sensor import CENTRE, CONTACT, MASS, MASSES, PLACES, STEP, TurnedSensor, inertia
from truewrench.emitted import emit
from truewrench.simulated_rig import ContactEvent

Array = NDArray[np.float64]

LEVEL, SLOPING = (0.0, 0.0, -1.0), (0.6, 0.0, 0.8)
TURNS = {
    "aligned": ((0.0, 0.0, 0.0), LEVEL),
    "half a turn": ((np.pi, 0.0, 0.0), LEVEL),
    "a quarter, hanging": ((-np.pi / 2, 0.0, 0.0), (0.0, 0.0, 1.0)),
    "a third about a diagonal": (tuple(2 * np.pi / 27**0.5 * np.ones(3)), LEVEL),
    "30 degrees": ((0.0, 0.0, np.pi / 6), LEVEL),
    "45 degrees": ((0.0, 0.0, np.pi / 4), LEVEL),
    "any, sloping": ((0.4, -1.3, 0.8), SLOPING),
}
"""Rotation vector from the sensor to the logged pose, and gravity in base axes."""
BY_QUARTERS = ("aligned", "half a turn", "a quarter, hanging", "a third about a diagonal")
INERTIA = 6e-5
"""kg m²: five of the std, 1.2e-5, of the inertia that this motion determines least."""
SIGMA = 5.0
"""Of each of some fifty Gaussian numbers in a case: one in 4e4 cases fails; seeds are fixed."""


@dataclass(frozen=True, eq=False)
class Bench:
    sensor: TurnedSensor
    fit: Fit

    def contact(self, axes: Axes | str | None) -> ContactWrench:
        return compensate(self.fit, self.sensor.recording(pushed=True, seed=1), axes=axes)


@cache
def bench(name: str) -> Bench:
    turn, gravity = TURNS[name]
    sensor = TurnedSensor(Rotation.from_rotvec(turn), gravity)
    recording = sensor.recording()
    model = spatial(recording.rig)
    return Bench(sensor, fit(model if name in BY_QUARTERS else model + sensor_rotation(), recording))


@pytest.mark.parametrize("name", TURNS)
def test_both_statements_of_the_centre_of_mass_are_right(name: str) -> None:
    sensor, fitted = bench(name).sensor, bench(name).fit
    assert sensor_to_pose(fitted.model, fitted.theta) == pytest.approx(sensor.to_pose.as_matrix(), abs=1e-3)
    true = {"sensor axes": CENTRE, "the axes of the logged pose": sensor.to_pose.apply(CENTRE)}
    centres = centres_of_mass(fitted)
    assert [c.frame for c in centres] == list(true)[: 1 + is_turned(fitted.model)]
    for centre in centres:
        assert np.abs(centre.value - true[centre.frame]) == pytest.approx(0, abs=SIGMA * centre.std.max())
        assert centre.std.max() < 2e-5  # m: 1000 samples of 0.02 N against 12 N are 1 part in 2e4 of 70 mm, each axis


@pytest.mark.parametrize("name", TURNS)
def test_the_contact_is_along_the_axes_that_were_asked_for(name: str) -> None:
    sensor = bench(name).sensor
    to_pose = np.kron(np.eye(2), sensor.to_pose.as_matrix())
    own = bench(name).contact(None)
    assert own.axes is Axes.SENSOR
    assert len(own.intervals) == 4
    logged = sensor.pose(np.arange(own.recording.samples) * STEP).as_matrix()
    turns = {
        Axes.SENSOR: np.broadcast_to(np.eye(6), (len(logged), 6, 6)),
        Axes.POSE: np.broadcast_to(to_pose, (len(logged), 6, 6)),
        Axes.BASE: np.stack([np.kron(np.eye(2), r) @ to_pose for r in logged]),
    }
    for axes, turn in turns.items():
        contact = bench(name).contact(axes)
        assert contact.axes is axes
        assert [m.interval for m in contact.means] == [m.interval for m in own.means]
        for mean in contact.means:
            inside = slice(mean.interval.first, mean.interval.last)
            assert np.abs(mean.wrench - (turn[inside] @ CONTACT).mean(axis=0)) == pytest.approx(
                0, abs=SIGMA * mean.std.max()
            )
        assert contact.wrench == pytest.approx((turn @ own.wrench[:, :, None])[:, :, 0], abs=0.02)
        assert contact.noise_std.max() < 0.025
        assert contact.noise_ratio.max() < 1.2


def test_base_axes_of_a_base_that_the_data_decide_to_hang() -> None:
    """Nothing states gravity: the world is then the base turned, and base axes are still those of the log."""
    sensor = TurnedSensor(Rotation.from_rotvec([np.pi, 0, 0]), (0.0, 0.0, 1.0))
    fitted = fit(spatial(), from_columns(sensor.columns()))
    assert fitted.model.gravity_direction == (0.0, 0.0, 1.0)
    contact = compensate(fitted, from_columns(sensor.columns(pushed=True, seed=1)), axes="base")
    turn = (sensor.pose(np.arange(contact.recording.samples) * STEP) * sensor.to_pose).as_matrix()
    for mean in contact.means:
        expected = (turn[mean.interval.first : mean.interval.last] @ CONTACT[:3]).mean(axis=0)
        assert np.abs(mean.wrench[:3] - expected) == pytest.approx(0, abs=SIGMA * mean.std[:3].max())


@pytest.mark.parametrize("axes", [Axes.POSE, Axes.BASE])
def test_covariances_turn_with_the_wrench(axes: Axes) -> None:
    """Where nothing of the turn is estimated: A C A', sample by sample."""
    own, turned = bench("a third about a diagonal").contact(None), bench("a third about a diagonal").contact(axes)
    turn = np.broadcast_to(np.asarray(turned.turn), own.covariance.shape)
    assert turned.wrench == pytest.approx(np.einsum("nij,nj->ni", turn, own.wrench), abs=1e-12)
    assert turned.covariance == pytest.approx(turn @ own.covariance @ turn.swapaxes(1, 2), rel=1e-9, abs=1e-15)
    assert turned.magnitude_std == pytest.approx(own.magnitude_std)  # of a length, whatever the axes
    for mean, before in zip(turned.means, own.means, strict=True):
        assert np.trace(mean.covariance[:3, :3]) == pytest.approx(np.trace(before.covariance[:3, :3]), rel=1e-6)


@pytest.mark.parametrize("axes", list(Axes))
def test_an_estimated_turn_is_in_the_covariance(axes: Axes) -> None:
    """The systematic covariance is J C J', J by central differences over the parameters, with the zero kept."""
    fitted = CalibratedModel.of(bench("30 degrees").fit)
    columns = bench("30 degrees").sensor.columns(pushed=True, seed=1)
    pushed = from_columns({name: values[:100] for name, values in columns.items() if name != "repeat"})

    def wrench(theta: Array) -> Array:
        return compensate(replace(fitted, theta=theta), pushed, keep_zero=True, axes=axes).wrench[::10]

    steps = 1e-5 * np.sqrt(np.diag(fitted.covariance)) * np.eye(len(fitted.theta)) * 1e3
    jacobian = np.stack([(wrench(fitted.theta + d) - wrench(fitted.theta - d)) / (2 * d.sum()) for d in steps], axis=2)
    contact = compensate(fitted, pushed, keep_zero=True, axes=axes)
    expected = jacobian @ fitted.covariance @ jacobian.swapaxes(1, 2)
    assert contact.systematic_covariance[::10] == pytest.approx(expected, rel=1e-4, abs=1e-4 * expected.max())


@pytest.mark.parametrize("name", TURNS)
def test_the_payload_is_turned_once(name: str) -> None:
    """Along the logged pose's axes by itself, and in any frame in which the sensor's own axes have a stated pose."""
    sensor, fitted = bench(name).sensor, bench(name).fit
    model, size = fitted.model, len(fitted.model.parameters)
    given = model, fitted.theta[:size], fitted.covariance[:size, :size]
    flange = ToolInertia.of(*given)
    turned = is_turned(model)
    assert flange.frame == (ALONG_POSE if turned else SENSOR_FRAME)
    assert not flange.left_out  # an estimated turn is in the frame
    stated = ToolInertia.of(*given, along=Axes.SENSOR).seen_from((0, 0, 0.04, *sensor.to_pose.as_euler("xyz")))
    for tool, offset in ((flange, 0.0), (stated, 0.04)):
        centre = sensor.to_pose.apply(CENTRE) + np.array([0, 0, offset])
        assert tool.centre_of_mass == pytest.approx(centre, abs=1e-4)
        assert tool.inertia == pytest.approx(inertia(MASSES, sensor.to_pose.apply(PLACES)), abs=INERTIA)
    own = ToolInertia.of(*given, along=Axes.SENSOR)
    assert own.centre_of_mass == pytest.approx(CENTRE, abs=1e-4)
    assert own.centre_std == pytest.approx(CentreOfMass.of(fitted).std, rel=1e-6)
    assert own.inertia == pytest.approx(inertia(MASSES, PLACES), abs=INERTIA)
    assert own.mass == pytest.approx(MASS, abs=1e-3)


def test_the_std_of_an_inertia_has_that_of_the_turn() -> None:
    """In sensor axes: against differences over the parameters."""
    fitted = CalibratedModel.of(bench("any, sloping").fit)
    std = np.sqrt(np.diag(fitted.covariance))

    def moments(theta: Array) -> Array:
        return np.asarray(ToolInertia.of(fitted.model, theta, fitted.covariance, along=Axes.SENSOR).inertia).ravel()

    steps = 1e-2 * std * np.eye(len(std))
    jacobian = np.stack(
        [(moments(fitted.theta + d) - moments(fitted.theta - d)) / (2 * d.sum()) for d in steps], axis=1
    )
    expected = np.sqrt(np.diag(jacobian @ fitted.covariance @ jacobian.T)).reshape(3, 3)
    tool = ToolInertia.of(fitted.model, fitted.theta, fitted.covariance, along=Axes.SENSOR)
    assert tool.inertia_std == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("name", ["half a turn", "30 degrees"])
def test_emitted_code_gives_the_contact_in_sensor_axes(name: str) -> None:
    fitted, pushed = bench(name).fit, bench(name).sensor.recording(pushed=True, seed=1)
    code = emit(fitted, "numpy")
    assert "Readings, biases and contact are in sensor axes" in " ".join(code.replace("#", " ").split())
    names = code.partition("Signals u in order: ")[2].partition(". No other")[0].replace("#", " ").split(",")
    signals = np.stack([pushed.signals[n.strip()] for n in names], axis=1)
    emitted = module(code)
    state = emitted.State()
    contact = [emitted.compensate(state, *rows) for rows in zip(signals[::20], pushed.wrench[::20], strict=True)]
    kept = compensate(fitted, pushed, keep_zero=True)
    assert np.array(contact) == pytest.approx(kept.wrench[::20], abs=1e-9)


def test_the_plane_has_tip_axes_and_the_force_at_the_tip_stays() -> None:
    """A push at the tip in tip, sensor and base axes; its size does not depend on them, its direction does."""
    rig = Rig(link_lengths=(1.0, 0.97, 0.4), tip_length=0.2)
    push = ContactEvent(force=(3.0, -4.0, 0.0), torque=(0.0, 0.0, 0.2 * 3.0), start=2.0, end=4.0)
    fitted = fit(planar(rig) + sensor_rotation(), simulated_recording(Space.PLANE, seed=1))
    pushed = simulated_recording(Space.PLANE, push, seed=2, repeats=2)
    angle = float(fitted.values["sensor_rotation.angle"])
    tip, sensor, base = (compensate(fitted, pushed, axes=axes, tip_length=0.2) for axes in ("pose", "sensor", "base"))
    assert compensate(fitted, pushed).axes is Axes.POSE
    for contact in (sensor, base):
        assert contact.magnitude == pytest.approx(tip.magnitude)
        assert contact.magnitude_std == pytest.approx(tip.magnitude_std)
        assert [m.tip_force for m in contact.means] == [m.tip_force for m in tip.means]
    turned = np.angle(np.exp(1j * (tip.point_force.direction - sensor.point_force.direction)))
    assert turned == pytest.approx(angle, abs=1e-9)
    turned = np.angle(np.exp(1j * (base.point_force.direction - tip.point_force.direction - pushed.signals["phi"])))
    assert turned == pytest.approx(0, abs=1e-9)
    assert "tip axes" in CentreOfMass.of(fitted).frame
