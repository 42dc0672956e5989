"""The planar arm against finite differences, against MuJoCo, and against the chapter's 22.2 to 22.4."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import sympy as sp
from numpy.typing import NDArray

from modeling.kinematics.arm import POSE_SIGNALS, PlanarArm, forward_kinematics, joint_symbols

Array = NDArray[np.float64]
States = tuple[Array, Array, Array]

LENGTH, RATE, ACCELERATION = 1.5, 2.0, 10.0  # largest of a link (m) and of a joint (rad/s, rad/s²) in these tests


@pytest.fixture(scope="module", params=range(1, 6), ids=lambda joints: f"{joints} joints")
def case(request: pytest.FixtureRequest) -> tuple[PlanarArm, States]:
    """An arm of 1 to 5 joints and 100 random states of it."""
    rng = np.random.default_rng(request.param)
    q, dq, ddq = (rng.uniform(-limit, limit, (100, request.param)) for limit in (np.pi, RATE, ACCELERATION))
    return PlanarArm(tuple(map(float, rng.uniform(0.1, LENGTH, request.param)))), (q, dq, ddq)


def test_velocities_and_accelerations_are_time_derivatives(case: tuple[PlanarArm, States]) -> None:
    arm, (q, dq, ddq) = case
    h = 1e-5

    def at(t: float) -> dict[str, Array]:
        return arm.pose(q + dq * t + ddq * t**2 / 2, dq + ddq * t, ddq)

    now, ahead, behind = at(0.0), at(h), at(-h)
    # A central difference errs by h²/6 of the third derivative, at most l (w³ + 3 w a) = 2e4 m/s³ of a position and
    # l (w⁴ + 6 w² a + 3 a²) = 4e5 m/s⁴ of a velocity with w = 10 rad/s, a = 50 rad/s², l = 7.5 m; by 1e-9 of rounding.
    for value, rate, error in (("px", "vx", 1e-6), ("py", "vy", 1e-6), ("vx", "ax", 1e-5), ("vy", "ay", 1e-5)):
        np.testing.assert_allclose((ahead[value] - behind[value]) / (2 * h), now[rate], atol=error)
    for value, rate in (("phi", "dphi"), ("dphi", "ddphi")):
        np.testing.assert_allclose((ahead[value] - behind[value]) / (2 * h), now[rate], atol=1e-8)  # quadratic in t


def mujoco_pose(lengths: tuple[float, ...], states: States) -> dict[str, Array]:
    """Pose signals by MuJoCo: hinges about +y, x right and z up, no gravity so that accelerations are kinematic."""
    inertial = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
    starts = (0.0, *lengths[:-1])
    chain = "".join(f'<body pos="0 0 {start!r}"><joint type="hinge" axis="0 1 0"/>{inertial}' for start in starts)
    kinds = ("framepos", "framelinvel", "framelinacc", "framexaxis", "frameangvel", "frameangacc")
    sensors = "".join(f'<{kind} objtype="site" objname="s"/>' for kind in kinds)
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian"/><option gravity="0 0 0"/><worldbody>{chain}'
        f'<site name="s" pos="0 0 {lengths[-1]!r}"/>{"</body>" * len(lengths)}</worldbody>'
        f"<sensor>{sensors}</sensor></mujoco>"
    )
    data = mujoco.MjData(model)
    rows = []
    for q, dq, ddq in zip(*states, strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = q, dq, ddq
        mujoco.mj_inverse(model, data)
        rows.append(data.sensordata.copy())
    position, velocity, acceleration, x_axis, spin, spin_rate = np.array(rows).reshape(-1, 6, 3).transpose(1, 0, 2)
    return {
        "phi": np.arctan2(-x_axis[:, 2], x_axis[:, 0]),
        "dphi": spin[:, 1],
        "ddphi": spin_rate[:, 1],
        "px": position[:, 0],
        "py": position[:, 2],
        "vx": velocity[:, 0],
        "vy": velocity[:, 2],
        "ax": acceleration[:, 0],
        "ay": acceleration[:, 2],
    }


def test_pose_is_mujocos(case: tuple[PlanarArm, States]) -> None:
    arm, states = case
    pose, reference = arm.pose(*states), mujoco_pose(arm.link_lengths, states)
    assert set(pose) == set(reference) == set(POSE_SIGNALS)
    turns = (pose.pop("phi") - reference.pop("phi")) / (2 * np.pi)
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-13)  # MuJoCo's angle is known up to whole turns
    for name, values in pose.items():
        np.testing.assert_allclose(values, reference[name], atol=1e-11)  # rounding of numbers up to 1000


def moving(expression: sp.Expr, joints: int) -> sp.Expr:
    """Time derivative of an expression in q and dq, by the chain rule."""
    q, dq, ddq = (joint_symbols(joints, prefix) for prefix in ("q", "dq", "ddq"))
    rates = zip((*q, *dq), (*dq, *ddq), strict=True)
    return sum((expression.diff(symbol) * rate for symbol, rate in rates), sp.S.Zero)


@pytest.mark.parametrize("joints", range(1, 6))
def test_sensor_origin_is_22_2(joints: int) -> None:
    lengths = sp.symbols(f"l1:{joints + 1}", positive=True)
    pose = forward_kinematics(lengths)
    q = joint_symbols(joints, "q")
    for name, function in (("px", sp.sin), ("py", sp.cos)):
        printed = sum(length * function(sum(q[: k + 1])) for k, length in enumerate(lengths))
        assert sp.expand(pose[name] - printed) == 0
    assert sp.expand(pose["phi"] - sum(q)) == 0
    for value, rate in (("px", "vx"), ("py", "vy"), ("vx", "ax"), ("vy", "ay"), ("phi", "dphi"), ("dphi", "ddphi")):
        assert sp.expand(moving(pose[value], joints) - pose[rate]) == 0


def test_acceleration_of_the_centre_of_mass_is_22_4_as_printed() -> None:
    joints = 3
    pose = forward_kinematics(sp.symbols(f"l1:{joints + 1}", positive=True))
    l_g, phi, dphi, ddphi = sp.Symbol("l_g"), pose["phi"], pose["dphi"], pose["ddphi"]
    centre = (pose["px"] + l_g * sp.sin(phi), pose["py"] + l_g * sp.cos(phi))  # 22.3
    derived = [moving(moving(component, joints), joints) for component in centre]
    printed = [
        pose["ax"] + l_g * (-(dphi**2) * sp.sin(phi) + ddphi * sp.cos(phi)),
        pose["ay"] + l_g * (-(dphi**2) * sp.cos(phi) - ddphi * sp.sin(phi)),
    ]
    assert [sp.expand(d - p) for d, p in zip(derived, printed, strict=True)] == [0, 0]


def test_pose_of_a_symbolic_arm_is_that_of_numbers() -> None:
    lengths = (1.0, 0.97, 0.4)
    symbols = sp.symbols("l1:4", positive=True)
    rng = np.random.default_rng(0)
    states = [rng.uniform(-2, 2, 3) for _ in range(3)]
    names = [s for prefix in ("q", "dq", "ddq") for s in joint_symbols(3, prefix)]
    values = dict(zip(symbols, lengths, strict=True)) | dict(zip(names, np.concatenate(states), strict=True))
    pose = PlanarArm(lengths).pose(*(s[None] for s in states))
    for name, expression in forward_kinematics(symbols).items():
        assert pose[name][0] == pytest.approx(float(expression.subs(values)), rel=1e-12, abs=1e-12)  # rounding
