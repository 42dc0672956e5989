"""Lag and delay against exact answers, derivatives against finite differences, and the parts of a response.

The readings are tau = ddphi (a tool of unit inertia and no mass), so that the recorded ddphi is the load.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.signal import lsim

from estimation.model_response import missing_inputs, model_response, predicted_readings
from estimation.noise.whitening import AutoregressiveWhitener
from estimation.recordings.reading import from_columns
from estimation.recordings.recording import Recording
from modeling import effects
from modeling.chain.effect import Effect
from modeling.chain.model import WrenchModel, planar
from modeling.chain.prediction import compiled_prediction
from modeling.errors import InputError
from modeling.noise import NoiseModel

Array = NDArray[np.float64]

TAU = 2
EVERY_MEMORY = pytest.mark.parametrize("effect", [effects.sensor_lag(), effects.time_delay()], ids=lambda e: str(e.id))


def ticks(count: int, dt: float) -> Array:
    return np.arange(count, dtype=np.float64) * np.float64(dt)


def recording_of(load: Array, dt: float, repeats: int = 1, **more: Array) -> Recording:
    """A recording whose ddphi is `load`, one repeat long or all of them."""
    n = repeats * len(load)
    columns = {name: np.zeros(n) for name in ("phi", "dphi", "ax", "ay", "fx", "fy", "tau")}
    columns |= {"time": ticks(n, dt), "ddphi": np.tile(load, repeats)}
    if repeats > 1:
        columns["repeat"] = np.repeat(np.arange(float(repeats)), len(load))
    return from_columns(columns | more)


def theta_of(model: WrenchModel, **own: float) -> Array:
    values = {"I": 1.0} | {f"{model.effects[-1].id}.{name}": value for name, value in own.items()}
    return np.array([values.get(p.name, p.nominal) for p in model.parameters])


def read(model: WrenchModel, recording: Recording, **own: float) -> Array:
    return predicted_readings(model, recording, theta_of(model, **own))[:, TAU]


# ---------------------------------------------------------------------------------- periodic motions


@settings(max_examples=30, deadline=None)
@given(harmonic=st.integers(1, 40), phase=st.floats(0, 6.3), tau=st.floats(0, 2.0), repeats=st.integers(2, 4))
def test_lag_of_a_sine_is_a_first_order_filters(harmonic: int, phase: float, tau: float, repeats: int) -> None:
    once, dt = 200, 0.02
    w, time = 2 * np.pi * harmonic / (once * dt), ticks(repeats * once, dt)
    recording = recording_of(np.sin(w * time[:once] + phase), dt, repeats)
    expected = np.sin(w * time + phase - np.arctan(w * tau)) / np.sqrt(1 + (w * tau) ** 2)
    got = read(planar() + effects.sensor_lag(), recording, time_constant=tau)
    np.testing.assert_allclose(got, expected, atol=1e-11)  # rounding of the transform and of w t


@settings(max_examples=30, deadline=None)
@given(harmonic=st.integers(1, 40), phase=st.floats(0, 6.3), delay=st.floats(-3, 3), repeats=st.integers(2, 4))
def test_delay_of_a_sine_is_a_shift(harmonic: int, phase: float, delay: float, repeats: int) -> None:
    once, dt = 200, 0.02
    w, time = 2 * np.pi * harmonic / (once * dt), ticks(repeats * once, dt)
    recording = recording_of(np.sin(w * time[:once] + phase), dt, repeats)
    got = read(planar() + effects.time_delay(), recording, delay=delay)
    np.testing.assert_allclose(got, np.sin(w * (time - delay) + phase), atol=1e-11)  # rounding, as above


def test_lag_and_delay_act_one_after_the_other() -> None:
    once, dt, w = 200, 0.02, 2 * np.pi * 3 / 4.0
    time = ticks(2 * once, dt)
    recording = recording_of(np.sin(w * time[:once]), dt, 2)
    model = planar() + effects.sensor_lag() + effects.time_delay()
    values = {"I": 1.0, "sensor_lag.time_constant": 0.2, "time_delay.delay": 0.1}
    got = predicted_readings(model, recording, np.array([values.get(p.name, 0.0) for p in model.parameters]))[:, TAU]
    expected = np.sin(w * (time - 0.1) - np.arctan(0.2 * w)) / np.hypot(1, 0.2 * w)
    np.testing.assert_allclose(got, expected, atol=1e-11)  # rounding


@EVERY_MEMORY
def test_memory_leaves_the_zero_alone(effect: Effect) -> None:
    """The bias is added after it: a constant load passes H(0) = 1, and the bias does not pass at all."""
    recording = recording_of(np.full(100, 3.0), 0.02, 2)
    model = planar() + effect
    theta = theta_of(model, **{effect.parameters(model.space)[0].name: 0.3})
    theta[TAU] = 5.0
    np.testing.assert_allclose(predicted_readings(model, recording, theta)[:, TAU], 8.0, rtol=1e-12)  # rounding


# ---------------------------------------------------------------------------------------- single runs


def wandering(time: Array) -> Array:
    """Smooth, and not closed: its ends meet neither in value nor in slope."""
    return np.sin(1.7 * time + 0.4) + 0.5 * np.cos(4.1 * time) + 0.05 * time


@pytest.mark.parametrize("tau", [0.02, 0.1, 0.5])
def test_lag_of_a_single_run_is_the_simulated_filters(tau: float) -> None:
    """After 25 time constants the start is forgotten to 1e-11.

    What is left: lsim takes the input as straight between samples, (w dt)²/12 with w = 4.1 rad/s; our transform is
    that of the sampled series, whose kinks at the reflected ends alias by about as much there and nowhere else.
    """
    dt, duration = 0.005, 20.0
    time = ticks(int(duration / dt), dt)
    load = wandering(time)
    got = read(planar() + effects.sensor_lag(), recording_of(load, dt), time_constant=tau)
    reference = lsim(([1.0], [tau, 1.0]), load, time, X0=[load[0] * tau])[1]
    inner = (time > 25 * tau) & (time < duration - 1.0)
    np.testing.assert_allclose(got[inner], reference[inner], atol=1e-4)


@pytest.mark.parametrize("delay", [0.0123, -0.0471, 0.2])
def test_delay_of_a_single_run_is_a_shift(delay: float) -> None:
    """Away from the ends. A kink of the reflected ends (its bend, 8 /s² at most, on samples 5 ms apart) answers an
    interpolation with bend dt² / (pi² k) k samples away: 2e-6 after 1 s."""
    dt, duration = 0.005, 20.0
    time = ticks(int(duration / dt), dt)
    got = read(planar() + effects.time_delay(), recording_of(wandering(time), dt), delay=delay)
    inner = (time > 1.0) & (time < duration - 1.0)
    np.testing.assert_allclose(got[inner], wandering(time - delay)[inner], atol=1e-5)


@EVERY_MEMORY
def test_ends_of_a_single_run_stay_near_the_run(effect: Effect) -> None:
    """No wrap-around from one end to the other: a step between them of 10 would show as such."""
    dt = 0.01
    time = ticks(1000, dt)
    load = time.copy()
    got = read(planar() + effect, recording_of(load, dt), **{effect.parameters(planar().space)[0].name: 0.05})
    # Of a ramp both lag and delay make the same ramp 0.05 s later. The reflected ends keep its slope, but are blended
    # over 125 samples towards the middle, 5 away: k samples off by 5 (pi k / 125)² / 4, 0.02 after 0.05 s.
    np.testing.assert_allclose(got, load - 0.05, atol=0.05)


@EVERY_MEMORY
def test_separate_runs_of_one_motion_read_like_a_single_one(effect: Effect) -> None:
    """Time restarts in every repeat: no run is in a periodic state, and none remembers the one before."""
    dt, once = 0.01, 400
    load, model = wandering(ticks(once, dt)), planar() + effect
    own = {effect.parameters(model.space)[0].name: 0.1}
    n = 3 * once
    columns = {name: np.zeros(n) for name in ("phi", "dphi", "ax", "ay", "fx", "fy", "tau")}
    columns |= {"time": np.tile(ticks(once, dt), 3), "repeat": np.repeat(np.arange(3.0), once)}
    separate = from_columns(columns | {"ddphi": np.tile(load, 3)})
    assert not separate.continuous
    got, single = read(model, separate, **own), read(model, recording_of(load, dt), **own)
    np.testing.assert_allclose(got, np.tile(single, 3), atol=1e-12)  # rounding


def test_poses_at_rest_have_no_memory() -> None:
    phi = np.linspace(-1, 1, 12)
    recording = from_columns({"phi": phi, "fx": 0 * phi, "fy": 0 * phi, "tau": 0 * phi})
    model = planar() + effects.sensor_lag()
    theta = np.array([1.0, 2.0, 3.0, 0.9, 0.05, 0.01, 0.4])
    response = model_response(model, recording, theta)
    np.testing.assert_array_equal(response.value, predicted_readings(planar(), recording, theta[:-1]))
    np.testing.assert_array_equal(response.derivative[:, :, -1], 0.0)


# -------------------------------------------------------------------------------------- derivatives


@EVERY_MEMORY
@pytest.mark.parametrize("repeats", [1, 3])
@pytest.mark.parametrize("amount", [0.05, 0.3])
def test_derivative_of_the_memory_is_a_finite_difference(effect: Effect, repeats: int, amount: float) -> None:
    """Central, h = 1e-5 s: h²/6 w³ with w = 12 rad/s makes 3e-8, and what aliases near the ends of a run, up to
    w = pi / dt = 157 rad/s, with h² w² / 6 = 4e-7 of it; rounding of 1e-15 / h is less."""
    once, dt, h = 300, 0.02, 1e-5
    time = ticks(once, dt)
    load = np.sin(2 * np.pi * time / 6.0) + 0.3 * np.cos(2 * np.pi * 11 * time / 6.0 + 1)
    recording, model = recording_of(load, dt, repeats), planar() + effect
    name = effect.parameters(model.space)[0].name
    response = model_response(model, recording, theta_of(model, **{name: amount}))
    ahead, behind = (read(model, recording, **{name: amount + s * h}) for s in (1, -1))
    slope = response.derivative[:, TAU, -1]
    assert np.abs(slope).max() > 0.1
    np.testing.assert_allclose(slope, (ahead - behind) / (2 * h), atol=1e-5)


@EVERY_MEMORY
@pytest.mark.parametrize("repeats", [1, 3])
def test_derivative_of_the_body_passes_the_memory_too(effect: Effect, repeats: int) -> None:
    """A linear parameter: the value at one less the value at zero is its column."""
    rng = np.random.default_rng(0)
    recording, model = recording_of(rng.normal(size=100), 0.02, repeats), planar() + effect
    theta = theta_of(model, **{effect.parameters(model.space)[0].name: 0.1})
    inertia = [p.name for p in model.parameters].index("I")
    response = model_response(model, recording, theta)
    without = predicted_readings(model, recording, np.where(np.arange(len(theta)) == inertia, 0.0, theta))
    np.testing.assert_allclose(response.value - without, response.derivative[:, :, inertia], atol=1e-12)  # rounding


# ---------------------------------------------------------------------------------------------- parts


def by_the_sample(model: WrenchModel, recording: Recording, theta: Array) -> Array:
    prediction, signals = compiled_prediction(model), recording.motion.model_signals
    samples = recording.samples
    return prediction.load.value(signals, theta, samples) + prediction.bias.value(signals, theta, samples)


CASES: dict[str, tuple[Callable[[], Effect], bool]] = {
    "viscous_drag": (effects.viscous_drag, False),
    "com_offset": (effects.com_offset, False),
    "bias_drift": (effects.bias_drift, True),
    "thermal_drift": (effects.thermal_drift, True),
    "contact_event": (effects.contact_event, True),
}


@pytest.mark.parametrize("effect_id", CASES)
@pytest.mark.parametrize("repeats", [1, 3])
def test_parts_add_up_to_what_the_model_says_of_each_sample(effect_id: str, repeats: int) -> None:
    """What repeats with the motion is computed once, what passes over the whole record, and only that."""
    make, passes = CASES[effect_id]
    rng, once, dt = np.random.default_rng(1), 120, 0.02
    n = once * repeats
    more = {"temperature": 22 + np.linspace(0, 3, n)}
    more |= {name: np.tile(rng.normal(size=once), repeats) for name in ("vx", "vy", "ax", "ay")}
    recording = recording_of(rng.normal(size=once), dt, repeats, **more)
    model = planar() + make()
    names = [p.name for p in model.parameters]
    theta = rng.uniform(0.1, 1.0, len(names))
    if effect_id == "contact_event":
        theta[[names.index(f"contact_event.{end}") for end in ("start", "end")]] = 0.3 * dt * n, 0.7 * dt * n
    response = model_response(model, recording, theta)
    assert (response.whole is not None) == (passes and repeats > 1)
    assert response.periodic[0].shape == (once, 3)
    assert response.value.shape == (n, 3)
    assert response.derivative.shape == (n, 3, len(theta))
    np.testing.assert_allclose(response.value, by_the_sample(model, recording, theta), rtol=1e-13, atol=1e-13)
    if response.whole is None and repeats > 1:
        np.testing.assert_array_equal(response.value, np.tile(response.periodic[0], (repeats, 1)))
    step = 1e-6  # every parameter but d and the times is linear: rounding of 1e-15 / step; d is quadratic
    for i in range(len(theta)):
        ahead, behind = (by_the_sample(model, recording, theta + s * step * np.eye(len(theta))[i]) for s in (1, -1))
        np.testing.assert_allclose(response.derivative[:, :, i], (ahead - behind) / (2 * step), atol=1e-7)


@pytest.mark.parametrize("effect_id", [*CASES, "sensor_lag", "saturation"])
def test_means_over_blocks_are_whitened_as_all_samples_are(effect_id: str) -> None:
    """Of a single run, by noise of averages; a model that is not instantaneous is evaluated sample by sample."""
    rng, n, block = np.random.default_rng(4), 403, 10
    model = planar() + getattr(effects, effect_id)()
    names = ("temperature", "px", "py", "vx", "vy", "ax", "ay", "phi", "dphi")
    recording = recording_of(rng.normal(size=n), 0.02, 1, **{name: rng.normal(size=n) for name in names})
    theta = rng.uniform(0.1, 1.0, len(model.parameters))
    noise = NoiseModel(np.diag([0.1, 0.2, 0.01]), np.array([[0.5, 0.3, 0.1]]), block)
    whitener = AutoregressiveWhitener(n, noise)
    means, series = (model_response(model, recording, theta, block=each) for each in (block, 1))
    assert len(means.value) == (n // block if compiled_prediction(model).instantaneous else n)
    for found, expected in zip(whitener.response(means), whitener.response(series), strict=True):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_missing_input_is_named() -> None:
    recording = recording_of(np.zeros(50), 0.02)
    model = planar() + effects.thermal_drift() + effects.cable_spring()
    assert set(missing_inputs(model, recording)) == {"temperature", "px", "py"}
    with pytest.raises(InputError, match=r"temperature|px|py"):
        model_response(model, recording, np.zeros(len(model.parameters)))


def test_missing_input_of_a_deflected_model_is_named() -> None:
    model = planar() + effects.viscous_drag() + effects.tip_flexibility()
    theta = np.array([p.nominal if np.isfinite(p.nominal) else 50.0 for p in model.parameters])
    with pytest.raises(InputError, match="the model needs the signal 'v"):
        model_response(model, recording_of(np.zeros(50), 0.02), theta)
