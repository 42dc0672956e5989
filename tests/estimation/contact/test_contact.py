"""Contact wrenches from MuJoCo's readings: the push that was put in comes back, with the uncertainty that it has."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from estimation.contact.contact_wrench import CalibratedModel, ContactWrench, compensate
from estimation.fit import Fit, fit
from estimation.recordings.recording import Recording
from modeling import effects
from modeling.chain.effect import Effect
from modeling.chain.model import WrenchModel, planar, spatial
from modeling.rig import Convention, Rig, SensorDescription
from modeling.space import Space
from tests.shared.recordings import recording_of
from tests.shared.rigs import SIMULATED
from truewrench import simulated_rig as simulated

pytest.importorskip("mujoco")

Array = NDArray[np.float64]

SAMPLES, REPEATS = 250, 4
PUSH = (0.3, 0.5)
"""Part of each repeat during which the tool is pushed."""
TETHER = simulated.HIDDEN_EFFECTS["cable_spring"]
LEAK = simulated.HIDDEN_EFFECTS["sensor_crosstalk"]
TURNED = simulated.HIDDEN_EFFECTS["sensor_rotation"]


def pushes(space: Space, period: float) -> list[simulated.ContactEvent]:
    torque = (0.0, 0.0, 0.3) if space is Space.PLANE else (0.1, -0.2, 0.3)
    force = (4.0, -2.0, 0.0) if space is Space.PLANE else (4.0, -2.0, 3.0)
    return [
        simulated.ContactEvent(force=force, torque=torque, start=(r + PUSH[0]) * period, end=(r + PUSH[1]) * period)
        for r in range(REPEATS)
    ]


@cache
def recorded(
    space: Space,
    hidden: tuple[simulated.HiddenEffect, ...] = (),
    *,
    push: bool = False,
    convention: str = "on_tool",
    seed: int = 1,
) -> Recording:
    rig = replace(SIMULATED[space], convention=convention)
    motion = rig.random_motion(seed=seed)
    present = [*hidden, *(pushes(space, motion.period) if push else [])]
    frame = simulated.simulate(rig, motion, hidden=present, repeats=REPEATS, samples_per_period=SAMPLES, seed=seed)
    links = rig.link_lengths if isinstance(rig, simulated.PlanarRig) else None
    described = Rig(link_lengths=links, sensor=SensorDescription(convention=Convention(convention)))
    return recording_of(frame, without=("temperature",), name=f"seed {seed}", rig=described)


def true_push(space: Space, recording: Recording) -> Array:
    assert recording.time is not None
    period = recording.samples_per_repeat * (recording.dt or 0.0)
    wrench = np.sum([p.wrench(recording.time) for p in pushes(space, period)], axis=0)
    return np.asarray(wrench[:, [0, 1, 5]] * [1, -1, 1] if space is Space.PLANE else wrench)


def model_of(space: Space, convention: str, *added: Effect) -> WrenchModel:
    rig = Rig(sensor=SensorDescription(convention=Convention(convention)))
    return (planar if space is Space.PLANE else spatial)(rig) + added


def hidden_in(space: Space, *hidden: simulated.HiddenEffect) -> tuple[simulated.HiddenEffect, ...]:
    """The effects in their places on the training motion, where they stay."""
    rig = SIMULATED[space]
    return simulated.resolve_effects(rig, rig.random_motion(seed=1), hidden, repeats=REPEATS)


@cache
def calibrated(space: Space, hidden: tuple[simulated.HiddenEffect, ...], convention: str, *added: Effect) -> Fit:
    return fit(model_of(space, convention, *added), recorded(space, hidden, convention=convention))


# -------------------------------------------------------------------------------- the push comes back


@pytest.mark.parametrize("space", list(Space))
@pytest.mark.parametrize("convention", ["on_tool", "on_sensor"])
def test_a_push_comes_back(space: Space, convention: str) -> None:
    """Whatever the readings' sign: the error's repeating part is a tenth of the noise and two of its own errors."""
    recording = recorded(space, push=True, convention=convention, seed=3)
    contact = compensate(calibrated(space, (), convention), recording)
    assert_exact(contact, true_push(space, recording))
    assert len(contact.intervals) == REPEATS
    assert_means_are_the_push(contact, true_push(space, recording))
    for number, interval in enumerate(contact.intervals):
        for edge, part in ((interval.first, PUSH[0]), (interval.last, PUSH[1])):
            assert abs(edge - (number + part) * SAMPLES) <= 4


def assert_means_are_the_push(contact: ContactWrench, true: Array) -> None:
    """Each mean of the table within four std of what was injected: 1 in 700 for 24 numbers; |F| is its size."""
    for mean in contact.means:
        injected = true[mean.interval.first : mean.interval.last].mean(axis=0)
        assert (np.abs(mean.wrench - injected) < 4 * mean.std).all()
        assert (mean.std < contact.floor).all()
        forces = contact.space.value
        assert mean.force == pytest.approx(float(np.linalg.norm(mean.wrench[:forces])), rel=1e-12)
        assert mean.largest_force >= mean.force
        assert np.isnan(mean.tip_force)  # six axes, and a plane without a tip length


def assert_exact(contact: ContactWrench, true: Array) -> None:
    """The repeating power may exceed that of a tenth of the noise by four of its standard errors: 1 in 5000 for six."""
    per_power = np.sqrt(2 / (SAMPLES * REPEATS * (REPEATS - 1)))
    allowed = contact.floor * np.sqrt(0.1**2 + 4 * per_power)
    assert (contact.systematic_contact_error(true) < allowed).all()


@pytest.mark.parametrize("hidden", [LEAK, TURNED], ids=["crosstalk", "turned"])
def test_a_push_is_seen_through_the_same_sensor_as_the_tool(hidden: simulated.HiddenEffect) -> None:
    """A sensor that leaks or is mounted turned shows the push leaking or turned: its inverse takes that back."""
    added = effects.named(hidden.id)
    place = hidden_in(Space.PLANE, hidden)
    recording = recorded(Space.PLANE, place, push=True, seed=3)
    true = true_push(Space.PLANE, recording)
    with_it = compensate(calibrated(Space.PLANE, place, "on_tool", added), recording)
    without = compensate(calibrated(Space.PLANE, place, "on_tool"), recording)
    assert_exact(with_it, true)
    assert (without.systematic_contact_error(true) > without.floor / 2).any()


def test_a_hidden_effect_is_taken_for_contact_until_it_is_in_the_model() -> None:
    """The point of it all: the rigid tool's contact is wrong by many times the noise, the found model's is not."""
    place = hidden_in(Space.PLANE, TETHER)
    recording = recorded(Space.PLANE, place, push=True, seed=3)
    true = true_push(Space.PLANE, recording)
    rigid = compensate(calibrated(Space.PLANE, place, "on_tool"), recording)
    found = compensate(calibrated(Space.PLANE, place, "on_tool", effects.cable_spring()), recording)
    assert (rigid.systematic_contact_error(true) > 5 * rigid.floor).all()
    assert_exact(found, true)
    assert len(found.intervals) == REPEATS


# ----------------------------------------------------------------------------------------- uncertainty


@pytest.mark.parametrize("space", list(Space))
def test_parameters_doubt_is_the_derivative(space: Space) -> None:
    """Of a covariance u u' it is (D u)(D u)', D u by a central difference along u; a step of a std, where the contact
    is linear to 1e-6 of its own std."""
    added = effects.sensor_rotation() if space is Space.PLANE else effects.gravity_tilt()
    known = CalibratedModel.of(calibrated(space, (), "on_tool", added))
    recording = recorded(space, push=True, seed=3)
    along = np.random.default_rng(1).standard_normal(len(known.theta)) * np.sqrt(np.diag(known.covariance))
    kept = compensate(replace(known, covariance=np.outer(along, along)), recording, keep_zero=True)
    moved = [replace(known, theta=known.theta + sign * along) for sign in (1, -1)]
    up, down = (compensate(m, recording, keep_zero=True).wrench for m in moved)
    expected = np.einsum("ni,nj->nij", (up - down) / 2, (up - down) / 2)
    assert kept.systematic_covariance == pytest.approx(expected, rel=1e-3, abs=1e-5 * expected.max())


def test_a_zero_that_moved_is_a_zero_that_moved() -> None:
    """The contact stays to rounding, the shift is reported; kept, the old zero shows it as a contact."""
    recording = recorded(Space.PLANE, push=True, seed=3)
    known = calibrated(Space.PLANE, (), "on_tool")
    shift = np.array([1.5, -0.7, 0.04])
    moved = replace(recording, wrench=recording.wrench + shift)
    before, after, kept = (
        compensate(known, recording),
        compensate(known, moved),
        compensate(known, moved, keep_zero=True),
    )
    assert after.wrench == pytest.approx(before.wrench, abs=1e-9)
    assert after.zero_shift - before.zero_shift == pytest.approx(shift, abs=1e-9)
    assert (np.abs(before.zero_shift) < 5 * np.sqrt(np.diag(before.detection.zero_covariance))).all()
    assert kept.wrench - after.wrench == pytest.approx(
        np.broadcast_to([-1, 1, -1] * after.zero_shift, kept.wrench.shape)
    )


def test_std_is_that_of_the_error() -> None:
    """Errors over their std have mean square 1 (1000 samples x 3), within six standard errors of that."""
    recording = recorded(Space.PLANE, push=True, seed=3)
    contact = compensate(calibrated(Space.PLANE, (), "on_tool"), recording)
    score = (contact.wrench - true_push(Space.PLANE, recording)) / np.sqrt(
        np.diagonal(contact.covariance, axis1=1, axis2=2)
    )
    assert (score**2).mean() == pytest.approx(1.0, abs=6 * np.sqrt(2 / score.size))


def test_what_the_poses_did_not_show_is_named() -> None:
    """Poses at rest know no inertia; a motion asks for it."""
    rig = SIMULATED[Space.SPACE]
    frame = simulated.static_poses(rig, 30, seed=1)
    stated = Rig(sensor=SensorDescription(convention=Convention.ON_TOOL))
    known = fit(spatial(stated), recording_of(frame, without=("temperature",), name="poses", rig=stated))
    contact = compensate(known, recorded(Space.SPACE, push=True, seed=3))
    assert set(contact.unknown) == {"Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz"}
    assert np.isfinite(contact.covariance).all()


def test_a_delay_is_stated() -> None:
    known = calibrated(Space.PLANE, hidden_in(Space.PLANE, simulated.SensorLag()), "on_tool", effects.sensor_lag())
    contact = compensate(known, recorded(Space.PLANE, seed=3))
    assert contact.group_delay == pytest.approx(known.values["sensor_lag.time_constant"])
