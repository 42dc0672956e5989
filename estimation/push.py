"""Pushes: intervals of a single run in which something other than the tool's own physics acts on the sensor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from estimation.distributions import student_isf
from estimation.layout import Layout, layout
from estimation.recording import Recording
from estimation.response import respond
from modeling.model import WrenchModel

Array = NDArray[np.float64]

BLOCKS = 120
"""Stretches that a run is averaged over; a push lasts at least two of them."""
CHANCE = 0.01
"""Chance of taking a run without a push for one with a push."""


@dataclass(frozen=True, eq=False)
class Averages:
    """Readings and regressor of recordings averaged over blocks: what is slow enough to be a tool or a push.

    reading (b, p), regressor (b, p, k) in the unknowns of the layout, owner (b,) the recording of each block
    raw_spread (recordings, p): median over blocks of the raw samples' std about their block
    """

    unknowns: Layout
    reading: Array
    regressor: Array
    owner: NDArray[np.intp]
    raw_spread: Array

    @cached_property
    def scale(self) -> Array:
        """Weight of each block and channel (b, p): the spread of a recording's successive differences."""
        scale = np.ones_like(self.reading)
        for number in np.unique(self.owner):
            own = self.owner == number
            steps = np.abs(np.diff(self.reading[own], axis=0))
            scale[own] = np.maximum(np.median(steps, axis=0), 1e-9 + 1e-6 * np.abs(self.reading[own]).max(axis=0))
        return scale

    def residual_without(self, left_out: NDArray[np.bool_]) -> Array:
        """Residual (b, p) of all blocks after a weighted fit to those not left out."""
        kept = ~left_out
        rows = (self.regressor / self.scale[:, :, None])[kept].reshape(-1, self.unknowns.size)
        target = (self.reading / self.scale)[kept].ravel()
        length = np.linalg.norm(rows, axis=0)
        length[length == 0] = 1.0
        solution = np.linalg.lstsq(rows / length, target, rcond=1e-6)[0] / length
        return np.asarray(self.reading - self.regressor @ solution)

    def constant_wrench(self, inside: NDArray[np.bool_]) -> tuple[Array, Array]:
        """A constant wrench (p,) in a window, estimated together with the tip, and how the tip inflates its std (p,).

        The inflation is 1 where the tip cannot imitate such a wrench, and grows without limit as it can.
        """
        p = self.reading.shape[1]
        constant = inside[:, None, None] * np.eye(p)
        rows = (np.concatenate([self.regressor, constant], axis=2) / self.scale[:, :, None]).reshape(
            len(inside) * p, -1
        )
        length = np.linalg.norm(rows, axis=0)
        length[length == 0] = 1.0
        left, singular, right = np.linalg.svd(rows / length, full_matrices=False)
        kept = singular > 1e-9 * singular[0]
        inverse = right[kept].T / singular[kept]
        wrench = (inverse @ (left[:, kept].T @ (self.reading / self.scale).ravel()) / length)[-p:]
        inflation = np.linalg.norm(inverse, axis=1)[-p:]
        return wrench, np.asarray(inflation)


def find_pushes(model: WrenchModel, recordings: Sequence[Recording]) -> tuple[tuple[tuple[float, float], ...], ...]:
    """At most one interval (s) per single run in which a push explains what the rigid tip cannot.

    The window is the one without which the tip fits the rest of the run best. It is a push when a constant wrench in
    it, estimated together with the tip, exceeds anything that the run leaves elsewhere: Student's t with the larger
    of the rest's spread and of the raw samples' about their block, and with as many degrees of freedom as the rest
    has independent blocks (by its lag-one correlation), paid for by channels and windows. Repeats see far less.
    """
    single = [r.repeats == 1 and not r.at_rest and r.samples >= 10 * BLOCKS for r in recordings]
    if not any(single):
        return ((),) * len(recordings)
    averages = _averaged(model.base, recordings)
    found: list[tuple[tuple[float, float], ...]] = []
    for number, recording in enumerate(recordings):
        window = _window(averages, number) if single[number] else None
        step = recording.samples / BLOCKS * (recording.dt or 0.0)
        found.append(() if window is None else ((window[0] * step, window[1] * step),))
    return tuple(found)


