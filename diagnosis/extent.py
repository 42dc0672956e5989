"""Extent: where the values of an effect can lie that are searched in a recording."""

from __future__ import annotations

from dataclasses import replace
from math import inf

import numpy as np

from diagnosis.background import Background
from estimation.recording import Recording
from estimation.response import signals_of
from estimation.tones import Between
from estimation.whitening import LineWhitener
from modeling.effect import Effect, Extent
from modeling.tip import body_parameters

LOUDEST = 3
"""Tones looked at: a line beside the right one may be the louder by chance."""


def extent_of(background: Background, number: int, effect: Effect) -> Extent:
    """What one of the fit's recordings spans for an effect, given what the fit leaves of it."""
    spanned = background.extent(number, lambda: _spanned(background, number))
    if any(p.nuisance and p.unit == "Hz" for p in effect.parameters(background.fit.model.space)):
        return replace(spanned, tones=loudest_tones(background, number))
    return spanned


def _spanned(background: Background, number: int) -> Extent:
    """What one of the fit's recordings spans for any effect."""
    fit = background.fit
    recording = fit.recordings[number]
    low, high = _visited(recording)
    load = recording.wrench - fit.residuals[number]
    tip = recording.rig.tip_length if recording.rig is not None else None
    return Extent(
        low=low,
        high=high,
        start=0.0,
        end=recording.samples * (recording.dt or 0.0),
        reach=2 * (tip or 0.2),
        events=fit.noise[number].events,
        tones=(),
        largest=tuple(map(float, np.abs(recording.wrench).max(axis=0))),
        swing=tuple(map(float, np.ptp(load, axis=0) / 2)),
        inertia=_inertia(background),
    )


def _visited(recording: Recording) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Corners (m) of the box that the sensor visits, empty without a position."""
    signals = signals_of(recording)
    axes = [a for a in ("px", "py", "pz") if a in signals][: recording.dimension]
    low, high = (tuple(float(f(signals[a])) for a in axes) for f in (np.min, np.max))
    return low, high


def _inertia(background: Background) -> float:
    """The largest moment of inertia of the tool about the sensor, kg m², as the fit has it."""
    values = background.fit.values
    names = [p.name for p in body_parameters(background.fit.model.space) if p.unit == "kg m²"]
    return max((abs(values[name]) for name in names), default=0.0)


def loudest_tones(background: Background, number: int) -> tuple[float, ...]:
    """Frequencies (Hz) of the loudest lines of what a fit leaves between the motion's lines, sharpened.

    The loudest is among them however quiet it is, so that a search may be paid for as one over all lines.
    """
    fit = background.fit
    recording, noise = fit.recordings[number], fit.noise[number]
    whitener = noise.whitener
    if not isinstance(whitener, LineWhitener) or not len(whitener.between) or len(noise.spectra) == 0:
        return ()
    start = sum(n.whitener.rows for n in fit.noise[:number]) + whitener.steady_rows
    rows = background.residual[start : start + whitener.rows - whitener.steady_rows]
    power = (rows.reshape(len(whitener.between), -1) ** 2).sum(axis=1)
    power[whitener.between < whitener.repeats] = -inf
    between = Between(recording, fit.residuals[number])
    lines = whitener.between[np.argsort(power)[::-1][:LOUDEST]]
    duration = recording.samples * (recording.dt or 1.0)
    weights = [1 / np.array([s(np.array([line / duration]))[0] for s in noise.spectra]) for line in lines]
    return tuple(between.sharpened(float(line), w) for line, w in zip(lines, weights, strict=True))
