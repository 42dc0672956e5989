"""A rival model along trajectories: the least-squares problem of its fit to a true model, and initial values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from design.discrimination.whitened_prediction import WhitenedPrediction
from modeling.chain.effect import SearchDomain
from modeling.chain.model import WrenchModel
from modeling.rival_fit import RivalFit

Array = NDArray[np.float64]

FIT_TOLERANCE = 1e-12
"""Of lambda, relative: the minimum is found to rounding, so that an indistinguishable rival is recognised."""
FIT_EVALUATIONS = 200
"""Gauss-Newton needs about ten, and many only where a nuisance parameter drifts to a bound."""
GRID_STARTS = 3
"""Points of a nuisance grid from which the exact search starts."""


def whitened_predictions(views: Sequence[WhitenedPrediction], model: WrenchModel, theta: Array) -> tuple[Array, Array]:
    """Whitened readings (R,) and sensitivities (R, k) along several trajectories, stacked."""
    parts = [view.tangent(model, theta) for view in views]
    return np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])


@dataclass(frozen=True, eq=False)
class RivalAlongTrajectories:
    """A rival model along some trajectories (`views`), and the whitened prediction there of a true one (R,)."""

    target: Array
    model: WrenchModel
    views: Sequence[WhitenedPrediction]

    def fitted(self, start: Array) -> RivalFit:
        """The fit within physical bounds by nonlinear least squares with the analytic sensitivities.

        Trust regions are scaled by the columns' norms, so that an unidentifiable parameter does not move.
        """
        low, high = parameter_bounds(self.model)

        def residual(theta: Array) -> Array:
            return whitened_predictions(self.views, self.model, theta)[0] - self.target

        def slopes(theta: Array) -> Array:
            return whitened_predictions(self.views, self.model, theta)[1]

        fit: Any = least_squares(
            residual, np.clip(start, low, high), slopes, (low, high), x_scale="jac",
            ftol=FIT_TOLERANCE, xtol=FIT_TOLERANCE, gtol=None, max_nfev=FIT_EVALUATIONS,
        )  # fmt: skip
        return RivalFit(np.asarray(fit.x, dtype=float), 2 * float(fit.cost), bool(fit.success))


def parameter_bounds(model: WrenchModel) -> tuple[Array, Array]:
    """Physical bounds low (k,) and high (k,) of a model's parameters."""
    low, high = zip(*(p.bounds for p in model.parameters), strict=True)
    return np.array(low), np.array(high)


def rival_starts(
    target: Array, model: WrenchModel, own: tuple[str, ...], theta: Array, view: WhitenedPrediction, reach: float
) -> list[Array]:
    """Starting values of a fit to a target (R,): the best points of the effects' nuisance grids.

    At each point of the grids of the effects `own`, their amplitudes at nominal, all other parameters are estimated by
    linear least squares from theta (k,) and clipped to their bounds; the points of least residual are returned.
    """
    low, high = parameter_bounds(model)
    found = []
    for values in _grid(model, own, _search_domain(view, model, reach)):
        start = np.array([values.get(p.name, v) for p, v in zip(model.parameters, theta, strict=True)])
        value, slopes = view.tangent(model, start)
        norm = np.linalg.norm(slopes, axis=0)
        scale = np.where(norm > 0, norm, 1.0)
        step = np.linalg.lstsq(slopes / scale, target - value, rcond=None)[0] / scale
        inside = np.clip(start + step, low, high)
        found.append((float(((target - value - slopes @ (inside - start)) ** 2).sum()), inside))
    return [start for _, start in sorted(found, key=lambda pair: pair[0])[:GRID_STARTS]]


def _grid(model: WrenchModel, own: tuple[str, ...], domain: SearchDomain) -> list[dict[str, float]]:
    effects = [e for e in model.effects if e.id in own]
    grids = [[{f"{e.id}.{k}": v for k, v in point.items()} for point in e.nuisance_grid(domain)] for e in effects]
    return [{k: v for point in points for k, v in point.items()} for points in product(*grids)]


def _search_domain(view: WhitenedPrediction, model: WrenchModel, reach: float) -> SearchDomain:
    axes = [view.signals[f"p{a}"] for a in model.space.axes if f"p{a}" in view.signals]
    low, high = (tuple(float(f(axis)) for axis in axes) for f in (np.min, np.max))
    return SearchDomain(low=low, high=high, end=view.sampling.duration, reach=reach)
