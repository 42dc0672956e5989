"""Power spectral density of a single run's whitened residual: the colour that its autoregression leaves.

An autoregression of a few coefficients is flat below its corner, where 1/f noise keeps rising and where the motion of a
tool is. A score test in rows whitened by it takes that rise for effects. Here the spectrum of the rows themselves is
estimated, white and 1/f noise, and with it the level of each score: a heteroscedasticity and autocorrelation consistent
test by prewhitening (Andrews and Monahan, Econometrica 60, 1992). What a run does not tell of it is a distribution, by
Whittle's likelihood and Jeffreys' prior.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct, idct

from estimation.multiplicity import chi_square_p_value

Array = NDArray[np.float64]

BINS = 128
"""Values by which the distribution of a sum is approximated."""
NEGLIGIBLE = 1e-12
"""Probability of values that are left out."""


@dataclass(frozen=True, eq=False)
class NoiseLevel:
    """Power of the whitened noise along a direction: `known`, and independent uncertain parts.

    known         what is known of it, in units of the power that whitening took it for
    parts         values (s,) and probabilities (s,) of each part
    log_variance  variance of the log of all of it that is uncertain beside, as that of spectra estimated by repeats
    """

    known: float = 1.0
    parts: tuple[tuple[Array, Array], ...] = ()
    log_variance: float = 0.0

    def and_known(self, power: float, log_variance: float) -> NoiseLevel:
        """With a known power of another recording, and the variance of the log of all that it adds."""
        return NoiseLevel(self.known + float(power), self.parts, self.log_variance + float(log_variance))

    def and_parts(self, power: Array, probability: Array, log_variance: float) -> NoiseLevel:
        """With uncertain powers (p, s) of a recording's channels, their probabilities (p, s), and that variance."""
        parts = (*self.parts, *zip(power, probability, strict=True))
        return NoiseLevel(self.known, parts, self.log_variance + float(log_variance))

    @cached_property
    def mean(self) -> float:
        """Expectation of the power."""
        return self.known + sum(float(values @ probability) for values, probability in self.parts)

    @cached_property
    def variance_of_log(self) -> float:
        """Variance of the log of the power, to first order."""
        variance = sum(float((v - v @ p) ** 2 @ p) for v, p in self.parts)
        return self.log_variance + (variance / self.mean**2 if self.mean > 0 else 0.0)

    def p_value(self, score: float, rank: int) -> float:
        """P-value of a score of so many degrees of freedom in this noise, its expectation over the power."""
        values, probability = self._distribution
        return float(probability @ chi_square_p_value(score / np.maximum(values, 1e-300), rank, self.log_variance))

    @cached_property
    def _distribution(self) -> tuple[Array, Array]:
        """Values and probabilities of the sum of all parts."""
        values, probability = np.array([self.known]), np.ones(1)
        for power, chance in self.parts:
            likely = chance > NEGLIGIBLE * chance.max()
            values = (values[:, None] + power[likely]).ravel()
            probability = (probability[:, None] * chance[likely]).ravel()
            values, probability = _binned(values, probability)
        return values, probability / probability.sum()


def _binned(values: Array, probability: Array) -> tuple[Array, Array]:
    """A distribution of many values by that of the means over bins of equal ratio."""
    low, high = float(values.min()), float(values.max())
    if len(values) <= BINS:
        return values, probability
    if high <= low:  # of parts without power
        return values[:1], probability.sum(keepdims=True)
    low = max(low, NEGLIGIBLE * high)
    ratio = np.log(np.maximum(values, low) / low) / np.log(high / low)
    bins = np.minimum((BINS * ratio).astype(np.intp), BINS - 1)
    total, mean = (np.bincount(bins, weights, BINS) for weights in (probability, probability * values))
    kept = total > 0
    return np.asarray(mean[kept] / total[kept]), np.asarray(total[kept])


