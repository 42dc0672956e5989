"""Contact detection by multiscale window tests, with the sensor's zero."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, median_filter
from scipy.stats import chi2, norm

from estimation.contact.variance_of_means import VarianceOfMeans
from estimation.noise.autoregression import fit_autoregression
from modeling.noise.whitening import block_means

Array = NDArray[np.float64]
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
OUTSIDE_CLUSTER_PROBABILITY = 1e-3
"""Probability that a contact-free segment is left out of the cluster about the zero."""
MERGE_GAP = 10
"""Blocks: contacts with fewer between them are one interval, since a contact force can cross zero."""
GUARD_BLOCKS = 2
"""Blocks next to an interval that do not count as free: the shortest window has three, and may miss an edge."""
NOISE_LIMIT_PROBABILITY = 0.05
"""Probability that the noise at a scale, estimated from few differences, exceeds the value used in the tests."""
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
    """

    zero: Array
    zero_covariance: Array
    free: SampleMask
    covariance: Array
    intervals: tuple[ContactInterval, ...]
    false_alarms: float


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
    false_alarms: float = 0.01,
) -> ContactDetection:
    """Find the zero and the contacts of a record from its residual (n, p), measured minus predicted.

    A window's mean in each channel is tested against the variance that the noise of the free blocks and the model's
    systematic residual `remainder` (p,) give a mean of that length, Bonferroni-corrected for windows and channels, so
    that a record without contact gives any interval with a probability of `false_alarms` at the most. The noise is the
    larger of an autoregression's and of that from differences of means, at its upper confidence limit
    (`NOISE_LIMIT_PROBABILITY`). A window must be significant without its largest block too, against outliers. The
    disjoint windows are chosen to maximise their total excess over the threshold; the edges of an interval are those
    by the autoregression alone. The zero is the mean of the free samples unless it is given. Intervals, zero and noise
    are iterated to convergence.
    """
    blocks = BlockMeans.of(residual, dt)
    means = blocks.means
    search = ContactSearch(means, CandidateWindows.over(len(means)), remainder**2, false_alarms)
    states = [search.converged(start) for start in search.starts(floor**2 / blocks.size)]
    _, noise, quiet, found = max(states, key=lambda s: (bool(s.found), s.quiet.sum()))
    guarded = blocks.samples(binary_erosion(quiet, iterations=GUARD_BLOCKS, border_value=1))
    if zero is not None:  # contact-free about its own mean need not be free about the given zero
        found = search.about(zero, quiet)
        quiet = _outside(found, np.zeros(len(means), dtype=bool))
    free = guarded if zero is None else blocks.samples(quiet)
    return ContactDetection(
        zero=residual[guarded].mean(axis=0) if zero is None else zero,
        zero_covariance=noise.covariance(int(quiet.sum())) if zero is None else np.zeros((len(floor),) * 2),
        free=free,
        covariance=np.cov(residual[guarded].T) if guarded.sum() > 10 * len(floor) else np.diag(floor**2),
        intervals=tuple(_in_samples(i, blocks, len(means)) for i in found),
        false_alarms=false_alarms,
    )


def _in_samples(interval: ContactInterval, blocks: BlockMeans, count: int) -> ContactInterval:
    last = len(blocks.residual) if interval.last == count else interval.last * blocks.size
    return ContactInterval(interval.first * blocks.size, last, interval.p_value)


# --------------------------------------------------------------- zero, noise and intervals, iterated


class DetectionState(NamedTuple):
    """A zero (p,), the noise about it, the quiet blocks (b,) that both are estimated from, and the intervals found."""

    zero: Array
    noise: VarianceOfMeans
    quiet: SampleMask
    found: tuple[ContactInterval, ...]


