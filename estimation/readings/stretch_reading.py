"""Stretches of a run that are not as the others: a channel that is frozen, and readings that were re-zeroed in mid-log.

A frozen stretch is left out, and at a re-zero the run is cut: each piece is a recording with biases of its own.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from math import comb

import numpy as np
from numpy.typing import NDArray

from estimation.multiplicity import chi2_sf
from estimation.noise.events_in_repeats import runs_of
from estimation.reading.recording_check import stops
from estimation.readings.doubted_reading import DoubtedReading
from estimation.readings.noisy_stretch import SteadiedRecording, noisy_reading, resolution
from estimation.readings.rigid_tool import MEDIAN_SQUARE, SMALLEST_STD, THIRD
from estimation.readings.static_dwells import RANK_TOLERANCE, beyond_linear, tool_load
from estimation.recordings.recording import Recording
from modeling.chain.model import ALIGNED_MOUNTING, WrenchModel
from modeling.rig import Convention
from modeling.space import Space

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MOVED = 3.0
"""Std of what a rigid tool lets expect of a channel while it keeps one value, over its residual elsewhere, from which
it is frozen: at rest, or where the tool hardly loads it, a channel of coarse steps keeps its value too."""
COARSE = 10.0
"""Steps of a channel, instead of `MOVED`, where it changes in less than half of the rows: at rest it stays."""
MOVED_SHARE = 0.1
"""Of the channel's own std elsewhere: a channel is no reading within a dead band, which is smaller."""
BESIDE = 5
"""Rows on either side that a step is judged by: enough for a mean and a slope."""
SMEARED = (0, 1, 4, 16)
"""Rows on either side that a step may be smeared over, by a resampling or by a sensor's filter."""
SMEAR = 0.2
"""Of a step, what is left of it beside the rows that it is smeared over."""
SMEAR_STD = 3.0
"""Std of a sample that is none of that."""
RETURNS = 0.1
"""Of a step, what is left of it where the next one takes it back, as the end of a push does."""
AVERAGED = 10
"""Rows on either side of a re-zero of which one was taken for zero: a mean of those before it, while a robot moves."""
REACH = 40
"""Rows on either side of where the whole run shows a step, among which it is."""
STEP_SHARE = 0.05
"""Of the mean square that a rigid tool leaves, the least that a step of the biases explains: the first of two as large
explains more."""
LEAST_OWN = 1.0
"""Rows by which a step differs from what the tool reads, below which it is none."""
COINCIDENCE = 0.03
"""Probability that a step which is no re-zero ends as near to zero in all channels as it does, if it might as well have
ended anywhere up to where it began, or up to its size in the mean of forces, or of torques (Fisher's method): a push or
a payload is free to, a re-zero is not. A push that lasts to the end of a log has the same biases by another name."""
AS_STEP = 0.3
"""Of a step, the most by which the change of the biases that the rest of the run shows may differ from it: a push that
ends changes them by its share of the run, another pose not at all."""
RIVAL = 1.5
"""Mean square that another tool, or a push that begins or ends there, leaves over what another bias does, at least: a
load that is picked up turns with the tool."""
RIVAL_ENDS = 40
"""Other ends of a push that are tried."""
MOST_STEPS = 5
"""Re-zeros of a recording that are looked for."""
MOST_ROWS = 5000
"""Rows that are compared."""
LEAST_ROWS, LEAST_SHARE = 100, 0.05
"""Rows, and share of a recording, below which a piece of it tells nothing that is worth biases of its own."""
ROUNDING = 1e-9
"""Of a channel's largest reading: noise that is smaller is none."""


