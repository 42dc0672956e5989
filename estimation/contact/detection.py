"""Contact detection: the sensor's zero where nothing touches the tool, and the intervals in which something does."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, median_filter
from scipy.stats import chi2, norm

from estimation.contact.mean_noise import MeanNoise
from estimation.residual_noise import best_autoregression
from estimation.whitening import block_means

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

BLOCK = 0.005
"""Seconds that are averaged before anything is looked for: a touch by hand or a tap lasts several such blocks."""
MOST = 20_000
"""Blocks that a record is cut into at the most, so that a log of hours takes seconds: all windows are searched."""
FEWEST = 200
"""Blocks that a record is cut into at the least, however short it is, as far as it has samples."""
RATIO = 1.25
"""From one window's length to the next longer: one in between loses at most a tenth of its score."""
STRETCHES = 200
"""Stretches of a record that are asked for the zero."""
APART = 1e-3
"""Chance of a stretch at the zero that is not counted as agreeing on it."""
CLOSE = 10
"""Blocks: touches with fewer between them are one interval, since a touch passes through zero as well."""
GUARD = 2
"""Blocks beside an interval that do not count as free: the shortest window has three, and may miss an edge."""
DOUBT = 0.05
"""Chance that the noise on a scale, known from few differences, is more than what windows are tested against."""
MOST_GROWTH = 120
"""Times that a cluster may grow; one that still grows then has no edge, and is as good as any."""
ROUNDS = 12
"""Times that noise and intervals are found from one another; they mostly stand still after three."""


@dataclass(frozen=True)
class Interval:
    """An interval in which the reading leaves the free tool's by more than noise and known errors do.

    first, last   samples first <= t < last
    p_value       chance of the like anywhere in a record without contact, at the most
    """

    first: int
    last: int
    p_value: float


@dataclass(frozen=True, eq=False)
class Detection:
    """What of a record is free, its zero and its noise.

    zero        (p,) mean of the residual where the tool is free, and `zero_covariance` (p, p) of it
    free        (n,) samples outside every interval
    covariance  (p, p) of one sample's noise about the zero
    """

    zero: Array
    zero_covariance: Array
    free: Mask
    covariance: Array
    intervals: tuple[Interval, ...]
    false_alarms: float


