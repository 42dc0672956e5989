"""Period of a repeated motion: found by its difference function, refined by least squares, judged against noise.

The motion x (n, k), standardised, is compared with itself a lag later. Its difference function

    d(L) = mean over t of |x(t + L) - x(t)|² / 2

has minima near the multiples of a period. For each candidate L, the longest stretch in which |x(t + L) - x(t)| stays
small is folded: x_r(s) = x(first + r L + s). With the mean x̄ over the R folds and its slope x̄', the lateness of fold r
is, by least squares,

    late_r = -sum_s x̄'(s) (x_r(s) - x̄(s)) / sum_s |x̄'(s)|²,

and the straight line through late_r over r corrects the lag, first of a few repeats, then of ever more. What is left of
the products, summed in blocks, gives the standard deviation of the period. What does not repeat is x_r - x̄, averaged
over blocks of a fortieth of the period, less the variance that the samples' own noise (by fourth differences) has in
such a block: it may be no more than `TOLERANCE` of the motion, and what chance adds. Of all lags that repeat as well as
the best, the shortest is the period.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimation.recordings.weight_fit import SMALLEST_DIVISOR

Array = NDArray[np.float64]

TOLERANCE = 0.005
"""Root-mean-square of what does not repeat, over that of the motion. Robots that repeat a program stay below 0.003; a
hundredth of the motion is near a hundredth of the wrench, which is what sensors resolve of it."""
STRETCH_TOLERANCES = (0.3, 0.05, 3 * TOLERANCE)
"""The same at any instant, while the lag is not refined yet, and at last for the stretch that is judged."""
LARGEST_CORRECTION = 0.02
"""Of a period, by which the least squares may move it."""
LEAST_MOTION = {"angle": 0.01, "position": 2e-3, "acceleration": 0.1}
"""Standard deviation (rad, m, m/s²) of all components together below which there is no motion to repeat."""
LEAST_SIGNAL = 5.0
"""Standard deviation of the motion over that of its noise, below which a component cannot be judged."""
FEWEST_SAMPLES = 20
"""Of one repeat: fewer do not determine a motion and its acceleration."""
MOST_ROWS = 1 << 16
"""Rows that are searched; of longer recordings every m-th."""
CANDIDATES = 24
"""Minima of the difference function that are judged: the first nearly as deep ones, and half as many deepest ones."""
MOVING_OUTSIDE = 0.25
"""Share of the moving time that may be outside the repeats, as an approach and a return are."""
SCORE_BLOCKS = 8
"""Blocks of one period that are taken as independent in the std of the period."""
REST = 0.01
"""Of the motion: a part at either end that moves less is a rest."""
BLOCKS = 40
"""Blocks of one period: what does not repeat and is slower than two of them is seen."""
EXACT = 0.1 * TOLERANCE
"""What does not repeat of a motion that a program repeats exactly; longer candidates than that are multiples of it."""
NEARLY_AS_DEEP = 0.02
"""Of the motion's power: minima of the difference function so much less deep are candidates too."""
NOISE_STD = 5
"""By which a sample differs from a rest, and not by noise."""
NOISE_LIMIT = 8
"""Times the noise's variance that a squared difference of two samples may have: its mean is 2."""
SEEN_SINGLY = 30
"""Times the noise's variance, from which a tolerance shows in single differences; else means are taken."""
GROWTH = 4
"""Times as many repeats in the next refinement, whose period errs by less than a sample over them."""
LEAST_SQUARES_STEPS = 6
"""Of one refinement, which converges in two or three."""
CONVERGED = 1e-4
"""Samples over the whole stretch."""
CHANCE_STD = 4
"""Standard deviations of the noise's mean square, beyond which what does not repeat is not by chance."""
LEAST_MOVING = 0.25
"""Of the variation of each group, in the mean repeat; what moves less in it stands still most of the time."""


