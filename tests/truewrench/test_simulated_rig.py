"""The simulated rig against physics simple enough to write down by hand; nothing comes from `modeling`."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from design.trajectories.fourier import fourier_trajectory
from design.trajectories.trajectory import Trajectory
from truewrench.simulated_rig import (
    HIDDEN_EFFECTS,
    NOISE_MODELS,
    Array,
    BaseForce,
    BiasDrift,
    CableSpring,
    CentreOfMassOffset,
    ContactEvent,
    CoulombFriction,
    GravityTilt,
    HiddenEffect,
    MagnusForce,
    PayloadChange,
    PlanarRig,
    QuadraticDrag,
    Saturation,
    SensorCrosstalk,
    SensorEffect,
    SensorHysteresis,
    SensorLag,
    SensorRotation,
    SimulatedRig,
    SpatialRig,
    SpinningRotor,
    ThermalDrift,
    TimeDelay,
    ToolLoad,
    TranslationalFriction,
    ViscousDrag,
    resolve_effects,
    rigid_tool_wrench,
    simulate,
    static_poses,
    write_recording,
)

pytest.importorskip("mujoco")

G = 9.806
EXACT = 1e-12  # rounding of MuJoCo's recursions on numbers of order 10
PLANAR = PlanarRig(bias=(0.0, 0.0, 0.0), noise=(0.0, 0.0, 0.0))
SPATIAL = SpatialRig(bias=(0.0,) * 6, noise=(0.0,) * 6)
FORCES = ["fx", "fy", "fz"]
TORQUES = ["tx", "ty", "tz"]
NOISE = {PLANAR: PlanarRig().noise, SPATIAL: SpatialRig().noise}
CHANNELS = {PLANAR: ["fx", "fy", "tau"], SPATIAL: FORCES + TORQUES}


def still(*q: float) -> tuple[Array, Array, Array]:
    states = np.array([q], dtype=float)
    return states, np.zeros_like(states), np.zeros_like(states)


def planar_wrench(states: tuple[Array, Array, Array], *loads: ToolLoad, rig: SimulatedRig = PLANAR) -> Array:
    return rigid_tool_wrench(rig.scene, loads, np.arange(len(states[0]), dtype=float), states)[:, rig.rows]


def run(rig: SimulatedRig, *hidden: HiddenEffect, repeats: int = 1, samples: int = 100, seed: int = 1) -> pd.DataFrame:
    motion = rig.random_motion(seed=seed)
    return simulate(rig, motion, hidden=hidden, repeats=repeats, samples_per_period=samples)


def added(rig: SimulatedRig, *hidden: HiddenEffect, repeats: int = 1, samples: int = 100) -> Array:
    channels = CHANNELS[rig]
    with_them = run(rig, *hidden, repeats=repeats, samples=samples)
    without = run(rig, repeats=repeats, samples=samples)
    return (with_them[channels] - without[channels]).to_numpy()


# -------------------------------------------------------------------------- what the sensor feels


@pytest.mark.parametrize("phi", [0.0, 0.5, np.pi / 2, -2.0])
def test_static_weight_in_the_plane(phi: float) -> None:
    fx, fy, tau = planar_wrench(still(0.3, -0.9, phi + 0.6))[0]
    weight = PLANAR.mass * G
    # The sensor holds the weight up: m g along world y, (-sin phi, cos phi) in (x', y'), and fy points
    # along -y'. The centre hangs on an arm l_g along y': it takes -mlg g sin phi, clockwise, to hold it.
    assert fx == pytest.approx(-weight * np.sin(phi), abs=EXACT)
    assert fy == pytest.approx(-weight * np.cos(phi), abs=EXACT)
    assert tau == pytest.approx(-PLANAR.mlg * G * np.sin(phi), abs=EXACT)


def test_pure_rotation_needs_a_centripetal_force() -> None:
    rig, omega = replace(PLANAR, link_lengths=(0.7,), gravity=0.0), 3.0
    states = (np.array([[0.4]]), np.array([[omega]]), np.array([[0.0]]))
    fx, fy, tau = planar_wrench(states, rig=rig)[0]
    # mass m at 0.7 + l_g from the axis: m omega² (0.7 + l_g) inwards, which is +fy, without a torque
    assert fy == pytest.approx(omega**2 * (rig.mass * 0.7 + rig.mlg), abs=EXACT)
    assert abs(fx) < EXACT
    assert abs(tau) < EXACT


def test_angular_acceleration_needs_the_inertia_about_the_sensor() -> None:
    rig, alpha = replace(PLANAR, link_lengths=(0.7,), gravity=0.0), 5.0
    states = (np.array([[0.4]]), np.array([[0.0]]), np.array([[alpha]]))
    fx, _, tau = planar_wrench(states, rig=rig)[0]
    # the sensor origin itself accelerates by 0.7 alpha along x'
    assert fx == pytest.approx(alpha * (0.7 * rig.mass + rig.mlg), abs=EXACT)
    assert tau == pytest.approx(alpha * (rig.inertia + 0.7 * rig.mlg), abs=EXACT)


def test_force_is_newtons_law_for_the_centre_of_mass_along_a_motion() -> None:
    rig, step = PLANAR, 1e-4
    motion = rig.random_motion(seed=4)
    time = np.linspace(0.0, motion.period, 50)

    def centre(t: Array) -> Array:
        phi = np.cumsum(motion.evaluate(t)[0], axis=1)
        arms = np.array([*rig.link_lengths[:2], rig.link_lengths[2] + rig.mlg / rig.mass])
        return np.stack([(arms * np.sin(phi)).sum(axis=1), (arms * np.cos(phi)).sum(axis=1)], axis=1)

    acceleration = (centre(time + step) - 2 * centre(time) + centre(time - step)) / step**2
    fx, fy, _ = planar_wrench(motion.evaluate(time)).T
    phi = motion.evaluate(time)[0].sum(axis=1)
    world_x = fx * np.cos(phi) - fy * np.sin(phi)
    world_y = -fx * np.sin(phi) - fy * np.cos(phi)
    # second difference of a position of 2 m: 1e-16 · 2 · 4 / h² = 1e-7 of rounding, 1e-6 of truncation
    np.testing.assert_allclose(world_x, rig.mass * acceleration[:, 0], atol=1e-5)
    np.testing.assert_allclose(world_y, rig.mass * (acceleration[:, 1] + G), atol=1e-5)


def test_the_chapters_equation_22_8_holds() -> None:
    """Against 22.8 as PHYSICS.md prints it; the two routes share nothing but Newton."""
    motion = PLANAR.random_motion(seed=6)
    q, dq, ddq = motion.evaluate(np.linspace(0.0, motion.period, 60))
    lengths = np.array(PLANAR.link_lengths)
    angle, rate, push = (np.cumsum(x, axis=1) for x in (q, dq, ddq))
    ax = (lengths * (push * np.cos(angle) - rate**2 * np.sin(angle))).sum(axis=1)
    ay = (lengths * (-push * np.sin(angle) - rate**2 * np.cos(angle))).sum(axis=1)
    phi, dphi, ddphi = angle[:, -1], rate[:, -1], push[:, -1]
    m1 = ax * np.cos(phi) - (ay + G) * np.sin(phi)
    m3 = -(ax * np.sin(phi) + (ay + G) * np.cos(phi))
    expected = np.stack(
        [
            m1 * PLANAR.mass + ddphi * PLANAR.mlg,
            m3 * PLANAR.mass + dphi**2 * PLANAR.mlg,
            m1 * PLANAR.mlg + ddphi * PLANAR.inertia,
        ],
        axis=1,
    )
    np.testing.assert_allclose(planar_wrench((q, dq, ddq)), expected, atol=EXACT * 10)  # numbers of order 100


def test_work_of_the_sensor_is_the_change_of_energy_over_a_period() -> None:
    """A rigid tool gives back what it took: the sensor's power over a period is zero; drag takes some."""
    motion = SPATIAL.random_motion(seed=2)
    time = np.linspace(0.0, motion.period, 400, endpoint=False)  # smooth, periodic: spectral accuracy
    states = motion.evaluate(time)

    def mean_power(*loads: ToolLoad) -> float:
        wrench = rigid_tool_wrench(SPATIAL.scene, loads, time, states)
        turn = Rotation.from_euler("XYZ", states[0][:, 3:])
        step = 1e-6
        after = Rotation.from_euler("XYZ", motion.evaluate(time + step)[0][:, 3:])
        spin = (turn.inv() * after).as_rotvec() / step
        velocity = turn.inv().apply(states[1][:, :3])
        return float(((wrench[:, :3] * velocity).sum(axis=1) + (wrench[:, 3:] * spin).sum(axis=1)).mean())

    forward_difference = 1e-4  # W: step/2 · alpha · torque, some 1e-5
    assert abs(mean_power()) < forward_difference
    assert abs(mean_power(MagnusForce(d=0.0))) < forward_difference
    assert mean_power(ViscousDrag()) > 0.01
    assert mean_power(QuadraticDrag()) > 0.01
    assert mean_power(CoulombFriction()) > 0.01


