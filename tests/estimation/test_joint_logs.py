"""Recordings of joint coordinates of spatial arms: MuJoCo's and Pinocchio's readings, and what is found in them."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from estimation.contact.contact_filter import ContactFilter, LocalPolynomial
from estimation.contact.contact_wrench import CalibratedModel
from estimation.errors_in_variables import ErrorPropagation
from estimation.fit import fit
from estimation.input_noise import InputNoise
from estimation.pose_advice import CandidatePoses
from estimation.recordings.motion import MotionForm
from estimation.recordings.reading import from_columns
from estimation.repeat_table import motion_error_rows
from estimation.streaming.long_log import read_chunks
from modeling.chain.model import spatial
from modeling.chain.prediction import compiled_prediction
from modeling.effects import viscous_drag
from modeling.errors import InputError
from modeling.kinematics.urdf import read_urdf
from modeling.rig import Convention, Rig, SensorDescription, Workspace
from tests.shared.places import URDF
from tests.shared.rigs import FRAMES, spatial_arm
from truewrench.command_line import main
from truewrench.simulated_rig import SpatialRig, ViscousDrag, simulate

Array = NDArray[np.float64]

TOOL = SpatialRig()
CHANNELS = TOOL.channels
ON_TOOL = SensorDescription(convention=Convention.ON_TOOL)
CARRIAGE = Rig(spatial_arm=spatial_arm("carriage"), sensor=ON_TOOL)
ELBOW = Rig(spatial_arm=spatial_arm("elbow"), sensor=ON_TOOL)
DRAG = ViscousDrag()
SAMPLES, REPEATS, PERIOD = 400, 3, 5.0
GRAVITY = 9.806


def truth() -> dict[str, float]:
    """The parameters of the simulated rig's tool."""
    names = ("mx", "my", "mz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")
    biases = {f"bias_{channel}": value for channel, value in zip(CHANNELS, TOOL.bias, strict=True)}
    return {**biases, "m": TOOL.mass, **dict(zip(names, (*TOOL.first_moment, *TOOL.inertia), strict=True))}


@cache
def carriage_frame(*hidden: Any) -> pd.DataFrame:
    """MuJoCo's readings with noise, and what the carriage's resolvers say instead of the pose that they mean."""
    motion = TOOL.random_motion(seed=3, period=PERIOD)
    frame = simulate(TOOL, motion, hidden=hidden, repeats=REPEATS, samples_per_period=SAMPLES, seed=2)
    q = TOOL.quantised(motion.evaluate(np.arange(SAMPLES) * PERIOD / SAMPLES)[0])
    joints = {f"q{j + 1}": np.tile(column, REPEATS) for j, column in enumerate(q.T)}
    return frame.drop(columns=["qx", "qy", "qz", "qw", "px", "py", "pz"]).assign(**joints)


def elbow_motion(t: Array) -> tuple[Array, Array, Array]:
    """Two harmonics of each joint, so large that gravity is seen from all sides."""
    rng = np.random.default_rng(0)
    parts = [(h, rng.uniform(0.3, 0.6, 6), rng.uniform(0, 2 * np.pi, 6)) for h in (1, 3)]
    w = 2 * np.pi / PERIOD
    angles = [(h * w, a, h * w * t[:, None] + p) for h, a, p in parts]
    q = sum(a * np.sin(x) for _, a, x in angles)
    dq = sum(r * a * np.cos(x) for r, a, x in angles)
    ddq = sum(-(r**2) * a * np.sin(x) for r, a, x in angles)
    return np.asarray(q), np.asarray(dq), np.asarray(ddq)