@dataclass(frozen=True, eq=False)
class ContactSearch:
    """The search for intervals in the block means (b, p) of a record; `constant` (p,) is the systematic variance."""

    means: Array
    windows: CandidateWindows
    constant: Array
    false_alarms: float

    def starts(self, floor: Array) -> tuple[SampleMask, SampleMask]:
        """Two initial sets of free blocks, from methods that fail in different cases.

        The noise from differences is robust to a contact of any strength, unless it lasts for most of the record; the
        cluster is robust to long contacts, but not to a weak one connected to it.
        """
        return self.undisturbed(), largest_cluster(self.means, floor, self.constant)

    def undisturbed(self) -> SampleMask:
        """Blocks outside the intervals about the majority mean, by the noise of the quieter differences."""
        noise = VarianceOfMeans.of_differences(self.means, self.constant)
        quiet = np.ones(len(self.means), dtype=bool)
        zero = majority_mean(self.means, noise)
        for _ in range(DETECTION_ROUNDS):
            found = self.windows.exceeding(self.means - zero, noise, quiet, self.false_alarms)
            remaining = _outside(found, quiet)
            if (remaining == quiet).all():
                break
            quiet = remaining
            zero = self.means[quiet].mean(axis=0)
        return quiet

    def of(self, quiet: SampleMask) -> DetectionState:
        """Zero, noise and intervals estimated from the quiet blocks."""
        zero = self.means[quiet].mean(axis=0)
        autoregressive, likely, limit = self.noises(quiet)
        return DetectionState(zero, likely, quiet, self.intervals(zero, quiet, autoregressive, limit))

    def about(self, zero: Array, quiet: SampleMask) -> tuple[ContactInterval, ...]:
        """Intervals about a given zero, by the noise of quiet blocks about their own mean."""
        autoregressive, _, limit = self.noises(quiet)
        return self.intervals(zero, quiet, autoregressive, limit)

    def noises(self, quiet: SampleMask) -> tuple[VarianceOfMeans, VarianceOfMeans, VarianceOfMeans]:
        """Noise of the quiet blocks: of an autoregression; at least that of differences; at least their upper limit."""
        fitted = fit_autoregression(self.means - self.means[quiet].mean(axis=0), quiet)
        autoregressive = VarianceOfMeans.of_autoregression(fitted, len(quiet), self.constant)
        likely, limit = (
            autoregressive.at_least(VarianceOfMeans.of_differences(self.means, self.constant, quiet, doubt=doubt))
            for doubt in (0.5, NOISE_LIMIT_PROBABILITY)
        )
        return autoregressive, likely, limit

    def intervals(
        self, zero: Array, quiet: SampleMask, autoregressive: VarianceOfMeans, limit: VarianceOfMeans
    ) -> tuple[ContactInterval, ...]:
        """Intervals significant against the upper limit of the noise, with the edges by the autoregression."""
        significant, candidates = (
            self.windows.exceeding(self.means - zero, noise, quiet, self.false_alarms)
            for noise in (limit, autoregressive)
        )
        return _refined_intervals(significant, candidates)

    def converged(self, quiet: SampleMask) -> DetectionState:
        """The fixed point: the state whose quiet blocks are those outside its intervals."""
        state = self.of(quiet)
        for _ in range(DETECTION_ROUNDS):
            remaining = _outside(state.found, state.quiet)
            if (remaining == state.quiet).all():
                break
            state = self.of(remaining)
        return state


def _refined_intervals(
    significant: tuple[ContactInterval, ...], candidates: tuple[ContactInterval, ...]
) -> tuple[ContactInterval, ...]:
    """Candidate intervals that overlap a significant one, with its p-value."""
    found = []
    for interval in candidates:
        overlapping = [s.p_value for s in significant if s.first < interval.last and s.last > interval.first]
        if overlapping:
            found.append(ContactInterval(interval.first, interval.last, min(overlapping)))
    return tuple(found)


def _outside(found: tuple[ContactInterval, ...], quiet: SampleMask) -> SampleMask:
    """Blocks outside all intervals; `quiet` unchanged where fewer than 2 % would remain."""
    outside = np.ones(len(quiet), dtype=bool)
    for interval in found:
        outside[interval.first : interval.last] = False
    return outside if outside.sum() > 0.02 * len(outside) else quiet


