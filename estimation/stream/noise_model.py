"""Noise model: noise that is known beforehand, and whitens stretches of any length of any recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_toeplitz

from estimation.noise import Noise, NoiseSource
from estimation.whitening import LineWhitener, RegressionWhitener, inverse_root
from modeling.errors import InputError

Array = NDArray[np.float64]

ORDER = 30
"""Of the autoregression that stands for a spectrum: the highest that is tried on a residual."""
FREQUENCIES = 4096
"""Over which a spectrum is turned into autocovariances: the slowest is a hundred times slower than `ORDER` samples."""


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """Gaussian noise of p channels: noise[t] = sum_i a_i noise[t-i] + innovation.

    covariance    (p, p) of the innovations, in the products of the channels' units
    coefficients  (order, p) a_i of each channel; (0, p) for white noise
    block         samples averaged into one before anything else; the regression is that of the averages
    source        what it is known from
    sample_std    (p,) of one sample, where that does not follow from the rest
    Raises InputError for a covariance that is not one.
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
        try:
            np.linalg.cholesky(self.covariance)
        except np.linalg.LinAlgError:
            what = "the covariance of the noise is not a positive definite matrix"
            raise InputError(what=what, where="noise", remedy="give each channel a std above 0") from None

    @classmethod
    def white(cls, std: Sequence[float] | Array) -> Self:
        """White noise of the channels' std (p,), in their units, independent of each other."""
        return cls(np.diag(np.square(np.asarray(std, dtype=float))))

    @classmethod
    def of(cls, noise: Noise) -> Self:
        """The noise estimated from a recording, without its events.

        A spectrum S becomes the autoregression with the same first autocovariances (Yule-Walker): those are the
        integral of S cos(w t), and the innovations keep the channels' mean coherence.
        """
        whitener = noise.whitener
        if isinstance(whitener, RegressionWhitener):
            covariance = np.linalg.inv(whitener.root.T @ whitener.root)
            return cls(
                np.asarray(covariance, dtype=np.float64),
                whitener.coefficients,
                whitener.block,
                noise.source,
                noise.floor,
            )
        assert isinstance(whitener, LineWhitener)
        matrices = np.linalg.inv(np.conj(whitener.root.transpose(0, 2, 1)) @ whitener.root)
        levels = np.real(np.einsum("kii->ki", matrices))
        coherence = np.real(matrices / np.sqrt(levels[:, :, None] * levels[:, None, :])).mean(axis=0)
        found = [_autoregression(_even(noise.frequency, level)) for level in levels.T]
        spread = np.sqrt([variance for _, variance in found])
        coefficients = np.stack([a for a, _ in found], axis=1)
        return cls(coherence * np.outer(spread, spread), coefficients, 1, noise.source, noise.floor)

    @property
    def memory(self) -> int:
        """Samples of context that a stretch needs before its first row."""
        return len(self.coefficients) * self.block

    @cached_property
    def root(self) -> Array:
        """Inverse Cholesky factor (p, p) of the innovations' covariance."""
        return np.real(inverse_root(self.covariance))

    @cached_property
    def floor(self) -> Array:
        """Std (p,) of one sample: all answers to past innovations together, unless it is known otherwise."""
        if self.sample_std is not None:
            return self.sample_std
        shock = np.zeros(FREQUENCIES)
        shock[0] = 1.0
        from scipy.signal import lfilter  # which takes long to load

        answers = [lfilter([1.0], [1.0, *-a], shock) for a in self.coefficients.T]
        return np.sqrt(np.diag(self.covariance) * [float(answer @ answer) for answer in answers])

    def whitened(self, series: Array, history: int = 0) -> Array:
        """Innovations of unit variance (..., p, rows) of a series (..., p, n); its first `history` samples are context.

        At the start of a run, where there is no history, the first samples become context: `memory` of them give no
        row. Samples that do not fill a block at the end are left out.
        """
        count = series.shape[-1] // self.block
        means = series
        if self.block > 1:
            means = series[..., : count * self.block].reshape(*series.shape[:-1], count, self.block).mean(axis=-1)
        first = max(history // self.block, len(self.coefficients))
        innovation = means[..., first:]
        for lag, own in enumerate(self.coefficients, start=1):
            innovation = innovation - own[:, None] * means[..., first - lag : max(count - lag, 0)]
        return np.asarray(np.matmul(self.root, innovation))


def _even(frequency: Array, level: Array) -> Array:
    """A spectrum at even frequencies from 0 to the highest, (FREQUENCIES,), from that at others."""
    order = np.argsort(frequency)
    grid = np.linspace(0.0, frequency.max(), FREQUENCIES)
    return np.asarray(np.exp(np.interp(grid, frequency[order], np.log(level[order]))))


def _autoregression(spectrum: Array) -> tuple[Array, float]:
    """Coefficients (ORDER,) and the innovations' variance of the autoregression nearest to a spectrum of one sample."""
    autocovariance = np.fft.irfft(spectrum)
    coefficients = solve_toeplitz(autocovariance[:ORDER], autocovariance[1 : ORDER + 1])
    return coefficients, float(autocovariance[0] - coefficients @ autocovariance[1 : ORDER + 1])
