"""Joints and a tip that give way in the simulated rig, against physics by hand and against MuJoCo by another route."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from design.trajectories.fourier import fourier_trajectory
from design.trajectories.trajectory import Trajectory
from truewrench.simulated_rig import (
    Array,
    CableSpring,
    CommandedMotion,
    ContactEvent,
    JointBacklash,
    JointDeflection,
    JointElasticity,
    JointOffset,
    PayloadChange,
    PlanarRig,
    Scene,
    SimulatedRig,
    SpatialRig,
    TipFlexibility,
    ViscousDrag,
    rigid_tool_wrench,
    simulate,
    static_poses,
    true_wrench,
    weight_torques,
)
from truewrench.simulated_rig.mujoco_scene import States

pytest.importorskip("mujoco")

G = 9.806
PLANAR = PlanarRig(bias=(0.0, 0.0, 0.0), noise=(0.0, 0.0, 0.0), resolver_step=1e-12)
SPATIAL = SpatialRig(bias=(0.0,) * 6, noise=(0.0,) * 6, resolver_step=1e-12, position_step=1e-12)
PENDULUM = replace(PLANAR, link_lengths=(0.7,))
KNOCKING = JointBacklash(width=(0.01, 0.01, 0.01), torque_scale=2.0, speed_scale=0.5, knocks=True)


def still(*q: float) -> States:
    states = np.array([q], dtype=float)
    return states, np.zeros_like(states), np.zeros_like(states)


def over_a_period(rig: SimulatedRig, samples: int = 2000, seed: int = 1) -> tuple[Trajectory, CommandedMotion]:
    motion = rig.random_motion(seed=seed)
    time = np.arange(samples) * motion.period / samples
    return motion, CommandedMotion.along(motion, time, whole_period=True)


# ------------------------------------------------------------------------------------------- joints


def torques_of_massless_links(scene: Scene, q: Array) -> Array:
    """What MuJoCo's drives hold at rest when the links weigh nothing."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(scene.xml(()))
    for link in range(len(scene.links)):
        model.body_mass[mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, f"link{link}")] = 0.0
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_inverse(model, data)
    return np.array(data.qfrc_inverse)


def test_torque_of_the_weight_is_what_the_drives_hold_for_the_tool_alone() -> None:
    scene = PayloadChange(mass=0.3, d=0.2).changed(JointOffset(joint=2, offset=0.1).changed(PLANAR.scene))
    q = PLANAR.random_poses(5, np.random.default_rng(0))
    held = np.array([torques_of_massless_links(scene, pose + scene.joint_offsets) for pose in q])
    torque = weight_torques(scene, (q, np.zeros_like(q), np.zeros_like(q)))[0]
    np.testing.assert_allclose(torque, -held, atol=1e-13)  # rounding of numbers of order 20


def test_soft_joint_rests_where_its_spring_holds_the_tool() -> None:
    compliance, q = 0.02, 0.9
    scene, drive = PENDULUM.scene, CommandedMotion.resting(np.array([[q]]), np.zeros(1))
    found = JointElasticity(compliance=(compliance,)).moved(scene, drive, drive.states)
    moment = 0.7 * PENDULUM.mass + PENDULUM.mlg
    angle = brentq(lambda x: x - q - compliance * moment * G * np.sin(x), q, q + 1, xtol=1e-15)
    assert found[0][0, 0] == pytest.approx(angle, abs=1e-13)
    assert angle - q > 0.1  # a clockwise lean falls further clockwise
    (wrench,) = true_wrench(PENDULUM, (JointElasticity(compliance=(compliance,)),), drive)
    assert wrench[2] == pytest.approx(-PENDULUM.mlg * G * np.sin(angle), abs=1e-12)


def test_joint_that_cannot_hold_the_tool_is_refused() -> None:
    drive = CommandedMotion.resting(np.array([[0.9]]), np.zeros(1))
    with pytest.raises(ValueError, match="no static equilibrium"):
        JointElasticity(compliance=(1.0,)).moved(PENDULUM.scene, drive, drive.states)
    with pytest.raises(ValueError, match="each of 1 joints"):
        JointElasticity().moved(PENDULUM.scene, drive, drive.states)


@pytest.mark.parametrize(
    "shift",
    [JointElasticity(), KNOCKING, replace(KNOCKING, taken_up="motion")],
    ids=["elasticity", "backlash by load", "backlash by motion"],
)
def test_rates_and_accelerations_are_those_of_the_angles(shift: JointDeflection) -> None:
    motion = PLANAR.random_motion(seed=3)
    time, step = np.linspace(0.0, motion.period, 30), 1e-4

    def moved(at: Array) -> States:
        drive = CommandedMotion.along(motion, at)
        return shift.moved(PLANAR.scene, drive, drive.states)

    (before, slow, _), (here, rate, acceleration), (after, fast, _) = (moved(time + k * step) for k in (-1, 0, 1))
    assert np.abs(here - motion.evaluate(time)[0]).max() > 4e-3
    # Central differences leave h²/6 of the third derivative: at most 0.005 rad over (10 ms)³ here. Rounding is less.
    np.testing.assert_allclose(rate, (after - before) / (2 * step), atol=2e-5)
    np.testing.assert_allclose(acceleration, (fast - slow) / (2 * step), atol=5e-3)


