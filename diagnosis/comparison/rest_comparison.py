"""Residual while the tool moves against the residual while it rests: noise does not know which."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct

from estimation.distributions import normal_cdf
from estimation.recordings.motion_limits import AT_REST
from estimation.recordings.recording import Recording

Array = NDArray[np.float64]

SLOW_SHARE = 0.02
"""Of the largest speed in each column group, below which a sample is at rest."""
SHORTEST = 16
"""Samples of a window: fewer have no slow part."""
SHORT_STRETCHES = 0.2
"""Of the stretches at rest, that are shorter than a window and not used."""
FEWEST = 6
"""Windows at rest and in motion from which they are compared."""


def rest_p_values(recording: Recording, residual: Array) -> Array:
    """P-values (p,) of "a residual (n, p) changes as much while the tool rests as while it moves".

    Windows as long as most stretches at rest, one in each, and as many in motion as there is room for. Their slowest
    cosine is compared by ranks (Mann and Whitney, Ann. Math. Stat. 18, 1947), which holds for noise of any colour, as
    long as that is the same throughout. One where there are too few windows.
    """
    resting = at_rest(recording)
    stretches = _stretches(resting)
    lengths = [stop - start for start, stop in stretches if stop - start >= SHORTEST]
    if len(lengths) < FEWEST:
        return np.ones(residual.shape[1])
    length = int(np.quantile(lengths, SHORT_STRETCHES))
    rest = [start + (stop - start - length) // 2 for start, stop in stretches if stop - start >= length]
    motion = [s for start, stop in _stretches(~resting) for s in range(start, stop - length + 1, length)]
    if min(len(rest), len(motion)) < FEWEST:
        return np.ones(residual.shape[1])
    still, moving = (_slow_power(residual, starts, length) for starts in (rest, motion))
    return np.array([_rank_p_value(a, b) for a, b in zip(moving.T, still.T, strict=True)])


def at_rest(recording: Recording) -> NDArray[np.bool_]:
    """Whether (n,) the recorded motion rests."""
    recording.signals  # noqa: B018  derives the motion
    still = np.ones(recording.samples, dtype=bool)
    for derived in recording.derivatives.values():
        if np.std(derived.value, axis=0).max() < AT_REST:
            continue
        speed = np.linalg.norm(derived.first, axis=1)
        still &= speed <= SLOW_SHARE * max(float(speed.max()), 1e-300)
    return still


def _stretches(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Starts and stops of the runs of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int)))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _slow_power(residual: Array, starts: list[int], length: int) -> Array:
    """Power (windows, p) of the half cosine over each window."""
    windows = np.stack([residual[start : start + length] for start in starts])
    return np.asarray(dct(windows, axis=1, norm="ortho")[:, 1] ** 2)


def _rank_p_value(larger: Array, smaller: Array) -> float:
    """One-sided p-value of "the first sample (a,) is not larger than the second (b,)", by ranks."""
    a, b = len(larger), len(smaller)
    wins = float((larger[:, None] > smaller).sum() + 0.5 * (larger[:, None] == smaller).sum())
    return float(normal_cdf((a * b / 2 + 0.5 - wins) / np.sqrt(a * b * (a + b + 1) / 12)))
