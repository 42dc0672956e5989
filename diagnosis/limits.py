"""Limits: how large an effect that was not added could still be, in the channels' units."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from diagnosis.background import Background
from diagnosis.columns import amplitude_columns
from diagnosis.projection import Projected
from diagnosis.screening import Screening
from estimation.fit import Fit
from estimation.layout import Layout, layout
from estimation.response import respond
from modeling.effect import Values
from modeling.model import WrenchModel

Array = NDArray[np.float64]


def contribution_limit(fitted: Fit, screening: Screening) -> Mapping[str, float]:
    """Upper 95 % limit of what the effect contributes to each channel, as RMS over the first recording it acts in.

    The contribution is what other parameters of the model cannot take over. In the directions that whitening makes
    independent the amount is what was estimated plus 1.96 standard deviations.
    """
    model = fitted.model + screening.effect
    background = Background(fitted)
    unknowns = layout(model, fitted.recordings)
    number = next(i for i, m in enumerate(unknowns.models) if screening.effect.id in [e.id for e in m.effects])
    amplitudes = [p.name for p in screening.effect.qualified(model.space) if not p.nuisance]
    nuisance = {n: v for n, v in screening.start.items() if n not in amplitudes}
    columns = amplitude_columns(background, model, [nuisance])
    projected = Projected(background, columns, -np.inf)
    roots, _ = projected.directions
    directions = roots[0] / projected.scale[0][:, None]
    along = directions.T @ columns[:, 0].T @ background.residual
    raw = _raw_columns(fitted, model, unknowns, number, nuisance, amplitudes, columns[:, 0])
    power = (np.einsum("npa,ab->npb", raw, directions) ** 2).mean(axis=0)
    present = np.linalg.norm(directions, axis=0) > 0
    limit = np.sqrt((power * np.where(present, np.abs(along) + 1.96, 0.0) ** 2).sum(axis=1))
    return {c: float(v) for c, v in zip(fitted.recordings[number].channels, limit, strict=True)}


def _raw_columns(
    fitted: Fit,
    model: WrenchModel,
    unknowns: Layout,
    number: int,
    nuisance: Values,
    amplitudes: list[str],
    columns: Array,
) -> Array:
    """The effect's columns (n, p, a) in the channels' units, less what the model's other parameters take over."""
    own = unknowns.models[number]
    names = [unknowns.parameters[i].name for i in unknowns.index[number]]
    values = fitted.values
    theta = np.array(
        [nuisance.get(p.name, values.get(n, p.nominal)) for n, p in zip(names, own.parameters, strict=True)]
    )
    derivative = respond(own, fitted.recordings[number], theta).derivative
    place = [i for i, p in enumerate(own.parameters) if p.name in amplitudes]
    taken = Background(fitted).problem.evaluate(fitted.theta)[1]
    scale = np.linalg.norm(taken, axis=0)
    scale[scale == 0] = 1.0
    share = np.linalg.lstsq(taken / scale, columns, rcond=1e-9)[0] / scale[:, None]
    index = {p.name: i for i, p in enumerate(fitted.layout.parameters)}
    kept = [i for i, n in enumerate(names) if n in index]
    return np.asarray(derivative[:, :, place] - derivative[:, :, kept] @ share[[index[names[i]] for i in kept]])


def tolerance_of(base: Fit) -> tuple[dict[str, float], bool]:
    """What the user does not care about per channel, else a tenth of the noise floor; and whether it was stated."""
    recording, floor = base.recordings[0], base.noise[0].floor
    stated = (recording.rig.sensor.tolerance if recording.rig is not None else None) or {}
    tolerance = {c: float(stated.get(c, f / 10)) for c, f in zip(recording.channels, floor, strict=True)}
    return tolerance, bool(stated)


def within(size: Mapping[str, float], tolerance: Mapping[str, float]) -> bool:
    """Whether every channel is within tolerance."""
    return all(size[c] <= tolerance[c] for c in tolerance)