@cache
def elbow_columns(noise: float = 1.0) -> dict[str, Array]:
    """The tool's inertia times Pinocchio's acceleration of the sensor frame, gravity subtracted, in that frame.

    `noise` is in multiples of the simulated rig's.
    """
    import pinocchio  # slow to import

    model = pinocchio.buildModelFromUrdf(str(URDF / "elbow.urdf"))
    data, frame = model.createData(), model.getFrameId("tool0")
    values = list(truth().values())[7:]
    first, (xx, xy, xz, yy, yz, zz) = np.array(values[:3]), values[3:]
    com = first / TOOL.mass
    about_origin = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    about_com = about_origin + TOOL.mass * pinocchio.skew(com) @ pinocchio.skew(com)
    body = pinocchio.Inertia(TOOL.mass, com, about_com)
    t = np.arange(REPEATS * SAMPLES) * PERIOD / SAMPLES
    rows = []
    for q, dq, ddq in zip(*(np.pad(x, ((0, 0), (0, 2))) for x in elbow_motion(t[:SAMPLES])), strict=True):
        pinocchio.forwardKinematics(model, data, q, dq, ddq)
        pinocchio.updateFramePlacements(model, data)
        v = pinocchio.getFrameVelocity(model, data, frame, pinocchio.LOCAL)
        a = pinocchio.getFrameAcceleration(model, data, frame, pinocchio.LOCAL)
        a.linear += data.oMf[frame].rotation.T @ np.array([0.0, 0.0, GRAVITY])
        rows.append((body * a + v.cross(body * v)).vector)
    wrench = np.tile(rows, (REPEATS, 1)) + np.array(TOOL.bias)
    wrench += noise * np.random.default_rng(1).normal(size=wrench.shape) * np.array(TOOL.noise)
    columns: dict[str, Array] = {"time": t, "repeat": np.repeat(np.arange(float(REPEATS)), SAMPLES)}
    columns |= {f"q{j + 1}": column for j, column in enumerate(elbow_motion(t)[0].T)}
    return columns | dict(zip(CHANNELS, wrench.T, strict=True))


def require_truth(values: dict[str, dict[str, float]]) -> None:
    """Within 4.5 std: 1 in 1e4 for all 16 parameters; and the std say something."""
    score = {name: (values[name]["value"] - true) / values[name]["std"] for name, true in truth().items()}
    assert max(map(abs, score.values())) < 4.5, score
    assert values["m"]["std"] < 0.02 * TOOL.mass
    assert max(values[name]["std"] for name in ("Ixx", "Iyy", "Izz")) < 0.1 * max(TOOL.inertia)


# ------------------------------------------------------------------------------------- what is found