def test_weight_and_torque_in_space_at_rest() -> None:
    frame = static_poses(SPATIAL, 12, seed=3)
    assert "time" not in frame
    turn = Rotation.from_quat(frame[["qx", "qy", "qz", "qw"]].to_numpy())
    up = turn.inv().apply([0.0, 0.0, G])
    # pose angles are recorded in steps of 7.4e-6 rad: half a step on 12 N and on 0.9 N m
    np.testing.assert_allclose(frame[FORCES], SPATIAL.mass * up, atol=3e-4)
    np.testing.assert_allclose(frame[TORQUES], np.cross(SPATIAL.first_moment, up), atol=3e-5)


def test_spin_about_a_fixed_axis_in_space_needs_eulers_torque() -> None:
    rig, omega = replace(SPATIAL, gravity=0.0), 4.0
    q, dq = np.zeros((1, 6)), np.array([[0.0, 0.0, 0.0, omega, 0.0, 0.0]])
    wrench = rigid_tool_wrench(rig.scene, (), np.zeros(1), (q, dq, np.zeros((1, 6))))[0]
    _, xy, xz, _, _, _ = rig.inertia
    _, my, mz = rig.first_moment
    expected = [0.0, -(omega**2) * my, -(omega**2) * mz, 0.0, -(omega**2) * xz, omega**2 * xy]
    np.testing.assert_allclose(wrench, expected, atol=EXACT)


