"""Contact wrench by models that a diagnosis did not tell apart: their mean, and a std with what they differ by."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from diagnosis.diagnosis import diagnose
from estimation.contact.contact_wrench import Alternative, CalibratedModel, compensate
from estimation.fit import fit
from modeling.chain.model import planar
from modeling.effects import named
from modeling.errors import InputError
from modeling.space import Space
from tests.shared.recordings import base, drag_and_leak, recorded, recording_of
from tests.shared.rigs import RIG
from truewrench.simulated_rig import ContactEvent, PlanarRig, SensorCrosstalk, SensorRotation, ViscousDrag, simulate

pytest.importorskip("mujoco")

WEIGHT = 0.3


@cache
def models(space: Space) -> tuple[CalibratedModel, CalibratedModel]:
    """Two fits to one recording: a drag that grows linearly, and one that grows with the square."""
    recording = drag_and_leak(1) if space is Space.PLANE else recorded(space, ViscousDrag(c=0.3), seed=1)
    model = planar(RIG) if space is Space.PLANE else base(space)
    first, second = (fit(model + named(i), recording) for i in ("viscous_drag", "quadratic_drag"))
    return CalibratedModel.of(first), CalibratedModel.of(second)


def both(space: Space, weight: float = WEIGHT) -> CalibratedModel:
    """The first with the second as alternative."""
    first, second = models(space)
    return replace(first, alternatives=(Alternative("quadratic_drag", weight, second),))


@pytest.mark.parametrize(
    ("space", "options"),
    [
        (Space.PLANE, {}),
        (Space.PLANE, {"axes": "base"}),
        (Space.PLANE, {"axes": "base", "lag": 0.1}),
        (Space.SPACE, {}),
        (Space.SPACE, {"axes": "base"}),
    ],
)
def test_it_is_the_mean_with_the_variance_between(space: Space, options: dict[str, Any]) -> None:
    """By the models' own zeros each wrench is one by itself; of the covariance the zero's is none then."""
    kept: dict[str, Any] = options | {"keep_zero": True}
    recording = drag_and_leak(501) if space is Space.PLANE else recorded(space, ViscousDrag(c=0.3), seed=2, motion=6)
    first, second = (compensate(model, recording, **kept) for model in models(space))
    contact = compensate(both(space), recording, **kept)
    weights, each = (1 - WEIGHT, WEIGHT), (first, second)
    mean = sum(w * one.wrench for w, one in zip(weights, each, strict=True))
    tolerance = 1e-9 if "lag" not in options else 1e-2  # whose weights are by the samples that are free
    np.testing.assert_allclose(contact.wrench, mean, atol=tolerance)
    apart = first.wrench - second.wrench
    between = (1 - WEIGHT) * WEIGHT * apart[:, :, None] * apart[:, None, :]
    within = sum(w * one.systematic_covariance for w, one in zip(weights, each, strict=True))
    np.testing.assert_allclose(contact.systematic_covariance, within + between, atol=tolerance)
    assert contact.between is not None
    np.testing.assert_allclose(contact.between**2, np.diagonal(between, axis1=1, axis2=2), atol=tolerance)
    assert contact.between.max() > 0.01
    alone = compensate(both(space), recording, alternatives=False, **kept)
    assert alone.between is None
    np.testing.assert_array_equal(alone.wrench, first.wrench)
    np.testing.assert_array_equal(alone.covariance, first.covariance)


def test_models_that_agree_change_nothing() -> None:
    """Also with the recording's own zero, what is detected, and the force at the tip."""
    first, _ = models(Space.PLANE)
    twice = replace(first, alternatives=(Alternative("the same", 0.5, first),))
    rig = PlanarRig()
    motion = rig.random_motion(seed=1)
    frame = simulate(rig, motion, hidden=(ContactEvent(),), repeats=4, samples_per_period=250, seed=5)
    recording = recording_of(frame, rig=RIG)
    contact, plain = compensate(twice, recording), compensate(first, recording)
    assert contact.intervals == plain.intervals
    assert contact.intervals
    for name in ("wrench", "covariance", "zero_shift", "predicted", "magnitude", "magnitude_std"):
        np.testing.assert_allclose(getattr(contact, name), getattr(plain, name), rtol=1e-10, atol=1e-12)
    assert contact.between_rms.tolist() == [0.0, 0.0, 0.0]
    for mean, other in zip(contact.means, plain.means, strict=True):
        np.testing.assert_allclose(mean.std, other.std, rtol=1e-10)
        assert mean.tip_p_value == pytest.approx(other.tip_p_value, rel=1e-6)


