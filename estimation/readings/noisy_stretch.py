"""Stretches of larger noise within repeats: their readings weigh as little as they tell, and it is said."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from estimation.noise.events_in_repeats import runs_of, scatter_ratio
from estimation.readings.doubted_reading import DoubtedReading
from estimation.readings.rigid_tool import THIRD
from estimation.recordings.recording import Recording

Array = NDArray[np.float64]

NEARBY = 50
"""Samples on either side of a stretch that show where a repeat is beside the others: enough for a mean."""
PUSHED = 30.0
"""Power of the cubic that a repeat follows within a stretch, over that of noise which is as much larger there as its
scatter from sample to sample, from which it is no noise: of four coefficients, and a ratio that is known to a factor of
two, noise has more than this in fewer than one stretch of a thousand."""
RESOLUTION = 0.05
"""Quantile of a channel's changes that is its resolution where it changes in steps; else it is next to nothing."""
ENOUGH = 5
"""Stretches of that length elsewhere, from which what is usual is known."""
COARSE = 1.5
"""Steps of a channel, than which its third differences are smaller where these steps are most of its noise: they come
and go with the motion."""
MANY = 4
"""Repeats, from which their median is what they have in common: of three it is another one where one is pushed."""
DEGREE = 3
"""Of that polynomial."""