@dataclass(frozen=True, kw_only=True)
class MotionPeriod:
    """A period of the motion, and how well it repeats.

    period, std  s, and the standard deviation of the period
    start        s from the first sample to the first whole repeat
    repeats      whole repeats
    scatter      root-mean-square of the repeats' own lateness, s
    deviation    root-mean-square of what does not repeat, beyond noise, over that of the motion
    chance       what chance adds to the deviation of a motion with this noise
    correlation  of the motion with itself a period later
    """

    period: float
    std: float
    start: float
    repeats: int
    scatter: float
    deviation: float
    chance: float
    correlation: float


def motion_period(columns: Mapping[str, Array], dt: float, *, near: float | None = None) -> MotionPeriod | None:
    """The period of the motion in a recording's columns (n,) at a step of `dt` s; None where it does not repeat.

    With `near` (s), only periods within two hundredths of it; the whole record has to repeat with them.
    """
    every = -(-len(next(iter(columns.values()))) // MOST_ROWS)
    groups = [
        group for group in motion_components({name: column[::every] for name, column in columns.items()}) if group.moves
    ]
    if not groups:
        return None
    in_rows = _Search(groups).best(None if near is None else near / (dt * every))
    return None if in_rows is None else _in_seconds(in_rows, dt * every)


def _in_seconds(in_rows: MotionPeriod, dt: float) -> MotionPeriod:
    times = {name: getattr(in_rows, name) * dt for name in ("period", "std", "start", "scatter")}
    return replace(in_rows, **times)


# ---------------------------------------------------------------------------------------- components


@dataclass(frozen=True, eq=False)
class MotionComponent:
    """Columns of one kind (n, k): all angles, or all coordinates of a point."""

    kind: str
    values: Array

    @property
    def size(self) -> float:
        """Standard deviation of all columns together."""
        return float(np.sqrt(self.values.var(axis=0).sum()))

    @property
    def noise(self) -> float:
        """Variance of the noise of one sample, of all columns together, by fourth differences: they have 70 of it."""
        return float((np.diff(self.values, 4, axis=0) ** 2).mean(axis=0).sum()) / 70

    @property
    def moves(self) -> bool:
        """Whether there is a motion above its noise."""
        enough = len(self.values) > 2 * FEWEST_SAMPLES and self.size > LEAST_MOTION[self.kind]
        return enough and self.size > LEAST_SIGNAL * np.sqrt(self.noise)


def motion_components(columns: Mapping[str, Array]) -> list[MotionComponent]:
    """The motion in a recording's columns (n,): joints, or an orientation and a position.

    An orientation is taken as entries of its rotation, which know no sign.
    """
    rotations: list[MotionComponent] = []
    joints = sorted(name for name in columns if re.fullmatch(r"q\d+", name))
    if joints:
        return [MotionComponent("angle", np.stack([columns[name] for name in joints], axis=1))]
    if "phi" in columns:
        rotations = [MotionComponent("angle", np.stack([np.cos(columns["phi"]), np.sin(columns["phi"])], axis=1))]
    elif "qw" in columns:
        rotations = [MotionComponent("angle", _rotation_entries(*(columns[name] for name in ("qx", "qy", "qz", "qw"))))]
    for kind, prefix in (("position", "p"), ("acceleration", "a")):
        names = [prefix + axis for axis in "xyz" if prefix + axis in columns]
        if names:
            return [*rotations, MotionComponent(kind, np.stack([columns[name] for name in names], axis=1))]
    return rotations


def _rotation_entries(x: Array, y: Array, z: Array, w: Array) -> Array:
    """Two columns (n, 6) of the rotation matrix, over root 2, so that a small turn changes them by about its angle."""
    size = x * x + y * y + z * z + w * w
    entries = [
        w * w + x * x - y * y - z * z, 2 * (x * y + w * z), 2 * (x * z - w * y),
        2 * (x * y - w * z), w * w - x * x + y * y - z * z, 2 * (y * z + w * x),
    ]  # fmt: skip
    return np.asarray(np.stack(entries, axis=1) / size[:, None] / np.sqrt(2))


# -------------------------------------------------------------------------------------------- search


class _Search:
    """Candidates of a period, in samples, and their judgement."""

    def __init__(self, groups: list[MotionComponent]) -> None:
        self.groups = groups
        self.edges = np.cumsum([0, *(group.values.shape[1] for group in groups)])
        self.x = np.hstack([(group.values - group.values.mean(axis=0)) / group.size for group in groups])
        self.noise = np.array([group.noise / group.size**2 for group in groups])
        """Variance of the noise of one sample over that of the motion, of each group."""

    def best(self, near: float | None) -> MotionPeriod | None:
        """The shortest period that repeats as well as the best does; None without any."""
        periods: list[MotionPeriod] = []
        for lag in self._candidates() if near is None else iter([near]):
            judged = self._judged(lag, near)
            periods += [] if judged is None else [judged]
            if judged is not None and judged.deviation <= np.hypot(EXACT, judged.chance):
                break  # longer ones are multiples of it
        if not periods:
            return None
        enough = max(2 * min(one.deviation for one in periods), EXACT)
        return min(
            (one for one in periods if one.deviation <= np.hypot(enough, one.chance)), key=lambda one: one.period
        )

    def _without_rests(self) -> Array:
        """The motion without a rest at its beginning and at its end, which no period of it has."""
        reach = NOISE_STD * np.sqrt(float(self.noise.sum())) + REST
        ends = [np.abs(self.x - end).max(axis=1) > reach for end in (self.x[0], self.x[-1])]
        first = int(np.argmax(ends[0]))
        last = len(self.x) - int(np.argmax(ends[1][::-1]))
        return self.x[first:last] if last - first > 2 * FEWEST_SAMPLES else self.x

    def _candidates(self) -> Iterator[float]:
        """Ascending lags of the deepest minima of the difference function, and of the first nearly as deep."""
        d = difference_function(self._without_rests())
        inner = np.arange(FEWEST_SAMPLES - 1, len(d) - 1)
        inner = inner[(d[inner] <= d[inner - 1]) & (d[inner] < d[inner + 1])] if len(inner) else inner
        if not inner.size:
            return
        before, here, after = d[inner - 1], d[inner], d[inner + 1]
        bend = np.maximum(before - 2 * here + after, SMALLEST_DIVISOR)
        place, depth = inner + 0.5 * (before - after) / bend, here - (before - after) ** 2 / (8 * bend)
        deepest = np.argsort(depth, kind="stable")[: CANDIDATES // 2]
        nearly = np.flatnonzero(depth <= depth.min() + NEARLY_AS_DEEP)[:CANDIDATES]
        for i in np.union1d(deepest, nearly):
            yield float(place[i])

    def _judged(self, lag: float, near: float | None) -> MotionPeriod | None:
        """The period near a lag, with its evidence; None where the motion does not repeat with it."""
        line, first, last = (lag, 0.0, 0.0), 0, 0
        for tolerance in STRETCH_TOLERANCES:
            first, last = self._stretch(line[0], tolerance)
            refined = self._refined(line[0], first, last)
            if refined is None or abs(refined[0] - lag) > LARGEST_CORRECTION * lag:
                return None
            line = refined
        period, std, scatter = line
        repeats = whole_repeats(last - first, period)
        if repeats < 2 or (near is None and not self._is_most_of_the_motion(first, last, period)):
            return None
        folds = self._folds(first, period, repeats)
        deviation, chance = self._deviation(folds)
        if (deviation > np.hypot(TOLERANCE, chance)).any() or not self._is_moving(folds):
            return None
        later = 1 - float(((folds[1:] - folds[:-1]) ** 2).mean() / (2 * folds.var(axis=(0, 1)).mean()))
        return MotionPeriod(
            period=period, std=std, start=float(first), repeats=repeats, scatter=scatter,
            deviation=float(deviation.max()), chance=float(chance.max()), correlation=later,
        )  # fmt: skip

    def _stretch(self, lag: float, tolerance: float) -> tuple[int, int]:
        """First and one past the last sample of the longest stretch that is nearly the same a lag later."""
        count = int(len(self.x) - lag)
        change = interpolated(self.x, lag + np.arange(float(count))) - self.x[:count]
        noise, allowed = float(self.noise.sum()), len(self.groups) * tolerance**2
        # Means are sharper against noise, but blur where the repeats begin and end.
        smooth = _running_mean((change**2).sum(axis=1), int(lag / BLOCKS) if SEEN_SINGLY * noise > allowed else 0)
        alike = smooth < NOISE_LIMIT * noise + allowed
        bounds = np.flatnonzero(np.diff(np.concatenate([[0], alike.astype(np.int8), [0]])))
        if not bounds.size:
            return 0, 0
        starts, stops = bounds[::2], bounds[1::2]
        i = int(np.argmax(stops - starts))
        return int(starts[i]), min(int(stops[i] + lag + 1), len(self.x))

    def _folds(self, first: float, period: float, repeats: int) -> Array:
        """The motion (R, M, k) of every repeat at the same M phases."""
        count = max(int(period), FEWEST_SAMPLES)
        phases = np.arange(count) * (period / count)
        places = (first + period * np.arange(repeats))[:, None] + phases
        return interpolated(self.x, places.ravel()).reshape(repeats, len(phases), -1)

    def _refined(self, lag: float, first: int, last: int) -> tuple[float, float, float] | None:
        """Period, its std and the scatter of the repeats' lateness, in samples; None with less than two repeats."""
        period, repeats = lag, min(whole_repeats(last - first, lag), 3)
        if lag < FEWEST_SAMPLES - 0.5 or repeats < 2:
            return None
        while True:
            corrected = self._corrected(period, first, repeats)
            if corrected is None:
                return None
            period, most = corrected[0], whole_repeats(last - first, corrected[0])
            if repeats >= most:
                return corrected
            repeats = min(GROWTH * repeats, most)

    def _corrected(self, period: float, first: int, repeats: int) -> tuple[float, float, float] | None:
        """The same of so many repeats, by a few steps of least squares; None where they lead away."""
        std = scatter = 0.0
        for _ in range(LEAST_SQUARES_STEPS):
            line = self._line(self._folds(first, period, repeats), period)
            if line is None or abs(line[0]) > LARGEST_CORRECTION * period:
                return None
            change, std, scatter = line
            period += change
            if abs(change) * repeats < CONVERGED:
                break
        return period, std, scatter

    def _line(self, folds: Array, period: float) -> tuple[float, float, float] | None:
        """Slope of the lateness over the repeats, its std and the scatter about it, in samples.

        The std is a sandwich over blocks of the repeats, as what does not repeat is seldom white.
        """
        repeats, phases, _ = folds.shape
        mean = _running_mean(folds.mean(axis=0), phases // (2 * BLOCKS))  # its noise would have a slope of its own
        slope = (np.roll(mean, -1, axis=0) - np.roll(mean, 1, axis=0)) * phases / (2 * period)
        slope[[0, -1]] = 0.0  # the ends need not meet before the period is right
        size = float((slope**2).sum())
        if size <= 0:
            return None
        count = np.arange(repeats) - (repeats - 1) / 2
        scores = -np.einsum("rsk,sk->rs", folds - folds.mean(axis=0), slope) / size
        late = scores.sum(axis=1)
        per_repeat = float(count @ late / (count @ count))
        about = late - per_repeat * count
        scores -= per_repeat * count[:, None] * (slope**2).sum(axis=1) / size
        blocks = np.add.reduceat(scores, np.arange(0, phases, max(phases // SCORE_BLOCKS, 1)), axis=1)
        variance = float((count**2 @ blocks**2).sum()) * repeats / (repeats - 1)
        noise = float(self.noise.max()) / size
        std = np.sqrt(max(variance / (count @ count), noise) / (count @ count))
        return per_repeat, float(std), float(np.sqrt((about**2).sum() / max(repeats - 2, 1)))

    def _deviation(self, folds: Array) -> tuple[Array, Array]:
        """Root-mean-square of what does not repeat, beyond noise, of each group, and what chance adds to it."""
        repeats, phases, _ = folds.shape
        length = max(phases // BLOCKS, 1)
        blocks = phases // length
        departure = (folds - folds.mean(axis=0))[:, : blocks * length].reshape(repeats, blocks, length, -1).mean(axis=2)
        power = (departure**2).sum(axis=(0, 1)) / ((repeats - 1) * blocks)
        by_group = np.array([power[a:b].sum() for a, b in zip(self.edges[:-1], self.edges[1:], strict=True)])
        chance = self.noise / length
        slack = CHANCE_STD * chance * np.sqrt(2 / ((repeats - 1) * blocks))
        return np.sqrt(np.maximum(by_group - chance, 0.0)), np.sqrt(slack)

    def _is_moving(self, folds: Array) -> bool:
        """Whether the repeats hold most of the motion's variation, in every group, and more than one move."""
        power = folds.mean(axis=0).var(axis=0)
        by_group = np.array([power[a:b].sum() for a, b in zip(self.edges[:-1], self.edges[1:], strict=True)])
        return bool((by_group > LEAST_MOVING).all())

    def _is_most_of_the_motion(self, first: int, last: int, period: float) -> bool:
        """Whether nearly all the way is inside; way is counted between means over a fortieth of a period."""
        every = max(int(period / BLOCKS), 1)
        means = _running_mean(self.x, every)[::every]
        way = np.sqrt((np.diff(means, axis=0) ** 2).sum(axis=1))
        way = np.maximum(way - 2 * np.sqrt(float(self.noise.sum()) / every), 0.0)
        middle = (np.arange(len(way)) + 0.5) * every
        inside = float(way[(middle >= first) & (middle <= last)].sum())
        return inside >= (1 - MOVING_OUTSIDE) * float(way.sum())


def whole_repeats(samples: float, period: float) -> int:
    """How many whole repeats are in so many samples; the last sample may be half a sample early."""
    return int((samples + 0.5) / period)


def _running_mean(x: Array, reach: int) -> Array:
    """Means of a series (n, ...) over 2 reach + 1 samples, fewer at its ends."""
    total = np.concatenate([np.zeros((1, *x.shape[1:])), np.cumsum(x, axis=0)])
    low, high = (np.clip(np.arange(len(x)) + offset, 0, len(x)) for offset in (-reach, reach + 1))
    return np.asarray((total[high] - total[low]) / (high - low).reshape(-1, *[1] * (x.ndim - 1)))


def difference_function(x: Array) -> Array:
    """d(L) of a series (n, k) for the lags L = 0 .. n // 2, over the mean power of what is compared.

    sum |x(t + L) - x(t)|² is the power of both parts less twice their correlation, which is a product of transforms.
    """
    n = len(x)
    lags = n // 2 + 2
    size = 1 << int(np.ceil(np.log2(n + lags)))
    spectrum = np.zeros(size // 2 + 1)
    for column in x.T:
        spectrum += np.abs(np.fft.rfft(column, size)) ** 2
    correlation = np.fft.irfft(spectrum, size)[:lags]
    total = np.concatenate([[0.0], np.cumsum((x**2).sum(axis=1))])
    both = total[n - np.arange(lags)] + total[n] - total[:lags]
    count = n - np.arange(lags)
    return np.asarray((both - 2 * correlation) / (2 * count) / max(total[n] / n, SMALLEST_DIVISOR))


def interpolated(x: Array, places: Array) -> Array:
    """A smooth series (n, k) at places (m,) in samples, by the cubic polynomial through four neighbours."""
    base = np.clip(np.floor(places).astype(np.intp), 1, len(x) - 3)
    u = (np.clip(places, 0, len(x) - 1) - base)[:, None]
    weights = (
        -u * (u - 1) * (u - 2) / 6,
        (u + 1) * (u - 1) * (u - 2) / 2,
        -(u + 1) * u * (u - 2) / 2,
        (u + 1) * u * (u - 1) / 6,
    )
    return np.asarray(sum(weight * x[base + j] for j, weight in zip((-1, 0, 1, 2), weights, strict=True)))
