"""Derivatives of a sampled motion: truncated Fourier series (periodic) or smoothing splines (single run).

The bandwidth of a Fourier series ends where the motion's spectrum falls below its noise floor, that of a smoothing
spline where the likelihood puts it.
"""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from itertools import pairwise
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.recordings.smoothing_spline import BasisRows, SmoothingSpline
from modeling.significance import LEVELS

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Derivatives:
    """A series and its first two derivatives in time, each (N, k), per s and per s².

    `score` (k,) is the Bayesian information criterion n ln RSS + p ln n of the fit, by which two fits to the same
    series are compared. `spline` is the smoothing spline that they come from, None for a Fourier series and static
    poses.
    """

    value: Array
    first: Array
    second: Array
    score: Array
    spline: SmoothingSpline | None = None

    def rows(self, chosen: slice) -> Derivatives:
        """Some rows of the series, without its spline."""
        value, first, second = (series[chosen] for series in (self.value, self.first, self.second))
        return replace(self, value=value, first=first, second=second, spline=None)

    def one_after_another(self, count: int) -> Derivatives:
        """Of `count` series side by side, each (N, k): as series (count N, k), without their splines."""
        parts = (np.concatenate(np.hsplit(series, count)) for series in (self.value, self.first, self.second))
        value, first, second = parts
        return Derivatives(value=value, first=first, second=second, score=self.score[: value.shape[1]])


KEPT_BYTES = 64_000_000
"""Of all that is kept, by this process: about ten motions with position of ten minutes at 100 Hz."""


class RecentDerivatives:
    """Derivatives by the content of what they come from; the ones not used for longest go first.

    A recording is copied with another rig, other readings or a report, and reading reports and the evidence of frames
    look at its motion before a fit does. The content, not the object, says that nothing has changed.
    """

    def __init__(self, limit: int = KEPT_BYTES) -> None:
        self.limit = limit
        self._kept: OrderedDict[bytes, tuple[Derivatives, SmoothingSpline]] = OrderedDict()
        self._lock = Lock()

    def get(
        self, source: tuple[NDArray[Any], ...], derive: Callable[[], tuple[Derivatives, SmoothingSpline]]
    ) -> tuple[Derivatives, SmoothingSpline]:
        """Derivatives and their spline that follow from the arrays `source`, by `derive` where they are not kept."""
        key = _digest(source)
        with self._lock:
            kept = self._kept.get(key)
            if kept is not None:
                self._kept.move_to_end(key)
                return kept
        derived = derive()
        for array in (derived[0].value, derived[0].score, derived[1].spline.coefficients, derived[1].factor):
            array.flags.writeable = False  # others get the same ones
        if _bytes(derived) > self.limit:  # it would drive out all others
            return derived
        with self._lock:
            self._kept[key] = derived
            while self.size > self.limit:
                self._kept.popitem(last=False)
        return derived

    @property
    def size(self) -> int:
        """Bytes of all that is kept."""
        return sum(map(_bytes, self._kept.values()))


def _digest(arrays: tuple[NDArray[Any], ...]) -> bytes:
    digest = hashlib.blake2b(digest_size=32)
    for array in arrays:
        digest.update(repr((array.shape, array.dtype.str)).encode())
        digest.update(np.ascontiguousarray(array).data)
    return digest.digest()


def _bytes(kept: tuple[Derivatives, SmoothingSpline]) -> int:
    derivatives, spline = kept
    arrays = (derivatives.value, derivatives.first, derivatives.second, spline.spline.coefficients, spline.factor)
    return sum(array.nbytes for array in arrays)


# Sample and hold: values that a driver repeats until the sensor or the robot has new ones.


REGULAR_SHARE = 0.8
"""Share of holds of nearly the same length from which a lower rate, and no standstill, is behind them."""
ROUNDING = 0.02
"""Of a row: of the line through the instants, which the rows determine to a part of one."""
FEWEST_HOLDS, MOST_NEW = 20, 0.67
"""Holds, and share of rows with a new value, from which and up to which a lower rate is behind them: a clock of
whole rows has half at most."""
HOLD_SLACK = 4
"""Part of a hold by which it may be longer or shorter, but a row, where two clocks drift against each other."""
ONE_QUANTUM = 1e-6
"""Of a step: rounding of quanta in decimal digits."""
SLOPE_TOLERANCE = 1e-6
"""Of the range of slopes, far below what the rows determine."""
FEWEST_LINES = 64
"""Of a spectrum, from which three octaves of it determine a slope."""
STEEPEST = -4.0
"""Power of the frequency: linear interpolation of a slow log falls as f^-4."""


