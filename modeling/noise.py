"""Stationary Gaussian noise of the readings, autoregressive or by its spectrum, and whitening of its channels."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property
from typing import Self, TypeVar, cast

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_toeplitz

from modeling.errors import InputError
from modeling.rig import Rig

Array = NDArray[np.float64]
FourierLines = NDArray[np.complex128]
SeriesOrLines = TypeVar("SeriesOrLines", Array, FourierLines)

# Whitening of channels: inverse Cholesky factor of a covariance, its product with a series, and block means.


def inverse_cholesky_factor(covariance: SeriesOrLines) -> SeriesOrLines:
    """Inverse Cholesky factors W (..., p, p) of covariances C, lower triangular: W C W^H = 1."""
    return cast(SeriesOrLines, np.tril(np.linalg.inv(np.linalg.cholesky(covariance))))


def whitened_by_channel(root: SeriesOrLines, series: SeriesOrLines) -> Iterator[tuple[int, SeriesOrLines]]:
    """Each channel (..., n) of an inverse Cholesky factor (p, p) or (p, p, n) times a series, with its number.

    The series (..., p, n) are n samples, or n lines with a factor each.
    """
    for channel in range(len(root)):
        mixed = root[channel, 0] * series[..., 0, :]
        for other in range(1, channel + 1):
            mixed += root[channel, other] * series[..., other, :]
        yield channel, mixed


def whitened_channels(root: SeriesOrLines, series: SeriesOrLines) -> SeriesOrLines:
    """All channels (..., p, n) of `whitened_by_channel`."""
    white = np.empty_like(series)
    for channel, mixed in whitened_by_channel(root, series):
        white[..., channel, :] = mixed
    return white


def block_means(values: Array, block: int) -> Array:
    """Means (n // block, ...) of successive blocks of samples; an incomplete last block is left out."""
    if block == 1:
        return values
    count = len(values) // block
    parts = values[: count * block].T.reshape(*values.shape[:0:-1], count, block)
    return np.asarray((parts @ np.full(block, 1 / block)).T)


def require_positive_definite(covariance: NDArray[np.inexact]) -> None:
    """Raise InputError unless the covariances (..., p, p) are finite, Hermitian and positive definite."""
    scale = np.sqrt(np.abs(np.diagonal(covariance, axis1=-2, axis2=-1)))
    asymmetry = np.abs(covariance - covariance.conj().swapaxes(-1, -2))
    valid = np.isfinite(covariance).all() and (asymmetry <= 1e-9 * scale[..., None] * scale[..., None, :]).all()
    try:
        np.linalg.cholesky(covariance if valid else np.zeros((1, 1)))
    except np.linalg.LinAlgError:
        raise InputError(
            what="the covariance of the channels is not symmetric and positive definite",
            where="noise",
            remedy="give the std of every channel, above zero",
        ) from None


# Stationary Gaussian noise of the readings, and such noise given by its spectrum.


Complex = NDArray[np.complex128]


class NoiseSource(Enum):
    """What a noise estimate rests on: repeats, the std stated in the rig, a fit's residual, or rows within dwells."""

    REPEATS = "repeats"
    RIG = "rig"
    RESIDUAL = "residual"
    DWELLS = "dwells"

    @property
    def is_of_samples(self) -> bool:
        """Whether the std of a sample is known beforehand, without repeats or a fit."""
        return self in (NoiseSource.RIG, NoiseSource.DWELLS)


class StationaryNoise(ABC):
    """Stationary noise of p channels, by the linear map that makes it white and of unit variance."""

    @property
    def is_white(self) -> bool:
        """Whether every sample is whitened by itself."""
        return False

    @abstractmethod
    def whitened(self, series: Array, step: float) -> Array:
        """The whitened series (N, p, ...), samples `step` (s) apart: sums of its squares are information.

        The series is one period, and the noise stationary over it.
        """


@dataclass(frozen=True, eq=False)
class ColouredNoise(StationaryNoise):
    """Stationary noise of p channels with a spectrum.

    Interpolated linearly, constant beyond the last frequency.

    Parameters
    ----------
    frequency : array (F,)
        In Hz, increasing from zero.
    covariance : array (F, p, p)
        Hermitian. Normalised so that white noise has the covariance of one sample at every frequency: the two-sided
        spectral density times the sampling rate.

    Raises
    ------
    InputError
        When the frequencies do not increase, the shapes do not fit or a covariance is not positive definite.

    Notes
    -----
    One period of N samples has the information sum over its lines of S(f)^H C(f)^-1 S(f), S(f) the orthonormal discrete
    Fourier transform of the sensitivities: that of generalised least squares for noise that is stationary over the
    period, since the lines of stationary noise are independent of one another (exactly for periodic noise, else up to
    leakage of its correlation time over the record). With C(f) = L L^H it is the sum of squares of L^-1 S(f), which is
    a series in time again.

    Examples
    --------
    >>> import numpy as np
    >>> import truewrench as tw
    >>> noise = tw.ColouredNoise(np.array([0.0, 10.0]), np.array([[[4.0]], [[1.0]]]))
    >>> noise.whitened(np.ones((2, 1)), 0.05).round(3).tolist()
    [[0.5], [0.5]]
    """

    frequency: Array
    covariance: Complex | Array

    def __post_init__(self) -> None:
        frequency, covariance = np.asarray(self.frequency, dtype=float), np.asarray(self.covariance)
        if covariance.ndim != 3 or frequency.shape != covariance.shape[:1] or (np.diff(frequency) <= 0).any():
            raise InputError(
                what="increasing frequencies (F,) and covariances (F, p, p) were expected",
                where="noise spectrum",
                remedy="give one covariance matrix of the channels at each frequency",
            )
        require_positive_definite(covariance)

    @classmethod
    def of_spectra(cls, frequency: Array, power: Array) -> ColouredNoise:
        """Independent channels: `power` (F, p), white noise of one channel having std² at every frequency."""
        return cls(frequency, np.asarray(power)[:, :, None] * np.eye(np.shape(power)[1]))

    def at(self, frequency: NDArray[np.floating]) -> Complex:
        """C (L, p, p) at the frequencies (L,) in Hz."""
        flat = np.asarray(self.covariance, dtype=complex).reshape(len(self.frequency), -1)
        parts = [np.interp(frequency, self.frequency, column) for column in flat.T]
        return np.stack(parts, axis=1).reshape(len(frequency), *self.covariance.shape[1:])

    def whitened(self, series: Array, step: float) -> Array:
        """L(f)^-1 times every line of the series, in the time domain; lines 0 and N/2 of a real series are real."""
        count = len(series)
        covariance = self.at(np.fft.rfftfreq(count, step))
        covariance[0] = covariance[0].real
        if count % 2 == 0:
            covariance[-1] = covariance[-1].real
        root = inverse_cholesky_factor(covariance).transpose(1, 2, 0)
        lines = whitened_channels(root, np.fft.rfft(series.T))
        return np.asarray(np.fft.irfft(lines, n=count).T, dtype=float)


# Gaussian autoregressive noise, white at order 0: stated, fitted to a residual, or from a spectrum by Yule-Walker.


SPECTRUM_ORDER = 30
"""Order of the autoregression that approximates a spectrum: the highest tried on a residual."""
SPECTRUM_POINTS = 4096
"""Frequencies at which a spectrum is transformed to autocovariances: the longest lag is a hundred times
`SPECTRUM_ORDER`."""


@dataclass(frozen=True, eq=False)
class NoiseModel(StationaryNoise):
    """Gaussian autoregressive noise of p channels: noise[t] = sum_i a_i noise[t-i] + innovation.

    Parameters
    ----------
    covariance : array (p, p)
        Of the innovations, in the products of the channels' units.
    coefficients : array (order, p), optional
        The a_i of each channel; by default none, white noise.
    block : int, optional
        Samples averaged into one first, by default 1; the autoregression is that of these averages.
    source : NoiseSource, optional
        What the estimate rests on; by default the rig.
    sample_std : array (p,), optional
        Std of one sample, where that does not follow from the other fields.

    Raises
    ------
    InputError
        For a covariance that is not positive definite, and coefficients of another number of channels.

    Examples
    --------
    >>> import truewrench as tw
    >>> noise = tw.NoiseModel.white([0.1, 0.1, 0.01])
    >>> noise.is_white, noise.covariance.shape
    (True, (3, 3))
    """

    covariance: Array
    coefficients: Array = field(default_factory=lambda: np.zeros((0, 0)))
    block: int = 1
    source: NoiseSource = NoiseSource.RIG
    sample_std: Array | None = None

    def __post_init__(self) -> None:
        if not self.coefficients.size:
            object.__setattr__(self, "coefficients", np.zeros((0, len(self.covariance))))
        if self.coefficients.shape[1:] != self.covariance.shape[1:]:
            what = f"coefficients of {self.coefficients.shape[1]} channels and a covariance {self.covariance.shape}"
            raise InputError(what=what, where="noise", remedy="give one column of coefficients per channel")
        require_positive_definite(self.covariance)

    @classmethod
    def white(cls, std: Sequence[float] | Array) -> Self:
        """White noise of the channels' std (p,), in their units, independent of each other."""
        return cls(np.diag(np.square(np.asarray(std, dtype=float))))

    @classmethod
    def of_rig(cls, rig: Rig | None, channels: Sequence[str]) -> Self:
        """White noise of the rig's sensor.noise; InputError unless it states every channel."""
        stated = (None if rig is None else rig.sensor.noise) or {}
        missing = [channel for channel in channels if channel not in stated]
        if missing:
            what = f"the noise of {', '.join(missing)} is not stated, and the readings are weighted by it"
            remedy = f"state noise = {{ {', '.join(f'{c} = ..' for c in channels)} }} under [sensor] in the rig"
            raise InputError(what=what, where=f"rig {'' if rig is None else rig.name}".strip(), remedy=remedy)
        return cls.white([stated[channel] for channel in channels])

    @classmethod
    def of_spectrum(cls, frequency: Array, covariance: NDArray[np.complex128]) -> Self:
        """The autoregression with the first autocovariances of a spectrum (Yule-Walker).

        The spectrum is `covariance` (F, p, p) per sample at frequencies (F,), Hz, up to half the sampling rate. The
        autocovariances are the integral of its diagonal times cos(w t); the innovations keep the mean coherence.
        """
        levels = np.real(np.einsum("kii->ki", covariance))
        coherence = np.real(covariance / np.sqrt(levels[:, :, None] * levels[:, None, :])).mean(axis=0)
        solutions = [_yule_walker(_interpolated_spectrum(frequency, level)) for level in levels.T]
        spread = np.sqrt([variance for _, variance in solutions])
        return cls(coherence * np.outer(spread, spread), np.stack([a for a, _ in solutions], axis=1))

    @property
    def order(self) -> int:
        """Order of the autoregression."""
        return len(self.coefficients)

    @property
    def memory(self) -> int:
        """Samples of history that a chunk needs before its first row: order times block."""
        return self.order * self.block

    @property
    def is_white(self) -> bool:
        """Whether every sample is a row by itself: order 0 and no averaging."""
        return not self.order and self.block == 1

    @cached_property
    def root(self) -> Array:
        """Inverse Cholesky factor (p, p) of the innovations' covariance."""
        return inverse_cholesky_factor(self.covariance)

    @cached_property
    def floor(self) -> Array:
        """Std (p,) of one sample: root of the autocovariance at lag 0, unless given."""
        return np.sqrt(self.autocovariance(1)[0]) if self.sample_std is None else self.sample_std

    def autocovariance(self, lags: int) -> Array:
        """Autocovariance (lags, p) of each channel at lags 0 .. lags - 1.

        The transform of the spectrum s / |1 - sum a_k exp(-i w k)|² on a grid long enough against wrap-around.
        """
        grid = 1 << int(np.ceil(np.log2(max(8 * lags, SPECTRUM_POINTS))))
        response = 1 / np.fft.rfft(np.concatenate([np.ones((1, len(self.covariance))), -self.coefficients]), grid, 0)
        power = np.diag(self.covariance) * np.abs(response) ** 2
        return np.asarray(np.fft.irfft(power, grid, 0)[:lags])

    def of_channel(self, channel: int) -> NoiseModel:
        """The noise of one channel, given that there is none in the others."""
        variance = np.full((1, 1), self.root[channel, channel] ** -2)
        return replace(self, covariance=variance, coefficients=self.coefficients[:, channel : channel + 1])

    def innovations(self, series: Array, first: int | None = None) -> Array:
        """Innovations (..., p, n - first) of a series (..., p, n) from sample `first`, by default the order, on."""
        first, count = self.order if first is None else first, series.shape[-1]
        if not self.order or count <= first:
            return series[..., first:].copy()
        each = series[..., first - self.order :].reshape(-1, len(self.covariance), count - first + self.order)
        innovations = np.zeros((*each.shape[:2], count - first))
        for column, channel in np.argwhere(each.any(axis=2)).tolist():  # most derivatives are zero in most channels
            innovations[column, channel] = np.convolve(each[column, channel], self._filters[channel], "valid")
        return innovations.reshape(*series.shape[:-1], count - first)

    @cached_property
    def _filters(self) -> Array:
        """From a series to its innovations, (p, order + 1): 1, and the coefficients with the other sign."""
        return np.column_stack([np.ones(len(self.covariance)), -self.coefficients.T])

    def whitened_chunk(self, series: Array, history: int = 0) -> Array:
        """Innovations of unit variance (..., p, rows) of a series (..., p, n) after its first `history` samples.

        At the start of a run, where there is no history, the first `memory` samples serve as history and give no row.
        Samples at the end that do not fill a block are left out.
        """
        means = block_means(series.T, self.block).T
        return whitened_channels(self.root, self.innovations(means, max(history // self.block, self.order)))

    def whitened(self, series: Array, step: float) -> Array:
        """Innovations of unit variance of a periodic series (N, p, ...), one period; InputError for block averages."""
        if self.block > 1:
            remedy = "give the noise of single samples"
            raise InputError(what="it is the noise of averages over blocks", where="noise", remedy=remedy)
        past = series[len(series) - self.order :]
        innovation = self.innovations(np.concatenate([past, series]).T).T if self.order else series
        return np.asarray(np.einsum("cd,nd...->nc...", self.root, innovation))


def _interpolated_spectrum(frequency: Array, level: Array) -> Array:
    """A spectrum on a uniform grid from 0 to the highest frequency, (SPECTRUM_POINTS,), by log-linear interpolation."""
    order = np.argsort(frequency)
    grid = np.linspace(0.0, frequency.max(), SPECTRUM_POINTS)
    return np.asarray(np.exp(np.interp(grid, frequency[order], np.log(level[order]))))


def _yule_walker(spectrum: Array) -> tuple[Array, float]:
    """Coefficients (SPECTRUM_ORDER,) and innovations' variance with a spectrum's first autocovariances."""
    autocovariance = np.fft.irfft(spectrum)
    coefficients = solve_toeplitz(autocovariance[:SPECTRUM_ORDER], autocovariance[1 : SPECTRUM_ORDER + 1])
    return coefficients, float(autocovariance[0] - coefficients @ autocovariance[1 : SPECTRUM_ORDER + 1])
