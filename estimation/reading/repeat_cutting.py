"""Repeats of a motion cut from a series: by a period found or stated, or by a column that counts them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal

import numpy as np

from estimation.reading.log_reader import Array
from estimation.reading.sample_mending import (
    STAMP,
    Index,
    band_limited,
    differ_slightly,
    interpolated_position,
    interpolated_quaternion,
    repeat_lengths,
    slight_difference,
)
from estimation.reading.step_log import StepLog
from estimation.recordings.motion import QUATERNION
from estimation.recordings.motion_period import FEWEST_SAMPLES, MotionPeriod, motion_period, whole_repeats
from estimation.recordings.reading_report import PeriodReading, Span, spans
from estimation.recordings.repeat_motion import largest_deviation
from estimation.recordings.weight_fit import SMALLEST_DIVISOR
from modeling.errors import InputError
from modeling.rig import SPATIAL_CHANNELS

SMALLEST_SHIFT = 0.05
"""Of a sample: repeats that drift less against the clock over the whole record are not interpolated."""
IDENTICAL = 1e-6
"""Difference of readings between repeats over their size, below which no sensor has measured them."""
PHASE_SLACK = 0.1
"""Of a sample: a period that much short of a whole number of samples is cut into that number of them."""
SURE_STD = 3
"""Standard deviations by which a stated period differs from the fitted one beyond doubt."""
LATENESS_STEPS = 4
"""Gauss-Newton steps to the lateness of runs, from a few samples to below a hundredth of one."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CutSeries:
    """Columns (n,), `time` from 0 on and `repeat` where there are any, at a step of `dt` s, and the period of them.

    Of columns cut by their period, `kept` are the rows first <= i < last of the repeats; None where all were kept.
    """

    columns: Mapping[str, Array]
    dt: float
    period: PeriodReading | None = None
    kept: tuple[int, int] | None = None


def cut_into_repeats(columns: dict[str, Array], dt: float, stated: float | None, where: str, log: StepLog) -> CutSeries:
    """The columns (n,) of one run as repeats: of the stated period (s), as `repeat` counts them, or as found.

    Raises InputError where a stated period does not fit twice.
    """
    if stated is not None:
        return _cut_as_stated(columns, dt, stated, where, log)
    if "repeat" in columns:
        return _counted(columns, dt, where, log)
    period = motion_period(columns, dt)
    if period is None or _needs_mending(period, dt, len(next(iter(columns.values()))), log, where):
        return one_run(columns, dt)
    cut = _cut(columns, dt, period, where, log)
    if _readings_are_identical(cut):
        log.taken("the motion repeats, and all readings with it: no noise can be estimated; one run", where)
        return one_run(columns, dt)
    return cut


def one_run(columns: Mapping[str, Array], dt: float) -> CutSeries:
    """The columns as they are, with their time."""
    return CutSeries(columns={"time": _ticks(len(next(iter(columns.values()))), dt), **columns}, dt=dt)


def separate_runs(columns: Mapping[str, Array], dt: float, runs: int) -> CutSeries:
    """Runs of equally many samples, in each of which time restarts."""
    samples = len(next(iter(columns.values()))) // runs
    head = {"time": np.tile(_ticks(samples, dt), runs), "repeat": _numbers(runs, samples)}
    return CutSeries(columns={**head, **_without_repeat(columns)}, dt=dt)


# ----------------------------------------------------------------------------------------- periods


def _needs_mending(period: MotionPeriod, dt: float, samples: int, log: StepLog, where: str) -> bool:
    """Whether a strict reading forbids to cut by a period that nobody stated."""
    per_repeat, step = _grid(period, dt)
    if not log.strict or (step == dt and per_repeat * period.repeats == samples):
        return False
    what = f"the motion repeats every {period.period:.7g} s: one run, as repeats would have to be interpolated or cut"
    log.taken(what, where)
    return True


def _cut_as_stated(columns: dict[str, Array], dt: float, period: float, where: str, log: StepLog) -> CutSeries:
    """Cut with the stated period, corrected by least squares within its last digit, else as it stands."""
    samples = len(next(iter(columns.values())))
    repeats = whole_repeats(samples, period / dt)
    if round(period / dt) < FEWEST_SAMPLES or repeats < 2:
        what = f"a period of {period:g} s fits {samples * dt / period:.3g} times into {samples * dt:.4g} s"
        raise InputError(
            what=what, where="--period", remedy="give the period of a motion that ran at least twice, or --no-period"
        )
    fitted = motion_period(columns, dt, near=period)
    if fitted is not None and abs(fitted.period - period) <= max(0.5 * _last_digit(period), SURE_STD * fitted.std):
        if abs(fitted.period - period) > SURE_STD * fitted.std:
            log.taken(
                f"the stated period of {period:g} s is {fitted.period:.7g} s by least squares, which is taken", where
            )
        return _cut(columns, dt, fitted, where, log)
    what = "its repeats differ" if fitted is None else f"by least squares it is {fitted.period:.7g} s"
    what = f"the motion does not repeat with a period of {period:g} s: {what}"
    as_stated = MotionPeriod(
        period=period, std=0.0, start=0.0, repeats=repeats, scatter=0.0, deviation=1.0, chance=0.0, correlation=0.0
    )
    trial = _cut(columns, dt, as_stated, where, StepLog())
    worst = largest_deviation(trial.columns, int(trial.columns["repeat"][-1]) + 1)
    if worst is not None and worst.gross:
        how = "give its period, or let it be found without --period"
        log.suspicious(f"{what}, repeat {worst.repeat} {worst.sentence(dt)}; taken as one run; {how}", where)
        return one_run(_without_repeat(columns), dt)
    log.suspicious(what, where)
    return replace(_cut(columns, dt, as_stated, where, log), period=None)


