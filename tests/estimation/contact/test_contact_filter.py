"""The contact filter: exact where it has to be, as late as it says, and what `compensate` gives for whole recordings.

Random tests are seeded; the probabilities are those of another seed's failing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.signal import cont2discrete, dlsim, savgol_coeffs, savgol_filter
from scipy.spatial.transform import Rotation

from benchmarks.coverage import RIGS, Setting, silent_recording
from estimation.contact.contact_filter import ContactFilter, LocalPolynomial
from estimation.contact.contact_wrench import CalibratedModel, compensate
from estimation.recordings.motion import QUATERNION
from estimation.recordings.recording import Recording
from modeling import effects
from modeling.chain.model import WrenchModel, planar, spatial
from modeling.chain.prediction import compiled_prediction
from modeling.chain.sensor_axes import contact_gain_at
from modeling.errors import InputError
from modeling.kinematics.arm import PlanarArm
from modeling.rig import Convention, Rig, SensorDescription
from modeling.space import Space
from truewrench import simulated_rig as simulated

Array = NDArray[np.float64]

DT = 0.005
SPACES = pytest.mark.parametrize("space", list(Space), ids=lambda s: str(s.name))
PUSH = simulated.ContactEvent(start=1.5, end=3.5, force=(4.0, -2.0, 0.0), torque=(0.0, 0.0, 0.3))


def ticks(count: int, dt: float = DT) -> Array:
    return np.arange(count, dtype=np.float64) * dt


def calibration(
    model: WrenchModel, values: Mapping[str, float], floor: Sequence[float] | None = None
) -> CalibratedModel:
    theta = np.array([values.get(p.name, p.nominal) for p in model.parameters])
    scale = np.array(RIGS[model.space].noise if floor is None else floor)
    return CalibratedModel(model, theta, np.zeros((len(theta),) * 2), scale, np.zeros(len(scale)))


def truth_of(setting: Setting) -> CalibratedModel:
    return calibration(setting.model, setting.truth)


def run(contact: ContactFilter, table: Array) -> Array:
    """Every row's result (n, p), nan while there is none."""
    results = [contact.update(row) for row in table]
    return np.stack([np.full(len(contact.zero), np.nan) if r is None else r for r in results])


def table_of(recording: Recording, columns: Sequence[str]) -> Array:
    return np.hstack([recording.motion.recorded.stack(columns), recording.wrench])


def filter_of(known: CalibratedModel, recording: Recording, window: LocalPolynomial) -> ContactFilter:
    return ContactFilter(known, columns=tuple(recording.columns), window=window, rig=recording.rig)


# -------------------------------------------------------------------------------------- local polynomial


@pytest.mark.parametrize("degree", [2, 3, 4, 5])
@pytest.mark.parametrize("half", [3, 10, 40])
def test_kernels_are_scipys(degree: int, half: int) -> None:
    window = LocalPolynomial(half=half, dt=DT, degree=degree)
    for order in range(3):
        expected = savgol_coeffs(2 * half + 1, degree, deriv=order, delta=DT, use="dot")
        scale = np.abs(expected).max()
        np.testing.assert_allclose(window.kernels[order], expected, atol=1e-10 * scale)  # SciPy's monomials


def test_a_very_long_window_is_still_exact() -> None:
    """20 001 samples: in powers of the sample's number its equations have a condition of 1e16, in Legendre's of 3."""
    window = LocalPolynomial(half=10_000, dt=1.0)
    place = np.arange(-10_000, 10_001) / 10_000
    for order in range(3):
        moments = [window.kernels[order] @ place**power * 1e4**order for power in range(5)]
        expected = [0.0 if power != order else (1, 1, 2)[order] for power in range(5)]
        np.testing.assert_allclose(moments, expected, atol=1e-10)  # rounding of sums of 20 001


@pytest.mark.parametrize("order", [0, 1, 2])
def test_gain_is_what_a_sine_keeps(order: int) -> None:
    window, frequency = LocalPolynomial(half=12, dt=DT), np.array([0.0, 1.0, 7.0, 23.0, 60.0])
    time = (np.arange(25) - 12) * DT
    for f, gain in zip(frequency[1:], window.gain(frequency, order)[1:], strict=True):
        w = 2 * np.pi * f
        complex_gain = window.kernels[order] @ np.exp(1j * w * time) / (1j * w) ** order
        assert complex_gain == pytest.approx(gain, abs=1e-11)  # rounding, and no phase at all
    assert window.gain(0.0, order) == pytest.approx(1.0)
    assert window.norms[order] ** 2 == pytest.approx(np.sum(window.kernels[order] ** 2))