def test_on_sensor_is_the_negative_with_the_same_bias() -> None:
    poses = PLANAR.random_poses(5, np.random.default_rng(0))
    rig = replace(PLANAR, bias=(1.0, 2.0, 3.0))
    on_tool, on_sensor = (
        static_poses(replace(rig, convention=c), poses)[CHANNELS[PLANAR]].to_numpy() for c in ("on_tool", "on_sensor")
    )
    np.testing.assert_allclose(on_tool - rig.bias, -(on_sensor - rig.bias), atol=EXACT)


# -------------------------------------------------------------------------------- hidden effects


def test_com_offset_is_an_arm_across_the_tip() -> None:
    change = CentreOfMassOffset(mlx=0.01)
    rows = rigid_tool_wrench(change.changed(PLANAR.scene), (), np.zeros(1), still(0.0, 0.0, 0.0))[0]
    # upright, the weight hangs to the right of the tip: it has to be held with mlx g anticlockwise
    assert rows[5] == pytest.approx(-0.01 * G, abs=EXACT)
    alpha = (np.zeros((1, 3)), np.zeros((1, 3)), np.array([[0.0, 0.0, 2.0]]))
    no_weight = replace(change.changed(PLANAR.scene), gravity=np.zeros(3))
    turned = rigid_tool_wrench(no_weight, (), np.zeros(1), alpha)[0]
    # the inertia about the sensor is as described; the last link's end swings by 0.4 m
    assert turned[5] == pytest.approx(2.0 * (PLANAR.inertia + 0.4 * PLANAR.mlg), abs=EXACT)


def test_tilt_in_the_plane_is_a_turn_of_the_first_joint() -> None:
    tilted = rigid_tool_wrench(GravityTilt(tilt_y=0.2).changed(PLANAR.scene), (), np.zeros(1), still(0.1, 0.2, 0.3))
    leaning = rigid_tool_wrench(PLANAR.scene, (), np.zeros(1), still(-0.1, 0.2, 0.3))
    np.testing.assert_allclose(tilted, leaning, atol=EXACT)