def _last_digit(stated: float) -> float:
    """Unit of the last decimal that a stated number has: it is believed to half of it."""
    return float(Decimal(1).scaleb(int(Decimal(repr(stated)).as_tuple().exponent)))


def _grid(period: MotionPeriod, dt: float) -> tuple[int, float]:
    """Samples of one repeat, and their step: that of the clock where the repeats drift little against it.

    Otherwise the step is longer than the clock's by less than a sample in a repeat, as a shorter one would leave the
    upper end of the noise's spectrum empty.
    """
    nearest = round(period.period / dt)
    if abs(period.period / dt - nearest) * period.repeats < max(SMALLEST_SHIFT, period.std / dt * period.repeats):
        return nearest, dt
    per_repeat = int(period.period / dt + PHASE_SLACK)
    return per_repeat, period.period / per_repeat


def _cut(columns: dict[str, Array], dt: float, period: MotionPeriod, where: str, log: StepLog) -> CutSeries:
    """Whole repeats of a period, equally many samples each."""
    samples = len(next(iter(columns.values())))
    per_repeat, step = _grid(period, dt)
    first = int(period.start / dt + 0.5)
    count = period.repeats * per_repeat
    if first + count > samples and step == dt:
        first = max(samples - count, 0)
    if first + count > samples and step == dt:  # the last repeat lacks a sample
        return _cut(columns, dt, replace(period, repeats=period.repeats - 1), where, log)
    if step == dt:
        kept = {name: column[first : first + count] for name, column in columns.items()}
    else:
        kept = _resampled(columns, first + _ticks(count, step / dt))
        log.mended(f"interpolated at {per_repeat} samples a period, {1 / step:.8g} Hz", where, count)
    before, after = first * dt, max(samples * dt - first * dt - count * step, 0.0)
    last = min(first + round(count * step / dt), samples)
    left = samples - (last - first)
    if left:
        what = f"samples outside the whole repeats left out: {before:.4g} s before, {after:.4g} s after them"
        log.mended(what, where, left, samples, _outside(columns, first, last))
    log.taken(f"cut into {period.repeats} repeats of {per_repeat} samples", where)
    reading = PeriodReading(
        period=period.period, std=period.std, repeats=period.repeats, samples=per_repeat, deviation=period.deviation,
        chance=period.chance, correlation=period.correlation, before=before, after=after,
    )  # fmt: skip
    head = {"time": _ticks(count, step), "repeat": _numbers(period.repeats, per_repeat)}
    rows = (first, last) if left else None
    return CutSeries(columns={**head, **_without_repeat(kept)}, dt=step, period=reading, kept=rows)


def _outside(columns: Mapping[str, Array], begin: int, end: int) -> tuple[Span, ...]:
    """Intervals of the stamps of rows that are none of begin .. end - 1; none where the stamps are not known."""
    if STAMP not in columns:
        return ()
    rows = np.arange(len(columns[STAMP]))
    return spans(columns[STAMP], (rows < begin) | (rows >= end))


def _readings_are_identical(cut: CutSeries) -> bool:
    """Whether a channel is the same in all repeats, as a simulated one without noise is."""
    repeats = int(cut.columns["repeat"][-1]) + 1
    for name in (*SPATIAL_CHANNELS, "tau"):
        if name in cut.columns:
            runs = cut.columns[name].reshape(repeats, -1)
            if np.abs(runs - runs.mean(axis=0)).max() <= IDENTICAL * max(np.ptp(runs), SMALLEST_DIVISOR):
                return True
    return False


def _resampled(columns: Mapping[str, Array], places: Array) -> dict[str, Array]:
    """Columns at places (m,), in samples: the motion by splines, all else band-limited."""
    stamps = np.arange(len(next(iter(columns.values()))), dtype=np.float64)
    resampled: dict[str, Array] = {}
    if set(QUATERNION) <= set(columns):
        quaternions = np.stack([columns[name] for name in QUATERNION], axis=1)
        resampled |= dict(zip(QUATERNION, interpolated_quaternion(stamps, quaternions, places).T, strict=True))
    motion = [name for name in columns if name[0] in "pq" and name not in resampled]
    others = [name for name in columns if name[0] not in "pq"]
    if motion:
        smooth = np.stack([np.unwrap(columns[n]) if n == "phi" else columns[n] for n in motion], axis=1)
        resampled |= dict(zip(motion, interpolated_position(stamps, smooth, places).T, strict=True))
    if others:
        series = np.stack([columns[name] for name in others], axis=1)
        resampled |= dict(zip(others, band_limited(series, places).T, strict=True))
    return {name: resampled[name] for name in columns}


