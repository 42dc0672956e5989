"""Joint torques, poses at the ends and jerk as limits of designs, against Pinocchio and dense grids."""

from __future__ import annotations

import re
from argparse import Namespace
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio
import pytest
from numpy.typing import NDArray

from design.joint_torque import TORQUE_MARGIN, JointTorques, joint_torques
from design.limits import LimitUse, between_poses
from design.random_feasible import random_feasible_trajectory
from design.trajectories.fourier import FreeSeries
from design.trajectories.spline import RestToRest, SplineSeries
from design.trajectories.trajectory import TrajectorySeries
from design.trajectory_design import design
from modeling.errors import InputError
from modeling.kinematics.urdf import drive_data
from modeling.rig import Rig
from tests.shared.places import URDF
from truewrench.commands.design_request import DesignRequest

Array = NDArray[np.float64]

# A UR5e: its published lengths, masses (kg) and centres (m), links as solid cylinders (length, radius, m).
OFFSETS = ("0 0 0", "0 0 0.1625", "-0.425 0 0", "-0.3922 0 0", "0 0 0.1333", "0 0 0.0997")
TURNS = ("0 0 0", "1.5707963267948966 0 0", "0 0 0", "0 0 0", "1.5707963267948966 0 0", "-1.5707963267948966 0 0")
MASSES = (3.761, 8.058, 2.846, 1.37, 1.3, 0.365)
CENTRES = ("0 -0.026 0.002", "-0.2125 0 0.113", "-0.242 0 0.027", "0 -0.002 0.016", "0 0.002 0.016", "0 0 -0.001")
CYLINDERS = ((0.16, 0.06), (0.425, 0.06), (0.392, 0.05), (0.1, 0.045), (0.1, 0.045), (0.05, 0.04))
EFFORTS = (150, 150, 150, 28, 28, 28)
POSITION = [[-2.0, 2.0], [-2.2, -0.6], [0.4, 2.4], [-2.5, 0.5], [-2.5, -0.6], [-2.5, 2.5]]
LIMITS = {"position": POSITION, "velocity": [1.5, 1.5, 1.5, 2, 2, 2], "acceleration": [4, 4, 4, 8, 8, 8]}
PAYLOAD = {"link": "tool0", "mass": 1.5, "centre": [0.0, 0.01, 0.06], "inertia": [0.004, 0, 0, 0.005, 0, 0.002]}
CAPSULES = [
    {"name": "base", "start": [0, 0, 0], "end": [0, 0, 0.1], "radius": 0.075},
    {"link": "l2", "start": [0, 0, 0], "end": [-0.425, 0, 0], "radius": 0.06},
    {"link": "l3", "start": [0, 0, 0], "end": [-0.3922, 0, 0], "radius": 0.05},
    {"link": "l4", "start": [0, 0, 0], "end": [0, 0, 0.1333], "radius": 0.045},
    {"link": "l5", "start": [0, 0, 0], "end": [0, 0, 0.0997], "radius": 0.045},
    {"link": "tool0", "start": [0, 0, -0.05], "end": [0, 0, 0.15], "radius": 0.04},
]
FLOOR = {"normal": [0, 0, 1], "offset": 0.0, "clearance": 0.02}
TIP, HEIGHT = 0.15, (0.2, 1.2)
ALLOWED = [150, 44.9, 16.4, 1.88, 1.42, 28]
"""N m: 0.6 of what joints 2 to 5 have to hold with the arm stretched out level, the wrist turned any way; the others
hold nothing then."""
FREE = FreeSeries(joints=6, harmonics=(1, 2, 3), period=8.0)
SLOW = FreeSeries(joints=6, harmonics=(1, 2), period=8.0)