def test_viscous_drag_opposes_the_velocity_of_its_point() -> None:
    rig, omega = replace(PLANAR, link_lengths=(0.7,), gravity=0.0), 2.0
    states = (np.array([[0.4]]), np.array([[omega]]), np.array([[0.0]]))
    felt = planar_wrench(states, ViscousDrag(c=0.5, d=0.1), rig=rig) - planar_wrench(states, rig=rig)
    push = 0.5 * omega * 0.8  # the point moves clockwise, along +x'; the sensor has to push that way
    np.testing.assert_allclose(felt[0], [push, 0.0, 0.1 * push], atol=EXACT)
    square = planar_wrench(states, QuadraticDrag(c=0.5, d=0.1), rig=rig) - planar_wrench(states, rig=rig)
    np.testing.assert_allclose(square[0], felt[0] * omega * 0.8, atol=EXACT)


def test_coulomb_friction_keeps_its_size() -> None:
    torque = added(PLANAR, CoulombFriction(level=0.03))
    np.testing.assert_allclose(np.abs(torque[:, 2]), 0.03, rtol=1e-6)  # at 8 widths of the step, and faster
    np.testing.assert_allclose(torque[:, :2], 0.0, atol=EXACT)
    assert set(np.sign(torque[:, 2])) == {-1.0, 1.0}


def test_friction_against_the_translation_keeps_its_size() -> None:
    rig, omega = replace(PLANAR, link_lengths=(0.7,), gravity=0.0), 2.0
    friction = TranslationalFriction(level=0.4, d=0.1)
    for turning in (omega, -omega, 3 * omega):
        states = (np.array([[0.4]]), np.array([[turning]]), np.array([[0.0]]))
        felt = planar_wrench(states, friction, rig=rig) - planar_wrench(states, rig=rig)
        push = 0.4 * np.sign(turning)  # against a point that moves clockwise, along +x', the sensor pushes that way
        np.testing.assert_allclose(felt[0], [push, 0.0, 0.1 * push], atol=EXACT)
    np.testing.assert_array_equal(planar_wrench(still(0.4), friction, rig=rig), planar_wrench(still(0.4), rig=rig))


def test_a_force_in_base_axes_is_a_weight_without_inertia() -> None:
    """Downwards at d: the sensor holds it as it holds a mass there at rest, and not where that accelerates."""
    force = BaseForce(force=(0.0, 0.0, -0.1 * G), d=0.1)
    mass = PayloadChange(mass=0.1, d=0.1, time=0.0).changed(PLANAR.scene)
    for states in (still(0.1, 0.4, -0.3), still(0.9, 0.2, 0.3)):
        held = rigid_tool_wrench(mass, (), np.zeros(1), states)[:, PLANAR.rows]
        np.testing.assert_allclose(planar_wrench(states, force), held, atol=1e-10)  # of a payload of 1e-12 kg m²
    moving = (states[0], states[1], np.array([[1.0, 0.0, 0.0]]))
    pulled = planar_wrench(moving, force) - planar_wrench(moving)
    np.testing.assert_allclose(pulled, planar_wrench(states, force) - planar_wrench(states), atol=EXACT)


def test_a_torque_in_base_axes_turns_in_the_sensor() -> None:
    torque = np.array([0.05, -0.03, 0.08])
    change = added(SPATIAL, BaseForce(force=(0.0, 0.0, 0.0), torque=tuple(torque)))
    turns = Rotation.from_quat(run(SPATIAL)[["qx", "qy", "qz", "qw"]])
    np.testing.assert_allclose(change[:, :3], 0.0, atol=EXACT)
    np.testing.assert_allclose(change[:, 3:], -turns.inv().apply(torque), atol=1e-5)  # of recorded angles


