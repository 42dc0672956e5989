"""Derivatives against analytic ones."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.signal import lfilter

from estimation.recordings.differentiation import (
    fourier_derivatives,
    fourier_or_spline_derivatives,
    highest_excited_line,
    line_noise_floor,
    spline_derivatives,
)

Array = NDArray[np.float64]
SAMPLES, DT = 1000, 0.005


def times(samples: int, dt: float) -> Array:
    return np.linspace(0.0, samples * dt, samples, endpoint=False)


def harmonics(amplitudes: Array, phases: Array, shift: float = 0.0) -> tuple[Array, Array, Array]:
    """Value and two derivatives, (SAMPLES, 1), of sum a sin(w t + p) at harmonics 1 + shift, 2 + shift, .."""
    rate = 2 * np.pi * (np.arange(1, len(amplitudes) + 1) + shift) / (SAMPLES * DT)
    angle = rate * (np.arange(SAMPLES) * DT)[:, None] + phases
    value, first = (amplitudes * np.sin(angle)).sum(1), (amplitudes * rate * np.cos(angle)).sum(1)
    return value[:, None], first[:, None], -(amplitudes * rate**2 * np.sin(angle)).sum(1)[:, None]


@given(st.integers(1, 12), st.integers(0, 2**32 - 1), st.sampled_from([0.0, -0.5]))
def test_periodic_motion_without_noise_is_exact(lines: int, seed: int, shift: float) -> None:
    rng = np.random.default_rng(seed)
    value, first, second = harmonics(rng.uniform(0.1, 1, lines), rng.uniform(0, 6, lines), shift)
    fit = fourier_derivatives(value, DT, antiperiodic=shift != 0)
    # Rounding of 1e-15 times (2 pi h / T)² with a few hundred lines kept at most.
    np.testing.assert_allclose(fit.value, value, atol=1e-12)
    np.testing.assert_allclose(fit.first, first, atol=1e-10)
    np.testing.assert_allclose(fit.second, second, atol=1e-8)


@pytest.mark.parametrize("samples", [49, 98, 103, 107, 187, 196, 206, 347])
def test_no_line_is_lost_whatever_the_number_of_samples(samples: int) -> None:
    """Their numbers are whole; n (1 / n) is not 1 for each n here."""
    assert samples * (1 / samples) != 1
    t = 2 * np.pi * np.arange(samples) / samples
    for line in range(1, 12):
        fit = fourier_derivatives(np.sin(line * t)[:, None], 2 * np.pi / samples)
        np.testing.assert_allclose(fit.second[:, 0], -(line**2) * np.sin(line * t), atol=1e-8)


@pytest.mark.parametrize("resolution", [1e-4, 7.4e-6])
def test_quantisation_beyond_the_motion_is_left_out(resolution: float) -> None:
    rng = np.random.default_rng(1)
    value, _, second = harmonics(rng.uniform(0.1, 0.3, 5), rng.uniform(0, 6, 5))
    fit = fourier_derivatives(np.round(value / resolution) * resolution, DT)
    # White quantisation noise on five of 500 lines, each times at most w_5².
    noise = resolution / np.sqrt(12) * np.sqrt(2 * 6 / SAMPLES) * (2 * np.pi * 5 / (SAMPLES * DT)) ** 2
    assert np.std(fit.second - second) < 2 * noise


def test_a_gap_in_the_lines_does_not_end_the_motion() -> None:
    rng = np.random.default_rng(2)
    power = rng.exponential(size=501)
    power[[1, 2, 40]] = 1e6
    assert highest_excited_line(power) == 40


def test_pure_noise_has_no_lines() -> None:
    rng = np.random.default_rng(3)
    kept = [highest_excited_line(rng.exponential(size=501)) > 0 for _ in range(300)]
    # One of a hundred by design; the floor is itself an estimate. 300 trials at 3 % exceed 6 % once in 400.
    assert np.mean(kept) < 0.06


@pytest.mark.parametrize("slope", [0.0, -1.0, -2.0])
def test_floor_follows_coloured_noise(slope: float) -> None:
    rng = np.random.default_rng(4)
    truth = np.maximum(np.arange(2001.0), 1) ** slope
    ratio = line_noise_floor(rng.exponential(size=2001) * truth) / truth
    assert 0.7 < np.median(ratio) < 1.4
    assert 0.2 < ratio[5] < 5.0  # extrapolated two decades down


def tones(t: Array) -> tuple[Array, Array, Array]:
    """Motion that ends anywhere: three tones."""
    a, w, p = np.array([0.3, 0.2, 0.1]), 2 * np.pi * np.array([0.5, 1.1, 2.3]), np.array([1, 2, 0.4])
    angle = w * t[:, None] + p
    return (a * np.sin(angle)).sum(1), (a * w * np.cos(angle)).sum(1), -(a * w**2 * np.sin(angle)).sum(1)


def dwelling_move(t: Array) -> tuple[Array, Array, Array]:
    """A minimum-jerk move of 3 rad between two dwells."""
    length = 0.4 * t[-1]
    s = np.clip((t / t[-1] - 0.3) / 0.4, 0, 1)
    value, first = 10 * s**3 - 15 * s**4 + 6 * s**5, 30 * s**2 - 60 * s**3 + 30 * s**4
    return 3 * value, 3 * first / length, 3 * (60 * s - 180 * s**2 + 120 * s**3) / length**2


@pytest.mark.parametrize(("samples", "dt"), [(4000, 0.002), (20000, 0.001)])
@pytest.mark.parametrize("motion", [tones, dwelling_move])
@pytest.mark.parametrize(("noise", "share"), [(1e-6, 0.003), (1e-4, 0.015), (1e-3, 0.05)])
def test_single_run(motion: Callable[[Array], tuple[Array, ...]], samples: int, dt: float, noise: float,
                    share: float) -> None:  # fmt: skip
    value, first, second = motion(times(samples, dt))
    noisy = value + noise * np.random.default_rng(5).standard_normal(samples)
    fit = spline_derivatives(noisy[:, None], dt)
    error = np.abs(fit.second[:, 0] - second)
    # Shares of the acceleration's RMS, about twice what a cutoff at the signal's own floor leaves.
    assert np.std(fit.value[:, 0] - value) < 0.5 * noise
    assert np.std(fit.first[:, 0] - first) < share * np.std(first)
    assert np.sqrt(np.mean(error**2)) < 2 * share * np.std(second)
    assert error.max() < np.abs(second).max()  # nothing wild at the ends


def test_coloured_noise_is_not_taken_for_motion() -> None:
    value, _, second = dwelling_move(times(4000, 0.002))
    white = np.random.default_rng(6).standard_normal(4000)
    noise = 1e-4 * np.sqrt(1 - 0.95**2) * lfilter([1.0], [1.0, -0.95], white)
    fit = spline_derivatives((value + noise)[:, None], 0.002)
    error = np.abs(fit.second[:, 0] - second)
    # A cutoff by white noise's rules errs by 80 % in RMS, and by many times the largest at the ends.
    assert np.sqrt(np.mean(error**2)) < 0.25 * np.std(second)
    assert error.max() < np.abs(second).max()


def test_constant_is_constant() -> None:
    for fit in (spline_derivatives(np.full((500, 2), 0.3), 0.01), fourier_derivatives(np.full((500, 2), 0.3), 0.01)):
        np.testing.assert_allclose(fit.value, 0.3, atol=1e-12)
        np.testing.assert_allclose(fit.second, 0.0, atol=1e-8)


def test_separate_runs_need_not_close() -> None:
    t = times(SAMPLES, DT)
    rng = np.random.default_rng(7)
    closed = harmonics(np.array([0.3, 0.2, 0.1]), np.array([0.1, 1.0, 2.0]))
    opened = tuple(series[:, None] for series in dwelling_move(t))
    for value, _, second in (closed, opened):
        fit = fourier_or_spline_derivatives(value + 1e-6 * rng.standard_normal(value.shape), DT)
        assert np.std(fit.second - second) < 0.01 * np.std(second)
    periodic, spline = (describe(closed[0], DT).score for describe in (fourier_derivatives, spline_derivatives))
    assert periodic[0] < spline[0]