def urdf(folder: Path, kinds: Mapping[int, str] | None = None) -> Path:
    """The arm, with joints of other kinds by number."""
    text = '<robot name="loaded"><link name="base"/>'
    for j, (mass, (length, radius)) in enumerate(zip(MASSES, CYLINDERS, strict=True)):
        along, across = mass * radius**2 / 2, mass * (3 * radius**2 + length**2) / 12
        moments = (along, across, across) if j in (1, 2) else (across, across, along)
        inertia = " ".join(f'{name}="{value}"' for name, value in zip(("ixx", "iyy", "izz"), moments, strict=True))
        text += f'<link name="l{j + 1}"><inertial><origin xyz="{CENTRES[j]}" rpy="0.2 -0.1 {0.3 * j}"/>'
        text += f'<mass value="{mass}"/><inertia {inertia} ixy="0" ixz="0" iyz="0"/></inertial></link>'
        parent, kind = f"l{j}" if j else "base", (kinds or {}).get(j + 1, "revolute")
        text += f'<joint name="j{j + 1}" type="{kind}"><parent link="{parent}"/><child link="l{j + 1}"/>'
        text += f'<origin xyz="{OFFSETS[j]}" rpy="{TURNS[j]}"/><axis xyz="0 0 1"/>'
        text += f'<limit lower="-3" upper="3" velocity="3" effort="{EFFORTS[j]}"/><dynamics damping="0.{j}"/></joint>'
    text += '<link name="tool0"/><joint name="flange" type="fixed"><parent link="l6"/><child link="tool0"/>'
    path = folder / f"arm{len(kinds or ())}.urdf"
    path.write_text(text + '<origin xyz="0 0 0.0996" rpy="0 0 0"/></joint></robot>')
    return path


def rig(folder: Path, kinds: Mapping[int, str] | None = None, **others: Any) -> Rig:
    robot = {"urdf": str(urdf(folder, kinds)), "sensor_frame": "tool0", "tip_length": TIP}
    limits = LIMITS | {"torque": ALLOWED} | others.pop("limits", {})
    return Rig.from_data({"robot": robot | others.pop("robot", {}), "limits": limits, "body": [PAYLOAD]} | others)


def torques(of: Rig) -> JointTorques:
    assert of.limits is not None
    asked = joint_torques(of.limits, of.arm)
    assert asked is not None
    return asked


def reference(of: Rig, carried: bool = True) -> Any:
    """Pinocchio's model of the arm, with the payload."""
    model = pinocchio.buildModelFromUrdf(of.urdf)
    model.gravity.linear = -of.gravity * np.array([0, 0, 1])
    if carried:
        tool = model.frames[model.getFrameId("tool0")].placement
        load = pinocchio.Inertia(1.5, np.array(PAYLOAD["centre"]), np.diag([0.004, 0.005, 0.002]))
        model.appendBodyToJoint(6, load, tool)
    return model


def some_motion(count: int) -> tuple[Array, Array, Array]:
    q, dq, ddq = np.random.default_rng(0).standard_normal((3, count, 6))
    return q, 2 * dq, 5 * ddq


@pytest.mark.parametrize("kinds", [{}, {3: "prismatic"}, {1: "prismatic", 6: "prismatic"}])
def test_torques_and_their_slopes_are_pinocchios(tmp_path: Path, kinds: dict[int, str]) -> None:
    of = rig(tmp_path, kinds, robot={"gravity": 9.7})
    q, dq, ddq = some_motion(5)
    model, damping = reference(of), 0.1 * np.arange(6)
    data = model.createData()
    asked = torques(of)
    expected = [pinocchio.rnea(model, data, *state) + damping * state[1] for state in zip(q, dq, ddq, strict=True)]
    np.testing.assert_allclose(asked.values(q, dq, ddq), expected, atol=1e-10)
    slopes = asked.slopes(q, dq, ddq)
    for state, slope in zip(zip(q, dq, ddq, strict=True), slopes, strict=True):
        pinocchio.computeRNEADerivatives(model, data, *state)
        mass = np.triu(data.M) + np.triu(data.M, 1).T
        by_velocity = data.dtau_dv + np.diag(damping)
        np.testing.assert_allclose(slope, np.hstack([data.dtau_dq, by_velocity, mass]), atol=1e-10)