def test_the_prediction_is_what_the_wrench_is_apart_from_the_readings() -> None:
    contact = compensate(both(Space.PLANE), drag_and_leak(501))
    load = (contact.predicted - contact.recording.wrench) @ contact.inverse_gain.T
    np.testing.assert_allclose(np.abs(load), np.abs(contact.wrench), atol=1e-9)


def test_what_the_models_differ_by_is_no_contact() -> None:
    """A zero that is 1 N off is a contact by itself; in doubt with the right one it is none."""
    fitted, unseen = (recorded(Space.PLANE, ViscousDrag(c=0.15), seed=5, motion=motion) for motion in (5, 7))
    right = CalibratedModel.of(fit(base(Space.PLANE) + named("viscous_drag"), fitted))
    wrong = replace(right, theta=right.theta + np.array([p.name == "bias_fx" for p in right.model.parameters]))
    doubted = replace(wrong, alternatives=(Alternative("right", 0.5, right),))
    assert compensate(wrong, unseen, keep_zero=True).intervals
    assert not compensate(doubted, unseen, keep_zero=True).intervals


def test_an_alternative_that_needs_more_than_was_recorded_is_named() -> None:
    first, _ = models(Space.PLANE)
    warm = recorded(Space.PLANE, ViscousDrag(c=0.15), seed=3, temperature=True)
    drifting = CalibratedModel.of(fit(base(Space.PLANE) + named("thermal_drift"), warm))
    doubted = replace(first, alternatives=(Alternative("thermal_drift", 0.5, drifting),))
    cold = recorded(Space.PLANE, ViscousDrag(c=0.15), seed=4)
    with pytest.raises(InputError, match="temperature") as raised:
        compensate(doubted, cold)
    assert "thermal_drift, which the diagnosis could not rule out" in str(raised.value)
    assert "--without-alternatives" in str(raised.value)
    assert compensate(doubted, cold, alternatives=False).between is None


@pytest.mark.long
def test_std_covers_the_error_on_a_motion_that_was_not_fitted() -> None:
    """Of turned or leaking sensors that small motions do not tell apart, on large ones without contact.

    Mean over 16 repeats, whose noise is small against the error of the model. z² has the mean 1 if the std hold; over
    eight recordings, each with about three independent directions, it exceeds 1.8 once in a hundred times.
    """
    small, large = PlanarRig(position_limit=0.5, velocity_limit=1.0, acceleration_limit=3.0), PlanarRig()
    effects = [named(i) for i in ("sensor_rotation", "sensor_crosstalk", "joint_offset", "com_offset")]
    squares: dict[bool, list[float]] = {True: [], False: []}
    for number in range(16):
        size = (0.03, -0.03)[number % 4 // 2]
        hidden = (SensorRotation(yaw=size), SensorCrosstalk(leaks=(("fy", "fx", size),)))[number % 2]
        fitted, unseen = (
            recording_of(
                simulate(
                    rig, rig.random_motion(seed=seed + number, period=3.0, harmonics=3), hidden=(hidden,),
                    repeats=repeats, samples_per_period=150, seed=seed + number,
                ),
                without=("temperature",), rig=RIG,
            )
            for rig, seed, repeats in ((small, 1000, 4), (large, 3000, 16))
        )  # fmt: skip
        average = diagnose(planar(RIG), fitted, effects=effects).averaged
        if len(average.members) == 1:
            continue
        for doubted, found in squares.items():
            contact = compensate(average, unseen, alternatives=doubted)
            error = contact.wrench.reshape(16, -1, 3).mean(axis=0)
            systematic = np.diagonal(contact.systematic_covariance, axis1=1, axis2=2)[: len(error)]
            found.append(float((error**2 / (systematic + np.diag(contact.noise) / 16)).mean()))
    assert len(squares[True]) >= 8
    assert np.mean(squares[True]) < 1.8
    assert np.mean(squares[False]) > np.mean(squares[True])