def majority_mean(means: Array, noise: VarianceOfMeans) -> Array:
    """Mean (p,) of the largest cluster of segments: those within the chi-square limit of the segment with most such."""
    length = max(1, len(means) // ZERO_SEGMENTS)
    segments = block_means(means, length)
    scale = np.sqrt(noise.variance[length - 1] + noise.constant)
    distance = (((segments[None] - segments[:, None]) / scale) ** 2).sum(axis=2)
    near = distance < chi2.isf(OUTSIDE_CLUSTER_PROBABILITY, means.shape[1])
    return np.asarray(segments[near[near.sum(axis=1).argmax()]].mean(axis=0))


def largest_cluster(means: Array, floor: Array, constant: Array) -> SampleMask:
    """The largest cluster of blocks (b,) about one value.

    Its centre starts as the block with most others within the chi-square limit of its variance: the larger of `floor`
    (p,) and of the blocks' fast variance (half of the squared successive differences), plus the model's `constant`.
    Centre and covariance are then iterated with the members' mean and covariance to convergence: of Gaussian blocks,
    however slow, all but `OUTSIDE_CLUSTER_PROBABILITY` are members. Where the cluster is too small, all blocks are.
    """
    steps = np.diff(means, axis=0)
    fast = (1.4826 * np.median(np.abs(steps), axis=0)) ** 2 / 2 if len(steps) else np.zeros(means.shape[1])
    scale = np.sqrt(np.maximum(np.maximum(floor, fast) + constant, 1e-300))
    limit = chi2.isf(OUTSIDE_CLUSTER_PROBABILITY, means.shape[1])
    candidates = means[:: max(1, len(means) // (2 * ZERO_SEGMENTS))]
    distance = (((means[None] - candidates[:, None]) / scale) ** 2).sum(axis=2)
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


# ---------------------------------------------------------------------------------------- the windows


@dataclass(frozen=True, eq=False)
class CandidateWindows:
    """Every window over b blocks of lengths 3 and more that grow by `WINDOW_LENGTH_RATIO`: first <= t < last, sorted by
    their end."""

    first: NDArray[np.intp]
    last: NDArray[np.intp]
    blocks: int

    @classmethod
    def over(cls, blocks: int) -> CandidateWindows:
        """Windows of three blocks up to half of the record."""
        longest = max(3, blocks // 2)
        count = 2 + int(np.log(longest / 3) / np.log(WINDOW_LENGTH_RATIO))
        lengths = np.unique(np.round(np.geomspace(3, longest, count)).astype(np.intp))
        last = np.concatenate([np.arange(length, blocks + 1) for length in lengths])
        length = np.repeat(lengths, [blocks + 1 - n for n in lengths])
        order = np.argsort(last, kind="stable")
        return cls((last - length)[order], last[order], blocks)

    def exceeding(
        self, deviation: Array, noise: VarianceOfMeans, quiet: SampleMask, false_alarms: float
    ) -> tuple[ContactInterval, ...]:
        """The disjoint windows whose statistics exceed the threshold by the largest sum, close ones merged.

        The statistic is the squared mean over its variance, twice the logarithm of the likelihood ratio; the threshold
        is Bonferroni-corrected for windows and channels.
        """
        size = self.standardised(deviation, noise, int(quiet.sum()))
        limit = norm.isf(false_alarms / size.size / 2)
        merged: list[tuple[int, int, float]] = []
        for index in _best_disjoint(self, (size**2).max(axis=1) - limit**2):
            first, last = int(self.first[index]), int(self.last[index])
            p_value = float(min(1.0, size.size * 2 * norm.sf(size[index].max())))
            if merged and merged[-1][1] + MERGE_GAP > first:
                before = merged.pop()
                first, p_value = before[0], min(before[2], p_value)
            merged.append((first, last, p_value))
        return tuple(ContactInterval(*window) for window in merged)

    def standardised(self, deviation: Array, noise: VarianceOfMeans, quiet: int) -> Array:
        """Mean of each window and channel over its std (windows, p), the zero's own error included, as absolute values.

        The smaller of the whole window's and of that without its largest block, a mean over one block less.
        """
        sums = np.concatenate([np.zeros((1, deviation.shape[1])), np.cumsum(deviation, axis=0)])
        zero = noise.variance[max(1, quiet) - 1]
        largest = [RangeMaximum.of(np.abs(column)) for column in deviation.T]
        size = np.empty((len(self.first), deviation.shape[1]))
        for length in map(int, np.unique(self.last - self.first)):
            these = self.last - self.first == length
            total = sums[self.last[these]] - sums[self.first[these]]
            places = np.stack([one.between(self.first[these], length) for one in largest], axis=1)
            reduced = total - np.take_along_axis(deviation, places, axis=0)
            whole, without = (np.sqrt(noise.variance[n - 1] + noise.constant + zero) for n in (length, length - 1))
            size[these] = np.minimum(np.abs(total / length) / whole, np.abs(reduced / (length - 1)) / without)
        return size


@dataclass(frozen=True, eq=False)
class RangeMaximum:
    """Index of the maximum of a series (b,) in a range: `tables[k]` for the 2^k values from each index on."""

    series: Array
    tables: tuple[NDArray[np.intp], ...]

    @classmethod
    def of(cls, series: Array) -> RangeMaximum:
        """Each table from the one before it: the larger of two adjacent maxima."""
        tables = [np.arange(len(series))]
        while 2 ** len(tables) <= len(series):
            half = 2 ** (len(tables) - 1)
            left, right = tables[-1][:-half], tables[-1][half:]
            tables.append(np.where(series[left] >= series[right], left, right))
        return cls(series, tuple(tables))

    def between(self, first: NDArray[np.intp], length: int) -> NDArray[np.intp]:
        """Index of the largest value in `length` values from each index `first` on."""
        level = length.bit_length() - 1
        left, right = self.tables[level][first], self.tables[level][first + length - 2**level]
        return np.where(self.series[left] >= self.series[right], left, right)


def _best_disjoint(windows: CandidateWindows, gain: Array) -> list[int]:
    """Disjoint windows of the largest sum of gains: best[t] = max(best[t - 1], best[first] + gain of those to t)."""
    best, choice = np.zeros(windows.blocks + 1), np.full(windows.blocks + 1, -1)
    edges = np.searchsorted(windows.last, np.arange(windows.blocks + 2))
    for end in range(1, windows.blocks + 1):
        best[end] = best[end - 1]
        part = slice(edges[end], edges[end + 1])
        total = best[windows.first[part]] + gain[part]
        if len(total) and total.max() > best[end]:
            best[end], choice[end] = total.max(), part.start + int(total.argmax())
    chosen, end = [], windows.blocks
    while end > 0:
        if choice[end] < 0:
            end -= 1
        else:
            chosen.append(int(choice[end]))
            end = int(windows.first[choice[end]])
    return chosen[::-1]