def test_a_tilted_base_is_pinocchios_with_gravity_tilted(tmp_path: Path) -> None:
    direction = np.array([0.3, -0.5, -0.8]) / np.linalg.norm([0.3, -0.5, -0.8])
    of = rig(tmp_path, robot={"gravity_direction": direction.tolist()})
    model = reference(of)
    model.gravity.linear = of.gravity * direction
    q, dq, ddq = some_motion(3)
    expected = [pinocchio.rnea(model, model.createData(), *state) for state in zip(q, dq, ddq, strict=True)]
    np.testing.assert_allclose(torques(of).values(q, dq, ddq) - 0.1 * np.arange(6) * dq, expected, atol=1e-10)


def test_what_hangs_on_a_link_moves_with_it(tmp_path: Path) -> None:
    """A gripper beyond the sensor, its finger at coordinate zero: as Pinocchio's whole model, that joint still."""
    text = (URDF / "elbow.urdf").read_text()
    own = '<inertial><origin xyz="0.1 0.02 0" rpy="0.3 0 0"/><mass value="0.7"/>'
    own += '<inertia ixx="0.02" ixy="0.001" ixz="0" iyy="0.03" iyz="0.002" izz="0.025"/></inertial>'
    for link in ("base", "wrist", "tool0", "finger"):
        text = text.replace(f'<link name="{link}"/>', f'<link name="{link}">{own}</link>')
    path = tmp_path / "elbow.urdf"
    path.write_text(text)
    assert len(drive_data(path, "tool0").bodies) == 4  # the base's is moved by no joint
    data = {"robot": {"urdf": str(path), "sensor_frame": "tool0"}, "limits": LIMITS | {"torque": "urdf"}}
    of, model = Rig.from_data(data), pinocchio.buildModelFromUrdf(str(path))
    model.gravity.linear = np.array([0, 0, -9.806])
    for q, dq, ddq in zip(*some_motion(3), strict=True):
        still = np.zeros(model.nv - 6)
        expected = pinocchio.rnea(model, model.createData(), *(np.append(x, still) for x in (q, dq, ddq)))
        np.testing.assert_allclose(torques(of).values(q[None], dq[None], ddq[None])[0], expected[:6], atol=1e-10)
    assert torques(of).limits.allowed[0].tolist() == [-100.0, 100.0]


SERIES: dict[str, TrajectorySeries] = {
    "free": FREE,
    "rest": RestToRest(inner=FREE, ramp=1.0),
    "spline": SplineSeries(joints=6, knots=12, degree=3, period=8.0),
}


@pytest.mark.parametrize("name", SERIES)
@pytest.mark.parametrize("kinds", [{}, {3: "prismatic"}])
def test_the_largest_torque_is_a_bound_between_the_samples_and_near(
    tmp_path: Path, name: str, kinds: dict[int, str]
) -> None:
    """The grid of 20 001 misses a peak by far less than what separates the two."""
    of = rig(tmp_path, kinds, limits={"torque": "urdf"}, friction={"coulomb": [1, 2, 0, 0, 0, 3]})
    assert of.limits is not None
    asked = torques(of)
    motion = random_feasible_trajectory(SERIES[name], replace(of.limits, torque=None), seed=3)
    low, high = asked.enclosure(motion)
    dense = asked.values(*motion.evaluate(np.linspace(0.0, 8.0, 20001)))
    friction, margin = np.array([1, 2, 0, 0, 0, 3]), TORQUE_MARGIN * np.ptp(asked.room, axis=1) / 2
    for bound, reached in ((high - friction, dense.max(axis=0)), (-low - friction, -dense.min(axis=0))):
        assert (bound >= reached - 1e-9).all()
        assert (bound <= reached + margin + 1e-6).all()


def test_a_random_motion_keeps_torques_and_the_table_shows_them(tmp_path: Path) -> None:
    of = rig(tmp_path)
    assert of.limits is not None
    motion = random_feasible_trajectory(FREE, of.limits, arm=of.arm, seed=1)
    model = reference(of)
    states = zip(*motion.evaluate(np.linspace(0.0, 8.0, 801)), strict=True)
    reached = np.array(
        [pinocchio.rnea(model, model.createData(), *state) + 0.1 * np.arange(6) * state[1] for state in states]
    )
    assert (np.abs(reached) <= ALLOWED).all()
    use = LimitUse.of(motion, of.limits, arm=of.arm)
    assert use.worst.use <= 1
    assert "torque" in use.to_data()
    row = next(row for row in use.limited_quantities if row.quantity == "torque" and row.name == "q2")
    assert (row.unit, row.limit) == ("N m", (-44.9, 44.9))
    np.testing.assert_allclose([row.low, row.high], [reached[:, 1].min(), reached[:, 1].max()], atol=0.1)


