"""Contact detection by multiscale window tests, with the sensor's zero."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, maximum_filter1d, median_filter, minimum_filter1d

from estimation.autoregression import fit_autoregression
from estimation.multiplicity import chi2_isf, normal_cdf, normal_isf
from estimation.noise.transient_windows import Windows, cumulative_sums, inside, variances_of_sums
from modeling.noise import NoiseModel, block_means
from modeling.significance import LEVELS

Array = NDArray[np.float64]

NORMAL_QUARTILE = float(normal_isf(0.375))
"""Lower quartile of the absolute value of a standard normal variable."""
MIN_DIFFERENCES = 4
"""Least number of independent differences that the power at a scale is estimated from."""


@dataclass(frozen=True, eq=False)
class VarianceOfMeans:
    """Covariance of means over 1 .. n successive samples of stationary noise with p channels.

    variance     (n, p): of the mean over 1, 2, .. n samples of each channel
    correlation  (p, p) between the channels, assumed the same for all means
    constant     (p,) variance that averaging does not reduce: the model's systematic residual
    """

    variance: Array
    correlation: Array
    constant: Array

    @classmethod
    def of_autoregression(cls, noise: NoiseModel, longest: int, constant: Array) -> VarianceOfMeans:
        """The means of autoregressive noise over up to `longest` samples."""
        autocovariance, length = noise.autocovariance(longest), np.arange(1, longest + 1)[:, None]
        sums = np.maximum(variances_of_sums(autocovariance), 1e-12 * autocovariance[0] * length)
        scale = np.sqrt(np.diag(noise.covariance))
        return cls(sums / length**2, noise.covariance / np.outer(scale, scale), constant)

    def at_least(self, other: VarianceOfMeans) -> VarianceOfMeans:
        """The larger variance of both for every mean: an autoregression misses the slow part of 1/f noise."""
        return replace(self, variance=np.maximum(self.variance, other.variance))

    def covariance(self, length: int) -> Array:
        """Covariance (p, p) of a mean over `length` samples, the constant part included."""
        scale = np.sqrt(self.variance[length - 1])
        return np.asarray(self.correlation * np.outer(scale, scale) + np.diag(self.constant))


@dataclass(frozen=True, eq=False)
class MeanDifferences:
    """Differences of successive means of a series (n, p) over 1, 2, 4, .. samples; of few those of the scale before.

    power        (s, p) mean square; from their lower quartile unless `quiet`
    independent  (s,) number of independent differences
    quiet        whether they are of samples that are known to be contact-free
    samples      n
    """

    power: Array
    independent: Array
    quiet: bool
    samples: int

    @classmethod
    def of(cls, series: Array, quiet: NDArray[np.bool_] | None = None) -> MeanDifferences:
        """Of the `quiet` (contact-free) samples, or of the quieter part of a series.

        Where quiet samples are unknown the mean square comes from the lower quartile of the absolute differences, which
        a contact in less than three quarters of the record does not affect.
        """
        sums = cumulative_sums(series)
        disturbed = cumulative_sums(np.zeros(len(series)) if quiet is None else (~quiet).astype(float))
        powers, numbers = list[Array](), list[float]()
        for scale in map(int, _scales(len(series))):
            start = np.arange(0, len(series) + 1 - 2 * scale, max(1, scale // 4))
            start = start[disturbed[start + 2 * scale] == disturbed[start]]
            independent = len(start) * max(1, scale // 4) / (2 * scale)
            if powers and independent < MIN_DIFFERENCES:
                powers.append(powers[-1])
                numbers.append(numbers[-1])
                continue
            difference = (sums[start + 2 * scale] - 2 * sums[start + scale] + sums[start]) / scale
            powers.append(_mean_square(difference, robust=quiet is None))
            numbers.append(independent)
        return cls(np.stack(powers), np.array(numbers), quiet is not None, len(series))

    def variance_of_means(self, constant: Array, *, exceedance: float = 0.5) -> VarianceOfMeans:
        """The noise of the series.

        Two successive means over L have half of their sum with the variance V_2L, and half of their difference with
        D_L / 4, so that V_L = V_2L + D_L / 4: V_L is a sum over the scales above (Haar's wavelet variances; Allan's up
        to a factor). No noise model is needed. D_L is the mean square of the differences between means. Few differences
        leave it uncertain: from quiet ones it is the limit that D exceeds with probability `exceedance`, by default its
        median. At the largest scales D is extrapolated as constant, as for 1/f noise.
        """
        scales, powers = _scales(self.samples), self.power
        if self.quiet:
            freedom = np.maximum(self.independent, 1.0)
            powers = powers * np.array([one / chi2_isf(1 - exceedance, one) for one in map(float, freedom)])[:, None]
        levels = np.cumsum(powers[::-1], axis=0)[::-1] / 4 + 1e-300
        length = np.log(np.arange(1, self.samples + 1))
        variance = [np.exp(np.interp(length, np.log(scales), np.log(level))) for level in levels.T]
        return VarianceOfMeans(np.stack(variance, axis=1), np.eye(levels.shape[1]), constant)


def _scales(samples: int) -> NDArray[np.intp]:
    return np.asarray(2 ** np.arange(int(np.log2(max(samples, 2))) + 1), dtype=np.intp)


def _mean_square(difference: Array, *, robust: bool) -> Array:
    """Mean square (p,) of differences, or from their lower quartile."""
    if not len(difference):
        return np.full(difference.shape[1], 1e-300)
    if robust:
        return np.asarray((np.quantile(np.abs(difference), 0.25, axis=0) / NORMAL_QUARTILE) ** 2)
    return np.asarray((difference**2).mean(axis=0))


SampleMask = NDArray[np.bool_]

BLOCK_SECONDS = 0.005
"""Seconds averaged into one block before the search: a touch by hand or a tap lasts several blocks."""
MAX_BLOCKS_PER_RECORD = 20_000
"""Most blocks of a record, so that a log of hours takes seconds: all windows are searched."""
MIN_BLOCKS_PER_RECORD = 200
"""Fewest blocks of a record, if it has that many samples."""
WINDOW_LENGTH_RATIO = 1.25
"""Ratio of successive window lengths: a contact of a length in between loses at most a tenth of its score."""
ZERO_SEGMENTS = 200
"""Segments of a record whose means are candidates for the zero."""
MERGE_GAP = 10
"""Blocks: contacts with fewer between them are one interval, since a contact force can cross zero."""
GUARD_BLOCKS = 2
"""Blocks next to an interval that do not count as free: the shortest window has three, and may miss an edge."""
MAX_CLUSTER_STEPS = 120
"""Most growth steps of a cluster; one that has not converged by then is used as it is."""
DETECTION_ROUNDS = 12
"""Most iterations between noise and intervals; they mostly converge after three."""


@dataclass(frozen=True)
class ContactInterval:
    """An interval in which the reading deviates from the free tool's by more than noise and systematic residual.

    first, last   samples first <= t < last
    p_value       upper bound of the probability of such an interval anywhere in a record without contact
    """

    first: int
    last: int
    p_value: float


@dataclass(frozen=True, eq=False)
class ContactDetection:
    """Contact-free samples, zero, noise and contact intervals of a record.

    zero        (p,) mean of the residual where the tool is free; `zero_covariance` (p, p) its covariance
    free        (n,) samples outside every interval
    covariance  (p, p) of one sample's noise about the zero
    noise       of means over blocks of `block` samples, with the model's systematic residual
    """

    zero: Array
    zero_covariance: Array
    free: SampleMask
    covariance: Array
    noise: VarianceOfMeans
    block: int
    intervals: tuple[ContactInterval, ...]
    false_alarms: float

    def blocks(self, samples: int) -> int:
        """Blocks in so many samples: at least one, at most those of the record."""
        return min(max(1, samples // self.block), len(self.noise.variance))


@dataclass(frozen=True, eq=False)
class BlockMeans:
    """A residual (n, p) averaged over blocks of `size` samples: means (b, p)."""

    residual: Array
    size: int

    @classmethod
    def of(cls, residual: Array, dt: float | None) -> BlockMeans:
        """Blocks of `BLOCK_SECONDS` seconds, of one sample for static poses (dt None)."""
        shortest, longest = -(-len(residual) // MAX_BLOCKS_PER_RECORD), max(1, len(residual) // MIN_BLOCKS_PER_RECORD)
        return cls(residual, 1 if dt is None else max(shortest, min(longest, round(BLOCK_SECONDS / dt))))

    @property
    def means(self) -> Array:
        """Mean of each block; an incomplete last block is left out."""
        return block_means(self.residual, self.size)

    def samples(self, blocks: SampleMask) -> SampleMask:
        """The samples (n,) of a selection of blocks (b,); those after the last block follow it."""
        return np.concatenate([np.repeat(blocks, self.size), np.repeat(blocks[-1:], len(self.residual) % self.size)])


def detect_contacts(
    residual: Array,
    dt: float | None,
    *,
    floor: Array,
    remainder: Array,
    zero: Array | None = None,
    false_alarms: float = LEVELS.contact,
) -> ContactDetection:
    """Find the zero and the contacts of a record from its residual (n, p), measured minus predicted.

    A window's mean in each channel is tested against the variance that the noise of the free blocks and the model's
    systematic residual `remainder` (p,) give a mean of that length, Bonferroni-corrected for windows and channels, so
    that a record without contact gives any interval with a probability of `false_alarms` at the most. The noise is the
    larger of an autoregression's and of that from differences of means, at its upper confidence limit
    (`LEVELS.contact_noise`). A window must be significant without its largest block too, against outliers. The
    disjoint windows are chosen to maximise their total excess over the threshold; the edges of an interval are those
    by the autoregression alone. The zero is the mean of the free samples unless it is given. Intervals, zero and noise
    are iterated to convergence.
    """
    blocks = BlockMeans.of(residual, dt)
    means = blocks.means
    search = ContactSearch(means, remainder**2, false_alarms)
    states = [search.converged(start) for start in search.starts(floor**2 / blocks.size)]
    noise, quiet, intervals = max(states, key=lambda s: (bool(s.intervals), s.quiet.sum()))
    guarded = blocks.samples(binary_erosion(quiet, iterations=GUARD_BLOCKS, border_value=1))
    if zero is not None:  # contact-free about its own mean need not be free about the given zero
        intervals = search.state(quiet, zero).intervals
        quiet = _outside(intervals, np.zeros(len(means), dtype=bool))
    free = guarded if zero is None else blocks.samples(quiet)
    return ContactDetection(
        zero=residual[guarded].mean(axis=0) if zero is None else zero,
        zero_covariance=noise.covariance(int(quiet.sum())) if zero is None else np.zeros((len(floor),) * 2),
        free=free,
        covariance=np.cov(residual[guarded].T) if guarded.sum() > 10 * len(floor) else np.diag(floor**2),
        noise=noise,
        block=blocks.size,
        intervals=tuple(_in_samples(i, blocks, len(means)) for i in intervals),
        false_alarms=false_alarms,
    )


def _in_samples(interval: ContactInterval, blocks: BlockMeans, count: int) -> ContactInterval:
    last = len(blocks.residual) if interval.last == count else interval.last * blocks.size
    return ContactInterval(interval.first * blocks.size, last, interval.p_value)


# --------------------------------------------------------------- zero, noise and intervals, iterated


class DetectionState(NamedTuple):
    """The noise about a zero, the quiet blocks (b,) that both are estimated from, and the intervals of contact."""

    noise: VarianceOfMeans
    quiet: SampleMask
    intervals: tuple[ContactInterval, ...]


@dataclass(frozen=True, eq=False)
class ContactSearch:
    """The search for intervals in the block means (b, p) of a record; `constant` (p,) is the systematic variance."""

    means: Array
    constant: Array
    false_alarms: float

    @cached_property
    def windows(self) -> Windows:
        """Every window of three blocks up to half of the record, of lengths that grow by `WINDOW_LENGTH_RATIO`."""
        longest = max(3, len(self.means) // 2)
        count = 2 + int(np.log(longest / 3) / np.log(WINDOW_LENGTH_RATIO))
        lengths = np.unique(np.round(np.geomspace(3, longest, count)).astype(np.intp))
        return Windows.of_lengths(lengths, len(self.means))

    def starts(self, floor: Array) -> tuple[SampleMask, SampleMask]:
        """Two initial sets of free blocks, from methods that fail in different cases.

        The noise from differences is robust to a contact of any strength, unless it lasts for most of the record; the
        cluster is robust to long contacts, but not to a weak one connected to it.
        """
        return self.undisturbed(), largest_cluster(self.means, floor, self.constant)

    def undisturbed(self) -> SampleMask:
        """Blocks outside the intervals about the majority mean, by the noise of the quieter differences."""
        noise = MeanDifferences.of(self.means).variance_of_means(self.constant)
        quiet, zero = np.ones(len(self.means), dtype=bool), majority_mean(self.means, noise)
        for _ in range(DETECTION_ROUNDS):
            remaining = _outside(self.exceeding(zero, noise, quiet), quiet)
            if (remaining == quiet).all():
                break
            quiet = remaining
            zero = self.means[quiet].mean(axis=0)
        return quiet

    def state(self, quiet: SampleMask, zero: Array | None = None) -> DetectionState:
        """Noise of the quiet blocks about their own mean, and the intervals about that mean or a given zero.

        The noise is that of an autoregression, but at least that of differences. Intervals are significant against the
        upper limit of the latter; their edges are those by the autoregression alone.
        """
        mean = self.means[quiet].mean(axis=0)
        fitted = fit_autoregression(self.means - mean, quiet)
        autoregressive = VarianceOfMeans.of_autoregression(fitted, len(quiet), self.constant)
        differences = MeanDifferences.of(self.means, quiet)
        likely, limit = (
            autoregressive.at_least(differences.variance_of_means(self.constant, exceedance=share))
            for share in (0.5, LEVELS.contact_noise)
        )
        zero = mean if zero is None else zero
        significant, candidates = (self.exceeding(zero, noise, quiet) for noise in (limit, autoregressive))
        return DetectionState(likely, quiet, _refined_intervals(significant, candidates))

    def converged(self, quiet: SampleMask) -> DetectionState:
        """The fixed point: the state whose quiet blocks are those outside its intervals."""
        state = self.state(quiet)
        for _ in range(DETECTION_ROUNDS):
            remaining = _outside(state.intervals, state.quiet)
            if (remaining == state.quiet).all():
                break
            state = self.state(remaining)
        return state

    def exceeding(self, zero: Array, noise: VarianceOfMeans, quiet: SampleMask) -> tuple[ContactInterval, ...]:
        """The disjoint windows whose statistics exceed the threshold by the largest sum, close ones merged.

        The statistic is the squared mean over its variance, twice the logarithm of the likelihood ratio; the threshold
        is Bonferroni-corrected for windows and channels.
        """
        size = self._standardised_means(zero, noise, int(quiet.sum()))
        limit = normal_isf(self.false_alarms / size.size / 2)
        merged: list[ContactInterval] = []
        for index in self.windows.best_disjoint(size.max(axis=0) ** 2 - limit**2):
            first, last = int(self.windows.first[index]), int(self.windows.last[index])
            largest = float(size[:, index].max())
            p_value = min(1.0, size.size * 2 * float(normal_cdf(-largest)))
            if merged and merged[-1].last + MERGE_GAP > first:
                before = merged.pop()
                first, p_value = before.first, min(before.p_value, p_value)
            merged.append(ContactInterval(first, last, p_value))
        return tuple(merged)

    def _standardised_means(self, zero: Array, noise: VarianceOfMeans, quiet: int) -> Array:
        """Mean of each channel and window over its std (p, w), the zero's own error included, as absolute values.

        The smaller of the whole window's and of that without its largest block, a mean over one block less. The zero
        is the mean of `quiet` blocks.
        """
        lengths, counts = self._lengths
        constant, zero = noise.constant + noise.variance[max(1, quiet) - 1], zero - self._centre
        whole, without = (
            np.repeat(np.sqrt(noise.variance[length - 1] + constant), counts, axis=0).T
            for length in (lengths, lengths - 1)
        )
        length = np.repeat(lengths, counts)
        total = self._window_sums.total - length * zero[:, None]
        reduced = (total - self._window_sums.largest(zero)) / (length - 1)
        return np.asarray(np.minimum(np.abs(total / length) / whole, np.abs(reduced) / without))

    @cached_property
    def _centre(self) -> Array:
        """Mean of all blocks (p,), without which sums keep their digits."""
        return np.asarray(self.means.mean(axis=0))

    @cached_property
    def _lengths(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """The lengths of the windows, in their order, and how many windows have each."""
        lengths, counts = np.unique(self.windows.last - self.windows.first, return_counts=True)
        return lengths, counts

    @cached_property
    def _window_sums(self) -> WindowSums:
        """In the order of `windows`, of the means less their centre."""
        means = self.means - self._centre
        sums = cumulative_sums(means)
        parts = [WindowSums.of(means, sums, int(length)) for length in self._lengths[0]]
        return WindowSums(*(np.concatenate(each, axis=1) for each in zip(*parts, strict=True)))


class WindowSums(NamedTuple):
    """Sums and extremes (p, w) of windows; channels first, since there are few of them."""

    total: Array
    lowest: Array
    highest: Array

    @classmethod
    def of(cls, series: Array, cumulative: Array, length: int) -> WindowSums:
        """All windows of one length of a series (n, p), from each sample on, w = n - length + 1."""
        count, origin = len(series) - length + 1, -(length // 2)
        lowest, highest = (
            extreme(series.T, length, axis=1, origin=origin)[:, :count]
            for extreme in (minimum_filter1d, maximum_filter1d)
        )
        return cls((cumulative[length:] - cumulative[:count]).T, lowest, highest)

    def largest(self, zero: Array) -> Array:
        """The sample furthest from a zero (p,) in each window, less the zero."""
        low, high = self.lowest - zero[:, None], self.highest - zero[:, None]
        return np.where(high >= -low, high, low)


def _refined_intervals(
    significant: tuple[ContactInterval, ...], candidates: tuple[ContactInterval, ...]
) -> tuple[ContactInterval, ...]:
    """Candidate intervals that overlap a significant one, with its p-value."""
    refined = []
    for interval in candidates:
        overlapping = [s.p_value for s in significant if s.first < interval.last and s.last > interval.first]
        if overlapping:
            refined.append(replace(interval, p_value=min(overlapping)))
    return tuple(refined)


def _outside(intervals: tuple[ContactInterval, ...], quiet: SampleMask) -> SampleMask:
    """Blocks outside all intervals; `quiet` unchanged where fewer than 2 % would remain."""
    outside = ~inside([(i.first, i.last) for i in intervals], len(quiet))
    return outside if outside.sum() > 0.02 * len(outside) else quiet


def majority_mean(means: Array, noise: VarianceOfMeans) -> Array:
    """Mean (p,) of the largest cluster of segments: those within the chi-square limit of the segment with most such."""
    length = max(1, len(means) // ZERO_SEGMENTS)
    segments = block_means(means, length)
    scale = np.sqrt(noise.variance[length - 1] + noise.constant)
    distance = (((segments[None] - segments[:, None]) / scale) ** 2).sum(axis=2)
    near = distance < chi2_isf(LEVELS.quiet_segment, means.shape[1])
    return np.asarray(segments[near[near.sum(axis=1).argmax()]].mean(axis=0))


def largest_cluster(means: Array, floor: Array, constant: Array) -> SampleMask:
    """The largest cluster of blocks (b,) about one value.

    Its centre starts as the block with most others within the chi-square limit of its variance: the larger of `floor`
    (p,) and of the blocks' fast variance (half of the squared successive differences), plus the model's `constant`.
    Centre and covariance are then iterated with the members' mean and covariance to convergence: of Gaussian blocks,
    however slow, all but `LEVELS.quiet_segment` are members. Where the cluster is too small, all blocks are.
    """
    steps = np.diff(means, axis=0)
    fast = (1.4826 * np.median(np.abs(steps), axis=0)) ** 2 / 2 if len(steps) else np.zeros(means.shape[1])
    scale = np.sqrt(np.maximum(np.maximum(floor, fast) + constant, 1e-300))
    limit = chi2_isf(LEVELS.quiet_segment, means.shape[1])
    candidates = means[:: max(1, len(means) // (2 * ZERO_SEGMENTS))]
    distance = np.zeros((len(candidates), len(means)))
    for one, other in zip((candidates / scale).T, (means / scale).T, strict=True):
        distance += np.subtract.outer(one, other) ** 2
    centre = candidates[int((distance < limit).sum(axis=1).argmax())]
    members: SampleMask = (((means - centre) / scale) ** 2).sum(axis=1) < limit
    for _ in range(MAX_CLUSTER_STEPS):
        if members.sum() <= 2 * means.shape[1]:
            break
        centre = means[members].mean(axis=0)
        deviation = means - centre
        covariance = deviation[members].T @ deviation[members] / members.sum() + np.diag(1e-6 * scale**2)
        grown: SampleMask = (deviation * np.linalg.solve(covariance, deviation.T).T).sum(axis=1) < limit
        if (grown == members).all():
            break
        members = grown
    smoothed = median_filter(members.astype(np.uint8), size=MERGE_GAP + 1, mode="nearest") > 0
    return smoothed if smoothed.sum() > 2 * means.shape[1] else np.ones(len(means), dtype=bool)