def test_windows_by_bandwidth_and_by_delay() -> None:
    for frequency in (3.0, 12.0, 40.0):
        window = LocalPolynomial.of_bandwidth(frequency, dt=DT)
        longer = replace(window, half=window.half + 1)
        assert longer.bandwidth < frequency <= window.bandwidth
        assert window.gain(window.bandwidth) == pytest.approx(np.sqrt(0.5), abs=1e-9)
        assert (window.gain(np.linspace(0, 0.999 * window.bandwidth, 200)) > np.sqrt(0.5)).all()
    assert LocalPolynomial.of_delay(0.05, dt=DT).half == 10
    assert LocalPolynomial.of_delay(0.0549, dt=DT).delay == pytest.approx(0.05)
    assert LocalPolynomial(half=2, dt=DT).bandwidth == 100.0  # five samples, five coefficients: every one as it is


@pytest.mark.parametrize(
    ("make", "what"),
    [
        (lambda: LocalPolynomial(half=1, dt=DT), "3 samples do not determine"),
        (lambda: LocalPolynomial(half=5, dt=DT, degree=1), "no acceleration"),
        (lambda: LocalPolynomial(half=5, dt=0.0), "step"),
        (lambda: LocalPolynomial.of_delay(0.004, dt=DT), "do not determine"),
        (lambda: LocalPolynomial.of_bandwidth(101.0, dt=DT), "half the sample rate"),
    ],
)
def test_windows_that_do_not_exist(make, what: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(InputError, match=what):
        make()


# --------------------------------------------------------------------------------- polynomials are exact

POLYNOMIAL = np.array([0.3, -0.7, 0.5, 1.1, -0.4, 0.2])  # of degree 5, which by symmetry does not matter


def test_polynomial_motion_and_contact_in_the_plane() -> None:
    """A slide along a polynomial at a constant angle, m (a - g), with the signs of 22.8 written down by hand."""
    phi, m, mlg, g = 0.6, 1.3, 0.2, 9.806
    time = ticks(80)
    x, y = np.polyval(POLYNOMIAL, time), np.polyval(-2 * POLYNOMIAL[::-1], time)
    ax, ay = np.polyval(np.polyder(POLYNOMIAL, 2), time), np.polyval(np.polyder(-2 * POLYNOMIAL[::-1], 2), time)
    across, along = (
        ax * np.cos(phi) - (ay + g) * np.sin(phi),
        ax * np.sin(phi) + (ay + g) * np.cos(phi),
    )
    contact = np.stack([np.polyval(POLYNOMIAL[i:], 3 * time) for i in range(3)], axis=1)
    free = np.stack([m * across, -m * along, mlg * across], axis=1) + np.array([15.0, 0.25, -1.33])
    table = np.column_stack([np.full(80, phi), x, y, free + contact * [-1.0, 1.0, -1.0]])
    values = {"bias_fx": 15.0, "bias_fy": 0.25, "bias_tau": -1.33, "m": m, "mlg": mlg, "I": 0.1}
    known = ContactFilter(
        calibration(planar(), values), columns=("phi", "px", "py"), window=LocalPolynomial(half=8, dt=DT)
    )
    result = run(known, table)
    assert np.isnan(result[:16]).all()
    np.testing.assert_allclose(result[16:], contact[8:-8], atol=1e-8)  # rounding / dt² of positions around 1 m
    assert known.delay == pytest.approx(8 * DT)


def test_polynomial_motion_and_contact_in_six_axes() -> None:
    """Upside down and sliding, the reading of a sensor that shows what the tool does to it."""
    time, turn = ticks(60), Rotation.from_rotvec([0.4, 2.9, -0.7])
    path = np.stack([np.polyval(np.roll(POLYNOMIAL, i), time) for i in range(3)], axis=1)
    lift = np.stack([np.polyval(np.polyder(np.roll(POLYNOMIAL, i), 2), time) for i in range(3)], axis=1)
    lift[:, 2] += 9.806
    m, first = 1.2, np.array([0.01, -0.02, 0.09])
    force = m * turn.inv().apply(lift)
    tool = np.hstack([force, np.cross(first, force / m)])
    contact = np.stack([np.polyval(POLYNOMIAL[::-1] * (i + 1), time) for i in range(6)], axis=1)
    table = np.hstack([np.tile(turn.as_quat(), (60, 1)), path, -(tool - contact)])
    values = {"m": m, "mx": first[0], "my": first[1], "mz": first[2], "Ixx": 0.1, "Iyy": 0.2, "Izz": 0.3}
    model = spatial(Rig(sensor=SensorDescription(convention=Convention.ON_SENSOR)))
    columns = (*QUATERNION, "px", "py", "pz")
    known = ContactFilter(calibration(model, values), columns=columns, window=LocalPolynomial(half=6, dt=DT))
    np.testing.assert_allclose(run(known, table)[12:], contact[6:-6], atol=1e-8)  # rounding / dt², as above


def test_a_turning_tool_by_the_polynomial_of_its_angle() -> None:
    time = ticks(60)
    table = np.column_stack(
        [np.polyval(POLYNOMIAL, time), *(0 * time,) * 2, np.polyval(np.polyder(POLYNOMIAL, 2), time)]
    )
    known = ContactFilter(calibration(planar(), {"I": 1.0}), columns=("phi",), window=LocalPolynomial(half=6, dt=DT))
    np.testing.assert_allclose(run(known, table)[12:], 0.0, atol=1e-8)  # rounding / dt²


# -------------------------------------------------------------------------------- against whole recordings


def noisy(recording: Recording, seed: int) -> Recording:
    scale = np.array(RIGS[Space.PLANE if recording.dimension == 2 else Space.SPACE].noise)
    noise = scale * np.random.default_rng(seed).standard_normal(recording.wrench.shape)
    return recording.with_readings(recording.wrench + noise)


@cache
def setting_of(space: Space, case: str = "") -> Setting:
    hidden: tuple[simulated.HiddenEffect, ...] = (PUSH,)
    added, amounts = {
        "": ((), ()),
        "lag": (("sensor_lag",), (("sensor_lag.time_constant", 0.03),)),
        "delay": (("time_delay",), (("time_delay.delay", 0.0123),)),
        "lead": (("time_delay",), (("time_delay.delay", -0.0123),)),
    }[case]
    if case == "lag":
        hidden = (PUSH, simulated.SensorLag(time_constant=0.03))
    elif case:
        hidden = (PUSH, simulated.TimeDelay(delay=dict(amounts)["time_delay.delay"]))
    return Setting(space=space, repeats=1, samples=1000, hidden=hidden, added=added, amounts=amounts)


@SPACES
@pytest.mark.parametrize("case", ["", "lag", "delay", "lead"])
def test_it_gives_what_compensate_gives(space: Space, case: str) -> None:
    """On the simulated rig, the same noise in both: `compensate` smoothed alike, and so many samples later.

    What differs is how the motion is differentiated, the window's share of a fast load, and the memory between samples;
    a tenth of one sample's noise. The first and last tenth are left out, where a single run's ends are continued.
    """
    setting = setting_of(space, case)
    known, recording = truth_of(setting), noisy(silent_recording(setting), 3)
    window = LocalPolynomial.of_delay(0.05, dt=DT)
    contact = filter_of(known, recording, window)
    result = run(contact, table_of(recording, tuple(recording.columns)))
    whole = savgol_filter(compensate(known, recording, keep_zero=True).wrench, window.samples, window.degree, axis=0)
    late = round(contact.delay / DT)
    assert late == 10 + (4 if case == "lead" else 0)
    difference = (result[late:] - whole[:-late])[100:-100]
    assert (np.sqrt((difference**2).mean(axis=0)) < 0.1 * known.floor).all()
    assert np.isnan(result[: contact.warm_up - 1]).all()
    assert np.isfinite(result[contact.warm_up - 1 :]).all()


@cache
def pushed(case: str) -> tuple[ContactFilter, Array]:
    """The filter and its results for the planar rig's push, without noise."""
    setting = setting_of(Space.PLANE, case)
    recording = silent_recording(setting)
    contact = filter_of(truth_of(setting), recording, LocalPolynomial.of_delay(0.05, dt=DT))
    return contact, run(contact, table_of(recording, tuple(recording.columns)))


@pytest.mark.parametrize("channel", [0, 1, 2])
@pytest.mark.parametrize("case", ["", "delay", "lead"])
def test_a_known_push_arrives_when_it_is_said_to(case: str, channel: int) -> None:
    """Where the correlation of the result with the rig's own push, so much later, is largest.

    The push's edges are two samples long, too steep to be sampled alike at any fraction of a step: 2 % of one.
    """
    contact, result = pushed(case)
    seen, time = np.isfinite(result[:, 0]), ticks(len(result))

    def unlike(late: float) -> float:
        inside = np.minimum(time - late - 1.5, 3.5 - time + late) / simulated.CONTACT_EDGE + 0.5
        push = np.sin(np.clip(inside, 0, 1) * np.pi / 2) ** 2
        return -float(np.corrcoef(push[seen], result[seen, channel])[0, 1])

    found = minimize_scalar(unlike, bounds=(0.0, 0.15), options={"xatol": 1e-7})
    assert found.fun < -0.99
    assert found.x == pytest.approx(contact.delay + contact.group_delay, abs=0.02 * DT)


@pytest.mark.parametrize("channel", [0, 1, 2])
@pytest.mark.parametrize("case", ["", "lag", "delay", "lead"])
def test_the_middle_of_a_push_is_as_late_as_stated_whatever_makes_it_late(case: str, channel: int) -> None:
    """The first moment of an answer is its group delay at zero frequency. No noise; what the motion leaves, 1e-3 of the
    floor, moves the middle of 2 s of push by 4 s lever / size: 1e-4 s at the most. So it does to the height."""
    contact, result = pushed(case)
    answer, time = np.nan_to_num(result[:, channel]), ticks(len(result))
    assert answer @ time / answer.sum() == pytest.approx(2.5 + contact.delay + contact.group_delay, abs=2e-4)
    top = answer[int(2.0 / DT) : int(3.4 / DT)].mean()
    assert top == pytest.approx((4.0, 2.0, 0.3)[channel], abs=0.05 * contact.calibration.floor[channel])


@pytest.mark.parametrize(("delay", "wait"), [(-0.0123, 4), (-0.01, 2), (0.0, 0), (0.01, 0), (0.0123, 0), (0.0023, 1)])
def test_a_lead_is_part_of_the_stated_delay(delay: float, wait: int) -> None:
    model = planar() + effects.time_delay()
    known = calibration(model, {"m": 1.0, "time_delay.delay": delay})
    contact = ContactFilter(known, columns=("phi",), window=LocalPolynomial(half=4, dt=DT))
    assert contact.delay == pytest.approx((4 + wait) * DT)
    assert contact.group_delay == pytest.approx(delay)


# ---------------------------------------------------------------------------------------- noise and bias


@SPACES
def test_the_stated_covariance_is_that_of_the_answers_to_single_errors(space: Space) -> None:
    """White noise adds the squares of the answers to each sample's own error, here of one floor in one channel."""
    mixed = planar() + effects.sensor_crosstalk() if space is Space.PLANE else spatial() + effects.sensor_rotation()
    amounts = {p.name: 0.1 * (1 + i) for i, p in enumerate(p for e in mixed.effects for p in e.qualified(space))}
    known = calibration(mixed, amounts)
    columns = ("phi",) if space is Space.PLANE else QUATERNION
    contact = ContactFilter(known, columns=columns, window=LocalPolynomial(half=5, dt=DT))
    squares = np.zeros((len(known.floor),) * 2)
    for channel, size in enumerate(known.floor):
        table = np.zeros((40, len(contact.columns)))
        table[:, len(columns) - 1] = 1.0
        table[20, len(columns) + channel] = size
        contact.restart()
        answer = run(contact, table)[contact.window.samples :]
        squares += answer.T @ answer
    np.testing.assert_allclose(contact.covariance, squares, rtol=1e-9, atol=1e-15)  # rounding
    np.testing.assert_allclose(contact.std, np.sqrt(np.diag(squares)))


@pytest.mark.parametrize("frequency", [1.0, 4.0, 10.0])
@pytest.mark.parametrize("given", ["px", "vx", "ax"])
def test_what_it_does_not_follow_of_a_fast_motion(frequency: float, given: str) -> None:
    """A shaken mass of 2 kg at phi = 0, m ax, without contact: the share that is left is the one stated."""
    window, w, time = LocalPolynomial(half=10, dt=DT), 2 * np.pi * frequency, ticks(300)
    shaken = {"px": np.sin(w * time) / -(w**2), "vx": np.cos(w * time) / -w, "ax": np.sin(w * time)}[given]
    columns = ("phi", "dphi", "ddphi", given, given.replace("x", "y"))
    motion = [0 * time, 0 * time, 0 * time, shaken, 0 * time]
    table = np.column_stack([*motion, 2 * np.sin(w * time), np.full(300, -2 * 9.806), 0 * time])
    contact = ContactFilter(calibration(planar(), {"m": 2.0}), columns=columns, window=window)
    result = run(contact, table)[20:, 0]
    share = contact.unfollowed(frequency)[0]
    expected = -2 * share * np.sin(w * (time[20:] - contact.delay))
    np.testing.assert_allclose(result, expected, atol=1e-8)  # rounding / dt²
    assert (share == 0) == (given == "ax")


# --------------------------------------------------------------------------- row by row, and all at once


def reference(known: CalibratedModel, recording: Recording, window: LocalPolynomial) -> Array:
    """The same over whole columns: SciPy's filter, the arm or quaternion algebra, SciPy's discretisation."""
    columns = {
        name: [
            savgol_filter(c, window.samples, window.degree, deriv=n, delta=DT)[window.half : -window.half]
            for n in range(3)
        ]
        for name, c in recording.columns.items()
    }
    if recording.dimension == 2:
        q, dq, ddq = (np.stack([columns[f"q{j}"][n] for j in (1, 2, 3)], axis=1) for n in range(3))
        assert recording.rig is not None
        signals = PlanarArm(recording.rig.link_lengths or ()).pose(q, dq, ddq)
    else:
        signals = turned({name: columns[name] for name in QUATERNION})
        signals |= {
            prefix + axis: columns["p" + axis][n] for n, prefix in enumerate(("p", "vp", "ap")) for axis in "xyz"
        }
    prediction = compiled_prediction(known.model)
    samples = recording.samples - 2 * window.half
    load, zero = (part.value(signals, known.theta, samples) for part in (prediction.load, prediction.bias))
    values = dict(zip((p.name for p in known.model.parameters), known.theta, strict=True))
    if "sensor_lag.time_constant" in values:
        tau = values["sensor_lag.time_constant"]
        system = cont2discrete((np.array([1.0]), np.array([tau, 1.0])), DT, method="foh")
        load = load[0] + np.stack([dlsim(system, c)[1][:, 0] for c in (load - load[0]).T], axis=1)
    measured = np.stack(
        [savgol_filter(c, window.samples, window.degree)[window.half : -window.half] for c in recording.wrench.T]
    )
    return np.asarray((measured.T - load - zero) @ np.linalg.inv(contact_gain_at(known.model, known.theta)[0]).T)


def turned(s: Mapping[str, Sequence[Array]]) -> dict[str, Array]:
    """Orientation and its rates by quaternion algebra: 2 conj(s) ds / |s|² has omega as its vector part."""
    value, first, second = (np.stack([s[name][n] for name in QUATERNION], axis=1) for n in range(3))
    size = np.sum(value**2, axis=1, keepdims=True)

    def vector_part(a: Array, b: Array) -> Array:
        return np.asarray(a[:, 3:] * b[:, :3] - b[:, 3:] * a[:, :3] - np.cross(a[:, :3], b[:, :3]))

    omega = 2 * vector_part(value, first) / size
    alpha = 2 * vector_part(value, second) / size - 2 * np.sum(value * first, axis=1, keepdims=True) / size * omega
    found = dict(zip(QUATERNION, (value / np.sqrt(size)).T, strict=True))
    found |= dict(zip(("wx", "wy", "wz"), omega.T, strict=True))
    return found | dict(zip(("alx", "aly", "alz"), alpha.T, strict=True))


@SPACES
@pytest.mark.parametrize("case", ["", "lag"])
def test_rows_give_what_whole_columns_give(space: Space, case: str) -> None:
    setting = setting_of(space, case)
    known, recording = truth_of(setting), noisy(silent_recording(setting), 4)
    window = LocalPolynomial(half=7, dt=DT)
    contact = filter_of(known, recording, window)
    result = run(contact, table_of(recording, tuple(recording.columns)))
    expected = reference(known, recording, window)[contact.warm_up - window.samples :]
    np.testing.assert_allclose(result[contact.warm_up - 1 :], expected, atol=1e-9)


def test_rows_by_name_in_any_order_and_with_more_in_them() -> None:
    setting = setting_of(Space.PLANE)
    known, recording = truth_of(setting), silent_recording(setting)
    window, names = LocalPolynomial(half=5, dt=DT), ("q3", "q1", "q2")
    by_name = ContactFilter(known, columns=names, window=window, rig=recording.rig)
    by_place = filter_of(known, recording, window)
    table = table_of(recording, ("q1", "q2", "q3"))[:60]
    rows = [dict(zip(("q1", "q2", "q3", "fx", "fy", "tau"), row, strict=True)) | {"mood": 1.0} for row in table]
    results = np.array([by_name.update(r) for r in rows][10:], dtype=float)
    np.testing.assert_allclose(results, run(by_place, table)[10:], atol=1e-9)  # rounding / dt²
    with pytest.raises(InputError, match="a row without q2, tau"):
        by_name.update({"q1": 0.0, "q3": 0.0, "fx": 0.0, "fy": 0.0})
    with pytest.raises(InputError, match=r"shape \(4,\)"):
        by_name.update(np.zeros(4))


def test_a_missing_value_starts_it_anew() -> None:
    setting = setting_of(Space.PLANE)
    known, recording = truth_of(setting), silent_recording(setting)
    table = table_of(recording, ("q1", "q2", "q3"))[:80]
    broken = table.copy()
    broken[40, 4] = np.nan
    contact = filter_of(known, recording, LocalPolynomial(half=5, dt=DT))
    whole = run(contact, table)
    contact.restart()
    parted = run(contact, broken)
    np.testing.assert_array_equal(parted[:40], whole[:40])
    assert np.isnan(parted[40:51]).all()
    np.testing.assert_array_equal(parted[51:], whole[51:])


# ------------------------------------------------------------------------------- columns of other kinds


def test_recorded_rates_are_used_as_they_are() -> None:
    """The derived ones are then not asked: wrong angles of the right mean do no harm to tau = I ddphi."""
    time = ticks(60)
    ddphi = np.sin(9 * time)
    rng = np.random.default_rng(5)
    known, window = calibration(planar(), {"I": 0.3}), LocalPolynomial(half=6, dt=DT)
    for columns, motion in [
        (("phi", "ddphi"), (rng.standard_normal(60), ddphi)),
        (("phi", "dphi", "ddphi"), (rng.standard_normal(60), rng.standard_normal(60), ddphi)),
    ]:
        contact = ContactFilter(known, columns=columns, window=window)
        result = run(contact, np.column_stack([*motion, 0 * time, 0 * time, 0.3 * ddphi]))
        np.testing.assert_allclose(result[12:], 0.0, atol=1e-12)  # rounding
    contact = ContactFilter(known, columns=("phi", "dphi"), window=window)
    result = run(contact, np.column_stack([rng.standard_normal(60), time**3, 0 * time, 0 * time, 0.3 * 3 * time**2]))
    np.testing.assert_allclose(result[12:], 0.0, atol=1e-10)  # rounding / dt


@SPACES
def test_whole_turns_and_signs_of_quaternions_do_not_show(space: Space) -> None:
    time = ticks(200)
    known = calibration(planar() if space is Space.PLANE else spatial(), {"m": 1.0, "mlg": 0.1, "I": 0.2, "Izz": 0.2})
    if space is Space.PLANE:
        plain = (3.0 + 8 * time)[:, None]
        jumping = (plain + np.pi) % (2 * np.pi) - np.pi
    else:
        plain = Rotation.from_rotvec(np.outer(8 * time, [0.0, 0.6, 0.8])).as_quat(canonical=False)
        plain *= np.where(np.cumsum([0.0, *(np.sum(plain[1:] * plain[:-1], axis=1) < 0)]) % 2, -1, 1)[:, None]
        jumping = plain * np.random.default_rng(6).choice([-1.0, 1.001], (200, 1))
    columns = ("phi",) if space is Space.PLANE else QUATERNION
    wrench = np.zeros((200, len(known.floor)))
    window = LocalPolynomial(half=6, dt=DT)
    smooth, other = (
        run(ContactFilter(known, columns=columns, window=window), np.hstack([motion, wrench]))
        for motion in (plain, jumping)
    )
    assert np.abs(jumping - plain).max() > 1
    np.testing.assert_allclose(other[12:], smooth[12:], atol=1e-8)  # rounding / dt²


def test_a_zero_that_follows_the_temperature() -> None:
    model = planar() + effects.thermal_drift()
    known = calibration(model, {"bias_fx": 2.0, "thermal_drift.fx": 0.2, "thermal_drift.tau": -0.01})
    warm = 20 + ticks(60) * 30
    table = np.column_stack([np.zeros(60), warm, 2.0 + 0.2 * (warm - 20), np.zeros(60), -0.01 * (warm - 20)])
    contact = ContactFilter(known, columns=("phi", "temperature"), window=LocalPolynomial(half=6, dt=DT))
    np.testing.assert_allclose(run(contact, table)[12:], 0.0, atol=1e-12)  # rounding
    moved = ContactFilter(known, columns=contact.motion.columns, window=contact.window, zero=[2.5, 0.0, 0.0])
    np.testing.assert_allclose(run(moved, table)[12:], [[0.5, 0, 0]] * 48, atol=1e-12)  # less is measured: it pushes


# ---------------------------------------------------------------------------------------------- the zero


def test_rezero_finds_a_shifted_zero_from_free_rows() -> None:
    """The mean of 900 results of a window's noise: about floor / sqrt(900) each, 4.5 sigma, 2e-5."""
    setting = Setting(repeats=1, samples=1000)
    known, recording = truth_of(setting), noisy(silent_recording(setting), 7)
    shift = np.array([0.8, -0.5, 0.06])
    table = table_of(recording, ("q1", "q2", "q3")) + np.concatenate([np.zeros(3), shift])
    before = filter_of(known, recording, LocalPolynomial(half=8, dt=DT))
    after = before.rezero(table)
    assert (np.abs(after.zero - before.zero - shift) < 4.5 * known.floor / np.sqrt(900)).all()
    np.testing.assert_allclose(before.zero, known.theta[:3])
    gain = contact_gain_at(known.model, known.theta)[0]
    first, second = run(before, table)[16:], run(after, table)[16:]
    np.testing.assert_allclose((first - second) @ gain.T, [after.zero - before.zero] * len(first), atol=1e-10)
    with pytest.raises(InputError, match="no result before row 17"):
        before.rezero(table[:16])


# ------------------------------------------------------------------------------------------------ misuse


def test_signals_that_rows_do_not_give_are_named_with_their_effect() -> None:
    window = LocalPolynomial(half=5, dt=DT)
    known = calibration(planar() + effects.viscous_drag() + effects.thermal_drift(), {})
    with pytest.raises(InputError, match=r"needs temperature, vx, vy \(for viscous_drag, thermal_drift\)"):
        ContactFilter(known, columns=("phi", "ax", "ay"), window=window)
    ContactFilter(known, columns=("phi", "px", "py", "temperature"), window=window)


@pytest.mark.parametrize(
    ("columns", "what"),
    [(("q1", "q2"), "no rig"), (("phi", "ax"), "missing ay"), (("temperature",), "neither q1..qn nor phi")],
)
def test_rows_without_a_motion_are_refused(columns: tuple[str, ...], what: str) -> None:
    with pytest.raises(InputError, match=what):
        ContactFilter(calibration(planar(), {}), columns=columns, window=LocalPolynomial(half=5, dt=DT))


def test_a_zero_is_one_number_a_channel() -> None:
    with pytest.raises(InputError, match="zero"):
        ContactFilter(calibration(planar(), {}), columns=("phi",), window=LocalPolynomial(half=5, dt=DT), zero=[1.0])


def test_it_prints_what_it_does() -> None:
    contact = ContactFilter(calibration(planar(), {}), columns=("phi",), window=LocalPolynomial(half=5, dt=DT))
    lines = str(contact).splitlines()
    assert lines[1].split() == ["delay", "0.025", "s"]
    assert "fcx" in str(contact)
    assert "Hz" in str(contact)