@dataclass(frozen=True, eq=False)
class Blocks:
    """A residual (n, p) averaged over blocks of `size` samples: means (b, p)."""

    residual: Array
    size: int

    @classmethod
    def of(cls, residual: Array, dt: float | None) -> Blocks:
        """Blocks of `BLOCK` seconds, of one sample for poses at rest (dt None)."""
        shortest, longest = -(-len(residual) // MOST), max(1, len(residual) // FEWEST)
        return cls(residual, 1 if dt is None else max(shortest, min(longest, round(BLOCK / dt))))

    @property
    def means(self) -> Array:
        """Mean of each block; what does not fill a block at the end is left out."""
        return block_means(self.residual, self.size)

    def samples(self, blocks: Mask) -> Mask:
        """The samples (n,) of some blocks (b,); those after the last block go with it."""
        return np.concatenate([np.repeat(blocks, self.size), np.repeat(blocks[-1:], len(self.residual) % self.size)])


def detect(
    residual: Array,
    dt: float | None,
    *,
    floor: Array,
    remainder: Array,
    zero: Array | None = None,
    false_alarms: float = 0.01,
) -> Detection:
    """Find the zero and the contacts of a record from its residual (n, p), measured minus predicted.

    A window's mean in each channel is tested against what the noise of the free blocks and the model's known
    `remainder` (p,) leave in a mean of that length, paid for by the number of windows and channels (Bonferroni), so
    that a record without contact gives any interval with a chance of `false_alarms` at the most. The noise is that of
    an autoregression or what the differences of means say, whichever is more, and of that the upper limit (`DOUBT`).
    A window counts without its loudest block, of which an outlier consists. The windows are those that together exceed
    their price most; the edges of what is found are those by the autoregression alone. The zero is the mean of the free
    samples unless it is given. Intervals, zero and noise are found from one another until they stand still.
    """
    blocks = Blocks.of(residual, dt)
    means = blocks.means
    search = Search(means, Windows.over(len(means)), remainder**2, false_alarms)
    settled = [search.settled(start) for start in search.starts(floor**2 / blocks.size)]
    _, noise, quiet, found = max(settled, key=lambda s: (bool(s.found), s.quiet.sum()))
    calm = blocks.samples(binary_erosion(quiet, iterations=GUARD, border_value=1))
    if zero is not None:  # what is calm need not be free
        found = search.about(zero, quiet)
        quiet = _outside(found, np.zeros(len(means), dtype=bool))
    free = calm if zero is None else blocks.samples(quiet)
    return Detection(
        zero=residual[calm].mean(axis=0) if zero is None else zero,
        zero_covariance=noise.covariance(int(quiet.sum())) if zero is None else np.zeros((len(floor),) * 2),
        free=free,
        covariance=np.cov(residual[calm].T) if calm.sum() > 10 * len(floor) else np.diag(floor**2),
        intervals=tuple(_in_samples(i, blocks, len(means)) for i in found),
        false_alarms=false_alarms,
    )


def _in_samples(interval: Interval, blocks: Blocks, count: int) -> Interval:
    last = len(blocks.residual) if interval.last == count else interval.last * blocks.size
    return Interval(interval.first * blocks.size, last, interval.p_value)


# --------------------------------------------------------------- zero, noise and intervals, from one another


class State(NamedTuple):
    """A zero (p,), the noise about it, the blocks (b,) that both come from, and the intervals that follow."""

    zero: Array
    noise: MeanNoise
    quiet: Mask
    found: tuple[Interval, ...]


@dataclass(frozen=True, eq=False)
class Search:
    """The search for intervals in the means (b, p) of a record's blocks; `constant` (p,) is known to be wrong."""

    means: Array
    windows: Windows
    constant: Array
    false_alarms: float

    def starts(self, floor: Array) -> tuple[Mask, Mask]:
        """Blocks that may be free, by two ways that fail differently.

        The noise of differences does not notice a push however strong, unless it is there for most of the record; the
        cluster does not mind that, but a weak push that grows out of it.
        """
        return self.undisturbed(), cluster(self.means, floor, self.constant)

    def undisturbed(self) -> Mask:
        """Blocks outside the intervals about the value that most agree on, by the noise of the quieter differences."""
        noise = MeanNoise.of_differences(self.means, self.constant)
        quiet = np.ones(len(self.means), dtype=bool)
        zero = agreed(self.means, noise)
        for _ in range(ROUNDS):
            found = self.windows.exceeding(self.means - zero, noise, quiet, self.false_alarms)
            left = _outside(found, quiet)
            if (left == quiet).all():
                break
            quiet = left
            zero = self.means[quiet].mean(axis=0)
        return quiet

    def of(self, quiet: Mask) -> State:
        """Zero, noise and intervals that follow from the quiet blocks."""
        zero = self.means[quiet].mean(axis=0)
        remembered, likely, largest = self.noises(quiet)
        return State(zero, likely, quiet, self.intervals(zero, quiet, remembered, largest))

    def about(self, zero: Array, quiet: Mask) -> tuple[Interval, ...]:
        """Intervals about a zero that is known, by the noise of quiet blocks about their own mean."""
        remembered, _, largest = self.noises(quiet)
        return self.intervals(zero, quiet, remembered, largest)

    def noises(self, quiet: Mask) -> tuple[MeanNoise, MeanNoise, MeanNoise]:
        """Noise of the quiet blocks: of an autoregression, with what differences say, and with their upper limit."""
        coefficients, innovations = best_autoregression(self.means - self.means[quiet].mean(axis=0), quiet)
        remembered = MeanNoise.of_autoregression(coefficients, innovations, len(quiet), self.constant)
        likely, largest = (
            remembered.at_least(MeanNoise.of_differences(self.means, self.constant, quiet, doubt=doubt))
            for doubt in (0.5, DOUBT)
        )
        return remembered, likely, largest

    def intervals(self, zero: Array, quiet: Mask, remembered: MeanNoise, largest: MeanNoise) -> tuple[Interval, ...]:
        """Intervals that exceed the largest noise, with the edges that they have in the remembered one."""
        sure, sharp = (
            self.windows.exceeding(self.means - zero, noise, quiet, self.false_alarms)
            for noise in (largest, remembered)
        )
        return _sharpened(sure, sharp)

    def settled(self, quiet: Mask) -> State:
        """The state in which the blocks outside its intervals are those that it comes from."""
        state = self.of(quiet)
        for _ in range(ROUNDS):
            left = _outside(state.found, state.quiet)
            if (left == state.quiet).all():
                break
            state = self.of(left)
        return state


def _sharpened(sure: tuple[Interval, ...], sharp: tuple[Interval, ...]) -> tuple[Interval, ...]:
    """Sharp intervals that a sure one lies in or reaches into, with its p-value."""
    found = []
    for interval in sharp:
        within = [s.p_value for s in sure if s.first < interval.last and s.last > interval.first]
        if within:
            found.append(Interval(interval.first, interval.last, min(within)))
    return tuple(found)


def _outside(found: tuple[Interval, ...], quiet: Mask) -> Mask:
    """Blocks outside all intervals; those of before where hardly any would be left."""
    left = np.ones(len(quiet), dtype=bool)
    for interval in found:
        left[interval.first : interval.last] = False
    return left if left.sum() > 0.02 * len(left) else quiet


def agreed(means: Array, noise: MeanNoise) -> Array:
    """The value (p,) that most stretches of a record agree on: the mean of those within reach of the best of them."""
    length = max(1, len(means) // STRETCHES)
    stretches = block_means(means, length)
    scale = np.sqrt(noise.variance[length - 1] + noise.constant)
    distance = (((stretches[None] - stretches[:, None]) / scale) ** 2).sum(axis=2)
    near = distance < chi2.isf(APART, means.shape[1])
    return np.asarray(stretches[near[near.sum(axis=1).argmax()]].mean(axis=0))


def cluster(means: Array, floor: Array, constant: Array) -> Mask:
    """The blocks (b,) that agree on one value.

    The value starts as the block that has most others within reach of its noise, the larger of `floor` (p,) and of the
    blocks' own fast variance (half of the square of successive differences), and of the model's `constant` error; value
    and reach grow by the members' mean and covariance until they stand still. Of Gaussian blocks, however slow, all but
    `APART` are members then. Where hardly any agree, all blocks are as good as any.
    """
    steps = np.diff(means, axis=0)
    fast = (1.4826 * np.median(np.abs(steps), axis=0)) ** 2 / 2 if len(steps) else np.zeros(means.shape[1])
    scale = np.sqrt(np.maximum(np.maximum(floor, fast) + constant, 1e-300))
    reach = chi2.isf(APART, means.shape[1])
    tried = means[:: max(1, len(means) // (2 * STRETCHES))]
    distance = (((means[None] - tried[:, None]) / scale) ** 2).sum(axis=2)
    centre = tried[int((distance < reach).sum(axis=1).argmax())]
    members: Mask = (((means - centre) / scale) ** 2).sum(axis=1) < reach
    for _ in range(MOST_GROWTH):
        if members.sum() <= 2 * means.shape[1]:
            break
        centre = means[members].mean(axis=0)
        away = means - centre
        spread = away[members].T @ away[members] / members.sum() + np.diag(1e-6 * scale**2)
        grown: Mask = (away * np.linalg.solve(spread, away.T).T).sum(axis=1) < reach
        if (grown == members).all():
            break
        members = grown
    voted = median_filter(members.astype(np.uint8), size=CLOSE + 1, mode="nearest") > 0
    return voted if voted.sum() > 2 * means.shape[1] else np.ones(len(means), dtype=bool)


# ---------------------------------------------------------------------------------------- the windows


@dataclass(frozen=True, eq=False)
class Windows:
    """Every window over b blocks of lengths 3 and more that grow by `RATIO`: first <= t < last, sorted by their end."""

    first: NDArray[np.intp]
    last: NDArray[np.intp]
    blocks: int

    @classmethod
    def over(cls, blocks: int) -> Windows:
        """Windows of three blocks up to half of the record."""
        longest = max(3, blocks // 2)
        count = 2 + int(np.log(longest / 3) / np.log(RATIO))
        lengths = np.unique(np.round(np.geomspace(3, longest, count)).astype(np.intp))
        last = np.concatenate([np.arange(length, blocks + 1) for length in lengths])
        length = np.repeat(lengths, [blocks + 1 - n for n in lengths])
        order = np.argsort(last, kind="stable")
        return cls((last - length)[order], last[order], blocks)

    def exceeding(self, deviation: Array, noise: MeanNoise, quiet: Mask, false_alarms: float) -> tuple[Interval, ...]:
        """The disjoint windows whose evidence exceeds its price most in sum, close ones as one interval.

        The evidence is the square of a mean over its std, twice the logarithm of its likelihood ratio.
        """
        size = self.standardised(deviation, noise, int(quiet.sum()))
        limit = norm.isf(false_alarms / size.size / 2)
        merged: list[tuple[int, int, float]] = []
        for index in _best_disjoint(self, (size**2).max(axis=1) - limit**2):
            first, last = int(self.first[index]), int(self.last[index])
            p_value = float(min(1.0, size.size * 2 * norm.sf(size[index].max())))
            if merged and merged[-1][1] + CLOSE > first:
                before = merged.pop()
                first, p_value = before[0], min(before[2], p_value)
            merged.append((first, last, p_value))
        return tuple(Interval(*window) for window in merged)

    def standardised(self, deviation: Array, noise: MeanNoise, quiet: int) -> Array:
        """Mean of each window and channel over its std (windows, p), the zero's own error included, as absolute values.

        The smaller of the whole window's and of that without its loudest block, a mean over one block less.
        """
        sums = np.concatenate([np.zeros((1, deviation.shape[1])), np.cumsum(deviation, axis=0)])
        zero = noise.variance[max(1, quiet) - 1]
        loudest = [RangeMaximum.of(np.abs(column)) for column in deviation.T]
        size = np.empty((len(self.first), deviation.shape[1]))
        for own in map(int, np.unique(self.last - self.first)):
            these = self.last - self.first == own
            total = sums[self.last[these]] - sums[self.first[these]]
            places = np.stack([one.between(self.first[these], own) for one in loudest], axis=1)
            rest = total - np.take_along_axis(deviation, places, axis=0)
            whole, without = (np.sqrt(noise.variance[n - 1] + noise.constant + zero) for n in (own, own - 1))
            size[these] = np.minimum(np.abs(total / own) / whole, np.abs(rest / (own - 1)) / without)
        return size


@dataclass(frozen=True, eq=False)
class RangeMaximum:
    """Where a series (b,) is largest between two places: `tables[k]` has the answers for 2^k from each place on."""

    series: Array
    tables: tuple[NDArray[np.intp], ...]

    @classmethod
    def of(cls, series: Array) -> RangeMaximum:
        """Each table from the one before it: the larger of two neighbours' answers."""
        tables = [np.arange(len(series))]
        while 2 ** len(tables) <= len(series):
            half = 2 ** (len(tables) - 1)
            left, right = tables[-1][:-half], tables[-1][half:]
            tables.append(np.where(series[left] >= series[right], left, right))
        return cls(series, tuple(tables))

    def between(self, first: NDArray[np.intp], length: int) -> NDArray[np.intp]:
        """Index of the largest value in `length` values from each of the places `first` on."""
        level = length.bit_length() - 1
        left, right = self.tables[level][first], self.tables[level][first + length - 2**level]
        return np.where(self.series[left] >= self.series[right], left, right)


def _best_disjoint(windows: Windows, gain: Array) -> list[int]:
    """Disjoint windows of the largest sum of gains: best[t] = max(best[t - 1], best[first] + gain of those to t)."""
    best, taken = np.zeros(windows.blocks + 1), np.full(windows.blocks + 1, -1)
    edges = np.searchsorted(windows.last, np.arange(windows.blocks + 2))
    for end in range(1, windows.blocks + 1):
        best[end] = best[end - 1]
        part = slice(edges[end], edges[end + 1])
        total = best[windows.first[part]] + gain[part]
        if len(total) and total.max() > best[end]:
            best[end], taken[end] = total.max(), part.start + int(total.argmax())
    chosen, end = [], windows.blocks
    while end > 0:
        if taken[end] < 0:
            end -= 1
        else:
            chosen.append(int(taken[end]))
            end = int(windows.first[taken[end]])
    return chosen[::-1]
