"""The convention of six-axis readings and the quarter turns of the mounting, decided from poses at rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from estimation.case import Case
from estimation.fit import fit
from estimation.recordings.reading import from_columns
from estimation.recordings.recording import Recording
from estimation.recordings.sign_convention import SignDecision, decide_convention, in_sensor_frame
from modeling.chain.model import QUARTER_TURNS, spatial
from modeling.errors import InputError
from modeling.rig import Convention
from truewrench.files.case_files import mounting_angle

GRAVITY = 9.806
MASS, CENTRE = 0.8, np.array([0.01, -0.02, 0.05])


def poses(*, sign: float, turn: np.ndarray, seed: int = 3, count: int = 20) -> Recording:
    """A tool weighed in random orientations by a sensor mounted turned: sign · turn · (-m g), seen from the sensor."""
    rng = np.random.default_rng(seed)
    orientation = Rotation.random(count, rng=rng)
    force = MASS * GRAVITY * orientation.apply([0.0, 0.0, 1.0], inverse=True)
    torque = np.cross(CENTRE, force)
    wrench = sign * np.concatenate([force @ turn.T, torque @ turn.T], axis=1) + 0.01 * rng.standard_normal((count, 6))
    columns = dict(zip(("qx", "qy", "qz", "qw"), orientation.as_quat().T, strict=True))
    columns |= dict(zip(("fx", "fy", "fz", "tx", "ty", "tz"), (wrench + 1.5).T, strict=True))
    return from_columns(columns, name="poses")


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("number", range(len(QUARTER_TURNS)))
def test_any_quarter_turn_and_either_sign_are_decided(sign: float, number: int) -> None:
    """The noise of 10 mN is a thousandth of the weight: the decision cannot fail, and mass comes back within 1 %."""
    turn = np.array(QUARTER_TURNS[number])
    model = Case.of(spatial(), [poses(sign=sign, turn=turn)]).model
    assert model.convention is (Convention.ON_TOOL if sign > 0 else Convention.ON_SENSOR)
    assert model.mounting == QUARTER_TURNS[number]
    values = fit(model, poses(sign=sign, turn=turn)).values
    assert values["m"] == pytest.approx(MASS, rel=0.01)
    found = np.array([values["mx"], values["my"], values["mz"]]) / values["m"]
    assert np.allclose(found, CENTRE, atol=0.003)  # 10 mN m over 8 N and 20 poses


def test_a_small_turn_is_left_to_the_effect_and_reported() -> None:
    turn = Rotation.from_rotvec([0.0, 0.0, 0.2]).as_matrix()
    recording = poses(sign=-1.0, turn=turn)
    assert np.allclose(decide_convention([recording], GRAVITY).mounting, turn, atol=0.01)
    assert Case.of(spatial(), [recording]).model.mounting == QUARTER_TURNS[0]


def test_fit_decides_by_itself() -> None:
    assert fit(spatial(), poses(sign=-1.0, turn=np.eye(3))).model.convention is Convention.ON_SENSOR


def test_poses_in_a_plane_do_not_decide() -> None:
    whole = poses(sign=1.0, turn=np.eye(3))
    turns = Rotation.from_rotvec(np.outer(np.linspace(0, 3, 20), [0.0, 1.0, 0.0]))
    flat = whole.moved(columns=dict(zip(("qx", "qy", "qz", "qw"), turns.as_quat().T, strict=True)))
    with pytest.raises(InputError, match="does not span three directions"):
        Case.of(spatial(), [flat])


def test_a_negative_mass_is_refused() -> None:
    model = replace(spatial(), convention=Convention.ON_TOOL)
    with pytest.raises(InputError, match=r"mass comes out as -0\.8"):
        fit(model, poses(sign=-1.0, turn=np.eye(3)))


def test_world_vectors_in_the_sensor_frame_are_those_of_scipy() -> None:
    """SciPy's inverse rotation, for quaternions that are not normalised; both round a dozen operations."""
    rng = np.random.default_rng(0)
    quaternions, vector = rng.standard_normal((50, 4)), rng.standard_normal((50, 3))
    signals = dict(zip(("qx", "qy", "qz", "qw"), quaternions.T, strict=True))
    rotation = Rotation.from_quat(quaternions)
    np.testing.assert_allclose(in_sensor_frame(signals, [*vector.T]), rotation.apply(vector, inverse=True), atol=1e-14)
    down = rotation.apply([0.0, 0.0, -1.0], inverse=True)
    np.testing.assert_allclose(in_sensor_frame(signals, (0.0, 0.0, -1.0)), down, atol=1e-14)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.3, 2.0, np.pi])
def test_mounting_angle_is_that_of_scipy(angle: float) -> None:
    """Exact to rounding at both ends, where the arc cosine of the trace would have lost half the digits."""
    rotation = Rotation.from_rotvec(angle * np.array([2.0, -1.0, 2.0]) / 3)
    decision = SignDecision(Convention.ON_TOOL, 1.0, rotation.as_matrix())
    assert mounting_angle(decision) == pytest.approx(angle, abs=1e-15)