def test_what_is_stored_is_what_was_read(tmp_path: Path) -> None:
    of = rig(tmp_path, friction={"coulomb": [1.0] * 6}, limits={"start": [0.0] * 6, "jerk": [40.0] * 6})
    again = Rig.from_data(of.to_data())
    assert again.to_data() == of.to_data()
    state = some_motion(2)
    np.testing.assert_array_equal(torques(again).values(*state), torques(of).values(*state))
    assert "friction.viscous" in str(of.table)
    assert "N m s" in str(of.table)


@pytest.mark.parametrize(
    ("others", "said"),
    [
        ({"limits": {"torque": [1.0] * 5}}, "as many numbers in each list"),
        ({"limits": {"torque": [-1.0] * 6}}, "torque"),
        ({"limits": {"torque": "none"}}, "limits\\.torque: Input should be 'urdf', got 'none'"),
        ({"limits": {"torque": [1.0] * 5 + ["x"]}}, "limits\\.torque\\[5\\]: expected a positive number"),
        ({"limits": {"torque": None}}, "no.*torque limits|state limits.torque"),
        ({"limits": {"end": [0.0] * 6}}, "no start"),
        ({"body": [PAYLOAD | {"joint": 6}]}, "got both"),
        ({"body": [{"mass": 1.0}]}, "got neither"),
        ({"body": [PAYLOAD | {"link": "base"}]}, "no joint"),
        ({"body": [PAYLOAD | {"link": "hand"}]}, "no link 'hand'"),
        ({"body": [PAYLOAD | {"mass": 0.0}]}, "mass"),
        ({"body": [PAYLOAD | {"inertia": [1.0, 0, 0, 0.1, 0, 0.1]}]}, "Ixx, Ixy"),
        ({"friction": {"viscous": [-1.0] * 6}}, "viscous"),
        ({"friction": {"coulomb": [1.0] * 5}}, "each of 6 joints"),
        ({"robot": {"urdf": None, "sensor_frame": None, "link_lengths": [0.1] * 6}}, "read from a URDF"),
    ],
)
def test_a_wrong_torque_limit_is_one_line(tmp_path: Path, others: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        rig(tmp_path, **others)
    assert "\n" not in str(caught.value)


def test_a_urdf_without_masses_or_efforts_is_named(tmp_path: Path) -> None:
    bare = {"urdf": str(URDF / "slide.urdf"), "sensor_frame": "sensor"}
    count = len(Rig.from_data({"robot": bare}).spatial_arm.chain)  # type: ignore[union-attr]
    limits = {name: [1.0] * count for name in ("position", "velocity", "acceleration", "torque")}
    with pytest.raises(InputError, match="no link that the joints move has a mass"):
        Rig.from_data({"robot": bare, "limits": limits})
    path = urdf(tmp_path)
    path.write_text(path.read_text().replace('effort="28"', 'effort="0"'))
    robot = {"urdf": str(path), "sensor_frame": "tool0"}
    with pytest.raises(InputError, match="no effort of 'j4'"):
        Rig.from_data({"robot": robot, "limits": LIMITS | {"torque": "urdf"}})
    path.write_text(path.read_text().replace('mass value="1.3"', 'mass value="-1.3"'))
    with pytest.raises(InputError, match=r"link 'l5': its mass is -1\.3 kg"):
        Rig.from_data({"robot": robot, "limits": LIMITS | {"torque": ALLOWED}})


def test_an_inertia_that_no_body_has_is_refused_and_a_rounded_one_is_stored(tmp_path: Path) -> None:
    path = urdf(tmp_path)
    data = {"robot": {"urdf": str(path), "sensor_frame": "tool0"}, "limits": LIMITS | {"torque": ALLOWED}}
    text, whole = path.read_text(), re.compile(r'ixx="[\d.]+" iyy="[\d.]+" izz="[\d.]+"')
    path.write_text(whole.sub('ixx="1" iyy="0.02" izz="0.02"', text, count=1))
    with pytest.raises(InputError, match=r"link 'l1': no body has its moments of inertia, ixx 1, ixy 0, .* kg m²"):
        Rig.from_data(data)
    path.write_text(whole.sub('ixx="0.031" iyy="0.015" izz="0.0157"', text, count=1))  # of a plate
    assert Rig.from_data(Rig.from_data(data).to_data()).limits is not None


def test_that_the_tool_of_a_model_is_not_carried_is_said_where_torques_are_limited(tmp_path: Path) -> None:
    of, options = rig(tmp_path), Namespace()
    assert of.limits is not None
    saved: Any = object()
    assert "tool of the model file is not added" in DesignRequest(options, of, saved).not_carried
    assert not DesignRequest(options, of, None).not_carried
    assert not DesignRequest(options, replace(of, limits=replace(of.limits, torque=None)), saved).not_carried


# ------------------------------------------------------------------------- motions that cannot be


@pytest.mark.parametrize(
    ("others", "said"),
    [
        ({"limits": {"torque": [150, [80, 90], 16, 1.9, 1.4, 28]}}, r"low limit of the torque of q2 by \d+(\.\d)? N m"),
        ({"friction": {"coulomb": [0, 50, 0, 0, 0, 0]}}, "friction of q2, 50 N m, is all"),
        (
            {"capsule": [*CAPSULES, {"name": "wall", "start": [0, 0, 0], "end": [0, 0, 1.0], "radius": 0.7}]},
            "low limit of the clearance of .* by 0.* m",
        ),
        ({"workspace": {"z": [1.4, 1.5]}}, "low limit of the workspace of z by .* m"),
    ],
)
def test_a_limit_that_no_posture_keeps_is_named_with_the_excess(
    tmp_path: Path, others: dict[str, Any], said: str
) -> None:
    with pytest.raises(InputError, match=said) as caught:
        design(rig(tmp_path, **others), series=FREE, samples=40, starts=1, bounded=False)
    assert "\n" not in str(caught.value)


def test_a_posture_that_hardly_any_random_one_has_is_found(tmp_path: Path) -> None:
    """A third of the torques: one random posture in 7000 is within all limits."""
    of = rig(tmp_path, limits={"torque": [150, 15, 5.47, 0.627, 0.473, 28]}, capsule=CAPSULES, half_space=[FLOOR])
    assert of.limits is not None
    for seed in range(2):
        motion = random_feasible_trajectory(SLOW, of.limits, workspace=of.workspace, arm=of.arm, seed=seed)
        assert LimitUse.of(motion, of.limits, of.workspace, of.arm).worst.use <= 1


UP = [0.0, -1.5, 0.9, -1.3, -1.5, 0.0]
RAMPED = RestToRest(inner=FREE, ramp=1.0)


@pytest.mark.parametrize(
    ("limits", "series", "said"),
    [
        ({"start": [3.0, *UP[1:]]}, RAMPED, "limits.start is beyond the high limit of the position of q1 by 1 rad"),
        ({"start": [0, -0.7, 0.5, 0, -1, 0]}, RAMPED, r"limits.start is beyond the .* limit of the torque of q\d by"),
        ({"start": UP, "end": [*UP[:5], -2.9]}, RAMPED, "limits.end is beyond the low limit of the position of q6"),
        ({"start": UP, "end": [1.9, *UP[1:]], "jerk": [0.1] * 6}, RAMPED, "the way from .* limit of the jerk of q1"),
        ({"start": UP}, FREE, "no motion of this series starts at rest"),
        ({"jerk": [1e-9] * 6}, FREE, "within its jerk limits"),
    ],
)
def test_a_pose_or_a_way_beyond_a_limit_is_named(
    tmp_path: Path, limits: dict[str, Any], series: TrajectorySeries, said: str
) -> None:
    generous = {"torque": [150, 70, 35, 6, 5, 28]} if "torque" not in said else {}
    of = rig(tmp_path, limits=generous | limits)
    with pytest.raises(InputError, match=said) as caught:
        design(of, series=series, samples=40, starts=1, bounded=False)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("end", [None, (0.5, -0.4, 0.6)])
def test_a_motion_starts_and_ends_at_rest_at_the_stated_poses(end: tuple[float, ...] | None) -> None:
    """Planar, with exact second derivatives; its limits on a dense grid, and better than random ones."""
    start, one = [0.3, 0.2, -0.4], {"position": [1.05, 1.22, 1.4], "velocity": [2.0] * 3, "acceleration": [10.0] * 3}
    limits = one | {"start": start} | ({"end": list(end)} if end else {})
    of = Rig.from_data({"robot": {"link_lengths": [1.0, 0.97, 0.4]}, "limits": limits})
    series = RestToRest(inner=FreeSeries(joints=3, harmonics=(1, 2), period=4.0), ramp=0.5)
    plan = design(of, series=series, samples=50, starts=1, bounded=end is not None)
    for time, pose in ((0.0, start), (4.0, end or start)):
        q, dq, ddq = plan.motion.evaluate([time])
        np.testing.assert_allclose(q[0], pose, atol=1e-12)
        np.testing.assert_allclose([dq[0], ddq[0], plan.motion.derivative([time], 3)[0]], 0.0, atol=1e-9)
    dense = np.linspace(0.0, 4.0, 4001)
    for order, limit in enumerate(one.values()):
        assert (np.abs(plan.motion.derivative(dense, order)) <= np.array(limit) + 1e-9).all()
    random = [plan.task.random((5, n)) for n in range(4)]
    assert plan.logdet > max(plan.task.objective.value(motion.coefficients) for motion in random) + 1
    assert plan.bound is None
    assert ("ends elsewhere" in plan.no_bound_reason) == (end is not None)


def test_a_series_between_poses_is_enclosed_and_projected() -> None:
    inner = FreeSeries(joints=2, harmonics=(1, 2), period=3.0)
    series = RestToRest(inner=inner, ramp=0.5, start=(0.2, -0.1), end=(1.0, 0.4))
    rng = np.random.default_rng(0)
    z = series.rest([9.0, 9.0])
    z[series.adjustable] = rng.standard_normal(series.adjustable.sum())
    dense = np.linspace(0.0, 3.0, 20001)
    for order in range(6):
        values = series.evaluate(z, dense, order)
        low, high = series.enclosure(z, order)
        assert (low <= values.min(axis=0) + 1e-9).all()
        assert (high >= values.max(axis=0) - 1e-9).all()
        if order:
            slope = np.gradient(series.evaluate(z, dense, order - 1), dense, axis=0)
            inside = (dense > 0.6) & (dense < 2.4)
            np.testing.assert_allclose(values[inside], slope[inside], atol=1e-4 * np.abs(values).max())
    from_free = FreeSeries(joints=2, harmonics=(1,), period=3.0)
    nearest = random_feasible_trajectory(from_free, limits_of_two(), seed=0).projected(series)
    np.testing.assert_allclose(nearest.evaluate([0.0, 3.0])[0], [[0.2, -0.1], [1.0, 0.4]], atol=1e-12)


def limits_of_two() -> Any:
    limits = {name: [2.0, 2.0] for name in ("position", "velocity", "acceleration")}
    return Rig.from_data({"robot": {"link_lengths": [1.0, 1.0]}, "limits": limits}).limits


# ----------------------------------------------------------------------------------------- designs


def smallest_distances(of: Rig, positions: Array) -> tuple[Array, Array]:
    """By Pinocchio's frames (N, ..): distances of capsules less their radii, and of their ends from the floor."""
    model, names = reference(of), [str(c.get("link", "base")) for c in CAPSULES]
    data, frames = model.createData(), [model.getFrameId(name) for name in names]
    poses = np.empty((len(positions), len(CAPSULES), 3, 4))
    for row, q in enumerate(positions):
        pinocchio.framesForwardKinematics(model, data, q)
        poses[row] = [np.c_[data.oMf[f].rotation, data.oMf[f].translation] for f in frames]
    ends = np.array([[c["start"], c["end"]] for c in CAPSULES], dtype=float)
    points = np.einsum("ncij,cej->ncei", poses[..., :3], ends) + poses[:, :, None, :, 3]
    radius, distances, share = np.array([c["radius"] for c in CAPSULES], dtype=float), [], np.linspace(0, 1, 41)
    for i in range(len(CAPSULES)):
        for j in range(i + 2, len(CAPSULES)):
            along = points[:, i, :1] + share[:, None] * (points[:, i, 1:] - points[:, i, :1])
            beside = points[:, j, 1] - points[:, j, 0]
            t = np.einsum("nsi,ni->ns", along - points[:, j, :1], beside) / (beside**2).sum(axis=1)[:, None]
            nearest = points[:, j, :1] + np.clip(t, 0, 1)[..., None] * beside[:, None]
            distances.append(np.linalg.norm(along - nearest, axis=2).min(axis=1) - radius[i] - radius[j])
    floor = points[:, 1:, :, 2] - radius[1:, None]
    return np.array(distances).T, floor.reshape(len(positions), -1)


@pytest.mark.long(9)
@pytest.mark.parametrize(("seed", "rests"), [(0, False), (7, True)])
def test_a_loaded_arm_keeps_every_limit_at_every_instant(tmp_path: Path, seed: int, rests: bool) -> None:
    """By Pinocchio at 20 001 instants. Of random postures one in twenty is within torques, clearances and height."""
    others: dict[str, Any] = {"capsule": CAPSULES, "half_space": [FLOOR], "workspace": {"z": list(HEIGHT)}}
    of, posture = rig(tmp_path, limits={"jerk": [25.0] * 6}, **others), np.zeros(6)
    if rests:
        assert of.limits is not None
        about = random_feasible_trajectory(FREE, of.limits, workspace=of.workspace, arm=of.arm, tip_length=TIP, seed=1)
        posture = about.derivative(FREE.instants(40), 0).mean(axis=0)
        of = rig(tmp_path, limits={"jerk": [25.0] * 6, "start": posture.tolist()}, **others)
    assert of.limits is not None
    series = RestToRest(inner=SLOW, ramp=1.0) if rests else SLOW
    plan = design(of, series=series, samples=60, starts=1, seed=seed, bounded=False)
    time = np.linspace(0.0, 8.0, 20001)
    q, dq, ddq = plan.motion.evaluate(time)
    if rests:
        np.testing.assert_allclose(q[[0, -1]], [posture, posture], atol=1e-12)
        np.testing.assert_allclose([dq[[0, -1]], ddq[[0, -1]]], 0.0, atol=1e-9)
    step = time[1] - time[0]
    jerk = np.diff(ddq, axis=0) / step
    for values, limits in ((q, of.limits.position), (dq, of.limits.velocity), (ddq, of.limits.acceleration)):
        assert (values >= limits[:, 0] - 1e-9).all()
        assert (values <= limits[:, 1] + 1e-9).all()
    assert np.abs(jerk).max() <= 25.0 + 1e-6
    model = reference(of)
    data = model.createData()
    reached = np.array([pinocchio.rnea(model, data, *state) for state in zip(q, dq, ddq, strict=True)])
    use = np.abs(reached + 0.1 * np.arange(6) * dq) / ALLOWED
    assert 0.98 < use.max() <= 1
    distances, floor = smallest_distances(of, q)
    assert distances.min() > 0
    assert floor.min() > 0.02
    random = [plan.task.random((9, number)) for number in range(3)]
    assert plan.logdet > max(plan.task.objective.value(motion.coefficients) for motion in random) + 5


def test_the_way_between_poses_is_checked_before_a_design(tmp_path: Path) -> None:
    of = rig(tmp_path, limits={"start": UP, "end": UP, "torque": [150, 70, 35, 6, 5, 28]})
    series = between_poses(RAMPED, of)
    assert isinstance(series, RestToRest)
    assert series.travel is None
    assert series.start == tuple(UP)