def test_a_spinning_rotor_is_a_flywheel() -> None:
    """What MuJoCo makes of a wheel on the tool, less the same wheel at rest relative to it."""
    mujoco = pytest.importorskip("mujoco")
    inertia, axis, spin = 2e-4, np.array([0.6, 0.0, 0.8]), 250.0
    hinges = "".join(f'<joint type="hinge" axis="{a}"/>' for a in ("1 0 0", "0 1 0", "0 0 1"))
    wheel = (
        '<body pos="0.01 0.02 0.1"><joint type="hinge" axis="0.6 0 0.8"/>'
        f'<inertial pos="0 0 0" mass="0.2" diaginertia="{inertia} {inertia} {inertia}"/></body>'
    )
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><worldbody><body>{hinges}<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><body><site name="s"/>'
        f'<inertial pos="0 0 0.05" mass="1" diaginertia="0.01 0.01 0.01"/>{wheel}</body></body></worldbody>'
        '<sensor><torque site="s"/></sensor></mujoco>'
    )
    states = tuple(np.random.default_rng(4).normal(size=(3, 5, 3)))
    felt = []
    for speed in (spin, 0.0):
        data, torques = mujoco.MjData(model), []
        for q, dq, ddq in zip(*states, strict=True):
            data.qpos[:], data.qvel[:], data.qacc[:] = [*q, 0.0], [*dq, speed], [*ddq, 0.0]
            mujoco.mj_inverse(model, data)
            torques.append(data.sensordata.copy())
        felt.append(np.array(torques))
    q, dq, ddq = (np.hstack([np.zeros((5, 3)), turning]) for turning in states)
    rotor = SpinningRotor(momentum=tuple(inertia * spin * axis))
    with_it, without = (rigid_tool_wrench(SPATIAL.scene, loads, np.zeros(5), (q, dq, ddq)) for loads in ((rotor,), ()))
    np.testing.assert_allclose(with_it[:, 3:] - without[:, 3:], felt[0] - felt[1], atol=1e-10)
    np.testing.assert_allclose(with_it[:, :3], without[:, :3], atol=EXACT)


def test_tether_pulls_when_taut_and_never_pushes() -> None:
    anchor = 1.0, 0.0, 2.37
    upright = still(0.0, 0.0, 0.0)  # the sensor is at (0, 2.37), 1 m from the anchor
    slack, taut = (CableSpring(k=10.0, anchor=anchor, length=length, d=0.0) for length in (1.2, 0.7))
    free = planar_wrench(upright)
    np.testing.assert_array_equal(planar_wrench(upright, slack), free)
    # it pulls the tool along +x with 10 · 0.3 N; the sensor holds against it
    np.testing.assert_allclose(planar_wrench(upright, taut) - free, [[-3.0, 0.0, 0.0]], atol=EXACT)


def test_tether_left_open_is_taut_half_of_the_time() -> None:
    for rig in (PLANAR, SPATIAL):
        push = np.abs(added(rig, CableSpring(d=0.1), samples=200)[:, :3]).max(axis=1)
        assert 0.4 < np.mean(push > 1e-9) < 0.6


def test_sensor_rotation_turns_the_reading_and_not_the_bias() -> None:
    rig = replace(PLANAR, bias=(15.0, 0.25, -1.33))
    straight, turned = run(rig), run(rig, SensorRotation(yaw=0.1))
    names = CHANNELS[PLANAR]
    load, read = (frame[names].to_numpy() - rig.bias for frame in (straight, turned))
    # axes turned clockwise by a, which is from e1 to e2: a vector's components turn back
    c, s = np.cos(0.1), np.sin(0.1)
    np.testing.assert_allclose(read[:, 0], c * load[:, 0] + s * load[:, 1], atol=EXACT)
    np.testing.assert_allclose(read[:, 1], c * load[:, 1] - s * load[:, 0], atol=EXACT)
    np.testing.assert_allclose(read[:, 2], load[:, 2], atol=EXACT)


def test_crosstalk_adds_the_named_channel() -> None:
    change = added(PLANAR, SensorCrosstalk(leaks=(("tau", "fx", 0.01),)))
    load = run(PLANAR)["fx"].to_numpy()
    np.testing.assert_allclose(change, np.outer(0.01 * load, [0.0, 0.0, 1.0]), atol=EXACT)


def wave(harmonic: int, amplitude: float = 0.01, period: float = 2.0) -> Trajectory:
    """A carriage that shakes along its x axis only."""
    sine = np.zeros((6, harmonic))
    sine[0, -1] = amplitude
    return fourier_trajectory(offset=np.zeros(6), sine=sine, cosine=np.zeros_like(sine), period=period)


