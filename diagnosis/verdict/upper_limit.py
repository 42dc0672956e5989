"""Upper 95 % limit of an absent effect's contribution to each channel."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from diagnosis.screening.finite_difference import GridPoint, response_differences, score_columns
from diagnosis.screening.grid_search import affected_rows
from diagnosis.screening.null_model import NullModel
from diagnosis.screening.projection import ProjectedColumns, WhitenedColumns
from diagnosis.screening.score_test import ScoreTest
from diagnosis.screening.screening_cache import ScreeningCache
from diagnosis.screening.whitened_sensitivity import sensitivity_series
from estimation.fit import Fit
from estimation.model_response import model_response
from estimation.parameter_layout import ParameterLayout, parameter_layout
from modeling.chain.effect import GridSuperposition
from modeling.chain.prediction import compiled_prediction

Array = NDArray[np.float64]


def contribution_upper_limit(
    fitted: Fit, screening: ScoreTest, cache: ScreeningCache | None = None
) -> Mapping[str, float]:
    """Upper 95 % limit of an effect's contribution to each channel, as RMS over the first recording it acts in.

    The contribution is the part not collinear with the model's other parameters, at the effect's best grid point. In
    each principal direction of the whitened columns the amount is its absolute estimate plus 1.96 standard deviations.
    """
    point = screening.point
    if point is None:
        raise ValueError("an effect that is not excited has no upper limit")
    null_model = NullModel.of(fitted, ScreeningCache() if cache is None else cache)
    model = fitted.model + screening.effect
    unknowns = parameter_layout(model, fitted.recordings)
    number = next(i for i, m in enumerate(unknowns.models) if screening.effect.id in [e.id for e in m.effects])
    choice = affected_rows(null_model, model, tested=False)
    whitened = WhitenedColumns(score_columns(null_model, model, [point], choice), choice)
    projected = ProjectedColumns(null_model, whitened, GridSuperposition.plain([{}]), -np.inf)
    directions = projected.directions[0][0] / projected.scale[0][:, None]
    columns = projected.columns(0)
    standardised = directions.T @ columns.T @ null_model.rows_of(choice).residual
    raw = _unwhitened_columns(null_model, unknowns, number, point, null_model.spread(columns, choice))
    gram = np.stack([raw[:, c].T @ raw[:, c] for c in range(raw.shape[1])]) / len(raw)
    power = np.einsum("ab,cad,db->cb", directions, gram, directions, optimize=True)
    present = np.linalg.norm(directions, axis=0) > 0
    limit = np.sqrt((power * np.where(present, np.abs(standardised) + 1.96, 0.0) ** 2).sum(axis=1))
    return {c: float(v) for c, v in zip(fitted.recordings[number].channels, limit, strict=True)}


def _unwhitened_columns(
    null_model: NullModel, unknowns: ParameterLayout, number: int, point: GridPoint, columns: Array
) -> Array:
    """The effect's derivatives (n, p, a) in the channels' units, less their part collinear with other parameters.

    Over one repeat where all of them are periodic, else over the whole record.
    """
    fitted = null_model.fit
    recording = fitted.recordings[number]
    theta = unknowns.values_of(number, {**fitted.values, **point.nuisances})
    collinear = null_model.directions.amounts(columns[null_model.reached])[fitted.layout.index[number]]
    every = list(range(len(point.amplitudes)))
    parts = [(-part @ collinear, every, periodic) for part, periodic in null_model.derivatives(number)]
    parts += _effect_derivatives(null_model, unknowns, number, point, theta)
    once, channels = parts[0][0].shape[:2]
    repeats = 1 if all(periodic for _, _, periodic in parts) else recording.repeats
    raw = np.zeros((len(every), channels, repeats, once))
    for part, places, periodic in parts:
        for place, series in zip(places, part.transpose(2, 1, 0), strict=True):
            raw[place] += series[:, None] if periodic else series.reshape(channels, repeats, once)
    return raw.reshape(len(every), channels, -1).transpose(2, 1, 0)


def _effect_derivatives(
    null_model: NullModel, unknowns: ParameterLayout, number: int, point: GridPoint, theta: Array
) -> list[tuple[Array, list[int], bool]]:
    """Summands (n, p, c) of an effect's derivatives or finite differences in a recording.

    With each the indices of its amplitudes, and whether it is over one repeat (True) or the whole record (False).
    """
    recording, own = null_model.fit.recordings[number], unknowns.models[number]
    place = {p.name: i for i, p in enumerate(own.parameters)}
    differentiated = [i for i, p in enumerate(point.amplitudes) if p not in point.named]
    which = tuple(place[point.amplitudes[i].name] for i in differentiated)
    prediction = compiled_prediction(own)
    found: list[tuple[Array, list[int], bool]] = []
    if which and (prediction.deflection is not None or set(which) & set(prediction.transfer_parameters)):
        response = model_response(own, recording, theta)
        periodic = response.whole is None
        derivative = response.periodic[1] if periodic else response.derivative
        found.append((derivative[:, :, list(which)], differentiated, periodic))
    elif which:
        for summand in sensitivity_series(own, recording, theta[None], which):
            found.append((summand.read()[:, :, 0], differentiated, summand.periodic))
    for _, amplitude, difference in response_differences(null_model, unknowns, number, [point]):
        found.append((difference.periodic[:, :, None], [amplitude], True))
        if difference.whole is not None:
            found.append((difference.whole[:, :, None], [amplitude], False))
    return found


def channel_tolerance(base: Fit) -> tuple[dict[str, float], bool]:
    """Tolerance per channel as stated in the rig, else a tenth of the noise floor; and whether it was stated."""
    recording, floor = base.recordings[0], base.noise[0].floor
    stated = (recording.rig.sensor.tolerance if recording.rig is not None else None) or {}
    tolerance = {c: float(stated.get(c, f / 10)) for c, f in zip(recording.channels, floor, strict=True)}
    return tolerance, bool(stated)


def within_tolerance(size: Mapping[str, float], tolerance: Mapping[str, float]) -> bool:
    """Whether the size is within tolerance in every channel."""
    return all(size[c] <= tolerance[c] for c in tolerance)
