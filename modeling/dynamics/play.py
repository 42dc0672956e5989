"""Play operator (hysteresis) on a record, with derivatives in load and half-width."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
from numpy.typing import NDArray

from modeling.dynamics.motion_record import MotionRecord
from modeling.errors import InputError

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
        turning_points = []
        for end, (_, at_of_series) in zip(ends.tolist(), turns, strict=True):
            rows = slice(end - len(at_of_series), end)
            branch = np.searchsorted(place[rows], clock, side="left")
            turning_points.append(cls(place[rows], crest[rows], height[rows], samples[rows], weights[rows], branch))
        return tuple(turning_points)


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
    powers = np.ones((count, len(place))).T
    for power in range(1, count):
        np.multiply(powers[:, power - 1], place, out=powers[:, power])
    return powers


def _ratio(numerator: Array, denominator: Array) -> Array:
    return np.divide(numerator, denominator, out=np.zeros_like(numerator), where=denominator != 0)


def _after_constant_section(series: Array, number: Indices, at: Indices) -> NDArray[np.bool_]:
    extremal, before, twice_before = (series[number, at - k] for k in range(3))
    return np.asarray((extremal == before) & (before == twice_before), dtype=bool)


@dataclass(frozen=True, eq=False)
class PlayResponse:
    """Output of the play operator of half-width w in each channel.

    While the load rises from a turning point at which the reading was y, the reading is max(y, load - w); while it
    falls, min(y, load + w). Every sample is therefore the load of the same sample, of the last active turning point, or
    of the first sample, plus w times -1, +1 or 0; the derivatives follow from this.
    """

    channels: tuple[ChannelPlay, ...]

    @classmethod
    def of(
        cls, load: Array, width: Array, *, periodic: bool, smooth: bool = True, measured: Array | None = None
    ) -> PlayResponse:
        """Play of half-widths (p,) on a load (n, p), both in the channels' units.

        `periodic`: the steady state of a periodic load. Otherwise the initial reading is the load (the centre of the
        play), and so it is for a periodic load of amplitude below w, whose steady state depends on its past; with
        readings that were `measured` (n, p), it is theirs until the load pushes (`initial_offset`). With
        `smooth` the load turns between its samples (see `TurningPoints`); without, at samples (static poses).

        Raises InputError for a negative width.
        """
        columns = np.ascontiguousarray(np.transpose(load), dtype=float)
        turns = TurningPoints.of_each(columns, periodic=periodic, smooth=smooth)
        read = None if measured is None else np.ascontiguousarray(np.transpose(measured), dtype=float)
        return cls.turning(columns, turns, width, periodic=periodic, measured=read)

    @classmethod
    def turning(
        cls,
        load: Array,
        turns: Sequence[TurningPoints],
        width: Array,
        *,
        periodic: bool,
        measured: Array | None = None,
    ) -> PlayResponse:
        """`of` a load (p, n) whose turning points are known, one entry a channel, and its `measured` readings."""
        if np.any(np.asarray(width) < 0):
            raise InputError(what=f"the half-width {np.min(width):g} is negative", where="play", remedy="make it >= 0")
        read = [None] * len(load) if measured is None else measured
        each = zip(load, turns, map(float, width), read, strict=True)
        return cls(tuple(ChannelPlay.of(*channel, periodic) for channel in each))

    @property
    def reading(self) -> Array:
        """The output of the play operator, (n, p)."""
        return np.stack([play.reading for play in self.channels], axis=1)

    @property
    def by_width(self) -> Array:
        """Derivative of each reading in its half-width, (n, p): -1 pushed up, +1 pushed down, 0 not pushed.

        At width 0 it is the one-sided derivative for increasing width, opposite to the direction of the load.
        """
        return np.stack([play.side for play in self.channels], axis=1)

    @property
    def measured(self) -> NDArray[np.bool_]:
        """The readings (n, p) that are those measured at the start."""
        return np.stack([(play.source < 0) & play.is_measured for play in self.channels], axis=1)

    def through(self, series: Array) -> Array:
        """Directional derivative of the reading for a change of the load (n, p, ...), widths constant."""
        changed = np.empty(series.shape)
        for channel, play in enumerate(self.channels):
            changed[:, channel] = play.through(series[:, channel])
        return changed


@dataclass(frozen=True, eq=False)
class PlayedRecord:
    """The play operator along a record: one response for each separate run, or one where repeats are continuous.

    `begun` is that of a record in steady state from the measured state that it begins in; None of others.
    """

    record: MotionRecord
    runs: tuple[PlayResponse, ...]
    begun: PlayedRecord | None = None

    @classmethod
    def of(cls, load: Array, record: MotionRecord) -> PlayedRecord:
        """Of a load (n, p), with the half-widths at the record's parameters."""
        width = record.vectors("play").value({}, record.theta, 1)[0]
        periodic, smooth = record.clock.periodic, record.dt is not None
        several = np.stack([run.T for run in record.runs(load)])
        turns = _turning_points(several.tobytes(), several.shape, periodic, smooth)
        measured = None
        if record.measured is not None:
            bias = record.vectors("bias").value(record.signals, record.theta, len(load))
            measured = np.ascontiguousarray((record.measured[: len(load)] - bias).T)
        of_run = None if periodic else measured
        runs = tuple(
            PlayResponse.turning(*run, width, periodic=periodic, measured=of_run)
            for run in zip(several, turns, strict=True)
        )
        if not periodic or measured is None:
            return cls(record, runs)
        turning = TurningPoints.of_each(several[0], periodic=False, smooth=smooth)
        begun = PlayResponse.turning(several[0], turning, width, periodic=False, measured=measured)
        return cls(record, runs, cls(record, (begun,)))

    @property
    def reading(self) -> Array:
        """The output (n, p)."""
        return np.concatenate([run.reading for run in self.runs])

    def through(self, series: Array) -> Array:
        """A small variation (n, p, ...) of the load through the linearised play."""
        pieces = zip(self.runs, self.record.runs(series), strict=True)
        return np.concatenate([run.through(piece) for run, piece in pieces])

    def total_derivative(self, derivative: Array) -> Array:
        """dP/dx dx + dP/dw dw (n, p, k), for the derivative dx of the load.

        A reading that is the measured one until the load pushes depends on no parameter, with its bias.
        """
        if not derivative.shape[2]:
            return derivative
        total = self.through(derivative)
        if (measured := np.concatenate([run.measured for run in self.runs])).any():
            _, bias = self.record.vectors("bias").tangent(self.record.signals, self.record.theta, len(total))
            total[measured] = -bias[measured]
        by_width, widths = np.concatenate([run.by_width for run in self.runs]), self.record.constant("play")[1]
        columns = np.flatnonzero(widths.any(axis=0))  # the few parameters that the widths depend on
        total[:, :, columns] += by_width[:, :, None] * widths[:, columns]
        return total