@pytest.mark.parametrize("time_constant", [0.003, 0.02, 0.5])
def test_lag_has_the_gain_and_phase_of_a_first_order_filter(time_constant: float) -> None:
    motion = wave(6)
    plain, lagged = (
        simulate(SPATIAL, motion, hidden=hidden, repeats=2, samples_per_period=400)["fx"].to_numpy()
        for hidden in ((), (SensorLag(time_constant=time_constant),))
    )
    response = np.fft.rfft(lagged)[12] / np.fft.rfft(plain)[12]
    w = 2 * np.pi * 6 / motion.period
    # straight between points 0.5 ms apart: relative error (w h)²/12 = 7e-6
    assert abs(response - 1 / (1 + 1j * w * time_constant)) < 2e-5
    assert abs(response) == pytest.approx(1 / np.sqrt(1 + (w * time_constant) ** 2), rel=1e-4)
    np.testing.assert_allclose(lagged[:400], lagged[400:], atol=1e-11)  # steady from the first sample


def test_delay_is_a_shift_of_the_reading() -> None:
    names, period, samples = CHANNELS[PLANAR], 5.0, 100
    delayed = run(PLANAR, TimeDelay(delay=3 * period / samples), repeats=2, samples=samples)
    plain = run(PLANAR, repeats=2, samples=samples)
    np.testing.assert_allclose(delayed[names], np.roll(plain[names].to_numpy(), 3, axis=0), atol=1e-10)
    pd.testing.assert_frame_equal(delayed[["time", "q1", "q2", "q3"]], plain[["time", "q1", "q2", "q3"]])


def test_play_lags_by_its_half_width_after_a_reversal() -> None:
    width, motion = 0.05, wave(1, amplitude=0.2)
    plain, played = (
        simulate(SPATIAL, motion, hidden=hidden, repeats=2, samples_per_period=1000)["fx"].to_numpy()
        for hidden in ((), (SensorHysteresis(force=width, torque=0.0),))
    )
    assert np.abs(played - plain).max() == pytest.approx(width, abs=EXACT)
    # 1 % of slack: the grid may miss the top of the load
    assert np.ptp(played) == pytest.approx(np.ptp(plain) - 2 * width, rel=1e-2)
    np.testing.assert_allclose(played[:1000], played[1000:], atol=EXACT)


def test_contact_acts_inside_its_interval_only() -> None:
    event = ContactEvent(force=(4.0, -2.0, 0.0), torque=(0.0, 0.0, 0.3), start=6.0, end=8.0)
    change = added(PLANAR, event, repeats=2)
    time = np.arange(200) * 0.05
    during = (time > 6.01) & (time < 7.99)
    outside = (time < 5.99) | (time > 8.01)
    # the sensor holds against it, also about its own origin
    np.testing.assert_allclose(change[during], np.tile([-4.0, 2.0, -0.3], (during.sum(), 1)), atol=EXACT)
    np.testing.assert_allclose(change[outside], 0.0, atol=EXACT)


def test_events_left_open_lie_inside_the_record() -> None:
    motion = PLANAR.random_motion()
    push, payload = resolve_effects(PLANAR, motion, (ContactEvent(), PayloadChange()), repeats=4)
    assert isinstance(push, ContactEvent)
    assert isinstance(payload, PayloadChange)
    assert (push.start, push.end, payload.time) == pytest.approx((11.0, 13.0, 8.0))


def test_payload_weighs_from_its_time_on() -> None:
    at_rest = fourier_trajectory(
        offset=np.array([0.0, 0.0, np.pi / 2]), sine=np.zeros((3, 1)), cosine=np.zeros((3, 1)), period=1.0
    )
    event = PayloadChange(mass=0.1, d=0.2, time=1.5)
    frame = simulate(PLANAR, at_rest, hidden=(event,), repeats=3, samples_per_period=10)
    change = (frame[["fx", "tau"]] - frame[["fx", "tau"]].iloc[0]).to_numpy()
    np.testing.assert_allclose(change[:15], 0.0, atol=EXACT)
    # the tip is level: x' points down
    np.testing.assert_allclose(change[15:], np.tile([-0.1 * G, -0.1 * G * 0.2], (15, 1)), atol=1e-11)