MIN_ROWS = 64
"""Rows of a channel below which its colour is not estimated."""
SINGLE_LINES = 32
"""Lowest lines that are bins by themselves; from there on as many bins to a factor e."""
LOWEST_CORNER = 0.1
"""Lowest line at which 1/f noise may exceed white noise."""
CORNERS = 48
"""Corners, in equal ratios up to `HIGHEST_CORNER` times the highest line, and none."""
EXPONENTS = (0.7, 1.0, 1.4)
"""Of the 1/f part: those of sensors are about 1, and what an autoregression leaves is not exactly a power."""
HIGHEST_CORNER = 10.0
"""Times the highest line: with the corner beyond it the spectrum is 1/f at all lines."""
SPREAD = 2.0
"""Std of a record's mean power, by which it may exceed that of the process."""


@dataclass(frozen=True, eq=False)
class WhitenedSpectrum:
    """Power spectral density of each channel's whitened rows at the lines of a cosine transform, 1 if they are white.

    White and 1/f noise: it is proportional to 1 + (corner / line)^exponent, with line 0 as line 1, in bins of lines.

    bins         of the lines
    power        (s, b, p) for each of s shapes, in units of white noise of unit variance
    probability  (s, p), of each shape
    """

    bins: LineBins
    power: Array
    probability: Array

    @classmethod
    def of(cls, residual: Array, leverage: Array, stated: bool = False) -> WhitenedSpectrum:
        """Of projected rows (n p,), of whose lines the share `leverage` (n, p) was projected out.

        With a `stated` std the level of all lines together is known, but for what a record has by chance: a spectrum
        that exceeds it does so by what the model lacks.
        """
        n, p = leverage.shape
        shapes = _Shapes.of(n)
        power = shapes.bins.sums(lines(residual, p) ** 2)
        free = shapes.bins.sums(np.maximum(1 - leverage, 0))
        freedom = np.maximum(free.sum(axis=0), 1.0)
        white = np.maximum(shapes.inverse @ power, 1e-300) / freedom
        log_likelihood = -0.5 * (freedom * np.log(white) + shapes.log @ free)
        information = shapes.slope**2 @ free - (shapes.slope @ free) ** 2 / freedom
        prior = shapes.prior(np.sqrt(np.maximum(information, 1e-300)))
        probability = np.exp(log_likelihood - log_likelihood.max(axis=0)) * prior
        likely = (probability > NEGLIGIBLE * probability.max(axis=0)).any(axis=1)
        probability = probability[likely] / probability[likely].sum(axis=0)
        spectra = white[likely][:, None, :] / shapes.inverse[likely][:, :, None]
        return cls(shapes.bins, shapes.bins.of_known_mean(spectra) if stated else spectra, probability)

    @property
    def rows(self) -> int:
        """n of a channel."""
        return self.bins.lines

    @cached_property
    def level(self) -> Array:
        """Expected power (n, p) at the lines."""
        return np.repeat(np.einsum("sbp,sp->bp", self.power, self.probability), self.bins.count, axis=0)

    @property
    def log_power_variance(self) -> Array:
        """Variance (p,) of the logarithm of a channel's power in a record, beyond that of white noise."""
        return np.asarray(2 * (self.level**2).sum(axis=0) / self.level.sum(axis=0) ** 2 - 2 / self.rows)

    def flattened(self, rows: Array, channel: int) -> Array:
        """Rows (n, ...) of a channel, filtered to a flat spectrum."""
        root = np.sqrt(self.level[:, channel])
        root = root.reshape(-1, *np.ones(rows.ndim - 1, dtype=int))
        return np.asarray(idct(dct(rows, axis=0, norm="ortho") / root, axis=0, norm="ortho"))

    def power_along(self, columns: Array) -> Array:
        """Expected power (s, p, g) along columns (n p, g) for each shape; a column's is the sum over its channels."""
        share = self.bins.sums(lines(columns, self.power.shape[2]) ** 2)
        return np.asarray((self.power.transpose(2, 0, 1) @ share.transpose(1, 0, 2)).swapaxes(0, 1))


