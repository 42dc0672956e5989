"""Signals of a recording against analytic motions, and the clock behind jittering stamps."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from estimation.recordings.motion import MotionForm
from estimation.recordings.reading import SampleClock, from_columns, read
from modeling.errors import InputError
from modeling.rig import Rig
from tests.shared.places import AIS2202, DATA, needs
from tests.shared.rigs import ARM_RIG

Array = NDArray[np.float64]
PERIOD, SAMPLES = 5.0, 500


def planar_wrench(n: int) -> dict[str, Array]:
    return {channel: np.zeros(n) for channel in ("fx", "fy", "tau")}


def spatial_wrench(n: int) -> dict[str, Array]:
    return {channel: np.zeros(n) for channel in ("fx", "fy", "fz", "tx", "ty", "tz")}


def joint_motion(repeats: int = 1) -> dict[str, Array]:
    n = repeats * SAMPLES
    t = np.arange(n) * PERIOD / SAMPLES
    w = 2 * np.pi / PERIOD
    columns = {"time": t + 3.0, "repeat": np.repeat(np.arange(float(repeats)), SAMPLES)} | planar_wrench(n)
    for j, (line, size) in enumerate([(1, 0.4), (2, 0.3), (3, 0.2)], start=1):
        columns[f"q{j}"] = size * np.sin(line * w * t + j)
        columns[f"ddq{j}"] = -((line * w) ** 2) * columns[f"q{j}"]
    return columns


def test_joint_motion_gives_the_pose() -> None:
    columns = joint_motion(repeats=3)
    truth = {name: columns.pop(name) for name in ("ddq1", "ddq2", "ddq3")}
    recording = from_columns(columns, rig=ARM_RIG)
    assert (recording.form, recording.repeats, recording.continuous) == (MotionForm.JOINTS, 3, True)
    s = recording.signals
    for name, expected in truth.items():
        np.testing.assert_allclose(s[name], expected, atol=1e-9)  # rounding times w²
    absolute = np.cumsum([columns[f"q{j}"] for j in (1, 2, 3)], axis=0)
    lengths = np.array([1.0, 0.97, 0.4])
    np.testing.assert_allclose(s["phi"], absolute[2], atol=1e-12)
    np.testing.assert_allclose(s["px"], lengths @ np.sin(absolute), atol=1e-12)
    np.testing.assert_allclose(s["py"], lengths @ np.cos(absolute), atol=1e-12)
    step = PERIOD / SAMPLES
    for position, acceleration in (("px", "ax"), ("py", "ay")):
        second = (s[position][2:] - 2 * s[position][1:-1] + s[position][:-2]) / step**2
        # Central differences err by step²/12 times the fourth derivative, below 1e3 m/s⁴ here.
        np.testing.assert_allclose(s[acceleration][1:-1], second, atol=1e-2)


def test_given_derivatives_are_used_and_the_rest_derived() -> None:
    columns = joint_motion(repeats=2)
    truth = {name: columns.pop(name) for name in ("ddq1", "ddq2", "ddq3")}
    marked = np.full(2 * SAMPLES, 0.125)
    s = from_columns(columns | {"dq1": marked, "ddq2": marked}, rig=ARM_RIG).signals
    np.testing.assert_array_equal(s["dq1"], marked)
    np.testing.assert_allclose(s["ddq1"], 0.0, atol=1e-9)
    np.testing.assert_array_equal(s["ddq2"], marked)
    np.testing.assert_allclose(s["ddq3"], truth["ddq3"], atol=1e-9)


@pytest.mark.parametrize("pause", [-4.99, 2.0])
def test_restarting_time_and_pauses_part_the_runs(pause: float) -> None:
    columns = joint_motion(repeats=3)
    columns["time"] = (
        np.tile(columns["time"][:SAMPLES], 3) if pause < 0 else columns["time"] + pause * columns["repeat"]
    )
    recording = from_columns(columns, rig=ARM_RIG)
    assert not recording.continuous
    assert recording.dt == pytest.approx(PERIOD / SAMPLES)
    assert recording.time is not None
    np.testing.assert_allclose(recording.time, np.tile(np.arange(SAMPLES) * PERIOD / SAMPLES, 3), atol=1e-9)
    np.testing.assert_array_equal(recording.signals["order"], np.arange(3 * SAMPLES))


def test_planar_pose_slow_and_wrapped() -> None:
    t = np.arange(2000) * 0.005
    phi = 0.9 * t
    columns = {"time": t, "phi": (phi + np.pi) % (2 * np.pi) - np.pi} | planar_wrench(2000)
    s = from_columns(columns).signals
    np.testing.assert_allclose(s["dphi"], 0.9, atol=1e-6)
    np.testing.assert_allclose(s["phi"], phi, atol=1e-9)
    assert not np.any(s["ax"])
    assert "px" not in s
    assert "vx" not in s


def test_whole_turns_in_a_period() -> None:
    t = np.arange(1500) * 0.01
    phi = 2 * np.pi * t / 5 + 0.2 * np.sin(2 * np.pi * t / 5)
    columns = {"time": t, "repeat": np.repeat([0, 1, 2], 500), "phi": np.angle(np.exp(1j * phi))}
    s = from_columns(columns | planar_wrench(1500)).signals
    rate = 2 * np.pi / 5 * (1 + 0.2 * np.cos(2 * np.pi * t / 5))
    np.testing.assert_allclose(s["dphi"], rate, atol=1e-9)
    np.testing.assert_allclose(np.angle(np.exp(1j * (s["phi"] - phi))), 0, atol=1e-9)


def test_acceleration_comes_from_a_recorded_position() -> None:
    t = np.arange(2000) * 0.005
    columns = {"time": t, "phi": 0.1 * t, "px": np.sin(2 * t), "py": np.cos(t)} | planar_wrench(2000)
    s = from_columns(columns).signals
    # The spline's own error without noise, largest at the ends.
    np.testing.assert_allclose(s["ax"], -4 * np.sin(2 * t), atol=1e-3)
    np.testing.assert_allclose(s["vy"], -np.sin(t), atol=1e-4)


def rotating(t: Array) -> tuple[Array, Array, Array]:
    """Orientation exp(a(t) z) exp(b(t) x), with its rate and acceleration in the turning frame."""
    a, da, dda = 0.8 * np.sin(t), 0.8 * np.cos(t), -0.8 * np.sin(t)
    b, db, ddb = np.cos(2 * t), -2 * np.sin(2 * t), -4 * np.cos(2 * t)
    turn = Rotation.from_rotvec(np.outer(a, [0, 0, 1])) * Rotation.from_rotvec(np.outer(b, [1, 0, 0]))
    omega = np.stack([db, da * np.sin(b), da * np.cos(b)], axis=1)
    beta = np.stack([ddb, dda * np.sin(b) + da * db * np.cos(b), dda * np.cos(b) - da * db * np.sin(b)], axis=1)
    return turn.as_quat(), omega, beta


def pose_columns(repeats: int, seed: int) -> tuple[dict[str, Array], Array, Array]:
    n = repeats * 1000
    t = np.arange(n) * 2 * np.pi / 1000
    quaternions, omega, alpha = rotating(t)
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], n)
    columns = dict(zip(("qx", "qy", "qz", "qw"), (quaternions * signs[:, None]).T, strict=True))
    columns |= {"time": t, "repeat": np.repeat(np.arange(repeats), 1000)} | spatial_wrench(n)
    return columns, omega, alpha


@pytest.mark.parametrize(("repeats", "tolerance"), [(3, 1e-8), (1, 1e-2)])
def test_quaternion_with_random_signs_gives_omega_and_alpha(repeats: int, tolerance: float) -> None:
    columns, omega, alpha = pose_columns(repeats, seed=8)
    s = from_columns(columns).signals
    found = np.stack([s[name] for name in ("wx", "wy", "wz", "alx", "aly", "alz")], axis=1)
    # Exact from a Fourier series; a spline's second derivative errs at the ends of a single run.
    np.testing.assert_allclose(found, np.concatenate([omega, alpha], axis=1), atol=tolerance)
    assert not np.any(s["apx"])
    assert "vpx" not in s


def test_full_turn_in_a_period_changes_the_quaternions_sign() -> None:
    t = np.arange(1200) * 0.01
    half = np.pi * t / 4
    columns = {"qx": 0 * t, "qy": np.sin(half), "qz": 0 * t, "qw": np.cos(half), "time": t}
    columns |= {"repeat": np.repeat([0, 1, 2], 400)} | spatial_wrench(1200)
    s = from_columns(columns).signals
    np.testing.assert_allclose(s["wy"], np.pi / 2, atol=1e-9)
    np.testing.assert_allclose(s["aly"], 0, atol=1e-8)


def test_poses_at_rest_have_no_rates() -> None:
    columns, _, _ = pose_columns(1, seed=9)
    columns = {name: column[:24] for name, column in columns.items() if name not in ("time", "repeat")}
    recording = from_columns(columns | {"wx": np.ones(24), "temperature": np.arange(24.0)})
    s = recording.signals
    assert recording.at_rest
    assert recording.dt is None
    assert recording.auxiliary == ("temperature",)
    assert "time" not in s
    for name in ("wx", "alz", "vpx", "apz"):
        assert not np.any(s[name])
    np.testing.assert_array_equal(s["order"], np.arange(24))


@given(st.integers(0, 2**32 - 1), st.floats(1e-4, 1.0), st.floats(0.0, 0.35), st.integers(50, 3000))
def test_clock_is_believed_and_not_the_stamp(seed: int, dt: float, jitter: float, samples: int) -> None:
    rng = np.random.default_rng(seed)
    stamps = 7.0 + dt * (np.arange(samples) + jitter * rng.uniform(-1, 1, samples))
    clock = SampleClock.of(stamps)
    # A slope's std is jitter sqrt(12 / N³) steps; five of them, and rounding.
    assert abs(clock.dt / dt - 1) < 5 * np.sqrt(12 / samples**3) + 1e-9
    assert abs(clock.start - 7.0) < 5 * dt / np.sqrt(samples) + 1e-9


@given(st.integers(0, 2**32 - 1), st.integers(5, 995), st.integers(1, 300))
def test_hole_is_found_where_it_is(seed: int, place: int, lost: int) -> None:
    jitter = np.random.default_rng(seed).uniform(-0.15, 0.15, 1000)
    stamps = 0.01 * (np.arange(1000) + jitter + np.where(np.arange(1000) >= place, lost, 0))
    with pytest.raises(InputError, match=rf"row {place + 2}: about {lost} samples are missing"):
        SampleClock.of(stamps)


def test_bursts_of_a_buffered_driver_are_no_holes() -> None:
    i = np.arange(2000)
    stamps = 0.001 * (i // 8 * 8 + 0.05 * (i % 8))
    assert SampleClock.of(stamps).dt == pytest.approx(0.001, rel=1e-4)


def test_two_rates_are_no_clock() -> None:
    steps = np.where(np.arange(1000) < 500, 0.01, 0.012)
    with pytest.raises(InputError, match="deviate"):
        SampleClock.of(np.cumsum(steps))


@needs(DATA)
def test_recordings_at_hand() -> None:
    for case in sorted((DATA / "planar").iterdir()):
        recording = read(case / "train.csv", rig=Rig.read(case / "rig.toml"))
        assert (recording.repeats, recording.samples_per_repeat, recording.continuous) == (8, 1000, True)
        assert recording.dt == pytest.approx(1 / 200)
        assert np.isfinite(list(recording.signals.values())).all()
    for name in ("baseline", "vibrations", "contact"):
        recording = read(AIS2202 / f"{name}.csv")
        assert recording.dt == pytest.approx(1 / 698, rel=1e-3)
        # Half a turn about the sensor's y.
        assert np.abs(np.trapezoid(recording.signals["wy"], recording.time)) == pytest.approx(np.pi, rel=0.02)
    assert read(AIS2202 / "calibration_poses.csv").at_rest
