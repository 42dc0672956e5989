"""Turning points of a sampled series, interpolated between samples where it is smooth."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

STENCIL_SAMPLES = 5
"""Samples of the interpolating polynomial at a turning point: the error of its extremum is O(h^5)."""

NEWTON_CORRECTIONS = 4
"""Newton steps from the parabola's extremum to the quartic's; the initial error O(h) is squared by each step."""


@dataclass(frozen=True, eq=False)
class TurningPoints:
    """The K local extrema of a series, in order.

    place    (K,), position in samples
    crest    (K,), +1 for a maximum, -1 for a minimum; they alternate
    height   (K,), extremal value in the unit of the series
    samples, weights   (K, m) each: height = sum of weights · series[samples]. As an extremum is stationary in its
             position, the weights are also the exact derivative of the height in those samples
    branch   (n,), number of turning points before each sample of the series
    """

    place: Array
    crest: Array
    height: Array
    samples: Indices
    weights: Array
    branch: Indices

    @classmethod
    def of_each(cls, series: Array, *, periodic: bool, smooth: bool) -> tuple[TurningPoints, ...]:
        """Turning points of each of several series (p, n); with `periodic` they are cyclic.

        With `smooth` an extremum is that of the polynomial through the five samples around it (all, if there are
        fewer), within half a step of the extremal sample. Otherwise, at the end of a constant section (not smooth), and
        where the polynomial does not exceed the sample (noise), it is that sample. A single run that turns within its
        first or last step is treated as starting or ending there.
        """
        turns = [_turns(one, periodic) for one in series]
        crest, at = (np.concatenate(parts) for parts in zip(*turns, strict=True))
        ends = np.cumsum([len(place) for _, place in turns])
        number = np.repeat(np.arange(len(series)), np.diff(ends, prepend=0))
        samples, centre = _stencils(at, series.shape[1], periodic)
        around = series[number[:, None], samples]
        offset, weights = np.zeros(len(at)), np.eye(samples.shape[1])[centre]
        if smooth and samples.shape[1] >= 3:
            offset, weights = _interpolated(around, centre, crest, _after_constant_section(series, number, at))
        place, height, clock = at + offset, np.sum(weights * around, axis=1), np.arange(series.shape[1])
        found = []
        for end, (_, own) in zip(ends.tolist(), turns, strict=True):
            part = slice(end - len(own), end)
            branch = np.searchsorted(place[part], clock, side="left")
            found.append(cls(place[part], crest[part], height[part], samples[part], weights[part], branch))
        return tuple(found)


def _turns(series: Array, periodic: bool) -> tuple[Array, Indices]:
    """The direction before each turning point, and its sample; the last sample of a constant section."""
    steps = np.diff(series, append=series[:1]) if periodic else np.diff(series)
    moving = np.flatnonzero(steps)
    signs = np.sign(steps[moving])
    before = np.roll(signs, 1)
    turning = signs != before
    if not periodic:
        turning[:1] = False
    return before[turning], moving[turning]


def _stencils(at: Indices, count: int, periodic: bool) -> tuple[Indices, Indices]:
    """The samples around each turning point, (K, m), and its index; shifted inwards at the ends of a single run."""
    size = min(STENCIL_SAMPLES, count)
    start = at - size // 2
    if not periodic:
        start = np.clip(start, 0, count - size)
    return (start[:, None] + np.arange(size)) % count, at - start


def _interpolated(around: Array, centre: Indices, crest: Array, constant: NDArray[np.bool_]) -> tuple[Array, Array]:
    """`_extrema`; the extremal sample itself after a constant section and where the polynomial does not exceed it."""
    offset, weights = _extrema(around, centre)
    extremal = around[np.arange(len(around)), centre]
    accepted = (crest * (np.sum(weights * around, axis=1) - extremal) >= 0) & ~constant
    sample = np.eye(around.shape[1])[centre]
    return np.where(accepted, offset, 0.0), np.where(accepted[:, None], weights, sample)


def _extrema(around: Array, centre: Indices) -> tuple[Array, Array]:
    """Offset of each extremum from its sample (at most half a step), and the weights of the samples in its height.

    With p the polynomial through the samples, p'(z) = 0 by Newton's method from the parabola through the extremal
    sample and its neighbours. Bounded to half a step, the error is O(h^4) at most, and the weights remain exact.
    """
    rows, size = np.arange(len(around)), around.shape[1]
    to_powers = _to_powers(size)
    powers, orders = around @ to_powers.T, np.arange(1, size)
    by_place = powers[:, 1:] * orders
    by_place_twice = by_place[:, 1:] * orders[:-1]
    before, extremum, after = (around[rows, centre + k] for k in (-1, 0, 1))
    origin = centre - (size - 1) / 2
    z = origin - _ratio(after - before, 2 * (after - 2 * extremum + before))
    for _ in range(NEWTON_CORRECTIONS):
        monomials = _monomials(z, size - 1)
        slope = np.einsum("ij,ij->i", by_place, monomials)
        curvature = np.einsum("ij,ij->i", by_place_twice, monomials[:, :-1])
        z = np.clip(z - _ratio(slope, curvature), origin - 0.5, origin + 0.5)
    return z - origin, _monomials(z, size) @ to_powers


@cache
def _to_powers(size: int) -> Array:
    """Coefficients of the polynomial through values at `size` samples about their centre, (size, size), by power."""
    return np.asarray(np.linalg.inv(np.vander(np.arange(size) - (size - 1) / 2, increasing=True)))


def _monomials(place: Array, count: int) -> Array:
    """Powers 0 to count - 1 of places (K,), (K, count)."""
    found = np.ones((count, len(place))).T
    for power in range(1, count):
        np.multiply(found[:, power - 1], place, out=found[:, power])
    return found


def _ratio(numerator: Array, denominator: Array) -> Array:
    return np.divide(numerator, denominator, out=np.zeros_like(numerator), where=denominator != 0)


def _after_constant_section(series: Array, number: Indices, at: Indices) -> NDArray[np.bool_]:
    extremal, before, twice_before = (series[number, at - k] for k in range(3))
    return np.asarray((extremal == before) & (before == twice_before), dtype=bool)
