"""Noise as a weight: lines and time, simulated generalised least squares, and what does not close on itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import solve_toeplitz
from scipy.stats import chi2

from design.information import Experiment
from modeling.chain.model import planar, spatial
from modeling.errors import InputError
from modeling.noise import ColouredNoise, NoiseModel
from tests.shared.information_cases import (
    PERIOD,
    RIG,
    SAMPLES,
    SPECTRUM,
    STD,
    Array,
    assert_alike,
    gram,
    joint_states,
    motion,
)
from tests.shared.rigs import ARM

CORRELATION: Array = np.array([[1.0, 0.3, 0.0], [0.3, 1.0, -0.2], [0.0, -0.2, 1.0]])


def test_a_flat_spectrum_is_white_noise() -> None:
    flat = ColouredNoise(np.array([0.0, 10.0]), np.tile(np.diag(STD**2), (2, 1, 1)))
    white = Experiment.of(planar(), ARM, noise=NoiseModel.white(STD)).information(motion(), SAMPLES)
    assert_alike(Experiment.of(planar(), ARM, noise=flat).information(motion(), SAMPLES), white, 1e-12)
    weighted = Experiment.of(planar(), ARM).columns(*joint_states(), PERIOD) / STD[:, None]
    assert_alike(white, gram(weighted), 1e-13)


@pytest.mark.parametrize("samples", [40, 41])
def test_coloured_information_is_the_sum_over_lines(samples: int) -> None:
    """sum over all lines, negative frequencies too, of S(f)^H C(f)^-1 S(f), S(f) = sum_t S_t exp(-..) / sqrt(N)."""
    experiment = Experiment.of(planar(), ARM)
    columns = experiment.columns(*joint_states(samples=samples), PERIOD)
    lines = np.fft.fft(columns, axis=0, norm="ortho")
    frequency = np.fft.fftfreq(samples, PERIOD / samples)
    total = np.zeros((6, 6), dtype=complex)
    for f, line in zip(frequency, lines, strict=True):
        covariance = SPECTRUM.at(np.array([abs(f)]))[0]
        covariance = covariance.conj() if f < 0 else covariance
        if f == 0 or 2 * abs(f) * PERIOD == samples:
            covariance = covariance.real.astype(complex)
        total += line.conj().T @ np.linalg.solve(covariance, line)
    found = gram(replace(experiment, noise=SPECTRUM).columns(*joint_states(samples=samples), PERIOD))
    assert np.abs(total.imag).max() < 1e-10 * np.abs(total).max()
    assert_alike(found, total.real, 1e-12)


def test_an_autoregression_weights_as_its_spectrum() -> None:
    """Stationary over the period: the innovations of a periodic series are its lines times 1 - sum a exp(-i w)."""
    coefficients, innovations = np.array([[0.6, 0.3, -0.2], [0.2, 0.1, 0.3]]), np.diag(STD) @ CORRELATION @ np.diag(STD)
    frequency = np.fft.rfftfreq(SAMPLES, PERIOD / SAMPLES).astype(np.float64)
    shift = np.exp(-2j * np.pi * np.outer(np.arange(SAMPLES // 2 + 1), [1, 2]) / SAMPLES)
    response = 1 / (1 - shift @ coefficients)
    spectrum = response[:, :, None] * innovations * response[:, None, :].conj()
    coloured = Experiment.of(planar(), ARM, noise=ColouredNoise(frequency, spectrum)).information(motion(), SAMPLES)
    noise = NoiseModel(innovations, coefficients)
    assert not noise.is_white
    assert_alike(Experiment.of(planar(), ARM, noise=noise).information(motion(), SAMPLES), coloured, 1e-10)
    with pytest.raises(InputError, match="averages over blocks"):
        replace(noise, block=2).whitened(np.zeros((SAMPLES, 3)), PERIOD / SAMPLES)


def noise_series(rng: np.random.Generator, count: int, samples: int) -> Array:
    """Noise (count, N, 3) of the spectrum that closes on itself over the period."""
    covariance = SPECTRUM.at(np.fft.rfftfreq(samples, PERIOD / samples))
    covariance[0], covariance[-1] = covariance[0].real, covariance[-1].real
    white = np.fft.rfft(rng.standard_normal((count, samples, 3)), axis=1)
    return np.fft.irfft(np.einsum("lcd,nld->nlc", np.linalg.cholesky(covariance), white), n=samples, axis=1)


def test_information_is_the_inverse_covariance_of_generalised_least_squares() -> None:
    """2000 simulated periods: their estimates scatter as M^-1 says, as a Wishart matrix does about its mean.

    The whitened scatter matrix A ~ W_6(n, I): its trace is chi-square with 6 n degrees of freedom, and its extreme
    eigenvalues over n = 2000 are (1 +- sqrt(6/n))² = 0.89 and 1.11 with a spread of 0.02. Failure probability 1e-5,
    seeded.
    """
    samples, count, rng = 100, 2000, np.random.default_rng(5)
    experiment = Experiment.of(planar(), ARM, noise=SPECTRUM)
    rows = experiment.columns(*joint_states(samples=samples), PERIOD).reshape(-1, 6)
    noise = noise_series(rng, count, samples)
    whitened = SPECTRUM.whitened(np.moveaxis(noise, 0, 2), PERIOD / samples).reshape(-1, count)
    assert np.mean(whitened**2) == pytest.approx(1.0, abs=5 * np.sqrt(2 / whitened.size))  # five standard deviations
    estimates = np.linalg.lstsq(rows, whitened, rcond=None)[0]
    root = np.linalg.cholesky(experiment.information(motion(), samples))
    scatter = root.T @ estimates @ estimates.T @ root
    assert 5e-7 < float(chi2.cdf(np.trace(scatter), 6 * count)) < 1 - 5e-7
    assert np.linalg.eigvalsh(scatter / count) == pytest.approx(np.ones(6), abs=0.2)
    ordinary = np.linalg.pinv(
        Experiment.of(planar(), ARM).columns(*joint_states(samples=samples), PERIOD).reshape(-1, 6)
    )
    worse = ordinary @ noise.reshape(count, -1).T
    assert np.all(np.var(worse, axis=1) > 0.9 * np.diag(np.linalg.inv(root @ root.T)))  # Gauss-Markov, 3 spreads


def test_noise_that_does_not_close_on_itself_differs_by_its_leakage() -> None:
    """First-order autoregression over many periods against generalised least squares with its whole covariance.

    The information per period is that of the lines up to a share of the order of (correlation time / record).
    """
    repeats, pole = 10, 0.8
    spectrum_at = np.linspace(0, 20, 400)
    power = (1 - pole**2) / np.abs(1 - pole * np.exp(-2j * np.pi * spectrum_at * PERIOD / SAMPLES)) ** 2
    noise = ColouredNoise.of_spectra(spectrum_at, np.tile(power[:, None], (1, 3)))
    experiment = Experiment.of(planar(), ARM, noise=noise)
    predicted_information = repeats * experiment.information(motion(), SAMPLES)
    columns = np.tile(Experiment.of(planar(), ARM).columns(*joint_states(), PERIOD), (repeats, 1, 1))
    covariance = pole ** np.arange(float(len(columns)))
    exact = np.sum([columns[:, c].T @ solve_toeplitz(covariance, columns[:, c]) for c in range(3)], axis=0)
    correlation_time = (1 + pole) / (1 - pole)
    share = correlation_time / len(columns)
    assert np.log(np.linalg.det(np.linalg.solve(exact, predicted_information))) == pytest.approx(0, abs=6 * share)


def test_noise_of_a_rig() -> None:
    np.testing.assert_allclose(NoiseModel.of_rig(RIG, planar().channels).root, np.diag(1 / STD))
    with pytest.raises(InputError, match="fz, tx, ty, tz"):
        NoiseModel.of_rig(RIG, spatial().channels)
    with pytest.raises(InputError, match="positive definite"):
        NoiseModel.white([1.0, 0.0, 1.0])
    with pytest.raises(InputError, match="increasing"):
        ColouredNoise.of_spectra(np.array([1.0, 0.5]), np.ones((2, 3)))
