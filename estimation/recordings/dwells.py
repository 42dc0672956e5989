"""Dwells: stretches of a log in which the sensor stood still, as static poses with the noise of their means.

Somebody who takes poses at rest with a logger that runs on has a log of dwells, with the transitions between them or
without. A dwell is found by the motion, which stands still in it, and by the readings, which have settled; its rows are
averaged to one pose. How well a mean is known follows from the noise within the dwells, whatever its colour, so that
the residual of a fit of the poses can be judged against noise that is no part of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from estimation.multiplicity import normal_isf
from estimation.recordings.motion import MIN_POSES, QUATERNION, MotionForm, numbered_names
from modeling.rig import SPATIAL_CHANNELS

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

WINDOWS = (0.25, 1.0)
"""s over which the motion is averaged before its displacement is taken: the first is shorter than any dwell, the second
is for a motion that dithers or has much noise."""
FEWEST_WINDOW, FEWEST_ROWS = 3, 5
"""Rows that are averaged at least, and rows of a dwell: of fewer no noise is told from a transient."""
SLOWEST, FASTEST = 0.002, 0.02
"""rad/s between which the speed lies from which the sensor moves: nobody drives an arm more slowly than the first, and
at the second the weight of a tool turns by a tenth of a radian within five seconds, which no dwell would hide."""
RESTLESS, AT_REST = 5.0, 0.3
"""Times that quantile of the displacement, which is of encoder noise or dithering where half of the rows are at rest,
beyond which the sensor moves."""
RADIUS = 0.02
"""rad within which a sensor at rest stays: dithering and a controller's error are smaller, and neighbouring poses that
are meant to differ are farther apart."""
EDGE = 5e-4
"""rad from a dwell's pose up to which rows next to it belong to it, or five times the noise of the motion."""
SMOOTHED = 9
"""Rows over which the motion is averaged then at the ends of a dwell: of an odd number the middle is one of them."""
NOISE_STD = 5.0
"""Std of the noise beyond which a row is not at the pose: rarely by chance in a log of 1e5 rows."""
MOST_UNSETTLED = 9
"""Blocks that are left out at most: the mean of the last is worth more than none."""
SETTLING_BLOCKS = 12
"""Blocks of a dwell in which its readings settle: a transient of a tenth of a dwell is seen in one of them."""
UNSETTLED = 6.0
"""Std of a block's mean about the line through the settled half beyond which it has not settled: a dwell has a dozen
blocks of up to six channels, and a log a hundred dwells."""
MOST_ROWS = 0.5
"""Share of a log's rows that are in dwells from which it is a log of them: of a run with pauses the motion is more."""
RESOLVED = 10
"""Rows of a transition at the median from which its accelerations are sampled: two derivatives of a motion that starts
and stops take some samples for each of its three phases."""
DISTINCT = 0.1
"""rad between poses that are distinct: less changes the weight in the sensor by a tenth at most."""
FLICKER_HADAMARD = 0.5 * np.log(256 / 27)
"""Hadamard variance of noise with the one-sided spectrum 1 / f, whatever the length of its blocks."""
INDEPENDENT = 0.5
"""Of neighbouring second differences, which share two of three blocks."""
REWEIGHTED, SMALLEST_SHARE = 3, 1e-9
"""Times that W and F are estimated, weighted as they were before, and share of the largest variance that a weight sees
at least: more rounds change them by less than their std."""
SMALLEST_VARIANCE = 1e-24
"""N² or (N m)², of readings without noise, so that they can be divided by it."""


def angles_of(columns: Mapping[str, Array], form: MotionForm) -> Array:
    """Joint angles, a planar angle, or twice a quaternion without jumps of its sign, (k, n), rad."""
    if form is MotionForm.PLANAR_POSE:
        return np.unwrap(columns["phi"])[None]
    if form is MotionForm.JOINTS:
        joints = sum(name[0] == "q" and name[1:].isdigit() for name in columns)
        return np.stack([columns[name] for name in numbered_names("q", joints)])
    return 2 * _continuous(np.stack([columns[name] for name in QUATERNION]))