# ----------------------------------------------------------------------------------- counted repeats


def _counted(columns: dict[str, Array], dt: float, where: str, log: StepLog) -> CutSeries:
    """Repeats as a column counts them; of slightly different length brought onto one clock."""
    lengths = repeat_lengths(columns["repeat"])
    if len(lengths) > 1 and not differ_slightly(lengths):
        columns = _whole_repeats(columns, lengths, where, log)
        lengths = repeat_lengths(columns["repeat"])
    if len(lengths) < 2 or not differ_slightly(lengths) or lengths.min() < FEWEST_SAMPLES:
        return one_run(columns, dt)
    period = motion_period(_without_repeat(columns), dt, near=float(lengths.mean()) * dt)
    what = f"repeats of {lengths.min()} to {lengths.max()} samples: "
    if period is not None and period.repeats >= len(lengths) - 1:
        log.mended(f"{what}cut anew by the period of the motion", where, len(columns["repeat"]))
        return _cut(columns, dt, period, where, log)
    return aligned_runs(columns, dt, lengths, where, log)


def _whole_repeats(columns: dict[str, Array], lengths: Index, where: str, log: StepLog) -> dict[str, Array]:
    """The columns without a first and a last repeat that are incomplete, as they are on two clocks or after a cut."""
    if len(lengths) < 3:
        return columns
    usual, total = int(np.median(lengths[1:-1])), int(lengths.sum())
    begin = int(lengths[0]) if lengths[0] < usual else 0
    end = total - (int(lengths[-1]) if lengths[-1] < usual else 0)
    if end - begin < total:
        at = _outside(columns, begin, end)
        log.mended("samples of incomplete repeats left out", where, total - (end - begin), total, at)
    return {name: column[begin:end] for name, column in columns.items()}


def aligned_runs(columns: Mapping[str, Array], dt: float, lengths: Index, where: str, log: StepLog) -> CutSeries:
    """Runs that began by a trigger, equally many samples of each: from where their motions agree, on one clock."""
    bounds = np.cumsum(lengths)[:-1]
    runs = [dict(zip(columns, parts, strict=True)) for parts in zip(*_split(columns, bounds), strict=True)]
    late = _lateness(runs)
    moved = bool(np.ptp(late) > SMALLEST_SHIFT)
    late = late - late.min() if moved else np.zeros(len(runs))
    count = min(int(length - 1 - shift) + 1 for length, shift in zip(lengths, late, strict=True))
    ticks = np.arange(count)
    kept = [
        _resampled(run, shift + ticks) if moved else _first(run, count) for run, shift in zip(runs, late, strict=True)
    ]
    what = f"repeats of {lengths.min()} to {lengths.max()} samples taken as separate runs of {count}"
    what += f", moved by up to {late.max():.2g} samples to where their motions agree" if moved else ""
    log.mended(what, where, int(lengths.sum()) - count * len(lengths), int(lengths.sum()))
    joined = {name: np.concatenate([run[name] for run in kept]) for name in columns}
    return separate_runs(joined, dt, len(lengths))


def _split(columns: Mapping[str, Array], bounds: Index) -> list[list[Array]]:
    return [np.split(column, bounds) for column in columns.values()]


def _first(columns: Mapping[str, Array], count: int) -> dict[str, Array]:
    return {name: column[:count] for name, column in columns.items()}


def _lateness(runs: Sequence[Mapping[str, Array]]) -> Array:
    """By how much each run's motion is late against the mean of all, in samples, within the slight differences."""
    names = [name for name in runs[0] if name[0] in "pq" and np.ptp(runs[0][name]) > 0]
    samples = min(len(next(iter(run.values()))) for run in runs)
    late, reach = np.zeros(len(runs)), slight_difference(samples)
    if not names:
        return late
    scale = np.array([np.std(runs[0][name]) for name in names])
    motions = [np.stack([run[name] for name in names], axis=1) / scale for run in runs]
    inner = np.arange(np.ceil(reach), samples - np.ceil(reach))
    for _ in range(LATENESS_STEPS):
        moved = [
            interpolated_position(np.arange(float(len(motion))), motion, inner + shift)
            for motion, shift in zip(motions, late, strict=True)
        ]
        mean = np.mean(moved, axis=0)
        slope = np.gradient(mean, axis=0)
        change = -np.einsum("rsk,sk->r", moved - mean, slope) / max(float((slope**2).sum()), SMALLEST_DIVISOR)
        late = np.clip(late + change - change.mean(), -reach, reach)
    return np.asarray(late)


def _without_repeat(columns: Mapping[str, Array]) -> dict[str, Array]:
    return {name: column for name, column in columns.items() if name != "repeat"}


def _numbers(repeats: int, samples: int) -> Array:
    return np.repeat(np.arange(repeats, dtype=np.float64), samples)


def _ticks(count: int, step: float) -> Array:
    """`count` instants from 0 on."""
    return np.asarray(step * np.arange(count), dtype=np.float64)
