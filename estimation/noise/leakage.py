"""Leakage: the transient of coloured noise at the record's ends, projected out of the whitened Fourier lines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy  # loads scipy.linalg with its first use
from numpy.typing import NDArray

from estimation.noise.power_spectrum import PowerSpectrum, power_levels
from estimation.noise.whitening import FourierLineWhitener

Array = NDArray[np.float64]

LEAKAGE_SAMPLES = 4
"""First samples of the periodically continued record at which coloured noise may have an unknown innovation."""


def without_leakage(
    plain: FourierLineWhitener,
    spectra: tuple[PowerSpectrum, ...],
    dt: float,
    tones: Array | None = None,
    judged: int = 0,
) -> FourierLineWhitener:
    """The whitener with the leakage of the record's ends projected out.

    Coloured noise is not periodic in the record. Whitened across its ends, where the transform continues the end with
    the start, the first few samples are wrong, by the same amount in all lines; a drift, which jumps there too, would
    be falsely significant. The initial state of the noise is therefore free, as in an autoregression conditional on
    its first samples: the noise's impulse responses at each of them are projected out of every column, and the result
    is scaled so that the squares of noise still add up to the number of rows.
    The series `tones` (n, p, k) are projected out too; the first `judged` of them at the excited lines only, so that
    they stay testable at the non-excited ones.
    """
    period = plain.samples // plain.repeats
    excited = plain.steady_state(impulse_responses(spectra, period, dt))
    non_excited = np.zeros((0, 1))
    if len(plain.non_excited_lines):
        non_excited = plain.non_excited(impulse_responses(spectra, plain.samples, dt))
    if tones is not None and tones.size:
        rows = plain.series(tones)
        excited = np.hstack([excited, rows[: plain.periodic_rows]])
        non_excited = np.hstack([non_excited, rows[plain.periodic_rows :, judged:]])
    return replace(plain, excited_leakage=_directions(excited), non_excited_leakage=_directions(non_excited))


def _directions(columns: Array) -> Array:
    """Orthonormal directions (k, rows) of the span of columns (rows, k); NumPy's QR takes twice as long for them."""
    if not columns.size:
        return np.zeros((0, len(columns)))
    basis = scipy.linalg.qr(columns, mode="economic", overwrite_a=True, check_finite=False)[0]
    return np.ascontiguousarray(basis.T)


def impulse_responses(spectra: tuple[PowerSpectrum, ...], n: int, dt: float) -> Array:
    """Impulse responses (n, p, p LEAKAGE_SAMPLES) of the noise to a unit innovation in one channel at a first sample.

    The causal series whose transform has the modulus sqrt(S): minimum phase, by folding the cepstrum.
    """
    p = len(spectra)
    series = np.zeros((n, p, p * LEAKAGE_SAMPLES))
    frequency = np.maximum(np.arange(n // 2 + 1), 1) / (n * dt)
    cepstrum = np.fft.irfft(np.log(power_levels(spectra, frequency)) / 2, n=n, axis=0)
    cepstrum[1 : (n + 1) // 2] *= 2
    cepstrum[n // 2 + 1 :] = 0
    response = np.fft.irfft(np.exp(np.fft.rfft(cepstrum, axis=0)), n=n, axis=0)
    for delay in range(LEAKAGE_SAMPLES):
        delayed = np.roll(response, delay, axis=0)
        series[:, np.arange(p), np.arange(p) * LEAKAGE_SAMPLES + delay] = delayed
    return series
