"""Turning points of a sampled series, between its samples where it is smooth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

STENCIL = 5
"""Samples that the curve through a turning point is laid through: the height of its top is then wrong by O(h^5)."""

CORRECTIONS = 4
"""Newton steps from the parabola's top to the quartic's; they begin O(h) apart, and each step squares that."""


@dataclass(frozen=True, eq=False)
class TurningPoints:
    """The K places where a series turns, in order.

    place    (K,), in samples
    crest    (K,), +1 for a highest point, -1 for a lowest; they alternate
    height   (K,), in the unit of the series
    samples, weights   (K, m) each: height = sum of weights · series[samples]. As the height of a top does not change
             with its place, the weights are also the exact derivative of the height in those samples
    """

    place: Array
    crest: Array
    height: Array
    samples: Indices
    weights: Array

    @classmethod
    def of(cls, series: Array, *, periodic: bool, smooth: bool) -> TurningPoints:
        """Those of a series (n,); with `periodic` its end is joined to its beginning.

        With `smooth` a top is that of the polynomial through the five samples around it (all, where there are fewer),
        sought within half a step of the highest sample. Otherwise it is that sample, and so it is at the end of a
        standstill, where nothing is smooth, and where the polynomial does not reach beyond the sample (noise). A single
        run that turns within its first or last step is taken to begin or end there.
        """
        crest, at = _turns(series, periodic)
        samples, centre = _stencils(at, len(series), periodic)
        around = series[samples]
        offset, weights = np.zeros(len(at)), np.eye(samples.shape[1])[centre]
        if smooth and samples.shape[1] >= 3:
            shift, fine = _tops(around, centre)
            beyond = crest * (np.sum(fine * around, axis=1) - series[at]) >= 0
            kept = beyond & ~_after_standstill(series, at)
            offset, weights = np.where(kept, shift, offset), np.where(kept[:, None], fine, weights)
        return cls(at + offset, crest, np.sum(weights * around, axis=1), samples, weights)


def _turns(series: Array, periodic: bool) -> tuple[Array, Indices]:
    """The direction from which each turn is reached, and its sample; after a standstill, the last sample of it."""
    steps = np.diff(series, append=series[:1]) if periodic else np.diff(series)
    moving = np.flatnonzero(steps)
    signs = np.sign(steps[moving])
    before = np.roll(signs, 1)
    turning = signs != before
    if not periodic:
        turning[:1] = False
    return before[turning], moving[turning]


def _stencils(at: Indices, count: int, periodic: bool) -> tuple[Indices, Indices]:
    """The samples around each turn, (K, m), and which of them it is; shifted inwards at the ends of a single run."""
    size = min(STENCIL, count)
    start = at - size // 2
    if not periodic:
        start = np.clip(start, 0, count - size)
    return (start[:, None] + np.arange(size)) % count, at - start


def _tops(around: Array, centre: Indices) -> tuple[Array, Array]:
    """Offset of each top from its sample (in steps, at most a half), and the weights of the samples in its height.

    With p the polynomial through the samples, p'(z) = 0 by Newton's method from the parabola through the highest
    sample and its neighbours. Held at half a step, it misses the top by O(h^4) at most, and its weights stay exact.
    """
    rows, size = np.arange(len(around)), around.shape[1]
    to_powers = np.linalg.inv(np.vander(np.arange(size) - (size - 1) / 2, increasing=True))
    powers, orders = around @ to_powers.T, np.arange(size)
    before, top, after = (around[rows, centre + k] for k in (-1, 0, 1))
    home = centre - (size - 1) / 2
    z = home - _ratio(after - before, 2 * (after - 2 * top + before))
    for _ in range(CORRECTIONS):
        slope = np.sum(powers[:, 1:] * orders[1:] * z[:, None] ** orders[:-1], axis=1)
        bend = np.sum(powers[:, 2:] * (orders[2:] * orders[1:-1]) * z[:, None] ** orders[:-2], axis=1)
        z = np.clip(z - _ratio(slope, bend), home - 0.5, home + 0.5)
    return z - home, z[:, None] ** orders @ to_powers


def _ratio(above: Array, below: Array) -> Array:
    return np.divide(above, below, out=np.zeros_like(above), where=below != 0)


def _after_standstill(series: Array, at: Indices) -> NDArray[np.bool_]:
    still = series[at] == series[at - 1]
    return np.asarray(still & (series[at - 1] == series[at - 2]), dtype=bool)
