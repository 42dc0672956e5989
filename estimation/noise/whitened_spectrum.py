"""Power spectral density of a single run's whitened residual: the colour that its autoregression leaves.

An autoregression of a few coefficients is flat below its corner, where 1/f noise keeps rising and where the motion of a
tool is. A score test in rows whitened by it takes that rise for effects. Here the spectrum of the rows themselves is
estimated, and with it the variance of each score: a heteroscedasticity and autocorrelation consistent test by
prewhitening (Andrews and Monahan, Econometrica 60, 1992).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct, idct

Array = NDArray[np.float64]

EXPONENTS = (0.0, 1.0)
"""Of 1/frequency in the terms of a spectrum: white noise and 1/f noise."""
MIN_ROWS = 64
"""Rows of a channel below which its colour is not estimated."""
SINGLE_LINES = 32
"""Lowest lines that are bins by themselves; from there on as many bins to a factor e."""
SPREAD = 2.0
"""Std of a record's mean power, by which it may exceed that of the process."""
STEPS = 50
STEP_TOLERANCE = 1e-3
"""Of the log of the spectrum: a hundredth of its std, or less."""


@dataclass(frozen=True, eq=False)
class WhitenedSpectrum:
    """Power spectral density of each channel's whitened rows at the lines of a cosine transform, 1 if they are white.

    level     (rows of a channel, p), its expected power in units of white noise of unit variance
    log_std   (rows of a channel, p), standard deviation of the log of the estimated level
    """

    level: Array
    log_std: Array

    @classmethod
    def of(cls, residual: Array, leverage: Array, stated: bool = False) -> WhitenedSpectrum:
        """Of projected rows (n p,), of whose lines the share `leverage` (n, p) was projected out.

        With a `stated` std the level of all lines together is known, but for what a record has by chance: a spectrum
        that exceeds it does so by what the model lacks.
        """
        n, p = leverage.shape
        bins = _bins(n)
        power, free = (np.add.reduceat(x, bins, axis=0) for x in (lines(residual, p) ** 2, np.maximum(1 - leverage, 0)))
        terms = _terms(n)
        binned = np.add.reduceat(terms, bins, axis=0) / np.diff([*bins, n])[:, None]
        fitted = [_Mixture.of(power[:, c], free[:, c], binned) for c in range(p)]
        level = np.stack([terms @ f.weights for f in fitted], axis=1)
        log_std = np.stack([f.log_std(terms) for f in fitted], axis=1)
        if stated:
            level = np.stack([_of_known_mean(column) for column in level.T], axis=1)
        return cls(level, log_std)

    @property
    def log_power_variance(self) -> Array:
        """Variance (p,) of the logarithm of a channel's power in a record, beyond that of white noise."""
        n = len(self.level)
        return np.asarray(2 * (self.level**2).sum(axis=0) / self.level.sum(axis=0) ** 2 - 2 / n)

    def flattened(self, rows: Array, channel: int) -> Array:
        """Rows (n, ...) of a channel, filtered to a flat spectrum."""
        root = np.sqrt(self.level[:, channel])
        root = root.reshape(-1, *np.ones(rows.ndim - 1, dtype=int))
        return np.asarray(idct(dct(rows, axis=0, norm="ortho") / root, axis=0, norm="ortho"))

    def of_columns(self, columns: Array) -> tuple[Array, Array]:
        """Level and variance of its log, each (g,), where the power of columns (n p, g) is.

        The errors of a channel's level go together at all its lines, those of the channels are independent. A column
        without power has level 1.
        """
        share = lines(columns, self.level.shape[1]) ** 2
        power = share.sum(axis=(0, 1))
        share /= np.where(power > 0, power, 1.0)
        level = np.where(power > 0, np.einsum("kp,kpg->g", self.level, share), 1.0)
        spread = np.einsum("kp,kpg->pg", self.level * self.log_std, share)
        return level, (spread**2).sum(axis=0) / level**2


def lines(rows: Array, channels: int) -> Array:
    """Cosine lines (n, p, ...) of rows (n p, ...), orthonormal."""
    return np.asarray(dct(rows.reshape(len(rows) // channels, channels, *rows.shape[1:]), axis=0, norm="ortho"))


def _bins(n: int) -> NDArray[np.intp]:
    """First lines of bins over which a spectrum is nearly constant: each line by itself, then ever more together."""
    edges = np.geomspace(SINGLE_LINES, n, max(2, round(np.log(n / SINGLE_LINES) * SINGLE_LINES)), endpoint=False)
    return np.unique(np.concatenate([np.arange(SINGLE_LINES), edges.astype(np.intp)]))


def _terms(n: int) -> Array:
    """Terms (n, 2) of a spectrum at the lines 0 .. n - 1, each of unit mean; line 0 as line 1."""
    line = np.maximum(np.arange(n), 1.0)
    terms = line[:, None] ** -np.array(EXPONENTS)
    return np.asarray(terms / terms.mean(axis=0))


@dataclass(frozen=True, eq=False)
class _Mixture:
    """Maximum-likelihood weights (2,) of the terms of a channel's spectrum, none negative, and their covariance."""

    weights: Array
    covariance: Array

    @classmethod
    def of(cls, power: Array, free: Array, terms: Array) -> _Mixture:
        """Of the power (b,) of bins of lines, of which `free` (b,) were not fitted away.

        Whittle's likelihood: power / expected is chi-square of `free` degrees of freedom. By multiplicative steps,
        which raise it and keep the weights positive (Fevotte, Bertin and Durrieu, Neural Computation 21, 2009).
        """
        weights = np.full(terms.shape[1], max(power.sum(), 1e-300) / max(free.sum(), 1.0) / terms.shape[1])
        for _ in range(STEPS):
            level = terms @ weights
            step = (terms.T @ (power / level**2)) / np.maximum(terms.T @ (free / level), 1e-300)
            weights = weights * np.sqrt(step)
            if np.abs(np.log(np.maximum(terms @ weights, 1e-300) / level)).max() < STEP_TOLERANCE:
                break
        relative = terms / (terms @ weights)[:, None]
        return cls(weights, np.linalg.pinv(0.5 * relative.T @ (relative * free[:, None])))

    def log_std(self, terms: Array) -> Array:
        """Standard deviation of the log of the spectrum of terms (n, 2)."""
        relative = terms / (terms @ self.weights)[:, None]
        return np.asarray(np.sqrt(np.maximum(np.einsum("kt,tu,ku->k", relative, self.covariance, relative), 0.0)))


def _of_known_mean(level: Array) -> Array:
    """The spectrum (n,) where the mean of the process is 1; that of a record differs, the more the redder it is."""
    mean = level.mean()
    if mean <= 1.0:
        return np.asarray(level / mean)
    least = _of_mean_one(level)
    most = 1.0 + SPREAD * np.sqrt(2 * (least**2).sum()) / least.sum()
    return level if mean <= most else np.asarray(most * _of_mean_one(level / most))


def _of_mean_one(level: Array) -> Array:
    """The spectrum (n,) of mean 1 and the largest entropy below a spectrum of larger mean, min(level, c)."""
    order = np.sort(level)
    clipped = (np.cumsum(order) + order * np.arange(len(order) - 1, -1, -1)) / len(order)
    first = int(np.searchsorted(clipped, 1.0))
    below = order[:first].sum()
    return np.asarray(np.minimum(level, (len(order) - below) / (len(order) - first)))