def test_joint_with_play_lies_where_the_weight_pulls_it() -> None:
    width = (0.02, 0.03, 0.01)
    poses = np.array([[0.5, 0.5, 0.5], [-0.5, -0.5, -0.5], [0.5, -0.4, -1.0]])
    expected = poses + np.array(width) / 2 * np.array([[1, 1, 1], [-1, -1, -1], [1, -1, -1]])
    played, at_the_ends = (
        static_poses(PLANAR, q, hidden=hidden)[["fx", "fy", "tau"]].to_numpy()
        for q, hidden in ((poses, (JointBacklash(width=width),)), (expected, ()))
    )
    np.testing.assert_allclose(played, at_the_ends, atol=1e-11)  # resolver steps of 1e-12 rad on 9 N


def test_play_taken_up_by_the_motion_stays_behind_it() -> None:
    drive = over_a_period(PLANAR)[1]
    shift = JointBacklash(width=(0.02,) * 3, taken_up="motion")
    behind = shift.moved(PLANAR.scene, drive, drive.states)[0] - drive.states[0]
    going = np.abs(drive.states[1]) > 0.2  # ten times the scale: tanh is 1 to 5e-9
    np.testing.assert_allclose(behind[going], -0.01 * np.sign(drive.states[1][going]), atol=1e-9)


def test_play_without_knocks_leaves_the_rates_alone() -> None:
    drive = over_a_period(PLANAR)[1]
    _, rate, acceleration = JointBacklash().moved(PLANAR.scene, drive, drive.states)
    np.testing.assert_array_equal(rate, drive.states[1])
    np.testing.assert_array_equal(acceleration, drive.states[2])


def test_play_is_in_front_of_the_soft_joint_and_an_offset_in_front_of_both() -> None:
    """Composed by hand: the gear's end, then the spring on it."""
    drive = CommandedMotion.resting(np.array([[0.3]]), np.zeros(1))
    play, soft = JointBacklash(width=(0.1,)), JointElasticity(compliance=(0.01,))
    both = true_wrench(PENDULUM, (soft, play), drive)
    end = CommandedMotion.resting(np.array([[0.35]]), np.zeros(1))
    np.testing.assert_allclose(both, true_wrench(PENDULUM, (soft,), end), atol=1e-12)
    shifted = true_wrench(PENDULUM, (soft, JointOffset(joint=1, offset=0.05)), drive)
    np.testing.assert_allclose(shifted, both, atol=1e-12)


# ---------------------------------------------------------------------------------------------- tip


def test_tip_at_rest_hangs_where_the_spring_holds_it() -> None:
    rig, tip, lean = PENDULUM, TipFlexibility(stiffness=3.0), 0.6
    frame = static_poses(rig, np.array([[lean]]), hidden=(tip,))
    bend = brentq(lambda x: 3.0 * x - rig.mlg * G * np.sin(lean + x), 0.0, 1.0, xtol=1e-15)
    assert bend > 0.1
    # The sensor stays with the robot: weight in its own axes, torque of the tool where it hangs.
    assert frame["tau"][0] == pytest.approx(-3.0 * bend, abs=1e-11)
    assert frame["fx"][0] == pytest.approx(-rig.mass * G * np.sin(lean), abs=1e-11)
    assert frame["fy"][0] == pytest.approx(-rig.mass * G * np.cos(lean), abs=1e-11)


def test_shaken_tip_answers_like_a_second_order_system() -> None:
    """In space, without weight, so little that nothing but the linear terms is left."""
    tip, rig = TipFlexibility(stiffness=4.0, damping=0.03), replace(SPATIAL, gravity=0.0)
    sine = np.zeros((6, 6))
    sine[0, -1] = 1e-6  # m: turns of 1e-6 rad, whose squares are 1e-12
    motion = fourier_trajectory(offset=np.zeros(6), sine=sine, cosine=np.zeros_like(sine), period=2.0)
    frame = simulate(rig, motion, hidden=(tip,), repeats=1, samples_per_period=400)
    found = np.fft.rfft(frame[["fx", "fy", "fz", "tx", "ty", "tz"]], axis=0)[6] / 200
    s = 2j * np.pi * 6 / motion.period
    push = 1e-6 * s**2 * -1j  # acceleration along x, as a phasor of the cosine
    inertia, moment = rig.scene.inertia, rig.scene.first_moment
    needed = np.cross(moment, [push, 0, 0])  # torque for the tool to stay straight
    bend = np.linalg.solve(inertia * s**2 + (4.0 + 0.03 * s) * np.eye(3), -needed)
    force = rig.mass * np.array([push, 0, 0]) + np.cross(s**2 * bend, moment)
    expected = np.concatenate([force, -(4.0 + 0.03 * s) * bend])
    np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())


