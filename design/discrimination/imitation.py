"""Imitation: how near a model can come to what another one reads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from design.discrimination.view import View
from modeling.effect import Extent
from modeling.model import WrenchModel

Array = NDArray[np.float64]

ACCURACY = 1e-12
"""Of lambda, relative: the minimum is found to rounding, so that what is exactly imitated shows as such."""
EVALUATIONS = 200
"""Gauss-Newton needs about ten, and many only where a nuisance parameter runs off to a bound."""
KEPT = 3
"""Points of a nuisance grid from which the exact search starts."""


@dataclass(frozen=True, eq=False)
class Imitation:
    """The values theta (k,) of a model at which it reads most like a target, and lambda, its whitened distance."""

    theta: Array
    separation: float


def readings(views: Sequence[View], model: WrenchModel, theta: Array) -> tuple[Array, Array]:
    """Whitened readings (R,) and derivatives (R, k) along several motions, one below the other."""
    parts = [view.tangent(model, theta) for view in views]
    return np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])


def imitate(target: Array, model: WrenchModel, views: Sequence[View], starts: Sequence[Array]) -> Imitation:
    """lambda = min over theta within its physical bounds of |target - reading(theta)|², the target (R,) whitened.

    Nonlinear least squares with the analytic sensitivities, from each start (k,); trust regions scaled by the columns'
    lengths, in which a parameter that no reading shows does not move.
    """
    low, high = bounds(model)

    def residual(theta: Array) -> Array:
        return readings(views, model, theta)[0] - target

    def slopes(theta: Array) -> Array:
        return readings(views, model, theta)[1]

    found = []
    for start in starts:
        fit: Any = least_squares(
            residual, np.clip(start, low, high), slopes, (low, high), x_scale="jac",
            ftol=ACCURACY, xtol=ACCURACY, gtol=None, max_nfev=EVALUATIONS,
        )  # fmt: skip
        found.append(Imitation(np.asarray(fit.x, dtype=float), 2 * float(fit.cost)))
    return min(found, key=lambda imitation: imitation.separation)


def bounds(model: WrenchModel) -> tuple[Array, Array]:
    """Physical bounds low (k,) and high (k,) of a model's parameters."""
    low, high = zip(*(p.bounds for p in model.parameters), strict=True)
    return np.array(low), np.array(high)


def starts(
    target: Array, model: WrenchModel, own: tuple[str, ...], theta: Array, view: View, reach: float
) -> list[Array]:
    """Where a search for the best imitation of a target (R,) may start: the best of its effects' nuisance grids.

    At each point of the grids of the effects `own`, their amplitudes at nominal, everything else is estimated by linear
    least squares from theta (k,); the points that leave least are kept. An amplitude beyond its bounds leaves what
    there is without it.
    """
    low, high = bounds(model)
    found = []
    for values in _grid(model, own, _extent(view, model, reach)):
        start = np.array([values.get(p.name, v) for p, v in zip(model.parameters, theta, strict=True)])
        value, slopes = view.tangent(model, start)
        length = np.linalg.norm(slopes, axis=0)
        scale = np.where(length > 0, length, 1.0)
        step = np.linalg.lstsq(slopes / scale, target - value, rcond=None)[0] / scale
        inside = np.clip(start + step, low, high)
        found.append((float(((target - value - slopes @ (inside - start)) ** 2).sum()), inside))
    return [start for _, start in sorted(found, key=lambda pair: pair[0])[:KEPT]]


def _grid(model: WrenchModel, own: tuple[str, ...], extent: Extent) -> list[dict[str, float]]:
    effects = [e for e in model.effects if e.id in own]
    grids = [[{f"{e.id}.{k}": v for k, v in point.items()} for point in e.nuisance_grid(extent)] for e in effects]
    return [{k: v for point in points for k, v in point.items()} for points in product(*grids)]


def _extent(view: View, model: WrenchModel, reach: float) -> Extent:
    axes = [view.signals[f"p{a}"] for a in model.space.axes if f"p{a}" in view.signals]
    low, high = (tuple(float(f(axis)) for axis in axes) for f in (np.min, np.max))
    return Extent(low=low, high=high, end=view.sampling.duration, reach=reach)