def test_event_is_felt_through_the_sensor() -> None:
    """A push with a lag decays after its end: the chain acts on the whole record."""
    event = ContactEvent(force=(4.0, 0.0, 0.0), torque=(0.0, 0.0, 0.0), start=5.0, end=7.0)
    lag = SensorLag(time_constant=0.5)
    lasting = added_to(lag, event)
    time = np.arange(200) * 0.05
    after = time > 7.02
    decay = -4.0 * np.exp(-(time - 7.0) / 0.5)
    # switched on for 4 time constants, and with edges of 10 ms: 2 % and 1 %
    np.testing.assert_allclose(lasting[after, 0], decay[after], rtol=0.04, atol=1e-3)


def added_to(base: HiddenEffect, extra: HiddenEffect) -> Array:
    names = CHANNELS[PLANAR]
    return (run(PLANAR, base, extra, repeats=2)[names] - run(PLANAR, base, repeats=2)[names]).to_numpy()


def test_drifts_are_slow_and_of_their_size() -> None:
    drift = added(PLANAR, BiasDrift(force=0.6, torque=0.05), repeats=8)
    np.testing.assert_allclose(np.ptp(drift, axis=0), [0.6, 0.6, 0.05], rtol=1e-9)
    assert np.abs(np.diff(drift[:, 0])).max() < 0.01
    thermal = added(PLANAR, ThermalDrift(force=0.2, torque=0.01), repeats=8)
    # from 22 °C at the start, 2 K above 20 °C, towards 25 °C with 20 s
    expected = 5 - 3 * np.exp(-np.arange(800) * 0.05 / 20)
    np.testing.assert_allclose(thermal, np.outer(expected, [0.2, 0.2, 0.01]), atol=EXACT)


def test_saturation_clips() -> None:
    plain, clipped = run(PLANAR)["fx"], run(PLANAR, Saturation(share=0.8))["fx"]
    level = 0.8 * plain.abs().max()
    np.testing.assert_allclose(clipped, plain.clip(-level, level), atol=EXACT)


@pytest.mark.parametrize("rig", [PLANAR, SPATIAL], ids=["planar", "spatial"])
@pytest.mark.parametrize("effect", HIDDEN_EFFECTS.values(), ids=lambda e: e.id)
def test_every_effect_shows_on_every_rig_that_can_have_it(rig: SimulatedRig, effect: HiddenEffect) -> None:
    if (effect.planar_only and rig is SPATIAL) or (effect.spatial_only and rig is PLANAR):
        with pytest.raises(ValueError, match=effect.id):
            run(rig, effect)
        return
    change = added(rig, effect, repeats=2)
    assert np.isfinite(change).all()
    size = np.sqrt((change**2).mean(axis=0)) / NOISE[rig]
    assert size.max() > 0.2, "weaker than a fifth of the noise in every channel"


@pytest.mark.parametrize("effect", HIDDEN_EFFECTS.values(), ids=lambda e: e.id)
def test_every_effect_at_rest(effect: HiddenEffect) -> None:
    if effect.needs_motion:
        with pytest.raises(ValueError, match="static poses"):
            static_poses(PLANAR, 5, hidden=(effect,))
    else:
        assert len(static_poses(PLANAR, 5, hidden=(effect,))) == 5


def test_some_effects_are_in_no_catalogue() -> None:
    assert sum(not effect.catalogued for effect in HIDDEN_EFFECTS.values()) >= 2


def test_sensor_effects_act_in_the_order_of_the_chain() -> None:
    def order(effect_id: str) -> int:
        effect = HIDDEN_EFFECTS[effect_id]
        assert isinstance(effect, SensorEffect)
        return effect.order

    chain = ["sensor_gain", "sensor_crosstalk", "gain_nonlinearity", "sensor_hysteresis", "sensor_lag"]
    assert all(order(a) < order(b) for a, b in pairwise(chain))
    forward = tuple(HIDDEN_EFFECTS[i] for i in chain)
    pd.testing.assert_frame_equal(run(PLANAR, *forward), run(PLANAR, *reversed(forward)))


# ------------------------------------------------------------------------------------- the record


def test_planar_record_has_the_agreed_columns() -> None:
    frame = run(PlanarRig(), repeats=3)
    assert list(frame) == ["time", "repeat", "q1", "q2", "q3", "fx", "fy", "tau", "temperature"]
    assert frame["repeat"].tolist() == [0] * 100 + [1] * 100 + [2] * 100
    np.testing.assert_allclose(np.diff(frame["time"]), 0.05, atol=1e-12)
    steps = frame["q1"] / 7.4e-6
    np.testing.assert_allclose(steps, steps.round(), atol=1e-6)