def _continuous(quaternions: Array) -> Array:
    """Quaternions (4, n) of which neighbours lie in one half sphere."""
    flips = (quaternions[:, 1:] * quaternions[:, :-1]).sum(axis=0) < 0
    return np.asarray(quaternions * np.where(np.concatenate([[0], np.cumsum(flips)]) % 2 == 0, 1.0, -1.0))


@dataclass(frozen=True, eq=False)
class Dwells:
    """The dwells of a log of n rows, in the order of time.

    ends     (m, 2) first row of each and the row after its last
    at_pose  (m, 2) the same of the rows at its pose, those in which the readings have not settled among them
    stamps   (n,) of all rows, s
    wrench   (n, p) readings of all rows
    angles   (k, n) of the motion, rad
    gaps     stretches of time in which nothing was logged
    """

    ends: NDArray[np.int64]
    at_pose: NDArray[np.int64]
    stamps: Array
    wrench: Array
    angles: Array
    gaps: int

    @classmethod
    def of(cls, columns: Mapping[str, Array], form: MotionForm, stamps: Array, wrench: Array, gaps: Mask) -> Dwells:
        """Of columns (n,) of a motion, with stamps (n,) in s; `gaps` (n - 1,) are the steps with missing samples."""
        angles = angles_of(columns, form)
        still = _still_stretches(angles, stamps, gaps)
        settled = _settled(still, wrench)
        ends, at_pose = (np.array(rows, dtype=np.int64).reshape(-1, 2) for rows in (settled, still))
        return cls(ends, at_pose, stamps, wrench, angles, int(gaps.sum()))

    def __len__(self) -> int:
        return len(self.ends)

    @property
    def rows(self) -> NDArray[np.int64]:
        """Number of rows (m,) of each."""
        return np.asarray(np.diff(self.ends, axis=1)[:, 0])

    @property
    def are_poses(self) -> bool:
        """Whether the log is of them: they are most of its rows, in as many distinct poses as a fit needs."""
        return len(self) >= MIN_POSES and self.share > MOST_ROWS and self.distinct >= MIN_POSES

    @property
    def are_sampled_between(self) -> bool:
        """Whether the motion from one to the next is sampled well enough for its accelerations."""
        return bool(np.median(self.moving_rows) >= RESOLVED)

    @property
    def share(self) -> float:
        """Share of the log's rows that are at a dwell's pose."""
        return float(np.diff(self.at_pose).sum()) / len(self.stamps)

    @property
    def instants(self) -> Array:
        """Mean stamp (m,) of each, s from the first."""
        means = self.means(self.stamps[:, None])[:, 0]
        return np.asarray(means - means[0])

    @cached_property
    def moving_rows(self) -> NDArray[np.int64]:
        """Number of rows (m - 1,) of the motion from each dwell to the next."""
        return np.asarray(self.at_pose[1:, 0] - self.at_pose[:-1, 1])

    def mean_columns(self, columns: Mapping[str, Array]) -> dict[str, Array]:
        """Means (m,) of columns (n,) by name, an orientation's of unit length."""
        names = list(columns)
        stacked = np.stack([columns[name] for name in names])
        turns = [names.index(name) for name in QUATERNION if name in names]
        if turns:
            stacked[turns] = _continuous(stacked[turns])
        if "phi" in names:
            stacked[names.index("phi")] = np.unwrap(columns["phi"])
        means = self.means(stacked.T).T
        means[turns] /= np.linalg.norm(means[turns], axis=0) if turns else 1.0
        return dict(zip(names, means, strict=True))

    def means(self, series: Array) -> Array:
        """Means (m, k) of a series (n, k)."""
        sums = np.concatenate([np.zeros((1, series.shape[1])), np.cumsum(series - series.mean(axis=0), axis=0)])
        return np.asarray((sums[self.ends[:, 1]] - sums[self.ends[:, 0]]) / self.rows[:, None] + series.mean(axis=0))

    @property
    def distinct(self) -> int:
        """Number of poses that differ from each other by more than `DISTINCT`."""
        poses: list[Array] = []
        for pose in self.means(self.angles.T):
            apart = (min(np.linalg.norm(pose - other), np.linalg.norm(pose + other)) for other in poses)
            if all(distance > DISTINCT for distance in apart):
                poses.append(pose)
        return len(poses)

    @cached_property
    def covariance(self) -> Array:
        """Covariance (p, m, m) of the means of each channel by the noise within the dwells, but for a constant.

        Noise that changes more slowly than within a dwell is alike in neighbouring ones. The zero of the readings takes
        up the constant. The noise of the motion is in it, as it turns the weight.
        """
        turns = np.einsum("kii->i", self._noise(self.angles.T).covariance)
        turns = turns / (3 if len(self.angles) == len(QUATERNION) else 1)  # about each axis
        means, forces = self.means(self.wrench), 3 if self.wrench.shape[1] == len(SPATIAL_CHANNELS) else 2
        sizes = [np.linalg.norm(group, axis=1) for group in np.split(means - means.mean(axis=0), [forces], axis=1)]
        levers = np.repeat(np.stack(sizes), [forces, means.shape[1] - forces], axis=0)
        floor = SMALLEST_VARIANCE + turns * levers**2
        return np.asarray(self._noise_of_readings.covariance + np.stack([np.diag(f) for f in floor]))

    @property
    def log_power_variance(self) -> Array:
        """Variance (p,) of the logarithm of the power of that noise, as it is estimated."""
        return self._noise_of_readings.log_power_variance

    @cached_property
    def _noise_of_readings(self) -> MeanNoise:
        return self._noise(self.wrench)

    def _noise(self, series: Array) -> MeanNoise:
        return MeanNoise.of([series[begin:end] for begin, end in self.ends], self._times)

    @property
    def std(self) -> Array:
        """Std (m, p) of each mean about those of the others."""
        mean = np.eye(len(self)) - 1 / len(self)
        variance = np.einsum("ij,pjk,ik->ip", mean, self.covariance, mean) * len(self) / (len(self) - 1)
        return np.asarray(np.sqrt(variance))

    @property
    def _times(self) -> Array:
        """Middle and length (2, m) of each, s."""
        first, last = self.stamps[self.ends[:, 0]], self.stamps[self.ends[:, 1] - 1]
        return np.stack([(first + last) / 2, (last - first) * self.rows / np.maximum(self.rows - 1, 1)])

    @property
    def counted(self) -> str:
        """What is averaged and what is left out, as a clause."""
        left_out = len(self.stamps) - int(self.rows.sum())
        gaps = f", {self.gaps} gap{'s' * (self.gaps > 1)} in time between" if self.gaps else ""
        moving = f"; {left_out} rows of transitions and of settling are left out" if left_out else ""
        return f"{len(self)} poses at rest, each the mean of {_range(self.rows)} rows{gaps}{moving}"