@lru_cache(maxsize=1)
def _turning_points(
    load: bytes, shape: tuple[int, int, int], periodic: bool, smooth: bool
) -> tuple[tuple[TurningPoints, ...], ...]:
    """Turning points of each run and channel of a load (runs, p, n); kept for the last: many widths are tried on it."""
    runs, channels, samples = shape
    series = np.frombuffer(load).reshape(runs * channels, samples)
    turning_points = TurningPoints.of_each(series, periodic=periodic, smooth=smooth)
    return tuple(turning_points[run * channels : (run + 1) * channels] for run in range(runs))


@dataclass(frozen=True, eq=False)
class ChannelPlay:
    """The play of one channel.

    reading  (n,)
    side     (n,), +1 where it is w above the load of its source, -1 below, 0 not pushed yet
    source   (n,), index of the last active turning point; K for the load of the same sample, -1 not pushed yet
    is_measured  whether the reading that is not pushed yet is the measured one, whatever the load
    """

    reading: Array
    side: Array
    source: Indices
    turns: TurningPoints
    is_measured: bool = False

    @classmethod
    def of(cls, load: Array, turns: TurningPoints, width: float, measured: Array | None, periodic: bool) -> ChannelPlay:
        """The play on a load (n,) with its turning points, and readings (n,) where they were measured."""
        offset = 0.0 if measured is None else initial_offset(load, measured, width)
        inside = measured is not None and abs(offset) < width
        states = _PlayStates.along(turns, width, load[0] + offset, 0.0 if inside else float(np.sign(offset)))
        if periodic:
            states = _PlayStates.along(turns, width, states.reading[-1], states.side[-1], states.source[-1])
        branch = turns.branch
        upwards = _directions(load, turns)[branch]
        held = states.reading[branch]
        pushed = upwards * (load - held) >= width
        pushed[0] &= periodic
        return cls(
            reading=np.where(pushed, load - upwards * width, held),
            side=np.where(pushed, -upwards, states.side[branch]),
            source=np.where(pushed, len(turns.place), states.source[branch]),
            turns=turns,
            is_measured=inside,
        )

    def through(self, series: Array) -> Array:
        """Directional derivative of the reading for a change (n, ...) of the load, by each sample's source."""
        changed = series.copy()
        changed[self.source < 0] = 0.0 if self.is_measured else series[0]
        held = np.flatnonzero((self.source >= 0) & (self.source < len(self.turns.place)))
        used, place = np.unique(self.source[held], return_inverse=True)
        weights = self.turns.weights[used]
        weights = weights.reshape(*weights.shape, *([1] * (series.ndim - 1)))
        columns = range(weights.shape[1])
        tops = sum((weights[:, m] * series[self.turns.samples[used, m]] for m in columns), np.zeros(()))
        changed[held] = tops[place]
        return changed


