"""Search domain of an effect's nonlinear parameters in a recording."""

from __future__ import annotations

from dataclasses import replace
from math import inf

import numpy as np

from diagnosis.screening.null_model import NullModel
from estimation.model_signals import model_signals
from estimation.noise.disturbances.tones import NonperiodicResidual
from estimation.noise.whitening import FourierLineWhitener
from estimation.recordings.recording import Recording
from modeling.chain.effect import Effect, SearchDomain
from modeling.parameter import Role
from modeling.tool.rigid_body import inertia_parameters

MAX_TONES = 3
"""Tones taken up: noise may make a neighbour of the right line the strongest."""


def search_domain(null_model: NullModel, number: int, effect: Effect) -> SearchDomain:
    """Search domain of an effect in one of the fit's recordings, given the fit's residual."""
    domain = null_model.search_domain(number, lambda: _recording_domain(null_model, number))
    if effect.has_role(Role.FREQUENCY, null_model.fit.model.space):
        return replace(domain, tones=strongest_tones(null_model, number))
    return domain


def _recording_domain(null_model: NullModel, number: int) -> SearchDomain:
    """Search domain of one of the fit's recordings, without tones."""
    fit = null_model.fit
    recording = fit.recordings[number]
    low, high = _position_box(recording)
    load = recording.wrench - fit.residuals[number]
    tip = recording.rig.tip_length if recording.rig is not None else None
    return SearchDomain(
        low=low,
        high=high,
        start=0.0,
        end=recording.samples * (recording.dt or 0.0),
        reach=2 * (tip or 0.2),
        events=fit.noise[number].events,
        tones=(),
        largest=tuple(map(float, np.abs(recording.wrench).max(axis=0))),
        swing=tuple(map(float, np.ptp(load, axis=0) / 2)),
        inertia=_inertia(null_model),
    )


def _position_box(recording: Recording) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Corners (m) of the bounding box of the sensor's positions, empty without positions."""
    signals = model_signals(recording)
    axes = [a for a in ("px", "py", "pz") if a in signals][: recording.dimension]
    low, high = (tuple(float(f(signals[a])) for a in axes) for f in (np.min, np.max))
    return low, high


def _inertia(null_model: NullModel) -> float:
    """The largest fitted moment of inertia of the tool about the sensor, kg m²."""
    values = null_model.fit.values
    return max(abs(values[p.name]) for p in inertia_parameters(null_model.fit.model.space))


def strongest_tones(null_model: NullModel, number: int) -> tuple[float, ...]:
    """Frequencies (Hz) of the residual's strongest non-excited lines, refined between lines.

    The strongest is always among them, so that the multiplicity correction may count the search as one over all lines.
    """
    fit = null_model.fit
    recording, noise = fit.recordings[number], fit.noise[number]
    whitener = noise.whitener
    if not isinstance(whitener, FourierLineWhitener) or not len(whitener.non_excited_lines) or len(noise.spectra) == 0:
        return ()
    start = sum(n.whitener.rows for n in fit.noise[:number]) + whitener.periodic_rows
    rows = null_model.residual[start : start + whitener.rows - whitener.periodic_rows]
    power = (rows.reshape(len(whitener.non_excited_lines), -1) ** 2).sum(axis=1)
    power[whitener.non_excited_lines < whitener.repeats] = -inf
    between = NonperiodicResidual(recording, fit.residuals[number])
    lines = whitener.non_excited_lines[np.argsort(power)[::-1][:MAX_TONES]]
    duration = recording.samples * (recording.dt or 1.0)
    weights = [1 / np.array([s(np.array([line / duration]))[0] for s in noise.spectra]) for line in lines]
    return tuple(between.sharpened(float(line), w) for line, w in zip(lines, weights, strict=True))
