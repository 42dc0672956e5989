"""Leakage of coloured noise at a record's ends: its transients, and spectra that fall further than it does.

The oracle is the noise's own filter: SciPy's responses to its initial states, and its frequency response.
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import butter, freqz, lfilter

from estimation.noise.power_spectrum import (
    FIRST_INNOVATIONS,
    LEAST_LEAKAGE,
    PowerSpectrum,
    _transients,
    leakage_free,
    line_powers,
    smooth_power_spectra,
)

Array = NDArray[np.float64]
Lines = NDArray[np.complex128]

SAMPLES = 1000
IMPULSE = np.eye(1, SAMPLES)[0]


def polynomial(*roots: complex) -> Array:
    """Coefficients of the polynomial with these roots, which are real or conjugate pairs."""
    return np.asarray(np.poly(roots).real, dtype=np.float64)


FILTERS: dict[str, tuple[Array, Array]] = {
    "low-pass": (polynomial(-0.9, -0.8), polynomial(0.8 * np.exp(0.5j), 0.8 * np.exp(-0.5j))),
    "average": (polynomial(*0.98 * np.exp(2j * np.pi * np.arange(1, 12) / 12)), polynomial()),
    "autoregression": (polynomial(), polynomial(0.9, 0.6, -0.4)),
    "white": (polynomial(), polynomial()),
}
"""Numerator and denominator; the zeros of the first two, near the unit circle, do not let them forget at once."""


def whitened_states(numerator: Array, denominator: Array) -> Array:
    """Whitened responses (n, k) of a filter to unit innovations before the record, the last one first."""
    long = lfilter(numerator, denominator, np.eye(1, SAMPLES + 100)[0])
    past = np.stack([long[k : k + SAMPLES] for k in range(1, 41)], axis=1)
    return np.asarray(lfilter(denominator, numerator, past, axis=0))


@pytest.mark.parametrize("name", FILTERS)
def test_transients_hold_what_innovations_before_the_record_leave_in_it(name: str) -> None:
    """Whatever they were, what is left of each has less than the noise's power in any direction."""
    numerator, denominator = FILTERS[name]
    found = _transients(lfilter(numerator, denominator, IMPULSE), lfilter(denominator, numerator, IMPULSE))
    states = whitened_states(numerator, denominator)
    span = np.linalg.qr(lfilter(denominator, numerator, found, axis=0))[0]
    assert np.linalg.norm(states - span @ (span.T @ states), 2) < LEAST_LEAKAGE
    needed = int((np.linalg.svd(states[FIRST_INNOVATIONS:], compute_uv=False) > LEAST_LEAKAGE).sum())
    assert found.shape[1] == FIRST_INNOVATIONS + needed
    assert (needed > 0) == (name in ("low-pass", "average"))


def smoothed(lines: Lines, nyquist: float) -> tuple[PowerSpectrum, ...]:
    """Spectra of lines (m, p), all but those at both ends."""
    frequency = np.arange(1, len(lines) + 1) / SAMPLES
    return smooth_power_spectra(frequency, np.abs(lines) ** 2 / SAMPLES, nyquist=nyquist)


@pytest.mark.parametrize("floor", [0.0, 0.01])
@pytest.mark.parametrize("corner", [0.1, 0.2])
def test_spectrum_of_a_filtered_series_is_not_that_of_its_leakage(corner: float, floor: float) -> None:
    """Up to 0.45 of the rate, where the power is down to a millionth and the leakage of this record is at 1e-3.

    In each of nine bands of 50 lines and 6 series the mean of log S errs by 1 / sqrt(300) = 0.06: 0.35 is 6 std.
    """
    numerator, denominator = butter(2, 2 * corner)
    rng = np.random.default_rng(0)
    series = lfilter(numerator, denominator, rng.standard_normal((SAMPLES + 500, 6)), axis=0)[500:]
    series = series + floor * rng.standard_normal(series.shape)
    lines = np.fft.rfft(series, axis=0)[1:-1]
    index = np.arange(1, len(lines) + 1)
    spectra, free = leakage_free(lines, index, SAMPLES, SAMPLES, 1.0, smoothed)
    true = np.abs(freqz(numerator, denominator, 2 * np.pi * index / SAMPLES)[1]) ** 2 + floor**2
    error = np.log(np.stack([s(index / SAMPLES) for s in spectra], axis=1) / true[:, None])
    bands = error[:450].reshape(9, 50, -1).mean(axis=(1, 2))
    assert np.abs(bands).max() < 0.35, bands
    ordinates = (np.abs(free) ** 2 / SAMPLES / true[:, None])[:450].reshape(9, 50, -1).mean(axis=(1, 2))
    assert np.abs(ordinates - 1).max() < 0.35, ordinates


def test_lines_count_by_no_less_than_what_leaks_into_them() -> None:
    """The mean periodogram of 400 filtered series of one period, within 5 of its std of a twentieth."""
    numerator, denominator = butter(2, 0.2)
    rng = np.random.default_rng(1)
    noise = lfilter(numerator, denominator, rng.standard_normal((SAMPLES + 500, 400)), axis=0)[500:]
    lines = np.fft.rfft(noise, axis=0)
    spectra, _ = leakage_free(lines[1:-1, :6], np.arange(1, SAMPLES // 2), SAMPLES, SAMPLES, 1.0, smoothed)
    powers = line_powers(spectra, SAMPLES, SAMPLES, 1.0)[5:-5].mean(axis=1)
    assert np.abs(np.log(powers / (np.abs(lines) ** 2 / SAMPLES).mean(axis=1)[5:-5])).max() < 0.6