@pytest.mark.parametrize("arm", ["carriage", "elbow"])
def test_fit_command_recovers_the_tool(arm: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The sign of the readings is decided too, and the model file says what the arm is without the URDF."""
    frame = carriage_frame() if arm == "carriage" else pd.DataFrame(elbow_columns())
    frame.to_csv(tmp_path / "run.csv", index=False)
    (tmp_path / "arm.urdf").write_text((URDF / f"{arm}.urdf").read_text())
    (tmp_path / "rig.toml").write_text(f'[robot]\nurdf = "arm.urdf"\nsensor_frame = "{FRAMES[arm]}"\n')
    out = tmp_path / "model.json"
    assert (
        main(["fit", str(tmp_path / "run.csv"), "--rig", str(tmp_path / "rig.toml"), "--json", "--out", str(out)]) == 0
    )
    require_truth(json.loads(capsys.readouterr().out)["parameters"])
    (tmp_path / "arm.urdf").unlink()
    stored = Rig.from_data(json.loads(out.read_text())["rig"])
    assert stored.arm == spatial_arm(arm)


def test_an_effect_that_needs_place_and_speed_is_fitted() -> None:
    """Within 4.5 std, and the std say something: the drag of the simulated rig, at its distance along the tip."""
    columns = {str(name): values.to_numpy() for name, values in carriage_frame(DRAG).items()}
    estimated = fit(spatial(CARRIAGE) + viscous_drag(), from_columns(columns, rig=CARRIAGE)).parameters
    for name, true in (("viscous_drag.c", DRAG.c), ("viscous_drag.d", DRAG.d)):
        assert abs(estimated[name].value - true) < 4.5 * estimated[name].std
        assert estimated[name].std < 0.2 * true


def test_joint_log_with_hardly_any_noise_gives_the_truth() -> None:
    """The joints' harmonics are all below half the sampling rate, so that their derivatives are exact; the noise of a
    millionth leaves a millionth of the std, which are below 0.01."""
    estimated = fit(spatial(ELBOW), from_columns(elbow_columns(1e-6), rig=ELBOW))
    for name, true in truth().items():
        assert estimated.values[name] == pytest.approx(true, abs=1e-7)


def test_contact_filter_takes_rows_of_joints() -> None:
    """What SciPy's filter, the arm and the model make of whole columns, here the noise."""
    window, dt = LocalPolynomial(half=6, dt=PERIOD / SAMPLES), PERIOD / SAMPLES
    columns = {name: values[:100] for name, values in elbow_columns().items()}
    model = spatial(ELBOW)
    theta, noise = np.array(list(truth().values())), np.array(TOOL.noise)
    known = CalibratedModel(model, theta, np.zeros((16, 16)), noise, np.zeros(6))
    names = [f"q{j + 1}" for j in range(6)]
    contact = ContactFilter(known, columns=names, window=window, rig=ELBOW)
    table = np.stack([columns[name] for name in (*names, *CHANNELS)], axis=1)
    results = [row for row in map(contact.update, table) if row is not None]

    smooth = [savgol_filter(table, 13, window.degree, deriv=n, delta=dt, axis=0)[6:-6] for n in range(3)]
    assert ELBOW.arm is not None
    signals = ELBOW.arm.pose(*(part[:, :6] for part in smooth))
    prediction = compiled_prediction(model)
    load, zero = (part.value(signals, theta, len(smooth[0])) for part in (prediction.load, prediction.bias))
    # The sensor does as much less as the environment does; rounding / dt².
    np.testing.assert_allclose(results, load + zero - smooth[0][:, 6:], atol=1e-8)


def test_poses_at_rest_are_advised_in_joint_coordinates() -> None:
    """Within the limits, in whole degrees and millimetres, with the signals that the arm gives there."""
    columns = {str(n): v.to_numpy()[:30] for n, v in carriage_frame().items() if n not in ("time", "repeat")}
    poses = CandidatePoses.of(from_columns(columns, rig=replace(CARRIAGE, workspace=Workspace(z=(0.0, 1.0)))))
    assert CARRIAGE.arm is not None
    q = np.stack([poses.columns[f"q{j + 1}"] for j in range(6)], axis=1)
    limits = CARRIAGE.position_limits
    assert limits is not None
    assert (limits[:, 0] <= q).all()
    assert (q <= limits[:, 1]).all()
    assert (q[:, 2] >= 0).all()  # the carriage's third slide is the tip's height
    assert 100 < len(poses) < 512
    np.testing.assert_allclose(poses.signals["qw"], CARRIAGE.arm.pose(q, 0 * q, 0 * q)["qw"], atol=1e-12)
    assert re.fullmatch(r"q1 = -?\d+ mm, q2 = -?\d+ mm, q3 = -?\d+ mm, q4 = -?\d+°, q5 = .*°", poses.words[0])


def test_noise_of_joints_is_refused_in_one_line() -> None:
    recording = from_columns(elbow_columns(), rig=ELBOW)
    noise = InputNoise(("q1",), np.eye(1))
    with pytest.raises(InputError, match="propagated through a planar arm only"):
        ErrorPropagation.of(spatial(ELBOW), recording, noise)


# ------------------------------------------------------------------------------------- how it is read


def test_signals_are_the_arms_and_recorded_rates_are_believed() -> None:
    columns = elbow_columns()
    q, dq, ddq = elbow_motion(columns["time"])
    rates = {f"{p}{j + 1}": x[:, j] for p, x in (("dq", dq), ("ddq", ddq)) for j in range(6)}
    recording = from_columns({**columns, **rates, "temperature": columns["q1"]}, rig=ELBOW)
    assert recording.form is MotionForm.JOINTS
    assert (recording.joints, recording.dimension, recording.auxiliary) == (6, 3, ("temperature",))
    assert ELBOW.arm is not None
    for name, expected in ELBOW.arm.pose(q, dq, ddq).items():
        # the mean over repeats, and joint angles as a series of harmonics: rounding
        np.testing.assert_allclose(recording.signals[name], expected, atol=1e-8)
    np.testing.assert_allclose(recording.signals["ddq6"], ddq[:, 5], atol=1e-10)


def test_rates_are_derived_where_none_were_recorded() -> None:
    columns = elbow_columns()
    recording = from_columns(columns, rig=ELBOW)
    assert ELBOW.arm is not None
    for name, expected in ELBOW.arm.pose(*elbow_motion(columns["time"])).items():
        np.testing.assert_allclose(recording.signals[name], expected, atol=1e-6 * max(1, np.abs(expected).max()))


def test_long_logs_and_poses_at_rest_are_read(tmp_path: Path) -> None:
    columns = elbow_columns()
    q, dq, ddq = elbow_motion(columns["time"])
    rates = {f"{p}{j + 1}": x[:, j] for p, x in (("dq", dq), ("ddq", ddq)) for j in range(6)}
    frame = pd.DataFrame({**columns, **rates}).drop(columns="repeat")
    frame.to_csv(tmp_path / "long.csv", index=False)
    chunks = list(read_chunks(tmp_path / "long.csv", rig=ELBOW, size=500))
    assert len(chunks) == 3
    assert ELBOW.arm is not None
    np.testing.assert_allclose(chunks[0].signals["apx"], ELBOW.arm.pose(q, dq, ddq)["apx"][:500], atol=1e-10)
    still = {name: values[:30] for name, values in columns.items() if name not in ("time", "repeat")}
    signals = from_columns(still, rig=ELBOW).signals
    np.testing.assert_array_equal(signals["apx"], np.zeros(30))
    np.testing.assert_allclose(signals["pz"], ELBOW.arm.pose(q[:30], 0 * q[:30], 0 * q[:30])["pz"], atol=1e-12)


def test_errors_of_sliding_joints_are_in_metres() -> None:
    columns = {str(name): values.to_numpy() for name, values in carriage_frame().items()}
    columns["q2"] = columns["q2"] + 1e-4 * np.random.default_rng(0).normal(size=len(columns["q2"]))
    rows = motion_error_rows(from_columns(columns, rig=CARRIAGE))
    assert {row.name: row.unit for row in rows} == dict.fromkeys(("q1", "q2", "q3"), "m") | dict.fromkeys(
        ("q4", "q5", "q6"), "rad"
    )


PLANE = Rig(link_lengths=(1.0, 0.5, 0.5, 0.2, 0.2, 0.1))


@pytest.mark.parametrize(
    ("rig", "dropped", "parts"),
    [
        (None, "", ["q1, q2, q3, q4, q5, q6 are joint angles", "no rig was given", "robot.urdf"]),
        (PLANE, "", ["the rig has no urdf"]),
        (ELBOW, "q4", ["missing q4", "every joint of robot.urdf"]),
        (Rig(spatial_arm=read_urdf(URDF / "elbow.urdf", "fore")), "", ["q4, q5, q6", "the rig's 3 joints"]),
    ],
)
def test_what_a_joint_log_lacks_is_one_line(rig: Rig | None, dropped: str, parts: list[str]) -> None:
    columns = {name: values for name, values in elbow_columns().items() if name != dropped}
    with pytest.raises(InputError) as caught:
        from_columns(columns, rig=rig)
    for part in parts:
        assert part in str(caught.value)


def test_a_planar_wrench_does_not_go_with_a_spatial_arm() -> None:
    found = {name: values for name, values in elbow_columns().items() if name[0] == "q" or name in ("time", "fx", "fy")}
    with pytest.raises(InputError, match="the rig has no link_lengths"):
        from_columns({**found, "tau": found["fx"]}, rig=ELBOW)


def test_an_orientation_does_without_a_rig() -> None:
    columns = elbow_columns()
    four = dict(zip(("qx", "qy", "qz", "qw"), np.tile([[0.0], [0.0], [0.0], [1.0]], len(columns["time"])), strict=True))
    recording = from_columns({**columns, **four})
    assert recording.form is MotionForm.POSE
    assert "q1" in recording.auxiliary


@pytest.mark.parametrize(
    ("column", "factor", "hint"), [("q5", 57.3, "rad (degrees?)"), ("q2", 1000.0, "m (millimetres?)")]
)
def test_wrong_units_are_noticed_by_the_urdfs_limits(column: str, factor: float, hint: str) -> None:
    frame = carriage_frame()
    with pytest.raises(InputError) as caught:
        from_columns({str(n): (factor if n == column else 1) * frame[n].to_numpy() for n in frame}, rig=CARRIAGE)
    assert column in str(caught.value)
    assert hint in str(caught.value)


def test_limits_without_end_are_no_limits() -> None:
    endless = Rig(spatial_arm=read_urdf(URDF / "seven.urdf", "l2"), sensor=ON_TOOL)  # two joints, the first endless
    columns = {name: values for name, values in elbow_columns().items() if name not in ("q3", "q4", "q5", "q6")}
    recording = from_columns({**columns, "q1": columns["q1"] + 100.0}, rig=endless)
    assert recording.joints == 2
