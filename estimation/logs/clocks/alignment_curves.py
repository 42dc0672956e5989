"""Alignment curves: the wrench and what the motion explains of it, by the stamps as read and by the clock offset."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import numpy as np

from estimation.logs.log_table import Array

MOST_ROWS = 5000
"""Rows from which the coefficients of the picture are taken."""
SHIFTS, SHORTEST, LONGEST = 20.0, 0.6, 4.0
"""Length of the part that is shown: in offsets, so that a shift can be seen, and its limits in s."""
POINTS = 600


@dataclass(frozen=True, kw_only=True, eq=False)
class AlignmentCurves:
    """One channel of the force (m,), the part of the record where it follows the motion fastest; see OffsetCurves."""

    channel: int
    instants: Array
    measured: Array
    as_stamped: Array
    aligned: Array

    @classmethod
    def of(
        cls, regressors: Callable[[Array], Array], stamps: Array, forces: Array, offset: float, as_read: float
    ) -> Self:
        """Of forces (n, d) at stamps (n,), with the motion's regressors (n, k) at any instants (n,).

        The coefficients are those of the motion at stamps less `offset`; `as_read` is the offset before estimation.
        """
        every = slice(None, None, max(len(stamps) // MOST_ROWS, 1))
        rows, times = forces[every], stamps[every] - offset
        motion = regressors(times)
        coefficients = np.linalg.lstsq(motion, rows, rcond=1e-10)[0]
        explained = motion @ coefficients
        share = explained.var(axis=0) / np.maximum(rows.var(axis=0), 1e-300)
        channel = int(np.argmax(share))
        length = float(np.clip(SHIFTS * abs(offset - as_read), SHORTEST, LONGEST))
        begin = _liveliest(times, explained[:, channel], length)
        inside = np.flatnonzero((stamps - offset >= begin) & (stamps - offset <= begin + length))
        inside = inside[:: max(len(inside) // POINTS, 1)]
        shown = stamps[inside]
        by_stamps, by_offset = (regressors(shown - late) @ coefficients[:, channel] for late in (as_read, offset))
        return cls(
            channel=channel, instants=shown - offset, measured=forces[inside, channel],
            as_stamped=by_stamps, aligned=by_offset,
        )  # fmt: skip


def _liveliest(times: Array, series: Array, length: float) -> float:
    """Start of the interval in which a series (n,) changes fastest: where the mean square of its steps is largest."""
    total = np.concatenate([[0.0], np.cumsum(np.diff(series) ** 2)])
    ends = np.searchsorted(times, times + length) - 1
    starts = np.flatnonzero(times <= max(times[-1] - length, times[0]))
    return float(times[starts[np.argmax(total[ends[starts]] - total[starts])]])
