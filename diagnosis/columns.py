"""Columns: an effect's whitened derivatives at the value at which it vanishes, for many nuisance values at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from diagnosis.background import Background
from estimation.fit import Fit
from estimation.layout import layout
from estimation.recording import Recording
from estimation.response import Passage, repeats_with_motion, respond, signals_of
from estimation.whitening import Whitener
from modeling.effect import Values
from modeling.model import WrenchModel
from modeling.prediction import compiled

Array = NDArray[np.float64]


def amplitude_columns(background: Background, model: WrenchModel, grid: Sequence[Values]) -> Array:
    """Whitened derivatives (rows, g, amplitudes) of the last effect's amplitudes at their nominal value."""
    fit = background.fit
    effect = model.effects[-1]
    unknowns = layout(model, fit.recordings)
    values = fit.values
    parts = []
    for number, (recording, noise) in enumerate(zip(fit.recordings, fit.noise, strict=True)):
        own = unknowns.models[number]
        names = [unknowns.parameters[i].name for i in unknowns.index[number]]
        count = len([p for p in effect.parameters(model.space) if not p.nuisance])
        if effect.id not in [e.id for e in own.effects]:
            parts.append(np.zeros((noise.whitener.rows, len(grid), count)))
            continue
        theta = np.array(
            [
                [g.get(p.name, values.get(n, p.nominal)) for n, p in zip(names, own.parameters, strict=True)]
                for g in grid
            ]
        )
        amplitude = {p.name for p in effect.qualified(model.space) if not p.nuisance}
        which = tuple(i for i, p in enumerate(own.parameters) if p.name in amplitude)
        parts.append(_whitened_slopes(own, recording, noise.whitener, theta, which))
    return np.concatenate(parts)


def where_judged(fit: Fit, columns: Array) -> Array:
    """Whitened columns (rows, g, a) in the rows where they are judged.

    What does not repeat with the motion is judged between the motion's lines only: on them it would be taken for
    anything periodic that the model lacks, because a push or a drift has some of every shape.
    """
    judged, start = columns.copy(), 0
    for noise in fit.noise:
        steady, end = start + noise.whitener.steady_rows, start + noise.whitener.rows
        if columns[steady:end].any():
            judged[start:steady] = 0
        start = end
    return judged


def _whitened_slopes(
    model: WrenchModel, recording: Recording, whitener: Whitener, theta: Array, which: tuple[int, ...]
) -> Array:
    """Whitened derivatives (rows, g, len(which)) in some parameters, at each of g parameter sets theta (g, k)."""
    prediction, signals = compiled(model), signals_of(recording)
    if set(which) & set(prediction.memory_parameters) or prediction.bend is not None or prediction.level is not None:
        rows = [whitener.response(respond(model, recording, row))[1][:, list(which)] for row in theta]
        return np.stack(rows, axis=1)
    total = np.zeros((whitener.rows, len(theta), len(which)))
    for emitted, passed in ((prediction.load, True), (prediction.zero, False)):
        if not set(which) & set(emitted.active):
            continue
        steady = repeats_with_motion(emitted.inputs, recording)
        samples = recording.samples_per_repeat if steady else recording.samples
        slopes = emitted.slopes(signals, theta, which, samples)
        if passed:
            load = emitted.value(signals, theta[0], samples)  # the same at each set: the effect's amount is nominal
            slopes = Passage(prediction, recording, theta[0], load).through(slopes)
        if steady:
            total[: whitener.steady_rows] += whitener.steady(slopes)
        else:
            total += whitener.series(slopes)
    return total