def _range(counts: NDArray[np.int64]) -> str:
    low, high = int(counts.min()), int(counts.max())
    return str(low) if low == high else f"{low} to {high}"


def _still_stretches(angles: Array, stamps: Array, gaps: Mask) -> list[tuple[int, int]]:
    """First row and row after the last of the stretches in which angles (k, n) stand still."""
    pieces = np.concatenate([[0], np.flatnonzero(gaps) + 1, [angles.shape[1]]]).astype(np.int64)
    step, noise = float(np.median(np.diff(stamps))), _step_noise(angles)

    def displacement(seconds: float) -> tuple[list[Array], float, float]:
        """Displacement of the rows of each piece over a window, the limit for rows at rest, and the largest limit."""
        window = max(round(seconds / step), FEWEST_WINDOW)
        pairs = pairwise(pieces.tolist())
        displaced = [_displacement(angles[:, a:b], window) for a, b in pairs]
        usual = RESTLESS * float(np.quantile(np.concatenate(displaced), AT_REST))
        by_noise = NOISE_STD * noise * float(np.sqrt(2 / window))
        return displaced, max(usual, by_noise), FASTEST * window * step

    displaced, limit, fastest = displacement(WINDOWS[0])
    if limit > fastest:
        displaced, limit, fastest = displacement(WINDOWS[1])
    limit = float(np.clip(limit, SLOWEST / FASTEST * fastest, fastest))
    stretches: list[tuple[int, int]] = []
    for start, moved in zip(pieces[:-1], displaced, strict=True):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], moved <= limit, [False]]).astype(np.int8)))
        for a, b in edges.reshape(-1, 2) + start:
            stretches += _at_one_pose(angles, int(a), int(b), int(start), int(start + len(moved)), noise)
    return _joined(angles, stretches, gaps)


