"""Smooth power spectral density from periodogram ordinates by penalised Whittle likelihood, robust against tones."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf

import numpy as np
import scipy  # loads scipy.linalg with its first use
from numpy.typing import NDArray

from estimation.multiplicity import gamma_isf
from estimation.noise.whitening import FourierLineWhitener
from estimation.recordings.smoothing_spline import basis_matrix
from modeling.errors import InputError
from modeling.significance import LEVELS

Array = NDArray[np.float64]

MAX_TONE_ROUNDS = 4
"""Fits of the curve, each without the tones that the last one left above it."""
EULER = 0.5772
"""Mean of -log of an exponential variable of mean one."""
MIN_ORDINATES = 8
"""Ordinates below which a curve of four coefficients and its smoothness are not identifiable."""
CURVATURE_PRIORS = (0.5, 1.0, 32.0)
"""Standard deviations, a priori, of d² log S / d log f² over a unit of log f, from which the marginal likelihood
chooses. The curvature of a first-order corner is 1 at the most, that of 1/f noise meeting a white floor 1/4, that of a
filter of order k is k² at its corner: by 1 alone the spectrum behind one of order 8 is wrong by a factor of two there.
The last is tried only where leakage shows a filter, and not where events and tones are looked for: a freer curve
follows them. The first is not for shapes below 1, of single runs, whose fit and autoregression took lowest lines."""
MANY_ORDINATES = 10.0
"""Of shape 1, in a unit of log f: with fewer there are not four, the coefficients of a cubic, in the width of a corner
of order 2 or more, and the curve is as stiff as by the second prior: a freer one would follow the lines by chance."""
MAX_PIECES = 24
"""Pieces of a spline in log f; twice as many in a `log_frequency` with an end, whose range is about twice as large."""


@dataclass(frozen=True, eq=False)
class PowerSpectrum:
    """log S as a penalised cubic spline in u(f): S(f) in the square of the signal's unit, per sample.

    tones   which of the ordinates were identified as tones and left out of the fit
    freedom effective number of parameters of the curve
    lowest  u of the lowest ordinate; below it the curve is extrapolated under the penalty
    nyquist half the sampling rate (Hz) where the curve is in `log_frequency` below it; infinite for log f
    """

    knots: Array
    coefficients: Array
    covariance: Array
    tones: NDArray[np.bool_]
    freedom: float
    lowest: float
    nyquist: float = inf

    def __call__(self, frequency: Array) -> Array:
        """S at positive frequencies; below the ordinates never less than at the lowest.

        An extrapolation falling towards zero frequency would make drift falsely significant.
        """
        return power_levels([self], frequency)[:, 0]

    def level(self, frequency: Array, basis: Array) -> Array:
        """S at positive frequencies (m,), by `basis` there."""
        curve, below = basis @ self.coefficients, log_frequency(frequency, self.nyquist) < self.lowest
        if below.any():
            curve[below] = np.maximum(curve[below], self._rows(np.array([self.lowest])) @ self.coefficients)
        return np.asarray(np.exp(curve))

    def log_variance(self, frequency: Array) -> Array:
        """Posterior variance of log S at these frequencies; it grows where the curve is extrapolated."""
        return log_power_variances([self], frequency)[:, 0]

    def basis(self, frequency: Array) -> Array:
        """Values (m, j) of the curve's j basis functions at frequencies (m,)."""
        return self._rows(log_frequency(frequency, self.nyquist))

    def mean_log_variance(self, basis: Array, shares: Array) -> Array:
        """Variance (g,) of the mean of log S over frequencies with the weights `shares` (m, g), by `basis` there."""
        loads = basis.T @ shares
        return np.asarray(((self.covariance @ loads) * loads).sum(axis=0))

    def _rows(self, u: Array) -> Array:
        """Basis values at u, constant beyond the end knots."""
        low, high = self.knots[3], self.knots[-4]
        return basis_matrix(np.clip(u, low, high), self.knots, 3)


def log_frequency(frequency: Array, nyquist: float = inf) -> Array:
    """u = log(2 fN / pi tan(pi f / 2 fN)) of positive frequencies (Hz): log f, but endless at half the sampling rate.

    There a filtered series has next to no power: the spectrum of a Butterworth filter, whose zeros are there, is
    1 / (1 + (f / corner)^2k) in the frequency exp(u), and nearly a straight line in u above its corner.
    """
    if nyquist == inf:
        return np.asarray(np.log(frequency))
    angle = np.pi / 2 * np.minimum(frequency / nyquist, 1.0)
    return np.asarray(np.log(2 * nyquist / np.pi * np.tan(angle)))