def lines(rows: Array, channels: int) -> Array:
    """Cosine lines (n, p, ...) of rows (n p, ...), orthonormal."""
    return np.asarray(dct(rows.reshape(len(rows) // channels, channels, *rows.shape[1:]), axis=0, norm="ortho"))


@dataclass(frozen=True, eq=False)
class LineBins:
    """Bins of lines over which a spectrum is nearly constant: each line by itself, then ever more together.

    lines  n; first, count  (b,), first line of each bin and how many it has
    """

    lines: int
    first: NDArray[np.intp]
    count: NDArray[np.intp]

    @classmethod
    def of(cls, n: int) -> LineBins:
        """Of n lines."""
        edges = np.geomspace(SINGLE_LINES, n, max(2, round(np.log(n / SINGLE_LINES) * SINGLE_LINES)), endpoint=False)
        first = np.unique(np.concatenate([np.arange(SINGLE_LINES), edges.astype(np.intp)]))
        return cls(n, first, np.diff([*first, n]))

    def sums(self, values: Array) -> Array:
        """Sums (b, ...) of values (n, ...) over the bins."""
        return np.asarray(np.add.reduceat(values, self.first, axis=0))

    def of_known_mean(self, power: Array) -> Array:
        """Spectra (s, b, p), falling with the line, where the mean of the process over its lines is 1.

        That of a record differs by chance, the more the redder it is.
        """
        count = self.count[:, None]
        mean = (power * count).sum(axis=1, keepdims=True) / self.lines
        least = self._clipped(power, np.ones_like(mean))
        spread = np.sqrt(2 * (least**2 * count).sum(axis=1, keepdims=True)) / self.lines
        most = 1 + SPREAD * spread
        return np.asarray(np.where(mean <= 1, power / mean, np.where(mean <= most, power, self._clipped(power, most))))

    def _clipped(self, power: Array, mean: Array) -> Array:
        """The spectra (s, b, p) of that mean (s, 1, p) and the largest entropy below those given: min(power, c)."""
        counted = power * self.count[:, None]
        below = counted.sum(axis=1, keepdims=True) - np.cumsum(counted, axis=1)
        limits = (mean * self.lines - below) / np.cumsum(self.count)[:, None]  # with ever more bins at the limit
        return np.asarray(np.minimum(power, limits.max(axis=1, keepdims=True)))


@dataclass(frozen=True, eq=False)
class _Shapes:
    """Spectra 1 + (corner / line)^exponent in bins of lines, every corner with every exponent.

    log      (s, b), log of a spectrum
    inverse  (s, b), 1 over it
    slope    (s, b), derivative of its log by the log of the corner
    """

    bins: LineBins
    log: Array
    inverse: Array
    slope: Array

    @classmethod
    @lru_cache(maxsize=8)
    def of(cls, n: int) -> _Shapes:
        """For n lines."""
        bins = LineBins.of(n)
        corners = np.geomspace(LOWEST_CORNER, HIGHEST_CORNER * n, CORNERS)
        spectra, slopes = [], []
        for exponent in EXPONENTS:
            steep = bins.sums(np.maximum(np.arange(n), 1.0) ** -exponent) / bins.count * corners[:, None] ** exponent
            spectra.append(1 + steep)
            slopes.append(exponent * steep / (1 + steep))
        spectrum = np.concatenate(spectra)
        return cls(bins, np.log(spectrum), 1 / spectrum, np.concatenate(slopes))

    def prior(self, density: Array) -> Array:
        """Jeffreys' prior from its density (s, p) over the log of the corner, each exponent as likely."""
        by_exponent = density.reshape(len(EXPONENTS), CORNERS, -1)
        return np.asarray((by_exponent / by_exponent.sum(axis=1, keepdims=True)).reshape(density.shape))