def _displacement(angles: Array, window: int) -> Array:
    """Displacement (n,) between the means of a window before each row and of one from it on; the ends take part."""
    n = angles.shape[1]
    sums = np.concatenate([np.zeros((len(angles), 1)), np.cumsum(angles - angles[:, :1], axis=1)], axis=1)
    row = np.arange(n)
    window = max(min(window, n // 2), 1)
    middle = np.clip(row, min(window, n - 1), max(n - window, 0))
    before, after = np.maximum(middle - window, 0), np.minimum(middle + window, n)
    lengths = np.maximum(middle - before, 1), np.maximum(after - middle, 1)
    change = (sums[:, after] - sums[:, middle]) / lengths[1] - (sums[:, middle] - sums[:, before]) / lengths[0]
    return np.asarray(np.linalg.norm(change, axis=0))


def _step_noise(angles: Array) -> float:
    """Std of the white noise of angles (k, n), of all together, from second differences, which a motion hardly has."""
    second = np.diff(angles, n=2, axis=1)
    spread = np.median(np.abs(second), axis=1) / normal_isf(0.25) / np.sqrt(6)
    return float(np.linalg.norm(spread))


def _at_one_pose(angles: Array, a: int, b: int, low: int, high: int, noise: float) -> list[tuple[int, int]]:
    """The still rows a <= i < b where they keep one pose, with the rows next to them at it within low <= i < high.

    A motion that is as slow as the noise leaves its pose by more than a dwell does, and is none.
    """
    if b - a < FEWEST_WINDOW:
        return []
    pose = np.median(angles[:, a:b], axis=1)
    about = angles[:, low:high] - pose[:, None]
    drift = _smooth(about[:, a - low : b - low], max((b - a) // 8, FEWEST_WINDOW))
    if np.linalg.norm(np.ptp(drift, axis=1)) > RADIUS:
        return []
    width = SMOOTHED if NOISE_STD * noise > EDGE and high - low > 2 * SMOOTHED else 1
    about = np.pad(_smooth(about, width), ((0, 0), (width // 2, width // 2)), mode="edge")
    distance = np.linalg.norm(about, axis=0)
    usual = float(np.quantile(distance[a - low : b - low], 0.95))
    near = distance <= max(EDGE, NOISE_STD * noise / np.sqrt(width), usual)
    while a > low and near[a - 1 - low]:
        a -= 1
    while b < high and near[b - low]:
        b += 1
    return [(a, b)] if b - a >= FEWEST_ROWS else []


def _smooth(series: Array, window: int) -> Array:
    """Means (k, n - window + 1) of a window of rows."""
    window = min(window, series.shape[1])
    sums = np.concatenate([np.zeros((len(series), 1)), np.cumsum(series, axis=1)], axis=1)
    return np.asarray((sums[:, window:] - sums[:, :-window]) / window)


def _joined(angles: Array, stretches: list[tuple[int, int]], gaps: Mask) -> list[tuple[int, int]]:
    """Stretches at one pose that meet or that a short disturbance parts are one."""
    joined: list[tuple[int, int]] = []
    for a, b in stretches:
        if joined:
            first, last = joined[-1]
            here = np.median(angles[:, a:b], axis=1)
            apart = np.linalg.norm(np.median(angles[:, first:last], axis=1) - here)
            between = angles[:, min(last, a) : a]
            strayed = np.linalg.norm(between - here[:, None], axis=0).max(initial=0.0)
            if max(apart, strayed) < RADIUS and not gaps[last - 1 : a].any():
                joined[-1] = (first, max(b, last))
                continue
            a = max(a, last)
        if b - a >= FEWEST_ROWS:
            joined.append((a, b))
    return joined


# ------------------------------------------------------------------------------------------ readings that settle


def _settled(stretches: list[tuple[int, int]], wrench: Array) -> list[tuple[int, int]]:
    """Stretches without the rows at their ends in which the readings have not settled, or leave already.

    Each end is held against the line through the blocks of the other half, the first end first; the spread of blocks
    about such lines is pooled over all stretches, so that slow noise is no transient.
    """
    means = [_block_means(wrench[a:b]) for a, b in stretches]
    spreads = [_about_line(m[len(m) // 2 :])[1] for m in means if len(m) == SETTLING_BLOCKS]
    if not spreads:
        return stretches
    spread = np.sqrt(np.median(np.square(spreads), axis=0))
    settled = []
    for a, b in stretches:
        begin = a + _unsettled(wrench[a:b], spread)
        settled.append((begin, b - _unsettled(wrench[begin:b][::-1], spread)))
    return settled


def _block_means(rows: Array) -> Array:
    """Means (blocks, p) of the rows (n, p) of a stretch, in as many blocks as it has rows for."""
    blocks = SETTLING_BLOCKS if len(rows) >= 2 * SETTLING_BLOCKS else 1
    return np.stack([block.mean(axis=0) for block in np.array_split(rows, blocks)])


def _about_line(means: Array) -> tuple[Array, Array]:
    """Line (2, p), at the mean block and its slope, through block means (b, p), and the std about it (p,)."""
    x = np.arange(len(means)) - (len(means) - 1) / 2
    slope = x @ means / (x @ x)
    rest = means - means.mean(axis=0) - np.multiply.outer(x, slope)
    return np.stack([means.mean(axis=0), slope]), np.sqrt((rest**2).sum(axis=0) / (len(means) - 2))


def _unsettled(rows: Array, spread: Array) -> int:
    """How many of the first rows (n, p) of a stretch have not settled: the blocks up to the last that is off the line.

    What falls below what is seen lasts about as long again.
    spread  std (p,) of the means of blocks about a line through them
    """
    means = _block_means(rows)
    if len(means) < SETTLING_BLOCKS:
        return 0
    half = len(means) // 2
    late = means[half:]
    (level, slope), _ = _about_line(late)
    x = np.arange(half) - half - (len(late) - 1) / 2
    off = np.abs(means[:half] - level - np.multiply.outer(x, slope))
    scale = np.sqrt(1 + 1 / len(late) + x**2 / float(((np.arange(len(late)) - (len(late) - 1) / 2) ** 2).sum()))
    far = np.flatnonzero((off > UNSETTLED * scale[:, None] * spread).any(axis=1))
    return int(np.ceil(min(2 * (far[-1] + 1), MOST_UNSETTLED) * len(rows) / len(means))) if far.size else 0


# ------------------------------------------------------------------------------------------ noise of a mean


@dataclass(frozen=True, eq=False)
class MeanNoise:
    """Noise of the means of pieces of p channels.

    covariance          (p, m, m) of the means of each, but for a constant
    log_power_variance  (p,) variance of the logarithm of its power, as it is estimated
    """

    covariance: Array
    log_power_variance: Array

    @classmethod
    def of(cls, pieces: Sequence[Array], times: Array) -> MeanNoise:
        """Of pieces (n_i, p), with `times` (2, m), their middles and lengths in s, in noise that is white and 1 / f.

        Its Hadamard variance in blocks of T rows is W / T + F: 1/6 of the mean square of second differences of
        neighbouring block means, to which a steady drift of the zero adds nothing: it is no noise. With the spectrum
        h / f it is 1/2 ln(256 / 27) h for any T. The covariance of means is W / n_i in the diagonal, and -h ln of the
        time between two of them, of which a mean of length T has the mean within itself, ln T - 3/2.

        One channel tells F / W badly where it is small, though it is most of what means differ by: a channel has at
        least the ratio that all show together.
        """
        longest = int(np.median([len(piece) for piece in pieces])) // 3
        lengths = [longest // 2**i for i in range(longest.bit_length())] or [1]
        squares = [np.concatenate([_second_differences(p, length) for p in pieces]) ** 2 for length in lengths]
        scales = np.array([length for length, s in zip(lengths, squares, strict=True) if len(s)], dtype=float)
        squares = [square for square in squares if len(square)]
        counts = INDEPENDENT * np.array([len(square) for square in squares])
        variances = np.array([square.mean(axis=0) / 6 for square in squares]).reshape(len(scales), -1)
        changes = np.flatnonzero(variances.any(axis=0))
        count = pieces[0].shape[1]
        covariance, log_power_variance = np.zeros((count, len(pieces), len(pieces))), np.zeros(count)
        if not len(changes):
            return cls(covariance, log_power_variance)
        levels = {int(c): _white_and_flicker(scales, variances[:, c], counts) for c in changes}
        smooth = variances[:, changes].max(axis=0) * SMALLEST_SHARE
        sizes = np.array([max(white, least) for (white, _), least in zip(levels.values(), smooth, strict=True)])
        white, flicker = _white_and_flicker(scales, (variances[:, changes] / sizes).mean(axis=1), counts * len(changes))
        shared = flicker / white if white > 0 else 0.0
        of_flicker, by_white = _of_flicker(*times) / FLICKER_HADAMARD, np.diag([1 / len(piece) for piece in pieces])
        slow = (float(np.trace(of_flicker)) - float(of_flicker.mean(axis=0).sum())) / len(pieces)
        for channel, (white, flicker) in levels.items():
            level = max(flicker, shared * white)
            covariance[channel] = white * by_white + level * of_flicker
            channels = len(changes) if flicker <= level else 1
            std = 1 / np.sqrt(channels * (counts / 2 / (white / scales + level) ** 2).sum())
            power = slow * level + white * float(np.trace(by_white)) / len(pieces)
            log_power_variance[channel] = np.log1p(slow * std / power) ** 2
        return cls(covariance, log_power_variance)


def _of_flicker(middles: Array, lengths: Array) -> Array:
    """Covariance (m, m) of means of noise with the spectrum 1 / f; a constant is arbitrary, and the least is zero."""
    apart = np.abs(middles[:, None] - middles)
    shortest = (lengths[:, None] + lengths) / 2
    logarithm = np.log(np.maximum(apart, shortest))
    np.fill_diagonal(logarithm, np.log(lengths) - 1.5)
    return np.asarray(logarithm.max() - logarithm)


def _second_differences(piece: Array, length: int) -> Array:
    """Second differences (b, p) of neighbouring means of blocks of so many rows (n, p)."""
    blocks = len(piece) // length
    means = piece[: blocks * length].reshape(blocks, length, piece.shape[1]).mean(axis=1)
    return np.diff(means, n=2, axis=0)


def _white_and_flicker(scales: Array, variances: Array, counts: Array) -> tuple[float, float]:
    """W >= 0 and F >= 0 of Hadamard variances W / T + F of blocks of T rows, from so many each."""
    from scipy.optimize import nnls  # slow to import

    weights, solution = np.sqrt(counts), np.zeros(2)
    for _ in range(REWEIGHTED):
        known = solution[0] / scales + solution[1] if solution.any() else variances
        size = np.maximum(known, variances.max() * SMALLEST_SHARE)
        rows = np.stack([1 / scales, np.ones_like(scales)], axis=1) * (weights / size)[:, None]
        norms = np.linalg.norm(rows, axis=0)
        solution = nnls(rows / norms, weights * variances / size)[0] / norms
    return float(solution[0]), float(solution[1])