def initial_offset(load: Array, measured: Array, width: float) -> float:
    """By how much the reading of a play of a half-width is off a load (n,) at first, from those measured (n,).

    What came before the record is unknown, and the reading is anywhere within the play of the load. It is the mean of
    those measured until the load pushes, weighted by how far it is from that, so that it changes steadily with width
    and load.
    """
    offset = np.clip(measured[0] - load[0], -width, width)
    weight = width - np.abs(load - load[0] - offset)
    weight[np.logical_or.accumulate(weight <= 0)] = 0.0
    if weight[0] > 0:
        offset = np.clip(weight @ measured / weight.sum() - load[0], -width, width)
    return float(offset)


@dataclass(frozen=True, eq=False)
class _PlayStates:
    """Reading, side and source initially and after each of the K turning points, (K + 1,)."""

    reading: Array
    side: Array
    source: Indices

    @classmethod
    def along(
        cls, turns: TurningPoints, width: float, reading: float, side: float = 0.0, source: int = -1
    ) -> _PlayStates:
        """From the reading, side and source at the first sample; at each turning point the load pushes or not."""
        crest, height = turns.crest, turns.height
        each = height - crest * width  # the reading where it pushes
        pushing = crest * (height - np.append(reading, each)[:-1]) >= width
        if not pushing.all():  # else all do, as without play, and each finds the reading of the one before
            pushing = _pushing(crest, height, each, width, float(reading))
        last = np.append(0, np.cumsum(pushing))
        readings, sides = np.append(reading, each[pushing]), np.append(side, -crest[pushing])
        return cls(readings[last], sides[last], np.append(source, np.flatnonzero(pushing))[last])


def _pushing(crest: Array, height: Array, each: Array, width: float, reading: float) -> NDArray[np.bool_]:
    """Whether the load pushes at each of K turning points, (K,), where the reading is then `each` (K,)."""
    pushing = np.zeros(len(crest), dtype=bool)
    for number, (up, top, pushed) in enumerate(zip(crest.tolist(), height.tolist(), each.tolist(), strict=True)):
        if up * (top - reading) >= width:
            pushing[number], reading = True, pushed
    return pushing


def _directions(load: Array, turns: TurningPoints) -> Array:
    """+1 where the load rises before each of the K turning points and after the last, -1 where it falls, (K + 1,)."""
    if not len(turns.crest):
        return np.array([-1.0 if load[-1] < load[0] else 1.0])
    return np.append(turns.crest, -turns.crest[-1])
