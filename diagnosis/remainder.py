"""Remainder: where an unexplained error lives, and what it looks like, for a person who may know what it is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.comparison import Comparison
from diagnosis.generic import generic_terms, standardised
from diagnosis.maps import ResidualMap, residual_maps

Array = NDArray[np.float64]

MOST_TERMS = 3


@dataclass(frozen=True)
class Remainder:
    """What is left in a recording that no effect explains.

    where            a sentence: the channel, the variable it follows and where it peaks
    looks_like       generic terms that describe it, with the share of its power that they take together
    explainable_rms  its size per channel
    """

    where: str
    looks_like: tuple[str, ...]
    share: float
    explainable_rms: Mapping[str, float | None]


def remainder(comparison: Comparison, tolerance: Mapping[str, float], *, fitted: bool = True) -> Remainder:
    """Describe what is left: the map that shows it best, and a sparse fit over generic terms.

    A recording that was not fitted is named.
    """
    size = comparison.explainable_rms or {}
    maps = residual_maps(comparison, tolerance)
    loudest = loudest_channel(comparison)
    best = next((m for m in maps if loudest is None or m.channel == loudest), None)
    channel = best.channel if best is not None else loudest or comparison.recording.channels[0]
    where = f"{channel}, in too few samples to say where" if best is None else _sentence(best)
    where = where if fitted else f"on {comparison.recording.name}, {where}"
    number = comparison.recording.channels.index(channel)
    terms, share = sparse_description(comparison, number)
    return Remainder(where, terms, share, {c: size.get(c) for c in comparison.recording.channels})


def _sentence(best: ResidualMap) -> str:
    peak = int(np.argmax(np.abs(best.mean)))
    rises = "rises" if best.mean[peak] > 0 else "falls"
    place = f"{best.variable} = {best.centre[peak]:.3g} {best.variable_unit}"
    return f"{best.channel} {rises} near {place} (by {abs(best.mean[peak]):.2g} {best.channel_unit})"


def loudest_channel(comparison: Comparison) -> str | None:
    """The channel whose explainable error stands out most from its noise floor; None without repeats."""
    size = comparison.explainable_rms
    if size is None:
        return None
    return max(size, key=lambda c: size[c] / max(comparison.noise_floor[c], 1e-300))


def sparse_description(comparison: Comparison, channel: int) -> tuple[tuple[str, ...], float]:
    """Up to three generic terms of the inputs, picked one after another, and the share of what repeats they take."""
    recording = comparison.recording
    once = recording.samples_per_repeat
    load = recording.wrench - comparison.residual
    terms = {k: v[:once] for k, v in generic_terms(recording, load).items() if np.ptp(v[:once]) > 0}
    columns, names = standardised(terms), list(terms)
    target = comparison.residual[:, channel].reshape(recording.repeats, once).mean(axis=0)
    target = target - target.mean()
    picked: list[int] = []
    left = target
    for _ in range(MOST_TERMS):
        gain = np.abs(columns.T @ left)
        gain[picked] = 0
        picked.append(int(gain.argmax()))
        solution = np.linalg.lstsq(columns[:, picked], target, rcond=None)[0]
        left = target - columns[:, picked] @ solution
    share = 1 - float(left @ left) / max(float(target @ target), 1e-300)
    return tuple(names[i] for i in picked), share
