"""Leakage: the transient of coloured noise at the record's ends, projected out of the whitened Fourier lines."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import inf

import numpy as np
import scipy  # loads scipy.linalg with its first use
from numpy.typing import NDArray

from estimation.noise.power_spectrum import PowerSpectrum, power_levels
from estimation.noise.whitening import FourierLineWhitener

Array = NDArray[np.float64]
Lines = NDArray[np.complex128]

FIRST_INNOVATIONS = 4
"""First samples of the record at which coloured noise may have an unknown innovation: all that the transient of an
autoregression of that order needs, and some room for the error of an estimated spectrum."""
PAST_INNOVATIONS = 32
"""Samples before the record whose innovations its first samples still show: all that the transient of a filter of that
order needs, such as an average over as many samples."""
LEAST_LEAKAGE = 1.0
"""Length of the whitened response to unit innovations before the record from which on it is projected out: as loud in
one row as the noise itself. An estimated spectrum of white noise has up to this by chance, at its lowest lines."""
MAX_SPECTRUM_ROUNDS = 8
"""Fits of the spectra, each without the leakage that the last ones give."""
SETTLED_SPECTRUM = 0.05
"""Largest change of log S between two rounds that ends them: a fraction of its standard deviation at any line."""
LEAST_REMAINING = 0.5
"""Share of a line's noise that must remain after a projection for its ordinate to be used."""


def without_leakage(
    plain: FourierLineWhitener,
    spectra: tuple[PowerSpectrum, ...],
    dt: float,
    tones: Array | None = None,
    judged: int = 0,
) -> FourierLineWhitener:
    """The whitener with the leakage of the record's ends projected out.

    Coloured noise is not periodic in the record. Whitened across its ends, where the transform continues the end with
    the start, its start does not follow from its end; a drift, which jumps there too, would be falsely significant. The
    initial state of the noise is therefore free: its `transients` are projected out of every column, and the result
    is scaled so that the squares of noise still add up to the number of rows.
    The series `tones` (n, p, k) are projected out too; the first `judged` of them at the excited lines only, so that
    they stay testable at the non-excited ones.
    """
    period = plain.samples // plain.repeats
    excited = plain.steady_state(_by_channel(transients(spectra, period, dt)))
    non_excited = np.zeros((0, 1))
    if len(plain.non_excited_lines):
        non_excited = plain.non_excited(_by_channel(transients(spectra, plain.samples, dt)))
    if tones is not None and tones.size:
        rows = plain.series(tones)
        excited = np.hstack([excited, rows[: plain.periodic_rows]])
        non_excited = np.hstack([non_excited, rows[plain.periodic_rows :, judged:]])
    return replace(plain, excited_leakage=_directions(excited), non_excited_leakage=_directions(non_excited))


def _by_channel(series: Sequence[Array]) -> Array:
    """Series (n, k) of each of p channels as readings (n, p, sum of k) of that channel alone."""
    found = np.zeros((len(series[0]), len(series), sum(s.shape[1] for s in series)))
    first = 0
    for channel, own in enumerate(series):
        found[:, channel, first : first + own.shape[1]] = own
        first += own.shape[1]
    return found


def _directions(columns: Array) -> Array:
    """Orthonormal directions (k, rows) of the span of columns (rows, k); NumPy's QR takes twice as long for them."""
    if not columns.size:
        return np.zeros((0, len(columns)))
    basis = scipy.linalg.qr(columns, mode="economic", overwrite_a=True, check_finite=False)[0]
    return np.ascontiguousarray(basis.T)