@dataclass(frozen=True, eq=False)
class SteadiedRecording:
    """A recording (n rows) and its stretches of larger noise: `ratio` (n, p) to that of the other repeats, else 1."""

    recording: Recording
    ratio: Array

    @classmethod
    def of(cls, recording: Recording) -> SteadiedRecording:
        """Of a recording, by the third differences of what its repeats have not in common; of few, of the readings.

        None of single runs, in which nothing tells a vibration of the motion.
        """
        if recording.repeats < 2:
            return cls(recording, np.ones_like(recording.wrench))
        blocks = recording.wrench.reshape(recording.repeats, recording.samples_per_repeat, -1)
        common = np.median(blocks, axis=0) if recording.repeats >= MANY else 0.0
        rough = np.diff(blocks - common, n=THIRD, axis=1)
        coarse = [
            np.median(np.abs(r)) < COARSE * resolution(c) for r, c in zip(rough.T, recording.wrench.T, strict=True)
        ]
        rough[:, :, coarse] = 0.0
        return cls(recording, scatter_ratio(np.pad(rough, ((0, 0), (1, THIRD - 1), (0, 0)), mode="edge")))

    @cached_property
    def stretches(self) -> list[tuple[int, int]]:
        """Their rows first <= i < last, those of each repeat by themselves."""
        noisy, m = np.any(self.ratio > 1, axis=1), self.recording.samples_per_repeat
        return [(a + i, b + i) for i in range(0, len(noisy), m) for a, b in runs_of(noisy[i : i + m])]

    @property
    def steadied(self) -> Recording:
        """The recording with readings whose noise is as large everywhere, and that have the weighted mean.

        With std k_r of repeat r and weights 1 / k_r² at each place of the motion, the deviations e_r = (x_r - mean) /
        k_r are as large in all repeats. Their mean over repeats is taken out, so that the mean of all is the weighted
        one, and they are scaled by what makes its variance V = 1 / sum k_r^-2 the one that repeats show: with the unit
        vector h_r = V^1/2 / k_r, sum (e_r - mean e)² has the expectation R - 2 + (sum h_r)² / R. How a repeat deviates
        slowly (drift, a push that is larger than its noise) is kept: it is no noise.
        """
        if not self.stretches:
            return self.recording
        repeats, m = self.recording.repeats, self.recording.samples_per_repeat
        blocks = self.recording.wrench.reshape(repeats, m, -1)
        std = self.ratio.reshape(blocks.shape)
        slow = self._slow(blocks, std)
        variance = 1 / (std**-2).sum(axis=0)
        mean = variance * ((blocks - slow) / std**2).sum(axis=0)
        unit = np.sqrt(variance) / std
        deviation = (blocks - slow - mean) / std
        shown = repeats - 2 + unit.sum(axis=0) ** 2 / repeats
        scale = np.sqrt(variance * repeats * (repeats - 1) / shown)
        steadied = slow + mean + scale * (deviation - deviation.mean(axis=0))
        noisy = np.any(std > 1, axis=(0, 2))[None, :, None]
        return self.recording.with_readings(np.where(noisy, steadied, blocks).reshape(-1, blocks.shape[2]))

    def _slow(self, blocks: Array, std: Array) -> Array:
        """How each repeat deviates slowly from the others at the places of the stretches (repeats, m, p), else 0."""
        repeats, m, p = blocks.shape
        weighted = (blocks / std**2).sum(axis=0) / (std**-2).sum(axis=0)
        deviation, quiet = (blocks - weighted).reshape(-1, p), np.all(std == 1, axis=2).ravel()
        slow = np.zeros_like(deviation)
        for first, last in self.stretches:
            length = last - first
            columns = np.linalg.qr(np.polynomial.legendre.legvander(np.linspace(-1, 1, length), DEGREE))[0]

            def beyond(begin: int, columns: Array = columns) -> Array:
                """Power (p,) of the cubic that a repeat follows beyond the line between its surroundings."""
                end = begin + len(columns)
                along = columns.T @ (deviation[begin:end] - self._between(deviation, quiet, begin, end))
                return np.asarray((along**2).sum(axis=0))

            starts = [i for i in range(0, len(deviation) - length, length) if quiet[i : i + length].all()]
            for repeat in range(repeats):
                begin = repeat * m + first % m
                slow[begin : begin + length] = self._between(deviation, quiet, begin, begin + length)
            usual = np.median([beyond(start) for start in starts], axis=0) if len(starts) >= ENOUGH else np.inf
            if np.any(beyond(first) > PUSHED * usual * (self.ratio[first:last] ** 2).mean(axis=0)):
                slow[first:last] = columns @ (columns.T @ deviation[first:last])
        return np.asarray(slow.reshape(blocks.shape))

    def _between(self, deviation: Array, quiet: NDArray[np.bool_], first: int, last: int) -> Array:
        """The line (l, p) between the means of what a repeat deviates by before and after some rows."""
        m = self.recording.samples_per_repeat
        low, high = (0, len(deviation)) if self.recording.continuous else (first // m * m, (first // m + 1) * m)
        means = []
        before, after = np.flatnonzero(quiet[low:first])[-NEARBY:], np.flatnonzero(quiet[last:high])[:NEARBY]
        for rows in (low + before, last + after):
            means += [deviation[rows].mean(axis=0)] if len(rows) else []
        if not means:
            return np.zeros((last - first, deviation.shape[1]))
        return np.linspace(means[0], means[-1], last - first)


def resolution(column: Array) -> float:
    """The step of a channel (n,) that changes in steps; next to nothing of any other."""
    changes = np.abs(np.diff(column))
    return float(np.quantile(changes[changes > 0], RESOLUTION)) if changes.any() else 0.0


def noisy_reading(every: Sequence[SteadiedRecording]) -> Iterator[DoubtedReading]:
    """What is said of recordings in which a repeat scatters more than the others for a while."""
    doubted = [each for each in every if each.stretches]
    if not doubted:
        return
    value, meanings, largest = {}, [], 1.0
    for each in doubted:
        dt = each.recording.dt or 1.0
        times = [[first * dt, last * dt] for first, last in runs_of(np.any(each.ratio > 1, axis=1))]
        value[each.recording.name] = times
        spans = ", ".join(f"{begin:.5g} to {end:.5g} s" for begin, end in times)
        meanings.append(f"{each.recording.name} from {spans}")
        largest = max(largest, float(each.ratio.max()))
    yield DoubtedReading(
        id="noisy_stretch", value=value,
        meaning=f"the noise is larger for a while ({'; '.join(meanings)}), and these readings weigh less",
        shown_by=f"one repeat scatters up to {largest:.2g} times as much from sample to sample as the others do there",
        statement="leave these repeats out of the log", adopted=True, mends=False, applies_to="map",
    )  # fmt: skip
