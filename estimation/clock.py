"""The clock behind stamps that jitter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.distributions import normal_isf
from modeling.errors import InputError

WINDOW = 50  # samples at most over which stamps are compared: longer than a burst of a buffered driver
LOST = 0.75  # samples by which the stamps must stay late to say that some are missing


@dataclass(frozen=True, kw_only=True)
class Clock:
    """A uniform clock: stamp of its first sample and step, in s."""

    start: float
    dt: float

    @classmethod
    def of(cls, stamps: NDArray[np.float64], *, where: str = "time", first_row: int = 2) -> Clock:
        """The straight line through the stamps (n,) in s, by least squares.

        A stamp is taken when a driver got the sample, so it jitters; the samples themselves were taken by a
        uniform clock (FORMATS, `time`). The line is believed, not the stamp. `first_row` is the row of the
        first stamp in its file. Raises InputError where time does not increase, where samples are missing
        and where the stamps follow no uniform clock.
        """
        stamps = np.asarray(stamps, dtype=float)
        _require_increasing(stamps, where, first_row)
        _require_whole(stamps, where, first_row)
        count = np.arange(len(stamps)) - (len(stamps) - 1) / 2
        dt = float(count @ stamps / (count @ count))
        _require_straight(stamps - stamps.mean() - dt * count, dt, where)
        return cls(start=float(stamps.mean() + dt * count[0]), dt=dt)

    def times(self, samples: int) -> NDArray[np.float64]:
        """Seconds since the first sample."""
        return np.arange(samples, dtype=np.float64) * np.float64(self.dt)


def _require_increasing(stamps: NDArray[np.float64], where: str, first_row: int) -> None:
    steps = np.diff(stamps)
    late = np.flatnonzero(steps <= 0)
    if late.size:
        i = int(late[0]) + 1
        what = f"time does not increase at row {first_row + i} ({stamps[i - 1]:.9g} s, then {stamps[i]:.9g} s)"
        raise InputError(what=what, where=where, remedy="sort the rows, or number separate runs in `repeat`")


def _require_whole(stamps: NDArray[np.float64], where: str, first_row: int) -> None:
    """A late stamp is followed by stamps in time; after missing samples all stay late."""
    window = min(max(len(stamps) // 10, 1), WINDOW)
    step = float(np.median(stamps[window:] - stamps[:-window])) / window
    late = stamps / step - np.arange(len(stamps))
    steps = np.diff(stamps) / step
    # A driver that hands over bursts makes a long step before each of them; only longer ones are holes.
    bursts = float(np.median(steps)) < 0.75
    usual = float(np.quantile(steps, 0.98)) + 0.4 if bursts else 1.5
    jitter = float(np.median(np.abs(steps - np.median(steps)))) / normal_isf(0.25) / np.sqrt(2)
    for i in np.flatnonzero(steps > usual) + 1:
        before, after = late[max(i - window, 0) : i], late[i : i + window]
        lost = float(np.median(after) - np.median(before))
        # The median of m stamps errs by 1.25 / sqrt(m) of their jitter; four times that is no chance.
        chance = 5 * jitter * np.sqrt(1 / len(before) + 1 / len(after))
        if lost > max(LOST, chance):
            what = f"a hole in time at row {first_row + int(i)}: about {max(round(lost), 1)} samples are missing"
            what += f" after {stamps[i - 1]:.9g} s"
            raise InputError(what=what, where=where, remedy="use the longer piece, or record without a gap")


def _require_straight(late: NDArray[np.float64], dt: float, where: str) -> None:
    window = min(max(len(late) // 10, 1), WINDOW)
    pieces = [np.median(piece) for piece in np.array_split(late, max(len(late) // window, 1))]
    wander = float(np.max(np.abs(pieces))) / dt
    if wander > max(3.0, 0.01 * len(late)):
        what = f"the time stamps wander {wander:.0f} samples away from a uniform clock"
        raise InputError(what=what, where=where, remedy="resample to a uniform rate, or record at one")
