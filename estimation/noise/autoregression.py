"""Gaussian autoregressive noise: estimated from a residual, or known beforehand (also from a spectrum by Yule-Walker).

Noise known beforehand whitens chunks of any length.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_toeplitz, solve_triangular

from estimation.noise.noise_source import NoiseSource
from modeling.errors import InputError

if TYPE_CHECKING:
    from estimation.noise.recording_noise import RecordingNoise

Array = NDArray[np.float64]

AUTOREGRESSION_ORDERS = (0, 1, 2, 4, 8, 15, 30)
"""Orders tried on a residual."""
AUTOREGRESSION_ORDER = 30
"""Order of the autoregression that approximates a spectrum: the highest tried on a residual."""
SPECTRUM_POINTS = 4096
"""Frequencies at which a spectrum is transformed to autocovariances: the longest lag is a hundred times
`AUTOREGRESSION_ORDER`."""


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """Gaussian autoregressive noise of p channels: noise[t] = sum_i a_i noise[t-i] + innovation.

    covariance    (p, p) of the innovations, in the products of the channels' units
    coefficients  (order, p) a_i of each channel; (0, p) for white noise
    block         samples averaged into one first; the autoregression is that of these averages
    source        what the estimate rests on
    sample_std    (p,) of one sample, where that does not follow from the other fields
    Raises InputError for a covariance that is not positive definite.
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
    def of(cls, noise: RecordingNoise) -> Self:
        """The noise estimated from a recording, outside its events.

        A spectrum S becomes the autoregression with the same first autocovariances (Yule-Walker): those are the
        integral of S cos(w t), and the innovations keep the channels' mean coherence.
        """
        from estimation.noise.whitening import AutoregressiveWhitener, FourierLineWhitener  # slow to import

        whitener = noise.whitener
        if isinstance(whitener, AutoregressiveWhitener):
            covariance = np.linalg.inv(whitener.root.T @ whitener.root)
            return cls(
                np.asarray(covariance, dtype=np.float64),
                whitener.coefficients,
                whitener.block,
                noise.source,
                noise.floor,
            )
        assert isinstance(whitener, FourierLineWhitener)
        matrices = np.linalg.inv(np.conj(whitener.root.transpose(0, 2, 1)) @ whitener.root)
        levels = np.real(np.einsum("kii->ki", matrices))
        coherence = np.real(matrices / np.sqrt(levels[:, :, None] * levels[:, None, :])).mean(axis=0)
        solutions = [_yule_walker(_interpolated_spectrum(noise.frequency, level)) for level in levels.T]
        spread = np.sqrt([variance for _, variance in solutions])
        coefficients = np.stack([a for a, _ in solutions], axis=1)
        return cls(coherence * np.outer(spread, spread), coefficients, 1, noise.source, noise.floor)

    @property
    def memory(self) -> int:
        """Samples of history that a chunk needs before its first row: order times block."""
        return len(self.coefficients) * self.block

    @property
    def is_white(self) -> bool:
        """Whether every sample is a row by itself: order 0 and no averaging."""
        return not len(self.coefficients) and self.block == 1

    @cached_property
    def root(self) -> Array:
        """Inverse Cholesky factor (p, p) of the innovations' covariance."""
        factor = np.linalg.cholesky(self.covariance)
        return np.asarray(solve_triangular(factor, np.eye(len(factor)), lower=True))

    @cached_property
    def floor(self) -> Array:
        """Std (p,) of one sample: the norm of the impulse response times the innovations' std, unless given."""
        if self.sample_std is not None:
            return self.sample_std
        from scipy.signal import lfilter  # slow to import

        impulse = np.zeros(SPECTRUM_POINTS)
        impulse[0] = 1.0
        responses = [lfilter([1.0], [1.0, *-a], impulse) for a in self.coefficients.T]
        return np.sqrt(np.diag(self.covariance) * [float(response @ response) for response in responses])

    def whitened(self, series: Array, history: int = 0) -> Array:
        """Innovations of unit variance (..., p, rows) of a series (..., p, n) after its first `history` samples.

        At the start of a run, where there is no history, the first `memory` samples serve as history and give no row.
        Samples at the end that do not fill a block are left out.
        """
        count = series.shape[-1] // self.block
        means = series
        if self.block > 1:
            means = series[..., : count * self.block].reshape(*series.shape[:-1], count, self.block).mean(axis=-1)
        first = max(history // self.block, len(self.coefficients))
        innovation = means[..., first:]
        for lag, coefficient in enumerate(self.coefficients, start=1):
            innovation = innovation - coefficient[:, None] * means[..., first - lag : max(count - lag, 0)]
        return np.asarray(np.matmul(self.root, innovation))


def _interpolated_spectrum(frequency: Array, level: Array) -> Array:
    """A spectrum on a uniform grid from 0 to the highest frequency, (SPECTRUM_POINTS,), by log-linear interpolation."""
    order = np.argsort(frequency)
    grid = np.linspace(0.0, frequency.max(), SPECTRUM_POINTS)
    return np.asarray(np.exp(np.interp(grid, frequency[order], np.log(level[order]))))


def _yule_walker(spectrum: Array) -> tuple[Array, float]:
    """Coefficients (AUTOREGRESSION_ORDER,) and innovations' variance with a spectrum's first autocovariances."""
    autocovariance = np.fft.irfft(spectrum)
    coefficients = solve_toeplitz(autocovariance[:AUTOREGRESSION_ORDER], autocovariance[1 : AUTOREGRESSION_ORDER + 1])
    return coefficients, float(autocovariance[0] - coefficients @ autocovariance[1 : AUTOREGRESSION_ORDER + 1])


def fit_autoregression(residual: Array, event_free: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Autoregression of a residual (n, p) where it is `event_free` (n,), the order by Akaike's criterion.

    Coefficients (order, p) of each channel and the innovations' joint covariance (p, p).
    """
    n, p = residual.shape
    best: tuple[float, Array, Array] | None = None
    for order in (order for order in AUTOREGRESSION_ORDERS if order <= n // 20):
        usable = _with_event_free_past(event_free, order)
        if usable.sum() < 10 * (order + p):
            continue
        coefficients, innovation = _autoregression_of_order(residual, usable, order)
        covariance = innovation.T @ innovation / max(1, len(innovation) - order)
        covariance += 1e-12 * np.eye(p) * max(np.trace(covariance) / p, 1e-300)
        criterion = usable.sum() * np.linalg.slogdet(covariance)[1] + 2 * order * p
        if best is None or criterion < best[0]:
            best = (float(criterion), coefficients, covariance)
    if best is None:
        return np.zeros((0, p)), np.diag(residual.var(axis=0))
    return best[1:]


def _with_event_free_past(event_free: NDArray[np.bool_], order: int) -> NDArray[np.bool_]:
    """Samples (n,) that are event-free together with their `order` predecessors."""
    usable = event_free.copy()
    for lag in range(1, order + 1):
        usable[lag:] &= event_free[:-lag]
    usable[:order] = False
    return usable


def _autoregression_of_order(residual: Array, usable: NDArray[np.bool_], order: int) -> tuple[Array, Array]:
    """Least-squares coefficients (order, p) of each channel by itself, and its innovations where `usable`."""
    index = np.flatnonzero(usable)
    coefficients = np.zeros((order, residual.shape[1]))
    innovation = residual[index].copy()
    for channel in range(residual.shape[1]):
        if order:
            past = np.stack([residual[index - lag, channel] for lag in range(1, order + 1)], axis=1)
            coefficients[:, channel] = np.linalg.lstsq(past, residual[index, channel], rcond=None)[0]
            innovation[:, channel] -= past @ coefficients[:, channel]
    return coefficients, innovation