@dataclass(frozen=True, eq=False)
class _Stretches:
    """What is doubted of a run (n rows), and the pieces that it is read as.

    stopped  by channel the rows first <= i < last in which it keeps one value, with how much it should have moved
    zeroed   rows from which the biases are others, with the rows on either side that are left out
    """

    recording: Recording
    stopped: dict[str, list[tuple[int, int, float]]] = field(default_factory=dict)
    zeroed: dict[int, int] = field(default_factory=dict)

    @property
    def pieces(self) -> tuple[Recording, ...]:
        """Whole repeats that follow each other, two of them at least; else single runs."""
        recording, usable = self.recording, self._usable
        once, ends = recording.samples_per_repeat, [0, *self.zeroed, recording.samples]
        whole = []
        for begin, end in pairwise(ends):
            inside = np.arange(recording.repeats) * once
            good = [begin <= i and i + once <= end and usable[i : i + once].all() for i in inside]
            whole += [(a * once, b * once) for a, b in runs_of(np.array(good)) if b - a > 1]
        if recording.repeats > 1 and whole:
            return self._named([_piece(recording, a, b, (b - a) // once) for a, b in whole])
        cuts = np.zeros(recording.samples, dtype=bool)
        cuts[list(self.zeroed)] = True
        if not recording.continuous:
            cuts[once::once] = True
        least = max(LEAST_ROWS, LEAST_SHARE * recording.samples)
        pieces = []
        for a, b in runs_of(usable):
            parts = [a, *(int(a + 1 + i) for i in np.flatnonzero(cuts[a + 1 : b])), b]
            pieces += [(c, d) for c, d in pairwise(parts) if d - c >= least]
        return self._named([_piece(recording, a, b, 1) for a, b in pieces])

    @property
    def _usable(self) -> Mask:
        usable = np.ones(self.recording.samples, dtype=bool)
        for stretches in self.stopped.values():
            for first, last, _ in stretches:
                usable[first:last] = False
        for row, beside in self.zeroed.items():
            usable[row - beside : row + beside] = False
        return usable

    def _named(self, pieces: Sequence[tuple[Recording, float, float]]) -> tuple[Recording, ...]:
        """The pieces, each with its times in its name where there are several; the recording if there is none.

        What was noticed when the log was read is said of the first.
        """
        if len(pieces) < 2:
            return tuple(piece for piece, _, _ in pieces) or (self.recording,)
        name, report = self.recording.name, self.recording.reading
        said = None if report is None else replace(report, steps=())
        return tuple(
            replace(r, name=f"{name} {begin:.5g} to {end:.5g} s", reading=said if number else report)
            for number, (r, begin, end) in enumerate(pieces)
        )


def without_bad_stretches(
    recordings: Sequence[Recording], model: WrenchModel
) -> tuple[tuple[tuple[Recording, ...], ...], tuple[DoubtedReading, ...]]:
    """Of each recording the pieces that it is read as, itself if nothing is doubted of it, and what is said of them."""
    base = replace(model.base, convention=Convention.ON_TOOL, mounting=ALIGNED_MOUNTING)
    every = [_stretches_of(recording, base) for recording in recordings]
    pieces = tuple(
        (recording,) if each is None else each.pieces for recording, each in zip(recordings, every, strict=True)
    )
    doubted = [each for each in every if each is not None]
    noisy = [[SteadiedRecording.of(piece) for piece in each] for each in pieces]
    readings = (
        *_frozen_reading(doubted),
        *_zeroed_reading(doubted),
        *noisy_reading([n for each in noisy for n in each]),
    )
    return tuple(tuple(piece.steadied for piece in each) for each in noisy), readings


def _stretches_of(recording: Recording, base: WrenchModel) -> _Stretches | None:
    if recording.at_rest or recording.samples < 2 * LEAST_ROWS:
        return None
    kept = [[] if np.ptp(column) == 0 else stops(column) for column in recording.wrench.T]
    run = _Run.of(recording, base, kept)
    steps = run.steps() if run is not None else []
    if run is None or not (any(kept) or steps):
        return None
    doubted = _Stretches(recording, dict(run.frozen(kept, steps)))
    usable = doubted._usable[run.rows]
    doubted = replace(doubted, zeroed=replace(run, kept=run.kept & usable).zeroed(steps))
    return doubted if (doubted.stopped or doubted.zeroed) and doubted.pieces != (recording,) else None


def _piece(recording: Recording, first: int, last: int, repeats: int) -> tuple[Recording, float, float]:
    """Rows first <= i < last of a run as a recording, and the times, s, at which they begin and end."""
    assert recording.time is not None
    assert recording.dt is not None
    columns = {name: column[first:last] for name, column in recording.columns.items()}
    continuous = repeats == 1 or recording.continuous
    moved = recording.moved(
        columns=columns, time=recording.dt * np.arange(last - first) if continuous else recording.time[: last - first],
        repeats=repeats, continuous=continuous,
    )  # fmt: skip
    return replace(moved, wrench=recording.wrench[first:last], whole=None), first * recording.dt, last * recording.dt


@dataclass(frozen=True, eq=False)
class _Step:
    """A step of the biases of a run.

    row, beside  the first row after it, and the rows on either side that it is smeared over
    size         (p,), by the readings beside it
    chance       that it ends as near to zero as it does
    """

    row: int
    beside: int
    size: Array
    chance: float


@dataclass(frozen=True, eq=False)
class _Run:
    """What a run is compared by, whatever the axes and signs of its sensor.

    rows (r,), features (r, k) that a rigid tool's wrench is linear in, the last of them the bias; kept (r,) those that
    are compared; noise (p,), std of a sample
    """

    recording: Recording
    base: WrenchModel
    rows: NDArray[np.int64]
    features: Array
    kept: Mask
    noise: Array

    @classmethod
    def of(cls, recording: Recording, base: WrenchModel, kept: Sequence[Sequence[tuple[int, int]]]) -> _Run | None:
        """Of a recording without the stretches in which a channel keeps its value; None of too few rows."""
        rows = np.arange(0, recording.samples, -(-recording.samples // MOST_ROWS))
        features = _features(recording, base, rows)
        stopped = [(rows >= a) & (rows < b) for each in kept for a, b in each]
        usable = ~np.any([*stopped, rows < 0], axis=0)
        if usable.sum() < 2 * features.shape[1]:
            return None
        third = np.median(np.abs(np.diff(recording.wrench, n=THIRD, axis=0)), axis=0)
        noise = third / (MEDIAN_SQUARE * comb(2 * THIRD, THIRD)) ** 0.5
        noise = np.maximum(noise, ROUNDING * np.abs(recording.wrench).max(axis=0) + SMALLEST_STD)
        return cls(recording, base, rows, features, usable, noise)

    @property
    def wrench(self) -> Array:
        """Readings (r, p)."""
        return self.recording.wrench[self.rows]

    def with_biases(self, steps: Sequence[_Step]) -> Array:
        """The features with the biases that begin at steps, (r, k + s)."""
        return np.column_stack([self.features, *((self.rows >= step.row).astype(float) for step in steps)])

    # A channel that is frozen: it keeps exactly one value while the motion would move it, by what other rows show.

    def frozen(
        self, stretches_of: Sequence[Sequence[tuple[int, int]]], steps: Sequence[_Step]
    ) -> Iterator[tuple[str, list[tuple[int, int, float]]]]:
        """Channels with the stretches in which they are frozen, and the std that is expected of them there."""
        features = self.with_biases(steps)
        parts = zip(self.recording.channels, self.recording.wrench.T, stretches_of, strict=True)
        for channel, column, stretches in parts:
            read, changes = column[self.rows], np.abs(np.diff(column))
            inside = [(self.rows >= first) & (self.rows < last) for first, last in stretches]
            elsewhere = ~np.any([*inside, self.rows < 0], axis=0)
            if elsewhere.sum() < 2 * features.shape[1] or not stretches:
                continue
            levels = MOVED if np.median(changes) > 0 else COARSE
            least = max(MOVED_SHARE * float(np.std(read[elsewhere])), levels * resolution(column))
            frozen = []
            for (first, last), within in zip(stretches, inside, strict=True):
                expected = [_expected(read, features, used, within) for used in (elsewhere, ~within)]
                moved = min(float(np.std(there)) if len(there) else 0.0 for there, _ in expected)
                limit = max(MOVED * std for _, std in expected)
                if moved > max(least, limit) and not _is_limit(column, float(column[first]), expected[0][0]):
                    frozen.append((first, last, moved))
            if frozen:
                yield channel, frozen

    # A re-zero: a step of all channels at once, to zero, that another bias from then on explains and nothing else does.

    def steps(self) -> list[_Step]:
        """Steps of the biases, by what the whole run shows and by the readings beside each."""
        at: list[int] = []
        features, wrench, rows = self.features[self.kept], self.wrench[self.kept], self.rows[self.kept]
        for _ in range(MOST_STEPS):
            basis = _orthonormal(features)
            left = wrench - basis @ (basis.T @ wrench)
            std = np.maximum(left.std(axis=0), self.noise)
            of_basis, of_left = (np.cumsum(each[::-1], axis=0)[::-1] for each in (basis, left / std))
            own = np.arange(len(rows), 0, -1) - (of_basis**2).sum(axis=1)
            gain = np.where(own > LEAST_OWN, (of_left**2).sum(axis=1) / np.maximum(own, LEAST_OWN), 0.0)
            best = int(np.argmax(gain))
            if gain[best] < STEP_SHARE * left.size:
                break
            features = np.column_stack([features, rows >= rows[best]])
            at += [] if any(abs(int(rows[best]) - other) < REACH for other in at) else [int(rows[best])]
        steps = [self._beside(row, [other for other in at if other != row]) for row in at]
        return [step for step in steps if step is not None]

    def _beside(self, row: int, others: Sequence[int]) -> _Step | None:
        """The step near a row, by the readings beside it; None where there is none that is sharp enough."""
        rows = np.arange(max(row - REACH, 0), min(row + REACH, self.recording.samples))
        biases = np.array([*others, row])
        biased = np.column_stack([self.features, self.rows[:, None] >= biases])[self.kept]
        solution = np.linalg.lstsq(biased, self.wrench[self.kept], rcond=None)[0][:-1]
        near = np.column_stack([_features(self.recording, self.base, rows), rows[:, None] >= biases[:-1]])
        expected = near @ solution
        beyond = self.recording.wrench[rows] - expected
        far = SMEARED[-1] + BESIDE
        edges = np.arange(far, len(rows) - far)
        if not len(edges):
            return None
        parts = [(beyond[:edge] / self.noise, beyond[edge:] / self.noise) for edge in edges]
        spread = [sum(((each - np.median(each, axis=0)) ** 2).sum() for each in part) for part in parts]
        edge = int(edges[int(np.argmin(spread))])
        low, high = (beyond[i : i + BESIDE].mean(axis=0) for i in (edge - far, edge + far - BESIDE))
        least = max(SMEAR * float(np.linalg.norm((high - low) / self.noise)), SMEAR_STD * len(low) ** 0.5)
        for beside in SMEARED:
            rest = (beyond[edge - beside - 1] - low) / self.noise, (beyond[edge + beside] - high) / self.noise
            if max(map(np.linalg.norm, rest)) < least:
                begins, ends = expected[edge - AVERAGED : edge + AVERAGED] + high, expected[edge] + low
                chance = _coincidence(begins, ends, high - low, self.noise)
                return _Step(int(rows[edge]), beside, high - low, chance)
        return None

    def zeroed(self, steps: Sequence[_Step]) -> dict[int, int]:
        """Rows of the steps that another bias explains, and no rival, with the rows beside that they smear."""
        steps = sorted((s for s in steps if s.chance < COINCIDENCE), key=lambda step: step.row)
        kept, count = self.kept, self.features.shape[1]
        while steps:
            columns = self.with_biases(steps)[kept]
            solution = np.linalg.lstsq(columns, self.wrench[kept], rcond=None)[0]
            std = np.maximum((self.wrench[kept] - columns @ solution).std(axis=0), self.noise)
            off = [
                np.linalg.norm((change - step.size) / std) / np.linalg.norm(step.size / std)
                for change, step in zip(solution[count:], steps, strict=True)
            ]
            worst = int(np.argmax(off))
            between = [n for n, pair in enumerate(pairwise(steps)) if _is_push(*pair)]
            if between:
                del steps[between[0] : between[0] + 2]
                continue
            if off[worst] <= AS_STEP:
                rivalled = [n for n in range(len(steps)) if self._is_rivalled(std, columns, count + n)]
                if not rivalled:
                    break
                worst = rivalled[0]
            steps.pop(worst)
        return {step.row: step.beside for step in steps}

    def _is_rivalled(self, std: Array, columns: Array, number: int) -> bool:
        """Whether another tool, or a push with an end there, explains about as much as the bias of that column does."""
        shared, after, wrench = np.delete(columns, number, axis=1), columns[:, number], self.wrench[self.kept] / std
        load = self.features[self.kept, :-1] * after[:, None]

        def left(*others: Array) -> float:
            return float((beyond_linear(wrench, np.column_stack([shared, *others])) ** 2).mean())

        by_bias = left(after)
        if left(load) < RIVAL * by_bias:
            return True
        row, edge = np.arange(len(after)), int(np.argmax(after))
        ends = np.linspace(0, len(after), RIVAL_ENDS + 2)[1:-1].astype(int)
        pushes = ((row >= min(edge, end)) & (row < max(edge, end)) for end in ends if end != edge)
        return any(left(push.astype(float)) < by_bias for push in pushes)


def _features(recording: Recording, base: WrenchModel, rows: NDArray[np.int64]) -> Array:
    """What a rigid tool's wrench is linear in at some rows (r,), and a bias, (r, k)."""
    return np.column_stack([tool_load(recording, base, rows).reshape(len(rows), -1), np.ones(len(rows))])


def _orthonormal(columns: Array) -> Array:
    """Basis (r, rank) of columns (r, k), some of which may be collinear or zero."""
    size = np.linalg.norm(columns, axis=0)
    left, values, _ = np.linalg.svd(columns / np.where(size > 0, size, 1.0), full_matrices=False)
    return np.asarray(left[:, values > RANK_TOLERANCE * values[0]])


def _expected(read: Array, features: Array, used: Mask, within: Mask) -> tuple[Array, float]:
    """What rows that are used let expect of a channel (r,) within others, and the std of what they leave.

    That is robust, as a stretch among them may be frozen, too.
    """
    solution = np.linalg.lstsq(features[used], read[used], rcond=RANK_TOLERANCE)[0]
    left = np.abs(read[used] - features[used] @ solution)
    return np.asarray(features[within] @ solution), float(np.median(left)) / MEDIAN_SQUARE**0.5


def _coincidence(begins: Array, ends: Array, step: Array, noise: Array) -> float:
    """P-value that one of the levels (e, p) at which readings may go on after a step is as near to zero by chance.

    `ends` (p,) is the level before it, `noise` (p,) the std of a sample.
    """
    forces = 2 if len(step) == 3 else 3
    mean = [np.full(len(group), np.sqrt(np.mean(group**2))) for group in (step[:forces], step[forces:])]
    ratio = (np.abs(begins) + noise) / np.maximum(np.maximum(np.abs(ends), np.concatenate(mean)), noise)
    return float(np.min(chi2_sf(-2 * np.log(np.minimum(1.0, ratio)).sum(axis=1), 2 * len(step))))


def _is_push(begin: _Step, end: _Step) -> bool:
    """Whether the second of two steps takes the first back."""
    return bool(np.linalg.norm(begin.size + end.size) < RETURNS * np.linalg.norm(begin.size))


def _is_limit(column: Array, value: float, expected: Array) -> bool:
    """Whether a channel (n,) that keeps a value while others are expected (r,) is at its limit, or in a dead band."""
    middle = float(np.median(expected))
    if value == 0.0 and np.median(np.abs(expected)) < np.abs(column[column != 0.0]).min():
        return True
    return (value == column.max() and middle > value) or (value == column.min() and middle < value)


# What is said of them.


def _frozen_reading(every: Sequence[_Stretches]) -> Iterator[DoubtedReading]:
    """What is said of channels that are frozen."""
    value: dict[str, dict[str, list[list[float]]]] = {}
    meanings, shown = [], []
    for each in every:
        recording, dt = each.recording, each.recording.dt or 1.0
        frozen: dict[str, list[str]] = {}
        for channel, stretches in each.stopped.items():
            column, unit = recording.wrench[:, recording.channels.index(channel)], _unit(recording, channel)
            times = [[first * dt, last * dt] for first, last, _ in stretches]
            value.setdefault(recording.name, {})[channel] = times
            spans = " and ".join(f"{begin:.5g} to {end:.5g} s" for begin, end in times)
            frozen.setdefault(spans, []).append(channel)
            shown += [
                f"{last - first} rows of {channel} in turn are exactly {column[first]:.6g} {unit}, while the motion"
                f" moves it by {moved:.2g} {unit} rms"
                for first, last, moved in stretches
            ]
        meanings += [
            f"{', '.join(channels)} of {recording.name} {'is' if len(channels) == 1 else 'are'} frozen from {spans}"
            for spans, channels in frozen.items()
        ]
    if value:
        yield DoubtedReading(
            id="channel_frozen", value=value, meaning=f"{'; '.join(meanings)}, and these rows are left out",
            shown_by="; ".join(shown), statement="leave these rows out of the log", adopted=True, mends=False,
            applies_to="map",
        )  # fmt: skip


def _zeroed_reading(every: Sequence[_Stretches]) -> Iterator[DoubtedReading]:
    """What is said of recordings that were re-zeroed."""
    doubted = [each for each in every if each.zeroed]
    if not doubted:
        return
    value = {each.recording.name: [row * (each.recording.dt or 1.0) for row in each.zeroed] for each in doubted}
    at = "; ".join(f"{name} at " + " and ".join(f"{time:.5g} s" for time in times) for name, times in value.items())
    first = doubted[0].recording
    row, beside = next(iter(doubted[0].zeroed.items()))
    before, after = first.wrench[row - beside - 1], first.wrench[row + beside]
    levels = ", ".join(
        f"{c} {b:.3g} to {a:.2g} {_unit(first, c)}" for c, b, a in zip(first.channels, before, after, strict=True)
    )
    yield DoubtedReading(
        id="rezeroed", value=value,
        meaning=f"the readings were re-zeroed in mid-log ({at}), and have biases of their own from then on",
        shown_by=f"all channels step there at once, and to zero: {levels}",
        statement="cut the log there into a recording before and one after", adopted=True, mends=False,
        applies_to="map",
    )  # fmt: skip


def _unit(recording: Recording, channel: str) -> str:
    return Space(recording.dimension).channel_units[channel]
