"""White and coloured sensor noise as whitening of readings."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from modeling.errors import InputError
from modeling.rig.rig import Rig

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


class SensorNoise(ABC):
    """Stationary noise of p channels, by the linear map that makes it white and of unit variance."""

    @abstractmethod
    def whitened(self, series: Array, step: float) -> Array:
        """The whitened series (N, p, ...), samples `step` (s) apart: sums of its squares are information."""


@dataclass(frozen=True, eq=False)
class WhiteNoise(SensorNoise):
    """White noise: `covariance` (p, p) of one sample, in products of the channels' units."""

    covariance: Array

    def __post_init__(self) -> None:
        _check(np.asarray(self.covariance)[None])

    @classmethod
    def of_std(cls, std: Sequence[float] | Array) -> WhiteNoise:
        """Independent channels, by the std of one sample (p,) of each, in its unit."""
        return cls(np.diag(np.asarray(std, dtype=float) ** 2))

    @classmethod
    def of_rig(cls, rig: Rig, channels: Sequence[str]) -> WhiteNoise:
        """Of the rig's sensor.noise; InputError unless it states every channel."""
        stated = rig.sensor.noise or {}
        missing = [channel for channel in channels if channel not in stated]
        if missing:
            raise InputError(
                what=f"sensor.noise does not state {', '.join(missing)}",
                where=f"rig {rig.name}".strip(),
                remedy="add its std to the rig, or design without weights",
            )
        return cls.of_std([stated[channel] for channel in channels])

    @cached_property
    def root(self) -> Array:
        """W (p, p) with W C W' = 1, lower triangular."""
        factor = np.linalg.cholesky(self.covariance)
        return np.asarray(solve_triangular(factor, np.eye(len(factor)), lower=True))

    def whitened(self, series: Array, step: float) -> Array:
        """W times every sample."""
        return np.asarray(np.einsum("cd,nd...->nc...", self.root, series))


@dataclass(frozen=True, eq=False)
class ColouredNoise(SensorNoise):
    """Noise with a spectrum: `covariance` (F, p, p), Hermitian, at the frequencies (F,) in Hz, increasing from zero.

    Normalised so that white noise has the covariance of one sample at every frequency: the two-sided spectral density
    times the sampling rate. Interpolated linearly, constant beyond the last frequency. One period of N samples has the
    information sum over its lines of S(f)^H C(f)^-1 S(f), S(f) the orthonormal discrete Fourier transform of
    the sensitivities: that of generalised least squares for noise that is stationary over the period, since the lines
    of stationary noise are independent of one another (exactly for periodic noise, else up to leakage of its
    correlation time over the record). With C(f) = L L^H it is the sum of squares of L^-1 S(f), which is a series in
    time again.
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
        _check(covariance)

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
        root = np.linalg.inv(np.linalg.cholesky(covariance))
        lines = np.einsum("lcd,ld...->lc...", root, np.fft.rfft(series, axis=0))
        return np.asarray(np.fft.irfft(lines, n=count, axis=0), dtype=float)


def _check(covariance: NDArray[np.inexact]) -> None:
    hermitian = np.allclose(covariance, covariance.conj().swapaxes(-1, -2), rtol=1e-9, atol=0)  # rounding of a file
    if not (np.isfinite(covariance).all() and hermitian and (np.linalg.eigvalsh(covariance) > 0).all()):
        raise InputError(
            what="the covariance of the channels is not symmetric and positive definite",
            where="noise",
            remedy="give the std of every channel, above zero",
        )
