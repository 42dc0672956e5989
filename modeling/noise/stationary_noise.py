"""Stationary Gaussian noise of the readings, and such noise given by its spectrum."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from modeling.errors import InputError
from modeling.noise.channel_whitening import inverse_cholesky_factor, require_positive_definite, whitened_channels

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


class NoiseSource(Enum):
    """What a noise estimate rests on: the repeats, the std stated in the rig, or the residual of a fit."""

    REPEATS = "repeats"
    RIG = "rig"
    RESIDUAL = "residual"


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
