"""Channels that stand still, clip, or have a dead band."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from estimation.evidence.channel_faults import clipped_rows, longest_stop
from estimation.logs.log_table import Array
from estimation.logs.step_log import StepLog
from estimation.recordings.reports.reading_curves import spans

ZERO_SHARE = 0.01


def note_suspicious_channels(columns: Mapping[str, Array], stamps: Array, where: str, log: StepLog) -> None:
    """Log channels that never change, stay at their largest value, or are exactly zero in a dead band.

    Columns (n,) by channel at stamps (n,), s.
    """
    whole = (float(stamps[0]), float(stamps[-1]))
    for name, column in columns.items():
        low, high = float(np.min(column)), float(np.max(column))
        if low == high:
            log.suspicious(f"{name} never changes ({low:.6g})", where, at=(whole,), channels=(name,))
            continue
        clipped, stop, whose = clipped_rows(column), longest_stop(column), (name,)
        if clipped is not None:
            what = f"{name} stays at its extreme value {clipped[0]:.6g}: saturated?"
            log.suspicious(what, where, clipped[1], len(column), spans(stamps, column == clipped[0]), whose)
        elif stop is not None and column[stop[0]] != 0.0:
            what = f"{name} stops at {column[stop[0]]:.6g} from row {stop[0] + 1} on: stuck?"
            log.suspicious(what, where, stop[1], len(column), spans(stamps, stop[0] + np.arange(stop[1])), whose)
        zeros = column == 0.0
        count = int((zeros[1:] & zeros[:-1]).sum())
        if count > ZERO_SHARE * len(column):
            what = f"{name} is exactly zero: a dead band, or no reading?"
            log.suspicious(what, where, count, len(column), spans(stamps, _runs(zeros)), whose)


def _runs(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Mask of those that have a neighbour."""
    pairs = mask[1:] & mask[:-1]
    return np.asarray(np.concatenate([pairs, [False]]) | np.concatenate([[False], pairs]))
