"""Sample and hold: values that a driver repeats until the sensor or the robot has new ones."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

REGULAR_SHARE = 0.8
"""Share of holds of nearly the same length from which a lower rate, and no standstill, is behind them."""
ROUNDING = 0.02
"""Of a row: of the line through the instants, which the rows determine to a part of one."""


def held_rows(columns: Iterable[Array], samples: int) -> tuple[NDArray[np.bool_], int]:
    """Mask (n,) of the rows with a new value in any column (n,), and the number of rows for which one is held.

    0 when the holds are of no regular length.
    """
    changed = np.ones(samples, dtype=bool)
    changed[1:] = False
    for column in columns:
        changed[1:] |= column[1:] != column[:-1]
    holds = np.diff(np.flatnonzero(changed))
    if len(holds) < 20 or changed.mean() > 0.67:
        return changed, 0
    usual = int(np.median(holds))
    regular = (np.abs(holds - usual) <= max(1, usual // 4)).mean() if usual > 1 else 0.0
    return changed, usual if regular > REGULAR_SHARE else 0


@dataclass(frozen=True, kw_only=True, eq=False)
class TrueSamples:
    """The samples behind held values.

    rows      (m,), those with a new value, and in a pause of the motion those that would have one
    instants  (m,), s, when it was true, on the clock of the rows
    rate      Hz, of the new values
    """

    rows: NDArray[np.intp]
    instants: Array
    rate: float

    @classmethod
    def of(cls, columns: Iterable[Array], dt: float, samples: int) -> TrueSamples | None:
        """Of columns (n,) that are held together, in rows dt s apart; None where none is held.

        New values come at the rate of their own clock. A row has the latest of them: none is from its future, and
        none is older than a row. So the instants are the latest straight line that no new value's row precedes,
        where that leaves none of them more than a row before its own; else the rows' own times.
        """
        columns = list(columns)
        changed, held = held_rows(columns, samples)
        if not held or all(map(_steps_are_of_one_size, columns)):
            return None
        rows = np.flatnonzero(changed)
        # The first value may have been held for some rows before the record began.
        rows = rows[1:] if rows[1] - rows[0] < held else rows
        holds = np.diff(rows)
        usual = float(np.mean(holds[np.abs(holds - held) <= max(1, held // 4)]))
        index = np.concatenate([[0], np.cumsum(np.maximum(np.round(holds / usual), 1))]).astype(int)
        every = np.arange(index[-1] + 1)  # a motion that pauses has new values that are not seen to be new
        step, late = _narrowest(index, rows)
        if np.ptp(late) < 1.0 + ROUNDING:
            instants = rows[0] - late[0] + late.min() + step * every
            rows_of_all = np.ceil(instants - ROUNDING).astype(np.intp)
        else:
            instants = np.floor(np.interp(every, index, rows))
            rows_of_all = instants.astype(np.intp)
        rows_of_all[index] = rows
        return cls(rows=rows_of_all, instants=instants * dt, rate=float((len(every) - 1) / (np.ptp(instants) * dt)))


def _steps_are_of_one_size(column: Array) -> bool:
    """Whether a column changes by one quantum at a time: a slow motion of coarse resolution, and nothing held."""
    steps = np.abs(np.diff(column))
    steps = steps[steps > 0]
    return steps.size == 0 or float(np.mean(np.abs(steps - np.median(steps)) < 1e-6 * np.median(steps))) > 0.5


def _narrowest(index: NDArray[np.intp], rows: NDArray[np.intp]) -> tuple[float, Array]:
    """Slope of the line through rows over index (m,) whose residual has the least range, and that residual.

    The range is convex in the slope: golden sections between slopes that tilt the whole line by two rows.
    """
    middle, reach = float(np.polyfit(index, rows, 1)[0]), 2.0 / index[-1]
    low, high = middle - reach, middle + reach
    ratio = (np.sqrt(5) - 1) / 2
    while high - low > 1e-6 * reach:
        left, right = high - ratio * (high - low), low + ratio * (high - low)
        if np.ptp(rows - left * index) <= np.ptp(rows - right * index):
            high = right
        else:
            low = left
    slope = (low + high) / 2
    return slope, rows - slope * index - rows[0]
