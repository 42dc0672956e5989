"""Limits: how large an effect that was not added could still be, in the channels' units."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from diagnosis.background import Background
from diagnosis.columns import sensitivity_series
from diagnosis.projection import Projected, Whitened
from diagnosis.screening import Screening
from diagnosis.search import reached_rows
from diagnosis.secants import Point, differences, effect_columns
from diagnosis.workspace import Workspace
from estimation.fit import Fit
from estimation.layout import Layout, layout
from estimation.response import respond
from modeling.effect import Combination
from modeling.prediction import compiled

Array = NDArray[np.float64]


def contribution_limit(fitted: Fit, screening: Screening, workspace: Workspace | None = None) -> Mapping[str, float]:
    """Upper 95 % limit of what the effect contributes to each channel, as RMS over the first recording it acts in.

    The contribution is what other parameters of the model cannot take over, at the point of its grid where the effect
    was at its best. In the directions that whitening makes independent the amount is what was estimated plus 1.96
    standard deviations.
    """
    point = screening.point
    if point is None:
        raise ValueError("an effect that is not excited has no limit")
    background = Background.of(fitted, Workspace() if workspace is None else workspace)
    model = fitted.model + screening.effect
    unknowns = layout(model, fitted.recordings)
    number = next(i for i, m in enumerate(unknowns.models) if screening.effect.id in [e.id for e in m.effects])
    choice = reached_rows(background, model, judged=False)
    whitened = Whitened(effect_columns(background, model, [point], choice), choice)
    projected = Projected(background, whitened, Combination.plain([{}]), -np.inf)
    directions = projected.directions[0][0] / projected.scale[0][:, None]
    columns = projected.columns(0)
    along = directions.T @ columns.T @ background.taken(choice).residual
    raw = _raw_columns(background, unknowns, number, point, background.spread(columns, choice))
    gram = np.stack([raw[:, c].T @ raw[:, c] for c in range(raw.shape[1])]) / len(raw)
    power = np.einsum("ab,cad,db->cb", directions, gram, directions, optimize=True)
    present = np.linalg.norm(directions, axis=0) > 0
    limit = np.sqrt((power * np.where(present, np.abs(along) + 1.96, 0.0) ** 2).sum(axis=1))
    return {c: float(v) for c, v in zip(fitted.recordings[number].channels, limit, strict=True)}


def _raw_columns(background: Background, unknowns: Layout, number: int, point: Point, columns: Array) -> Array:
    """The effect's columns (n, p, a) in the channels' units, less what the model's other parameters take over.

    Over one repeat where all that is periodic, else over the whole record.
    """
    fitted, own = background.fit, unknowns.models[number]
    recording = fitted.recordings[number]
    names = [unknowns.parameters[i].name for i in unknowns.index[number]]
    known = {**fitted.values, **point.nuisances}
    theta = np.array([known.get(n, p.nominal) for n, p in zip(names, own.parameters, strict=True)])
    taken = background.directions.amounts(columns[background.reached])[fitted.layout.index[number]]
    every = list(range(len(point.amplitudes)))
    parts = [(-part @ taken, every, periodic) for part, periodic in background.derivatives(number)]
    parts += _effect_series(background, unknowns, number, point, theta)
    once, channels = parts[0][0].shape[:2]
    repeats = 1 if all(periodic for _, _, periodic in parts) else recording.repeats
    raw = np.zeros((len(every), channels, repeats, once))
    for part, places, periodic in parts:
        series = part.transpose(2, 1, 0)
        raw[places] += series[:, :, None] if periodic else series.reshape(*series.shape[:2], repeats, once)
    return raw.reshape(len(every), channels, -1).transpose(2, 1, 0)


def _effect_series(
    background: Background, unknowns: Layout, number: int, point: Point, theta: Array
) -> list[tuple[Array, list[int], bool]]:
    """Summands (n, p, c) of some of an effect's columns in a recording.

    With each the places of its columns, and whether it is one repeat (True) or the whole record (False).
    """
    recording, own = background.fit.recordings[number], unknowns.models[number]
    place = {p.name: i for i, p in enumerate(own.parameters)}
    tangents = [i for i, p in enumerate(point.amplitudes) if p not in point.named]
    which = tuple(place[point.amplitudes[i].name] for i in tangents)
    prediction = compiled(own)
    found: list[tuple[Array, list[int], bool]] = []
    if which and (prediction.bend is not None or set(which) & set(prediction.memory_parameters)):
        response = respond(own, recording, theta)
        periodic = response.whole is None
        derivative = response.periodic[1] if periodic else response.derivative
        found.append((derivative[:, :, list(which)], tangents, periodic))
    elif which:
        for summand in sensitivity_series(own, recording, theta[None], which):
            found.append((summand.read()[:, :, 0], tangents, summand.periodic))
    for _, amplitude, difference in differences(background, unknowns, number, [point]):
        found.append((difference.periodic[:, :, None], [amplitude], True))
        if difference.whole is not None:
            found.append((difference.whole[:, :, None], [amplitude], False))
    return found


def tolerance_of(base: Fit) -> tuple[dict[str, float], bool]:
    """What the user does not care about per channel, else a tenth of the noise floor; and whether it was stated."""
    recording, floor = base.recordings[0], base.noise[0].floor
    stated = (recording.rig.sensor.tolerance if recording.rig is not None else None) or {}
    tolerance = {c: float(stated.get(c, f / 10)) for c, f in zip(recording.channels, floor, strict=True)}
    return tolerance, bool(stated)


def within(size: Mapping[str, float], tolerance: Mapping[str, float]) -> bool:
    """Whether every channel is within tolerance."""
    return all(size[c] <= tolerance[c] for c in tolerance)