def power_levels(spectra: Sequence[PowerSpectrum], frequency: Array) -> Array:
    """S (m, p) of several spectra at positive frequencies (m,)."""
    of_each = zip(spectra, bases(spectra, frequency), strict=True)
    return np.stack([s.level(frequency, basis) for s, basis in of_each], axis=1)


def log_power_variances(spectra: Sequence[PowerSpectrum], frequency: Array) -> Array:
    """Posterior variance (m, p) of log S of several spectra at positive frequencies (m,)."""
    of_each = zip(spectra, bases(spectra, frequency), strict=True)
    return np.stack([np.einsum("ij,ij->i", basis @ s.covariance, basis) for s, basis in of_each], axis=1)


def bases(spectra: Sequence[PowerSpectrum], frequency: Array) -> list[Array]:
    """Values (m, j) of each spectrum's basis functions; those of one record mostly have the same knots."""
    different = {(s.nyquist, s.knots.tobytes()): s for s in spectra}
    values = {key: s.basis(frequency) for key, s in different.items()}
    return [values[s.nyquist, s.knots.tobytes()] for s in spectra]


def smooth_power_spectra(
    frequency: Array,
    ordinates: Array,
    *,
    shape: float = 1.0,
    start: float | None = None,
    nyquist: float = inf,
    curvatures: Sequence[float] = CURVATURE_PRIORS[:2],
) -> tuple[PowerSpectrum, ...]:
    """Fit log S(f) to periodogram ordinates of each of p series by penalised Whittle likelihood.

    frequency  (m,) positive; ordinates (m, p) with mean S(f), distributed as Gamma of the given shape (1 for a single
    periodogram, R-1 for an average over R-1 differences); `start` the lowest frequency at which S will be evaluated;
    `nyquist` half the sampling rate (Hz) of series that were filtered; `curvatures` the priors that are tried.
    With the log link the Fisher information of each ordinate is `shape` whatever S, so that each scoring step is one
    penalised least-squares solve; the penalty on the curvature is chosen by the marginal likelihood. Ordinates above
    the Bonferroni-corrected Gamma quantile (`LEVELS.ordinate`) are tones and left out, with their neighbours.
    """
    begin = float(frequency.min()) if start is None else min(start, float(frequency.min()))
    grid = _Grid(log_frequency(frequency, nyquist), float(log_frequency(np.array([begin]), nyquist)[0]), nyquist)
    return tuple(_smoothed(grid, column, shape, curvatures) for column in ordinates.T)


def _smoothed(grid: _Grid, ordinates: Array, shape: float, curvatures: Sequence[float]) -> PowerSpectrum:
    """The spectrum of ordinates (m,), without those that are tones."""
    valid = np.isfinite(ordinates) & (ordinates > 0)
    if valid.sum() < MIN_ORDINATES:
        raise InputError(
            what="too few Fourier lines to estimate a channel's noise spectrum",
            where="recording",
            remedy="record longer, or the raw sensor instead of rounded readings",
        )
    limit = gamma_isf(LEVELS.ordinate / len(ordinates), shape) / shape
    tones, rounds = ~valid, MAX_TONE_ROUNDS
    while True:
        curve, level = _penalised_spline(grid, ordinates, ~tones, shape, curvatures)
        exceeding = valid & (ordinates > limit * level)
        tonal = tones | exceeding | np.roll(exceeding, 1) | np.roll(exceeding, -1)
        settled, rounds = (tonal == tones).all() or tonal.mean() > 0.3, rounds - 1
        tones = tones if settled else tonal
        if settled or not rounds:
            return replace(curve, tones=tones)