def swing(scene: Scene, motion: Trajectory, tip: TipFlexibility) -> Callable[[float, Array], Array]:
    """dy/dt of the tip's y = (quaternion, rate) by MuJoCo's mass matrix and bias in joint space."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(scene.xml(()))
    data = mujoco.MjData(model)
    mass = np.zeros((3, model.nv))

    def forward(time: float, y: Array) -> Array:
        q, dq, ddq = (part[0] for part in motion.evaluate(np.array([time])))
        quaternion, spin = y[:4] / np.linalg.norm(y[:4]), y[4:]
        data.qpos[:], data.qvel[:] = np.append(q, quaternion), np.append(dq, spin)
        data.qacc[:] = np.append(ddq, np.zeros(3))
        mujoco.mj_inverse(model, data)
        for row, unit in zip(mass, np.eye(model.nv)[-3:], strict=True):
            mujoco.mj_mulM(model, data, row, unit)
        bend = Rotation.from_quat(quaternion, scalar_first=True).as_rotvec()
        torque = -tip.stiffness * bend - tip.damping * spin - data.qfrc_inverse[-3:]
        rate = np.empty(4)
        mujoco.mju_mulQuat(rate, quaternion, np.append(0.0, spin / 2))
        return np.append(rate, np.linalg.solve(mass[:, -3:], torque))

    return forward


@pytest.mark.parametrize("rig", [PLANAR, SPATIAL], ids=["planar", "spatial"])
def test_periodic_swing_is_a_motion_of_mujocos_forward_dynamics(rig: SimulatedRig) -> None:
    """Another route to the same motion: joint-space dynamics, stepped in time from the first instant on."""
    tip, (motion, drive) = TipFlexibility(stiffness=10.0, damping=0.1), over_a_period(rig)
    scene = tip.changed(rig.scene)
    states = tip.settled(scene, drive, drive.states, lambda s: rigid_tool_wrench(scene, (), drive.time, s))
    start, end = (np.append(states[0][i, -4:], states[1][i, -3:]) for i in (0, 200))
    assert np.abs(states[0][:, -3:]).max() > 0.03
    solution = solve_ivp(
        swing(scene, motion, tip), (0.0, drive.time[200]), start, method="DOP853", rtol=1e-11, atol=1e-12
    )
    # The solver's tolerance, gathered over half a second, some 100 steps, on rates of 1 rad/s.
    np.testing.assert_allclose(solution.y[:, -1], end, atol=1e-8)


def test_grid_of_the_swing_is_fine_enough() -> None:
    motion = PLANAR.random_motion(seed=1)
    coarse, fine = (
        simulate(PLANAR, motion, hidden=(TipFlexibility(),), repeats=1, samples_per_period=samples)
        for samples in (100, 4000)
    )
    # 2000 points against 4000; what rounding leaves of accelerations at 400 Hz
    np.testing.assert_allclose(coarse[["fx", "fy", "tau"]], fine[["fx", "fy", "tau"]][::40], atol=1e-9)


def test_swinging_tip_feels_drag_and_tether() -> None:
    """A stiff tip is a rigid one, loads included."""
    motion, loads = SPATIAL.random_motion(seed=1), (ViscousDrag(), CableSpring())
    rigid, stiff = (
        simulate(SPATIAL, motion, hidden=hidden, repeats=1, samples_per_period=500).iloc[:, 9:15].to_numpy()
        for hidden in (loads, (*loads, TipFlexibility(stiffness=1e6, damping=1e3)))
    )
    # It bends by 1 N m / 1e6 N m/rad, and feels it in 1e-5 of what it weighs.
    np.testing.assert_allclose(stiff, rigid, atol=1e-4)


@pytest.mark.parametrize("other", [ContactEvent(), PayloadChange(), TipFlexibility()], ids=lambda e: e.id)
def test_swinging_tip_is_refused_with_what_is_not_periodic(other: ContactEvent) -> None:
    with pytest.raises(ValueError, match="hide one of them"):
        simulate(PLANAR, PLANAR.random_motion(), hidden=(TipFlexibility(), other))


def test_spring_that_cannot_hold_the_tool_is_refused() -> None:
    with pytest.raises(ValueError, match="stiffness"):
        static_poses(PENDULUM, np.array([[0.0], [1.5]]), hidden=(TipFlexibility(stiffness=0.1),))