def held_rows(columns: Iterable[Array], samples: int) -> tuple[NDArray[np.bool_], int]:
    """Mask (n,) of the rows with a new value in any column (n,), and the number of rows for which one is held.

    0 when the holds are of no regular length.
    """
    changed = np.ones(samples, dtype=bool)
    changed[1:] = False
    for column in columns:
        changed[1:] |= column[1:] != column[:-1]
    holds = np.diff(np.flatnonzero(changed))
    if len(holds) < FEWEST_HOLDS or changed.mean() > MOST_NEW:
        return changed, 0
    usual = int(np.median(holds))
    regular = (np.abs(holds - usual) <= max(1, usual // HOLD_SLACK)).mean() if usual > 1 else 0.0
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
        usual = float(np.mean(holds[np.abs(holds - held) <= max(1, held // HOLD_SLACK)]))
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
    return steps.size == 0 or float(np.mean(np.abs(steps - np.median(steps)) < ONE_QUANTUM * np.median(steps))) > 0.5


def _narrowest(index: NDArray[np.intp], rows: NDArray[np.intp]) -> tuple[float, Array]:
    """Slope of the line through rows over index (m,) whose residual has the least range, and that residual.

    The range is convex in the slope: golden sections between slopes that tilt the whole line by two rows.
    """
    middle, reach = float(np.polyfit(index, rows, 1)[0]), 2.0 / index[-1]
    low, high = middle - reach, middle + reach
    ratio = (np.sqrt(5) - 1) / 2
    while high - low > SLOPE_TOLERANCE * reach:
        left, right = high - ratio * (high - low), low + ratio * (high - low)
        if np.ptp(rows - left * index) <= np.ptp(rows - right * index):
            high = right
        else:
            low = left
    slope = (low + high) / 2
    return slope, rows - slope * index - rows[0]


RECENT = RecentDerivatives()


def fourier_derivatives(mean: Array, dt: float, *, antiperiodic: bool = False) -> Derivatives:
    """Fourier series of one period (N, k), sampled every dt s, and its exact derivatives.

    x(t) = sum_|h|<=K c_h exp(i w_h t), w_h = 2 pi h / (N dt); derivatives multiply by i w_h. K is the
    highest excited line above the noise floor, per column: quantisation of a resolver repeats in every period, so that
    averaging does not reduce it, and every further line adds it times w_h².
    An `antiperiodic` column changes sign after a period, as a quaternion does after a full turn:
    its lines lie at h + 1/2.
    """
    samples = len(mean)
    shift = 0.5 if antiperiodic else 0.0
    carrier = np.exp(-2j * np.pi * shift * np.arange(samples) / samples)[:, None]
    spectrum = np.fft.fft(mean * carrier, axis=0)
    order = np.fft.ifftshift(np.arange(samples) - samples // 2) + shift  # whole numbers, which k / (N (1/N)) is not
    if not antiperiodic and samples % 2 == 0:
        order[samples // 2] *= -1  # the line at half the rate is its own mirror image
    ascending = np.argsort(np.where(order >= 0, order, np.inf))[: int(np.sum(order >= 0))]
    power = np.abs(spectrum[ascending]) ** 2
    highest = np.array([highest_excited_line(column) for column in power.T])
    truncated = np.where(np.abs(order)[:, None] <= highest + shift, spectrum, 0)
    rate = 2j * np.pi * order[:, None] / (samples * dt)
    value, first, second = (np.real(np.fft.ifft(truncated * rate**n, axis=0) * np.conj(carrier)) for n in range(3))
    score = _bayesian_information_criterion(mean - value, 2 * highest + 1)
    return Derivatives(value=value, first=first, second=second, score=score)


def spline_derivatives(run: Array, dt: float, true: TrueSamples | None = None) -> Derivatives:
    """One run (N, k), sampled every dt s, as smoothing splines; of its `true` samples alone where values are held.

    Smoothness and the noise of the samples are those of the largest likelihood, the same for all columns. They do not
    depend on the unit of time: a series is smoothed with samples one apart, and only once (`RecentDerivatives`).
    """
    run = np.asarray(run, dtype=np.float64)
    every = np.arange(len(run))
    rows = every if true is None else true.rows
    places = every.astype(np.float64) if true is None else true.instants / dt
    derivatives, spline = RECENT.get((rows, places, run), lambda: _smoothed(rows, places, run))
    first, second = derivatives.first / dt, derivatives.second / dt**2
    return replace(derivatives, first=first, second=second, spline=spline.with_samples_every(dt))


def _smoothed(rows: NDArray[np.intp], places: Array, run: Array) -> tuple[Derivatives, SmoothingSpline]:
    """Derivatives per row and row² of a run (N, k), by a smoothing spline through some rows, true at places in rows."""
    spline = SmoothingSpline.of(places, run[rows])
    derivatives = SplineTimes.of(spline, np.arange(len(run), dtype=np.float64)).derivatives(spline)
    return replace(derivatives, score=_bayesian_information_criterion(run - derivatives.value, spline.freedom)), spline


@dataclass(frozen=True, eq=False)
class SplineTimes:
    """Times at which a smoothing spline, and others drawn from it, are differentiated.

    rows    the B-splines there, or at the first or last sample where that is nearer
    beyond  (N, 1) s after the last sample, or before the first, < 0
    """

    rows: BasisRows
    beyond: Array

    @classmethod
    def of(cls, spline: SmoothingSpline, times: Array) -> SplineTimes:
        """Times (N,), s, for splines on these knots."""
        inside = np.clip(times, spline.start, spline.end)
        return cls(spline.rows(inside, 2), (times - inside)[:, None])

    def derivatives(self, spline: SmoothingSpline) -> Derivatives:
        """Of the spline at the times; with constant acceleration before its first and after its last sample."""
        value, first, second = spline.derivatives(self.rows)
        value, first = value + self.beyond * first + self.beyond**2 / 2 * second, first + self.beyond * second
        return Derivatives(value=value, first=first, second=second, score=np.zeros(value.shape[1]), spline=spline)


def fourier_or_spline_derivatives(mean: Array, dt: float, *, antiperiodic: bool = False) -> Derivatives:
    """Mean of separate runs (N, k): as a period where that has the lower score, else as a single run.

    A motion that ends where it began with the same velocity needs few lines; one that does not needs very many, and
    the spline has the lower score.
    """
    periodic, single = fourier_derivatives(mean, dt, antiperiodic=antiperiodic), spline_derivatives(mean, dt)
    return periodic if periodic.score.sum() <= single.score.sum() else single


def highest_excited_line(power: Array) -> int:
    """Index of the highest excited line of a power spectrum (lines 0, 1, 2, ..).

    Noise lines over their floor are exponential with mean one, so that the largest of M exceeds
    ln(M / LEVELS.excited_line) in one of a hundred spectra. The cut is where the sum of (power / floor - that bound)
    over the lines up to it is largest: a strong line outweighs empty ones below it, a chance one does not.
    """
    bound = np.log(max(len(power), 2) / LEVELS.excited_line)
    # Clipped at what outweighs all lines: larger terms would lose later lines in the rounding of the sum.
    excess = np.minimum(power[1:] / line_noise_floor(power)[1:], 2 * bound * len(power))
    gain = np.cumsum(excess - bound)
    return int(np.argmax(np.concatenate([[0.0], gain])))


def line_noise_floor(power: Array) -> Array:
    """Expected noise power of each line, (M,), from the lines without motion.

    A robust line through log power against log frequency over the upper three octaves, falling at most as
    f^-4 and never rising: measured noise is coloured, and linear interpolation of a slow log falls as f^-4.
    The median of exponential noise is ln 2 of its mean. Few lines: their upper half's median.
    """
    lines = np.arange(len(power), dtype=float)
    rounding = np.finfo(float).eps ** 2 * float(power.max()) + np.finfo(float).tiny
    if len(power) < FEWEST_LINES:
        flat = float(np.median(power[len(power) // 2 :])) / np.log(2)
        return np.full(len(power), max(flat, rounding))
    edges = np.unique(np.round(np.geomspace(len(power) / 8, len(power), 9)).astype(int))
    pieces = [slice(a, b) for a, b in pairwise(edges)]
    level = np.log([max(float(np.median(power[piece])) / np.log(2), rounding) for piece in pieces])
    middle = np.log([float(lines[piece].mean()) for piece in pieces])
    slope = float(np.clip(_robust_slope(level, middle), STEEPEST, 0.0))
    height = float(np.median(level - slope * middle))
    floor: Array = np.maximum(np.exp(height + slope * np.log(np.maximum(lines, 1.0))), rounding)
    return floor


def _robust_slope(values: Array, places: Array) -> float:
    """Median of the slopes between all pairs of points (Theil and Sen)."""
    first, second = np.triu_indices(len(values), 1)
    return float(np.median((values[second] - values[first]) / (places[second] - places[first])))


def _bayesian_information_criterion(residual: Array, parameters: NDArray[np.int64] | float) -> Array:
    samples = len(residual)
    squares = np.sum(residual**2, axis=0) + np.finfo(float).tiny
    score: Array = samples * np.log(squares) + parameters * np.log(samples)
    return score