@dataclass(frozen=True, eq=False)
class _Grid:
    """u of the frequencies (m,) of ordinates, and of the lowest one at which a spectrum is evaluated."""

    u: Array
    begin: float
    nyquist: float = inf

    def pieces(self, ordinates: int) -> int:
        """Pieces of a curve through so many ordinates."""
        return int(np.clip(ordinates // 8, 4, MAX_PIECES if self.nyquist == inf else 2 * MAX_PIECES))

    def knots(self, pieces: int) -> Array:
        """Knots of so many pieces from the lowest to the highest frequency."""
        inner = np.linspace(self.begin, self.u.max() + 1e-9, pieces + 1)
        step = inner[1] - inner[0]
        return np.concatenate([inner[0] - step * np.arange(3, 0, -1), inner, inner[-1] + step * np.arange(1, 4)])

    def basis(self, pieces: int) -> Array:
        """Values (m, j) of the basis functions, computed once."""
        if pieces not in self._bases:
            self._bases[pieces] = basis_matrix(self.u, self.knots(pieces), 3)
        return self._bases[pieces]

    @cached_property
    def _bases(self) -> dict[int, Array]:
        return {}


def _penalised_spline(
    grid: _Grid, ordinates: Array, use: NDArray[np.bool_], shape: float, curvatures: Sequence[float]
) -> tuple[PowerSpectrum, Array]:
    """The curve of the largest marginal likelihood (Laplace), and its values (m,) at the frequencies.

    With knots h apart the curvature of a cubic spline is D c / h², D second differences of its coefficients c, so that
    the integral of its square over u is |D c|² / h³.
    """
    power = ordinates[use]
    pieces = grid.pieces(len(power))
    knots, whole = grid.knots(pieces), grid.basis(pieces)
    step, basis = knots[1] - knots[0], whole[use]
    gram, second = basis.T @ basis, np.diff(np.eye(basis.shape[1]), 2, axis=0)
    density = shape * np.abs(second) @ basis.sum(axis=0) / (4 * step)
    best: tuple[float, Array, Array, float] | None = None
    for prior in curvatures[int(shape < 1) :]:
        curvature = np.where(density < MANY_ORDINATES, min(prior, CURVATURE_PRIORS[1]), prior)
        penalty = second.T @ (second / curvature[:, None] ** 2) / step**3
        covariance = np.linalg.inv(shape * gram + penalty)
        coefficients = _fisher_scoring(basis, power, covariance, penalty, shape)
        log_power = basis @ coefficients
        criterion = 2 * shape * float(np.sum(log_power + power * np.exp(-log_power)))
        criterion += float(coefficients @ penalty @ coefficients + 2 * np.log(curvature).sum())
        criterion -= float(np.linalg.slogdet(covariance)[1])
        if best is None or criterion < best[0]:
            best = (criterion, coefficients, covariance, float(np.sum(covariance * (shape * gram))))
    assert best is not None
    curve = PowerSpectrum(knots, best[1], best[2], ~use, best[3], float(grid.u.min()), grid.nyquist)
    return curve, np.exp(whole @ curve.coefficients)


def _fisher_scoring(basis: Array, power: Array, covariance: Array, penalty: Array, shape: float) -> Array:
    """Coefficients of the largest penalised likelihood, `covariance` the inverse of the penalised information.

    They start at the penalised least squares of the logarithms, corrected for their mean with shape 1.
    """
    coefficients = covariance @ (shape * basis.T @ (np.log(power) + EULER))
    for _ in range(30):
        log_power = basis @ coefficients
        gradient = shape * basis.T @ (power * np.exp(-log_power) - 1) - penalty @ coefficients
        step = covariance @ gradient
        step *= min(1.0, 2.0 / (np.abs(step).max() + 1e-12))
        coefficients = coefficients + step
        if np.abs(step).max() < 1e-8:
            break
    return np.asarray(coefficients)


# Leakage: the transient of coloured noise at the record's ends, projected out of the whitened Fourier lines.


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
"""Largest change of a line's log power between two rounds that ends them: a fraction of its std at any line."""
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
    readings = np.zeros((len(series[0]), len(series), sum(s.shape[1] for s in series)))
    first = 0
    for channel, columns in enumerate(series):
        readings[:, channel, first : first + columns.shape[1]] = columns
        first += columns.shape[1]
    return readings


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
    cleaned = lines if start is None else start
    nuisances = np.zeros((len(index), 0)) if disturbances is None else disturbances
    spectra = smoothed(cleaned, inf)
    powers = line_powers(spectra, n, period, dt)[index]
    for _ in range(MAX_SPECTRUM_ROUNDS):
        series = transients(spectra, n, dt)
        if max(s.shape[1] for s in series) == FIRST_INNOVATIONS:
            break
        columns = [
            np.hstack([np.fft.rfft(transient, axis=0)[index], nuisances]).astype(np.complex128) for transient in series
        ]
        weights = 1 / np.sqrt(powers)
        cleaned = np.stack(
            [_projected(lines[..., c], basis, weights[:, c]) for c, basis in enumerate(columns)], axis=-1
        )
        spectra = smoothed(cleaned, 1 / (2 * dt))
        before, powers = powers, line_powers(spectra, n, period, dt)[index]
        if np.abs(np.log(powers / before)).max() < SETTLED_SPECTRUM:
            break
    return spectra, cleaned


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
