"""Whitened rows: exactly white for noise whose covariance is known, nearly so for noise that had to be estimated.

A whitener is linear: fed with the unit vectors it gives its own matrix W, and W C W' is the covariance of its rows.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_lyapunov

from estimation import autoregression
from estimation.autoregression import fit_autoregression
from estimation.model_response import ModelResponse
from estimation.noise.noise_estimation import estimate_noise
from estimation.noise.recording_noise import RecordingNoise
from estimation.noise.whitening import AutoregressiveWhitener, FourierLineWhitener, Whitener
from estimation.recordings.reading import from_columns
from estimation.recordings.recording import Recording
from modeling.noise import NoiseModel, NoiseSource, inverse_cholesky_factor
from modeling.rig import PLANAR_CHANNELS, Rig, SensorDescription
from truewrench.simulated_rig import NOISE_MODELS

Array = NDArray[np.float64]

P = 3
MIXING: Array = np.array([[1.0, 0.0, 0.0], [0.8, 0.5, 0.0], [-0.012, 0.016, 0.012]])
"""From independent channels to correlated ones of other sizes."""


def matrix_of(whitener: Whitener, samples: int) -> Array:
    """W (rows, samples P)."""
    return whitener.series(np.eye(samples * P).reshape(samples, P, samples * P))


# ------------------------------------------------------------------------------------ exact: lines


def levels(samples: int) -> Array:
    """Some smooth spectrum of each channel (lines, P), as power of one sample."""
    line = np.arange(samples // 2 + 1)[:, None] / samples
    return np.asarray(0.3 + np.array([3.0, 0.1, 1.0]) / (0.05 + line * np.array([1.0, 3.0, 0.2])))


def line_whitener(samples: int, repeats: int) -> tuple[FourierLineWhitener, Array]:
    """The whitener of circular noise, coloured and correlated, and that noise's covariance (n P, n P)."""
    index = np.arange(samples // 2 + 1)
    motion, between = index[index % repeats == 0], index[index % repeats != 0]
    spectra = np.einsum("ij,lj,kj->lik", MIXING, levels(samples), MIXING)
    root = np.stack([inverse_cholesky_factor(spectra[i]) for i in np.concatenate([motion, between])]).astype(complex)
    # covariance at lag t: (1/n) sum over all lines of S exp(2 pi i k t / n)
    lags = np.fft.irfft(spectra, n=samples, axis=0)
    shift = (np.arange(samples)[:, None] - np.arange(samples)) % samples
    covariance = lags[shift].transpose(0, 2, 1, 3).reshape(samples * P, samples * P)
    return FourierLineWhitener(samples, repeats, motion, between, root), covariance


@pytest.mark.parametrize(("samples", "repeats"), [(24, 3), (30, 2), (27, 3), (21, 1)])
def test_lines_of_known_noise_are_white(samples: int, repeats: int) -> None:
    whitener, covariance = line_whitener(samples, repeats)
    w = matrix_of(whitener, samples)
    assert w.shape == (whitener.rows, samples * P)
    rows = w @ covariance @ w.T
    # Line 0, and the last one of an even number, are real: their imaginary parts are nothing.
    alive = np.abs(w).max(axis=1) > 1e-12
    assert (~alive).sum() == P * (1 + (samples % 2 == 0))
    assert alive.sum() == samples * P
    np.testing.assert_allclose(rows, np.diag(alive.astype(float)), atol=1e-12)  # rounding


@pytest.mark.parametrize(("samples", "repeats"), [(24, 3), (30, 2)])
def test_whitening_loses_no_information(samples: int, repeats: int) -> None:
    """W' W is the inverse of the covariance: the rows' squares add up to the likelihood's quadratic form."""
    whitener, covariance = line_whitener(samples, repeats)
    w = matrix_of(whitener, samples)
    np.testing.assert_allclose(w.T @ w @ covariance, np.eye(samples * P), atol=1e-11)  # rounding, condition 1e4


@settings(deadline=None)
@given(st.integers(1, 5), st.integers(2, 30), st.integers(0, 2**32 - 1))
def test_parseval(repeats: int, once: int, seed: int) -> None:
    """Of white noise of unit variance the rows are a turned picture: the same sum of squares, sample by sample."""
    samples, rng = repeats * once, np.random.default_rng(seed)
    index = np.arange(samples // 2 + 1)
    motion, between = index[index % repeats == 0], index[index % repeats != 0]
    root = np.broadcast_to(np.eye(P, dtype=complex), (len(index), P, P))
    values = rng.standard_normal((samples, P))
    rows = FourierLineWhitener(samples, repeats, motion, between, root).series(values)
    assert rows @ rows == pytest.approx((values**2).sum(), rel=1e-12)  # rounding


# ------------------------------------------------------------------------- exact: autoregressions


COEFFICIENTS: Array = np.array([[1.2, 0.5, 0.0], [-0.4, 0.3, 0.6]])  # (order 2, P), each channel stable


def autoregressive_covariance(samples: int, innovations: Array) -> Array:
    """Of the stationary series x_t = sum_i a_i x_(t-i) + e_t by channel, (n P, n P): from its Lyapunov equation."""
    order = len(COEFFICIENTS)
    step = np.zeros((order * P, order * P))
    step[:P] = np.hstack([np.diag(a) for a in COEFFICIENTS])
    step[P:, :-P] = np.eye((order - 1) * P)
    source = np.zeros_like(step)
    source[:P, :P] = innovations
    state = solve_discrete_lyapunov(step, source)
    lags, power = [], np.eye(order * P)
    for _ in range(samples):
        lags.append((power @ state)[:P, :P])
        power = step @ power
    covariance = np.zeros((samples, P, samples, P))
    for i in range(samples):
        for j in range(samples):
            covariance[i, :, j] = lags[i - j] if i >= j else lags[j - i].T
    return covariance.reshape(samples * P, samples * P)


@pytest.mark.parametrize("samples", [12, 25])
def test_innovations_of_known_noise_are_white(samples: int) -> None:
    innovations = MIXING @ MIXING.T
    whitener = AutoregressiveWhitener(samples, NoiseModel(innovations, COEFFICIENTS))
    w = matrix_of(whitener, samples)
    assert w.shape == (whitener.rows, samples * P) == ((samples - 2) * P, samples * P)
    rows = w @ autoregressive_covariance(samples, innovations) @ w.T
    np.testing.assert_allclose(rows, np.eye(len(w)), atol=1e-10)  # rounding, noise powers from 1e-3 to 10


@pytest.mark.parametrize("first", [3, 7])
def test_innovations_are_what_the_past_does_not_predict(first: int) -> None:
    """Also of channels that are zero, and of a series that ends before its first innovation."""
    model = NoiseModel(np.eye(2), np.array([[0.5, 0.1], [-0.2, 0.3], [0.1, 0.2]]))
    series = np.random.default_rng(3).normal(size=(4, 2, 30))
    series[1, 0], series[2] = 0.0, 0.0
    past = sum(model.coefficients[lag - 1][:, None] * series[..., first - lag : 30 - lag] for lag in (1, 2, 3))
    np.testing.assert_allclose(model.innovations(series, first), series[..., first:] - past, atol=1e-14)
    assert not model.innovations(series, first)[2].any()
    assert model.innovations(series[..., :2], first).shape == (4, 2, 0)


def test_coefficients_are_those_of_least_squares() -> None:
    """Over all samples whose past is free of events, those that only a lower order can use included."""
    rng = np.random.default_rng(1)
    series = NOISE_MODELS["autoregressive"].draw(rng, 700, P) + 0.1 * rng.standard_normal((700, P))
    event_free = np.ones(700, dtype=bool)
    event_free[[*range(100, 130), *range(150, 420, 25)]] = False
    found = fit_autoregression(series, event_free).coefficients
    order = len(found)
    assert 0 < order < 30  # the highest, for which the past is factorised
    rows = [t for t in range(order, 700) if event_free[t - order : t + 1].all()]
    for channel in range(P):
        past = np.array([series[t - order : t, channel][::-1] for t in rows])
        expected = np.linalg.lstsq(past, series[rows, channel], rcond=None)[0]
        np.testing.assert_allclose(found[:, channel], expected, rtol=0, atol=1e-11)  # rounding


@pytest.mark.parametrize("at_once", [1, 7, 500])
def test_rows_factorised_in_parts_give_the_same(at_once: int, monkeypatch: pytest.MonkeyPatch) -> None:
    residual = np.cumsum(np.random.default_rng(4).standard_normal((500, 3)), axis=0)
    free = np.ones(500, dtype=bool)
    free[200:230] = False
    expected = fit_autoregression(residual, free)
    monkeypatch.setattr(autoregression, "ROWS_AT_ONCE", at_once)
    found = fit_autoregression(residual, free)
    np.testing.assert_allclose(found.coefficients, expected.coefficients, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found.covariance, expected.covariance, rtol=1e-9)


@pytest.mark.parametrize("block", [2, 5])
def test_block_means_of_white_noise_are_white(block: int) -> None:
    samples = 23
    whitener = AutoregressiveWhitener(samples, NoiseModel(MIXING @ MIXING.T / block, block=block))
    w = matrix_of(whitener, samples)
    assert len(w) == whitener.rows == samples // block * P
    covariance = np.kron(np.eye(samples), MIXING @ MIXING.T)
    np.testing.assert_allclose(w @ covariance @ w.T, np.eye(len(w)), atol=1e-10)  # rounding


@pytest.mark.parametrize("event", [(8, 13), (0, 4), (17, 20), (0, 1)])
def test_events_count_with_their_own_noise_and_teach_nothing_after(event: tuple[int, int]) -> None:
    """Inside, samples by themselves, ten times less sure; outside as without the event, save the two that follow it."""
    samples, order = 20, len(COEFFICIENTS)
    start, end = event
    noise = NoiseModel(np.eye(P), COEFFICIENTS)
    plain = AutoregressiveWhitener(samples, noise)
    marked = AutoregressiveWhitener(samples, noise, (event,), NoiseModel.white([10.0] * P))
    values = np.random.default_rng(0).normal(size=(samples, P))
    usual, rows = (w.series(values).reshape(-1, P) for w in (plain, marked))
    for t in range(order, samples):
        if start <= t < end:
            expected = 0.1 * values[t]
        elif end <= t < end + order:
            expected = np.zeros(P)
        else:
            expected = usual[t - order]
        np.testing.assert_allclose(rows[t - order], expected, atol=1e-14)  # rounding


def test_a_channel_by_itself_is_whitened_as_among_others_that_are_silent() -> None:
    samples, event = 20, (8, 13)
    noise = NoiseModel(MIXING @ MIXING.T, COEFFICIENTS, 2)
    whitener = AutoregressiveWhitener(samples, noise, (event,), NoiseModel.white([10.0] * P))
    values = np.random.default_rng(1).normal(size=(samples, 4))
    for channel in range(P):
        among = np.zeros((samples, P, 4))
        among[:, channel] = values
        expected = whitener.series(among).reshape(-1, P, 4)[:, channel]
        np.testing.assert_allclose(
            whitener.of_channel(channel).series(values[:, None]), expected, atol=1e-14
        )  # rounding


# --------------------------------------------------------------- repeats of one motion, and responses


def motion_only(samples: int, k: int | None = None) -> Array:
    rng = np.random.default_rng(samples)
    return rng.normal(size=(samples, P) if k is None else (samples, P, k))


@pytest.mark.parametrize(("once", "repeats"), [(8, 3), (15, 2), (9, 3), (21, 1)])
def test_steady_rows_are_those_of_the_tiled_series(once: int, repeats: int) -> None:
    whitener, _ = line_whitener(once * repeats, repeats)
    for part in (motion_only(once), motion_only(once, 4)):
        rows = whitener.series(np.concatenate([part] * repeats))
        steady = whitener.steady_state(part)
        assert len(steady) == whitener.periodic_rows
        np.testing.assert_allclose(rows[: whitener.periodic_rows], steady, atol=1e-12)  # rounding
        np.testing.assert_allclose(rows[whitener.periodic_rows :], 0.0, atol=1e-12)


@pytest.mark.parametrize("passing", [False, True])
def test_rows_of_a_response_are_those_of_its_series(passing: bool) -> None:
    once, repeats, k = 8, 3, 4
    whitener, _ = line_whitener(once * repeats, repeats)
    whole = (motion_only(once * repeats), motion_only(once * repeats, k)) if passing else None
    response = ModelResponse((motion_only(once), motion_only(once, k)), whole, repeats)
    value, derivative = whitener.response(response)
    np.testing.assert_allclose(value, whitener.series(response.value), atol=1e-12)  # rounding
    np.testing.assert_allclose(derivative, whitener.series(response.derivative), atol=1e-12)


# ------------------------------------------------------------------------ noise that was estimated

KINDS = ("white", "autoregressive", "pink_and_lines")


def drawn(kind: str, samples: int, seed: int) -> Array:
    return NOISE_MODELS[kind].draw(np.random.default_rng(seed), samples, P) @ MIXING.T


def recording_of(wrench: Array, repeats: int, *, separate: bool = False, rig: Rig | None = None) -> Recording:
    n = len(wrench)
    once, dt = n // repeats, 0.01
    columns = {name: np.zeros(n) for name in ("phi", "dphi", "ddphi", "ax", "ay")}
    index = np.arange(n, dtype=np.float64)
    columns |= {"time": np.float64(dt) * (index % once if separate else index)}
    columns |= dict(zip(PLANAR_CHANNELS, wrench.T, strict=True))
    if repeats > 1:
        columns["repeat"] = index // once
    return from_columns(columns, rig=rig)


def by_repeats(noise: Array) -> RecordingNoise:
    return estimate_noise(recording_of(noise, 6), noise)


def by_separate_runs(noise: Array) -> RecordingNoise:
    return estimate_noise(recording_of(noise, 6, separate=True), noise)


def by_residual(noise: Array) -> RecordingNoise:
    return estimate_noise(recording_of(noise, 1), noise)


def rows_of(noise: RecordingNoise, values: Array) -> Array:
    """(rows / P, P) of fresh noise, less those that are nothing by construction."""
    rows = noise.whitener.series(values).reshape(-1, P)
    return np.asarray(rows[np.abs(rows).max(axis=1) > 0])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("estimated", "source"),
    [(by_repeats, NoiseSource.REPEATS), (by_separate_runs, NoiseSource.REPEATS), (by_residual, NoiseSource.RESIDUAL)],
)
def test_estimated_noise_whitens_fresh_noise(
    kind: str, estimated: Callable[[Array], RecordingNoise], source: NoiseSource
) -> None:
    """Learnt from one draw, tried on another.

    A mean square of m rows errs by sqrt(2 / m), 1.5 to 3 % here for 3 channels of 1000 to 6000 rows, and the curve that
    it was divided by by as much; a correlation by 1 / sqrt(m). Limits are 4.5 of those (1 in 1e5 for each) and 10 % for
    what a smooth spectrum, or an autoregression in place of pink noise with tones, cannot follow.
    """
    samples = 6000
    noise = estimated(drawn(kind, samples, 1))
    assert noise.source is source
    rows = rows_of(noise, drawn(kind, samples, 2))
    m = len(rows)
    variance = (rows**2).mean(axis=0)
    np.testing.assert_allclose(variance, 1.0, atol=0.1 + 4.5 * np.sqrt(4 / m))
    correlation = rows.T @ rows / m / np.sqrt(np.outer(variance, variance))
    np.testing.assert_allclose(correlation, np.eye(P), atol=0.03 + 4.5 / np.sqrt(m))
    if source is NoiseSource.RESIDUAL and kind != "pink_and_lines":  # tones stay in an autoregression
        following = (rows[1:] * rows[:-1]).mean(axis=0) / variance
        np.testing.assert_allclose(following, 0.0, atol=0.03 + 4.5 / np.sqrt(m))


@pytest.mark.parametrize("kind", KINDS)
def test_motions_lines_are_as_white_as_those_between(kind: str) -> None:
    """Their noise is inferred from their neighbours: 6 draws of 500 lines, 3 channels and two parts each."""
    squares = []
    for seed in range(6):
        noise = by_repeats(drawn(kind, 6000, 100 + seed))
        squares.append(noise.whitener.series(drawn(kind, 6000, 200 + seed))[: noise.whitener.periodic_rows] ** 2)
    rows = np.concatenate(squares)
    assert rows.mean() == pytest.approx(1.0, abs=0.03 + 4.5 * np.sqrt(2 / len(rows)))  # 1 in 1e5


def test_noise_that_the_rig_states_is_divided_by() -> None:
    stated = {"fx": 0.5, "fy": 2.0, "tau": 0.01}
    rig = Rig(sensor=SensorDescription(noise=stated))
    values = drawn("white", 200, 5)
    noise = estimate_noise(recording_of(values, 1, rig=rig), values)
    assert noise.source is NoiseSource.RIG
    rows = noise.whitener.series(values).reshape(-1, P)
    np.testing.assert_allclose(rows, values / np.array(list(stated.values())), rtol=1e-14)  # rounding


@pytest.mark.parametrize("kind", KINDS)
def test_floor_is_the_spread_of_one_sample(kind: str) -> None:
    """Of AR(0.98) noise 6000 samples are worth 60: its variance errs by 18 %, its std by 9 %."""
    values = drawn(kind, 6000, 6)
    np.testing.assert_allclose(by_residual(values).floor, values.std(axis=0), rtol=1e-2)  # the rig's mean stays in
    np.testing.assert_allclose(by_repeats(values).floor, np.linalg.norm(MIXING, axis=1), rtol=0.4)


@pytest.mark.parametrize(("samples", "repeats"), [(24, 3), (30, 2), (27, 3), (21, 1), (20, 4)])
def test_a_transfer_function_is_a_factor_of_the_lines(samples: int, repeats: int) -> None:
    """A series filtered by its spectrum and then whitened; over the whole record, and of one repeat of it."""
    dt, whitener = 0.02, line_whitener(samples, repeats)[0]

    def lag(omega: Array) -> NDArray[np.complex128]:
        return np.asarray(np.exp(-0.7j * dt * omega) / (1 + 0.03j * omega), dtype=np.complex128)

    def filtered(series: Array) -> Array:
        omega = np.asarray(2 * np.pi * np.fft.rfftfreq(len(series), dt), dtype=np.float64)
        lines = np.fft.rfft(series, axis=0)
        lines *= lag(omega)[:, None]
        return np.asarray(np.fft.irfft(lines, n=len(series), axis=0), dtype=np.float64)

    filtering, random = whitener.with_filter(lag, dt), np.random.default_rng(2)
    whole, once = random.normal(size=(samples, P)), random.normal(size=(samples // repeats, P))
    np.testing.assert_allclose(filtering.series(whole), whitener.series(filtered(whole)), atol=1e-12)  # rounding
    np.testing.assert_allclose(filtering.non_excited(whole), whitener.non_excited(filtered(whole)), atol=1e-12)
    np.testing.assert_allclose(filtering.steady_state(once), whitener.steady_state(filtered(once)), atol=1e-12)