def test_spatial_record_has_the_agreed_columns() -> None:
    frame = run(SpatialRig(), repeats=2)
    pose = ["qx", "qy", "qz", "qw", "px", "py", "pz"]
    assert list(frame) == ["time", "repeat", *pose, *FORCES, *TORQUES, "temperature"]
    np.testing.assert_allclose((frame[pose[:4]] ** 2).sum(axis=1), 1.0, atol=1e-12)


def test_recorded_pose_is_that_of_the_motion() -> None:
    motion = SPATIAL.random_motion(seed=5)
    frame = simulate(SPATIAL, motion, repeats=1, samples_per_period=50)
    q = motion.evaluate(frame["time"].to_numpy())[0]
    np.testing.assert_allclose(frame[["px", "py", "pz"]], q[:, :3], atol=6e-7)  # half a step of 1e-6 m
    turn = Rotation.from_quat(frame[["qx", "qy", "qz", "qw"]].to_numpy())
    off = (Rotation.from_euler("XYZ", q[:, 3:]).inv() * turn).magnitude()
    assert off.max() < 1.2e-5  # half a step of 7.4e-6 rad in three angles


@pytest.mark.parametrize("name", NOISE_MODELS)
def test_noise_has_unit_variance(name: str) -> None:
    draws = NOISE_MODELS[name].draw(np.random.default_rng(0), 20_000, 30)
    # AR(0.98) has some 200 independent samples a channel, 6000 in all: 2 % of std of the variance, thrice
    assert draws.shape == (20_000, 30)
    assert (draws**2).mean() == pytest.approx(1.0, abs=0.06)


def test_noise_has_its_colour_and_tails() -> None:
    rng = np.random.default_rng(0)
    slow = NOISE_MODELS["autoregressive"].draw(rng, 50_000, 1)[:, 0]
    assert (slow[1:] * slow[:-1]).mean() / (slow**2).mean() == pytest.approx(0.98, abs=0.005)
    heavy = NOISE_MODELS["student_t"].draw(rng, 50_000, 1)[:, 0]
    assert (heavy**4).mean() > 5.0
    pink = np.abs(np.fft.rfft(NOISE_MODELS["pink_and_lines"].draw(rng, 50_000, 1)[:, 0])) ** 2
    assert pink[5:50].mean() > 5 * pink[20_000:].mean()
    assert pink[2:].argmax() + 2 in (round(0.1312347 * 50_000), round(0.2871113 * 50_000))


def test_same_seed_same_noise_whatever_is_hidden() -> None:
    rig = PlanarRig()
    drag = ViscousDrag()
    names = CHANNELS[PLANAR]
    difference = run(rig, drag)[names].to_numpy() - run(rig)[names].to_numpy()
    np.testing.assert_allclose(difference, added(PLANAR, drag), atol=EXACT)
    motion = rig.random_motion()
    first, other = (simulate(rig, motion, repeats=1, samples_per_period=50, seed=s)["fx"] for s in (0, 1))
    assert not np.allclose(first, other)


def test_written_recording_reads_back(tmp_path: Path) -> None:
    frame = run(PlanarRig(), repeats=2)
    path = write_recording(frame, tmp_path / "new" / "run.csv")
    pd.testing.assert_frame_equal(pd.read_csv(path), frame, rtol=1e-9)  # ten significant digits
    assert [p.name for p in path.parent.iterdir()] == ["run.csv"]


def test_bad_requests_are_refused() -> None:
    with pytest.raises(ValueError, match="coordinates"):
        simulate(PLANAR, SPATIAL.random_motion())
    with pytest.raises(ValueError, match="convention"):
        PlanarRig(convention="on_table")
    with pytest.raises(ValueError, match="bias"):
        PlanarRig(bias=(1.0,))
    with pytest.raises(ValueError, match="noise model"):
        simulate(PLANAR, PLANAR.random_motion(), noise="loud")
    with pytest.raises(ValueError, match="leaves the plane"):
        run(PLANAR, GravityTilt(tilt_x=0.1))
    with pytest.raises(ValueError, match="no channel"):
        run(PLANAR, SensorCrosstalk(leaks=(("fz", "fx", 0.1),)))