def _averaged(model: WrenchModel, recordings: Sequence[Recording]) -> Averages:
    unknowns = layout(model, recordings)
    readings, regressors, owners, spreads = [], [], [], []
    for number, recording in enumerate(recordings):
        response = respond(unknowns.models[number], recording, np.zeros(len(unknowns.models[number].parameters)))
        whole = np.zeros((recording.samples, len(recording.channels), unknowns.size))
        whole[:, :, unknowns.index[number]] = response.derivative
        count = recording.samples if recording.at_rest else min(BLOCKS, recording.samples)
        parts = np.array_split(np.arange(recording.samples), count)
        readings += [recording.wrench[part].mean(axis=0) for part in parts]
        regressors += [whole[part].mean(axis=0) for part in parts]
        owners += [number] * count
        spreads.append(np.median([recording.wrench[part].std(axis=0) for part in parts], axis=0))
    owner = np.array(owners, dtype=np.intp)
    return Averages(unknowns, np.array(readings), np.array(regressors), owner, np.array(spreads))


def _window(averages: Averages, number: int) -> tuple[int, int] | None:
    own = np.flatnonzero(averages.owner == number)
    coarse = [(i, j) for i in range(0, BLOCKS, 6) for j in range(i + 6, BLOCKS + 1, 6)]
    best = _best_window(averages, own, coarse)
    fine = range(-5, 6)
    near = [(best[0] + i, best[1] + j) for i in fine for j in fine]
    start, end = _best_window(averages, own, [(i, j) for i, j in near if 0 <= i < j - 1 and j <= BLOCKS])
    inside = np.zeros(len(averages.owner), dtype=bool)
    inside[own[start:end]] = True
    residual = averages.residual_without(inside)
    rest = residual[np.setdiff1d(own, own[start:end])]
    wrench, soaked = averages.constant_wrench(inside)
    windows = len(coarse) + len(near)
    return (start, end) if _exceeds(wrench, soaked, rest, averages.raw_spread[number], windows) else None


def _best_window(averages: Averages, own: NDArray[np.intp], windows: list[tuple[int, int]]) -> tuple[int, int]:
    """The window without which the rest fits best, per degree of freedom that the rest keeps."""
    scores = []
    for start, end in windows:
        inside = np.zeros(len(averages.owner), dtype=bool)
        inside[own[start:end]] = True
        rest = (averages.residual_without(inside) / averages.scale)[own][~inside[own]]
        left = len(rest)
        scores.append(np.inf if left < BLOCKS // 5 else float(left * np.log((rest**2).mean(axis=0) + 1e-12).sum()))
    # Inside the window every block has a wrench of its own; its likelihood counts as that of the whole spread.
    spread = np.log(
        ((averages.residual_without(np.zeros(len(averages.owner), dtype=bool)) / averages.scale)[own] ** 2).mean(axis=0)
        + 1e-12
    ).sum()
    totals = [s + (end - start) * spread for s, (start, end) in zip(scores, windows, strict=True)]
    return windows[int(np.argmin(totals))]


def _exceeds(wrench: Array, soaked: Array, rest: Array, raw_spread: Array, windows: int) -> bool:
    """Whether a constant wrench is more than the rest of the run, or its raw noise, could leave anywhere."""
    spread = np.sqrt((rest**2).mean(axis=0))
    correlation = np.clip((rest[1:] * rest[:-1]).mean(axis=0) / np.maximum(spread**2, 1e-300), 0.0, 0.99)
    freedom = np.maximum(2.0, len(rest) * (1 - correlation) / (1 + correlation))
    limit = student_isf(CHANCE / 2 / (len(wrench) * windows), freedom)
    return bool(np.any(np.abs(wrench) > limit * soaked * np.maximum(spread, raw_spread)))
