"""Uniform sample clock by least squares from jittering time stamps."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.distributions import normal_isf
from modeling.errors import InputError

JITTER_WINDOW = 50  # most samples over which stamps are compared: longer than a burst of a buffered driver
MISSING_SAMPLE_STEP = 0.75  # samples of lasting delay in the stamps from which samples count as missing


@dataclass(frozen=True, kw_only=True)
class SampleClock:
    """A uniform clock: stamp of its first sample and step, in s."""

    start: float
    dt: float

    @classmethod
    def of(cls, stamps: NDArray[np.float64], *, where: str = "time", first_row: int = 2) -> SampleClock:
        """The straight line through the stamps (n,) in s, by least squares.

        A stamp is taken when the driver received the sample, so it jitters; the samples themselves were taken by a
        uniform clock (FORMATS, `time`), so that the line replaces the stamps. `first_row` is the row of the
        first stamp in its file. Raises InputError where time does not increase, where samples are missing
        and where the stamps follow no uniform clock.
        """
        stamps = np.asarray(stamps, dtype=float)
        _require_increasing(stamps, where, first_row)
        _require_no_missing_samples(stamps, where, first_row)
        count = np.arange(len(stamps)) - (len(stamps) - 1) / 2
        dt = float(count @ stamps / (count @ count))
        _require_uniform_rate(stamps - stamps.mean() - dt * count, dt, where)
        return cls(start=float(stamps.mean() + dt * count[0]), dt=dt)

    def times(self, samples: int) -> NDArray[np.float64]:
        """Seconds since the first sample."""
        return np.arange(samples, dtype=np.float64) * np.float64(self.dt)


def _require_increasing(stamps: NDArray[np.float64], where: str, first_row: int) -> None:
    steps = np.diff(stamps)
    wrong = np.flatnonzero(steps <= 0)
    if wrong.size:
        i = int(wrong[0]) + 1
        what = f"time does not increase at row {first_row + i} ({stamps[i - 1]:.9g} s, then {stamps[i]:.9g} s)"
        raise InputError(what=what, where=where, remedy="sort the rows, or number separate runs in `repeat`")


def _require_no_missing_samples(stamps: NDArray[np.float64], where: str, first_row: int) -> None:
    for i, lost in missing_samples(stamps):
        what = f"a gap in time at row {first_row + i}: about {max(round(lost), 1)} samples are missing"
        what += f" after {stamps[i - 1]:.9g} s"
        raise InputError(what=what, where=where, remedy="use the longer piece, or record without a gap")


def missing_samples(stamps: NDArray[np.float64], window: int = JITTER_WINDOW) -> Iterator[tuple[int, float]]:
    """Index of each increasing stamp before which samples are missing, and how many, in samples.

    A delayed stamp is followed by punctual ones; after missing samples all stamps stay delayed.
    """
    window = min(max(len(stamps) // 10, 1), window)
    step = float(np.median(stamps[window:] - stamps[:-window])) / window
    delay = stamps / step - np.arange(len(stamps))
    steps = np.diff(stamps) / step
    # A driver that hands over bursts makes a long step before each of them; only longer ones are gaps.
    bursts = float(np.median(steps)) < 0.75
    usual = float(np.quantile(steps, 0.98)) + 0.4 if bursts else 1.5
    suspected = np.flatnonzero(steps > usual) + 1
    if not suspected.size:
        return
    jitter = float(np.median(np.abs(steps - np.median(steps)))) / normal_isf(0.25) / np.sqrt(2)
    for i in suspected:
        before, after = delay[max(i - window, 0) : i], delay[i : i + window]
        lost = float(np.median(after) - np.median(before))
        # The median of m stamps errs by 1.25 / sqrt(m) of their jitter; four times that is not by chance.
        chance = 5 * jitter * np.sqrt(1 / len(before) + 1 / len(after))
        if lost > max(MISSING_SAMPLE_STEP, chance):
            yield int(i), lost


def _require_uniform_rate(delay: NDArray[np.float64], dt: float, where: str) -> None:
    window = min(max(len(delay) // 10, 1), JITTER_WINDOW)
    pieces = [np.median(piece) for piece in np.array_split(delay, max(len(delay) // window, 1))]
    deviation = float(np.max(np.abs(pieces))) / dt
    if deviation > max(3.0, 0.01 * len(delay)):
        what = f"the time stamps deviate by {deviation:.0f} samples from a uniform clock"
        raise InputError(what=what, where=where, remedy="resample at a uniform rate, or record at one")
