"""Stretches of a run that are not as the others: a channel that is frozen, and readings that were re-zeroed in mid-log.

A frozen stretch is left out, and at a re-zero the run is cut: each piece is a recording with biases of its own.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from math import comb
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.reading.recording_check import stops
from estimation.readings.doubted_reading import DoubtedReading
from estimation.readings.rigid_tool import MEDIAN_SQUARE, THIRD
from estimation.readings.static_dwells import beyond_linear, linear_features, tool_load
from estimation.recordings.recording import Recording
from modeling.chain.model import ALIGNED_MOUNTING, WrenchModel
from modeling.rig import Convention
from modeling.space import Space

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MOVED = 3.0
"""Std of what a rigid tool lets expect of a channel while it keeps one value, over its residual elsewhere, from which
it is frozen: at rest, or where the tool hardly loads it, a channel of coarse steps keeps its value too."""
MOVED_SHARE = 0.1
"""Of the channel's own std elsewhere: a channel is no reading within a dead band, which is smaller."""
BESIDE = 5
"""Rows on either side that a step is judged by: enough for a mean and a slope."""
SMEARED = (1, 4)
"""Rows on either side that a step may be smeared over, by a resampling and by a sensor's filter."""
COINCIDENCE = 1e-3
"""Probability that a step which is no re-zero ends as near to zero in all channels as it does, if it might as well have
ended anywhere up to where it began: a push or a payload is free to, a re-zero is not."""
AS_STEP = 0.3
"""Of a step, the most by which the change of the biases that the rest of the run shows may differ from it: a push that
ends changes them by its share of the run, another pose not at all."""
RIVAL = 2.0
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
        for begin, end in zip(ends, ends[1:], strict=False):
            inside = np.arange(recording.repeats) * once
            good = [begin <= i and i + once <= end and usable[i : i + once].all() for i in inside]
            whole += [(a * once, b * once) for a, b in _runs(np.array(good)) if b - a > 1]
        if recording.repeats > 1 and whole:
            return self._named([_piece(recording, a, b, (b - a) // once) for a, b in whole])
        cuts = np.zeros(recording.samples, dtype=bool)
        cuts[list(self.zeroed)] = True
        if not recording.continuous:
            cuts[once::once] = True
        least = max(LEAST_ROWS, LEAST_SHARE * recording.samples)
        pieces = []
        for a, b in _runs(usable):
            parts = [a, *(int(a + 1 + i) for i in np.flatnonzero(cuts[a + 1 : b])), b]
            pieces += [(c, d) for c, d in zip(parts, parts[1:], strict=False) if d - c >= least]
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
        """The pieces, each with its times in its name where there are several; the recording if there is none."""
        if len(pieces) < 2:
            return tuple(piece for piece, _, _ in pieces) or (self.recording,)
        name = self.recording.name
        return tuple(replace(r, name=f"{name} {begin:.5g} to {end:.5g} s") for r, begin, end in pieces)


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
    return pieces, (*_frozen_reading(doubted), *_zeroed_reading(doubted))


def _stretches_of(recording: Recording, base: WrenchModel) -> _Stretches | None:
    if recording.at_rest or recording.samples < 2 * LEAST_ROWS:
        return None
    kept = [[(a, b) for a, b in stops(column) if np.ptp(column) > 0] for column in recording.wrench.T]
    steps = list(_steps_to_zero(recording.wrench))
    if not any(kept) and not steps:
        return None
    rows = np.arange(0, recording.samples, -(-recording.samples // MOST_ROWS))
    features = np.column_stack([linear_features(tool_load(recording, base, rows)), np.ones(len(rows))])
    stopped = dict(_frozen(recording, kept, rows, features))
    found = _Stretches(recording, stopped)
    usable = found._usable[rows]
    found = replace(found, zeroed=_zeroed(recording, steps, rows[usable], features[usable]))
    whole = found.stopped or found.zeroed
    return found if whole and found.pieces != (recording,) else None


def _runs(mask: Mask) -> list[tuple[int, int]]:
    """First and last + 1 of the stretches in which a mask (n,) is true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _piece(recording: Recording, first: int, last: int, repeats: int) -> tuple[Recording, float, float]:
    """Rows first <= i < last of a run as a recording, and the times, s, at which they begin and end."""
    assert recording.time is not None and recording.dt is not None
    columns = {name: column[first:last] for name, column in recording.columns.items()}
    continuous = repeats == 1 or recording.continuous
    moved = recording.moved(
        columns=columns, time=recording.dt * np.arange(last - first) if continuous else recording.time[: last - first],
        repeats=repeats, continuous=continuous,
    )  # fmt: skip
    return replace(moved, wrench=recording.wrench[first:last], whole=None), first * recording.dt, last * recording.dt


# A channel that is frozen: it keeps exactly one value while the motion, and what the other rows show, would move it.


def _frozen(
    recording: Recording, kept: Sequence[Sequence[tuple[int, int]]], rows: NDArray[np.int64], features: Array
) -> Iterator[tuple[str, list[tuple[int, int, float]]]]:
    """Channels with the rows (first, last) among those `kept` in which they are frozen, and their expected std."""
    for channel, column, stretches in zip(recording.channels, recording.wrench.T, kept, strict=True):
        inside = [(rows >= first) & (rows < last) for first, last in stretches]
        outside = ~np.any([*inside, rows < 0], axis=0)
        if outside.sum() < 2 * features.shape[1] or not stretches:
            continue
        coefficients = np.linalg.lstsq(features[outside], column[rows[outside]], rcond=None)[0]
        expected = features @ coefficients
        std = float(np.std((column[rows] - expected)[outside]))
        least = max(MOVED * std, MOVED_SHARE * float(np.std(column[rows[outside]])))
        frozen = []
        for (first, last), within in zip(stretches, inside, strict=True):
            value, moved = column[first], float(np.std(expected[within])) if within.any() else 0.0
            beyond = float(np.median(expected[within])) if within.any() else value
            saturated = (value == column.max() and beyond > value) or (value == column.min() and beyond < value)
            if moved > least and not saturated:
                frozen.append((first, last, moved))
        if frozen:
            yield channel, frozen


def _frozen_reading(every: Sequence[_Stretches]) -> Iterator[DoubtedReading]:
    """What is said of channels that are frozen."""
    value: dict[str, Any] = {}
    meanings, shown = [], []
    for each in every:
        recording, dt = each.recording, each.recording.dt or 1.0
        for channel, stretches in each.stopped.items():
            column, unit = recording.wrench[:, recording.channels.index(channel)], _unit(recording, channel)
            times = [[first * dt, last * dt] for first, last, _ in stretches]
            value.setdefault(recording.name, {})[channel] = times
            spans = " and ".join(f"{begin:.5g} to {end:.5g} s" for begin, end in times)
            meanings.append(f"{channel} of {recording.name} is frozen from {spans}")
            shown += [
                f"{last - first} rows in turn are exactly {column[first]:.6g} {unit}, while the motion moves"
                f" {channel} by {moved:.2g} {unit} rms"
                for first, last, moved in stretches
            ]
    if value:
        yield DoubtedReading(
            id="channel_frozen", value=value, meaning=f"{'; '.join(meanings)}, and these rows are left out",
            shown_by="; ".join(shown), statement="leave these rows out of the log", adopted=True, mends=False,
            applies_to="map",
        )  # fmt: skip


# A re-zero: a step of all channels at once, to zero, that another bias from then on explains and nothing else does.


def _steps_to_zero(wrench: Array) -> Iterator[tuple[int, int, Array]]:
    """Rows of readings (n, p) at which all channels step to zero, the rows beside that are smeared, and the step (p,).

    The least likely `MOST_STEPS`. Of a step between two rows they tell; of one that is smeared, means on either side,
    extrapolated by their slopes, as a robot may be moving.
    """
    noise = np.median(np.abs(np.diff(wrench, n=THIRD, axis=0)), axis=0) / (MEDIAN_SQUARE * comb(2 * THIRD, THIRD)) ** 0.5
    std = np.maximum(noise, ROUNDING * np.abs(wrench).max(axis=0))
    sums = np.concatenate([np.zeros((1, wrench.shape[1])), np.cumsum(wrench, axis=0)])
    means = (sums[BESIDE:] - sums[:-BESIDE]) / BESIDE
    levels = [(0, np.arange(1, len(wrench)), wrench[:-1], wrench[1:])]
    for gap in SMEARED:
        row = np.arange(2 * BESIDE + gap, len(wrench) - 2 * BESIDE - gap)
        after, later = means[row + gap], means[row + gap + BESIDE]
        before, earlier = means[row - gap - BESIDE], means[row - gap - 2 * BESIDE]
        middle = gap + (BESIDE - 1) / 2
        ends = before + (before - earlier) * (middle + 1) / BESIDE
        levels.append((gap, row, ends, after - (later - after) * middle / BESIDE))
    candidates = []
    for gap, row, ends, begins in levels:
        chance = np.minimum(1.0, (np.abs(begins) + std) / np.maximum(np.abs(ends), std)).prod(axis=1)
        candidates += [
            (gap, float(chance[i]), int(row[i]), begins[i] - ends[i]) for i in np.flatnonzero(chance < COINCIDENCE)
        ]
    taken: list[int] = []
    for gap, _, row, step in sorted(candidates, key=lambda candidate: candidate[:2]):
        if len(taken) == MOST_STEPS or any(abs(row - other) < 4 * BESIDE for other in taken):
            continue
        taken.append(row)
        yield row, gap, step


def _zeroed(
    recording: Recording, steps: Sequence[tuple[int, int, Array]], rows: NDArray[np.int64], features: Array
) -> dict[int, int]:
    """Those steps that another bias from then on explains, with the rows beside them that are smeared.

    The last of the features (r, k) at some rows (r,) is the bias.
    """
    steps = sorted(steps, key=lambda step: step[0])
    wrench = recording.wrench[rows]
    while steps:
        biases = np.column_stack([rows >= row for row, _, _ in steps]).astype(float)
        columns = np.column_stack([features, biases])
        solution = np.linalg.lstsq(columns, wrench, rcond=None)[0]
        left = wrench - columns @ solution
        std = np.maximum(left.std(axis=0), ROUNDING * np.abs(wrench).max(axis=0))
        off = [
            np.linalg.norm((change - step) / std) / np.linalg.norm(step / std)
            for change, (_, _, step) in zip(solution[features.shape[1] :], steps, strict=True)
        ]
        worst = int(np.argmax(off))
        if off[worst] > AS_STEP:
            steps.pop(worst)
            continue
        rivalled = [n for n in range(len(steps)) if _is_rivalled(wrench / std, features, biases, n)]
        if not rivalled:
            break
        steps.pop(rivalled[0])
    return {row: beside for row, beside, _ in steps}


def _is_rivalled(wrench: Array, features: Array, biases: Array, number: int) -> bool:
    """Whether another tool, or a push with an end there, explains about as much of readings (r, p) as a bias does."""
    others, after = np.delete(biases, number, axis=1), biases[:, number]
    shared = np.column_stack([features, others])

    def left(columns: Array) -> float:
        return float((beyond_linear(wrench, np.column_stack([shared, columns])) ** 2).mean())

    limit = RIVAL * left(after)
    if left(features[:, :-1] * after[:, None]) < limit:
        return True
    row, edge = np.arange(len(after)), int(np.argmax(after))
    ends = np.linspace(0, len(after), RIVAL_ENDS + 2)[1:-1].astype(int)
    pushes = [(row >= min(edge, end)) & (row < max(edge, end)) for end in ends if end != edge]
    return any(left(push.astype(float)) < limit / RIVAL for push in pushes)


def _zeroed_reading(every: Sequence[_Stretches]) -> Iterator[DoubtedReading]:
    """What is said of recordings that were re-zeroed."""
    doubted = [each for each in every if each.zeroed]
    if not doubted:
        return
    value = {each.recording.name: [row * (each.recording.dt or 1.0) for row in each.zeroed] for each in doubted}
    at = "; ".join(
        f"{name} at " + " and ".join(f"{time:.5g} s" for time in times) for name, times in value.items()
    )
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