def transients(spectra: tuple[PowerSpectrum, ...], n: int, dt: float) -> list[Array]:
    """Series (n, k) of each channel in whose span the leakage of its noise over n samples is.

    The noise is the response to unit innovations of the causal series whose transform has the modulus sqrt(S): minimum
    phase, by folding the cepstrum. The series are its responses to innovations at the first samples and, as far as
    `LEAST_LEAKAGE` of them is not in the span of these, to innovations before the record, for which the transform,
    which continues the end with the start, has those at the end. All responses of an autoregression are in the span of
    the first ones; those of a filter with zeros are not, and a low-pass has zeros.
    """
    frequency = np.maximum(np.arange(n // 2 + 1), 1) / (n * dt)
    cepstrum = np.fft.irfft(np.log(power_levels(spectra, frequency)) / 2, n=n, axis=0)
    cepstrum[1 : (n + 1) // 2] *= 2
    cepstrum[n // 2 + 1 :] = 0
    log_response = np.fft.rfft(cepstrum, axis=0)
    responses, inverses = (np.fft.irfft(np.exp(sign * log_response), n=n, axis=0).T for sign in (1, -1))
    return [_transients(response, inverse) for response, inverse in zip(responses, inverses, strict=True)]


def _transients(response: Array, inverse: Array) -> Array:
    """Transients (n, k) of a channel of this impulse response h (n,), whitened by the inverse response g (n,).

    Whitened, the response to an innovation at one of the first samples is 1 there and else 0. That to one k samples
    before the record, h_(t+k) at t < n - k, is the circular one, 1 at n - k, less what the h_0 .. h_(k-1) there give:
    the sum over i = 1 .. k of h_(k-i) g_(t+i).
    """
    n = len(response)
    first = np.stack([np.roll(response, delay) for delay in range(FIRST_INNOVATIONS)], axis=1)
    leads = np.arange(1, min(PAST_INNOVATIONS, n // 2) + 1)
    factors = np.triu(scipy.linalg.toeplitz(response[: len(leads)]))
    white = -np.stack([np.roll(inverse, -lead) for lead in leads], axis=1) @ factors
    white[n - leads, leads - 1] += 1
    beyond = white[FIRST_INNOVATIONS:]
    if np.linalg.norm(beyond) <= LEAST_LEAKAGE:
        return first
    _, length, directions = np.linalg.svd(np.linalg.qr(beyond, mode="r"))
    past = scipy.linalg.hankel(response, np.zeros(len(leads) + 1))[:, 1:]
    return np.hstack([first, (past - first @ white[:FIRST_INNOVATIONS]) @ directions[length > LEAST_LEAKAGE].T])


def line_powers(spectra: tuple[PowerSpectrum, ...], n: int, period: int, dt: float) -> Array:
    """Noise power (n // 2 + 1, p) by which lines of n samples are weighted: a steep spectrum with its leakage.

    At least the expected power of the lines of one period: the transform of the autocovariance times
    1 - |lag| / period. That bounds the range of the powers: otherwise a filtered sensor's lines above its corner, where
    there is next to no noise, would be all that counts, and what a model says of an edge between two samples is not
    right to a millionth. The rows of such lines have less than unit variance.
    """
    levels = power_levels(spectra, np.maximum(np.arange(n // 2 + 1), 1) / (n * dt))
    if spectra[0].nyquist == inf:
        return levels
    lag = np.minimum(np.arange(n), n - np.arange(n))
    covariance = np.fft.irfft(levels, n=n, axis=0) * np.maximum(1 - lag / period, 0.0)[:, None]
    return np.asarray(np.maximum(levels, np.fft.rfft(covariance, axis=0).real))


def leakage_free(
    lines: Lines,
    index: NDArray[np.intp],
    n: int,
    period: int,
    dt: float,
    smoothed: Callable[[Lines, float], tuple[PowerSpectrum, ...]],
    *,
    start: Lines | None = None,
    disturbances: Lines | None = None,
) -> tuple[tuple[PowerSpectrum, ...], Lines]:
    """Spectra and lines (..., m, p) of series of n samples without leakage, from the lines `index` (m,) with it.

    Where a spectrum falls steeply, leakage of its large values exceeds the small ones: the spectrum `smoothed` from
    lines as they are is the leakage's, and its lines are not independent, as all of them show the same few values at
    the record's ends. So the `transients` that the spectra give, and lines of `disturbances` (m, k), are projected out
    of the lines over the root of `line_powers`, which are scaled to their former variance, the spectra are smoothed
    again, up to half the sampling rate (their `nyquist`), and so on until they stay the same. Where the leakage is
    within the first innovations the lines are returned as they are: `start`, by default the lines given.
    """
    found = lines if start is None else start
    known = np.zeros((len(index), 0)) if disturbances is None else disturbances
    spectra, frequency = smoothed(found, inf), index / (n * dt)
    for _ in range(MAX_SPECTRUM_ROUNDS):
        series = transients(spectra, n, dt)
        if max(s.shape[1] for s in series) == FIRST_INNOVATIONS:
            break
        weights, before = 1 / np.sqrt(line_powers(spectra, n, period, dt)[index]), power_levels(spectra, frequency)
        columns = [np.hstack([np.fft.rfft(own, axis=0)[index], known]).astype(np.complex128) for own in series]
        found = np.stack([_projected(lines[..., c], own, weights[:, c]) for c, own in enumerate(columns)], axis=-1)
        spectra = smoothed(found, 1 / (2 * dt))
        if np.abs(np.log(power_levels(spectra, frequency) / before)).max() < SETTLED_SPECTRUM:
            break
    return spectra, found


def _projected(lines: Lines, columns: Lines, weight: Array) -> Lines:
    """Lines (..., m) less what columns (m, k) explain of them under a weight (m,), scaled to their former variance.

    As they are where less than `LEAST_REMAINING` of the variance remains.
    """
    directions = _directions(_real_rows(columns.T * weight).T)
    rows = _real_rows(lines * weight)
    real, imaginary = np.split(rows - (rows @ directions.T) @ directions, 2, axis=-1)
    remaining = 1 - (directions**2).sum(axis=0).reshape(2, -1).sum(axis=0) / 2
    scaled = (real + 1j * imaginary) / (weight * np.sqrt(np.maximum(remaining, LEAST_REMAINING)))
    return np.where(remaining > LEAST_REMAINING, scaled, lines)


def _real_rows(lines: Lines) -> Array:
    """Real, then imaginary parts (..., 2 m) of lines (..., m)."""
    return np.concatenate([lines.real, lines.imag], axis=-1)
