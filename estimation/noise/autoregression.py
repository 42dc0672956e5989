"""Autoregression fitted to a residual by least squares, the order by Akaike's criterion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from modeling.noise.autoregressive_noise import NoiseModel
from modeling.noise.stationary_noise import NoiseSource

Array = NDArray[np.float64]

AUTOREGRESSION_ORDERS = (0, 1, 2, 4, 8, 15, 30)
"""Orders tried on a residual."""
SMALLEST_STD = 1e-150
"""Std of a residual that is constant; its square is above the smallest number."""


def fit_autoregression(residual: Array, event_free: NDArray[np.bool_]) -> NoiseModel:
    """Autoregression of a residual (n, p) where it is `event_free` (n,), the order by Akaike's criterion.

    Each channel has its own coefficients; the innovations have a joint covariance. White noise for a short residual.
    """
    n, p = residual.shape
    best, least = NoiseModel.white(np.maximum(residual.std(axis=0), SMALLEST_STD)), np.inf
    for order in (order for order in AUTOREGRESSION_ORDERS if order <= n // 20):
        usable = _with_event_free_past(event_free, order)
        if usable.sum() < 10 * (order + p):
            continue
        coefficients, innovation = _autoregression_of_order(residual, usable, order)
        covariance = innovation.T @ innovation / max(1, len(innovation) - order)
        covariance += 1e-12 * np.eye(p) * max(np.trace(covariance) / p, 1e-300)
        criterion = usable.sum() * np.linalg.slogdet(covariance)[1] + 2 * order * p
        if criterion < least:
            best, least = NoiseModel(covariance, coefficients, source=NoiseSource.RESIDUAL), float(criterion)
    return best


def _with_event_free_past(event_free: NDArray[np.bool_], order: int) -> NDArray[np.bool_]:
    """Samples (n,) that are event-free together with their `order` predecessors."""
    usable = event_free.copy()
    for lag in range(1, order + 1):
        usable[lag:] &= event_free[:-lag]
    usable[:order] = False
    return usable


def _autoregression_of_order(residual: Array, usable: NDArray[np.bool_], order: int) -> tuple[Array, Array]:
    """Least-squares coefficients (order, p) of each channel by itself, and its innovations where `usable`."""
    index = np.flatnonzero(usable)
    coefficients = np.zeros((order, residual.shape[1]))
    innovation = residual[index].copy()
    for channel in range(residual.shape[1]):
        if order:
            past = np.stack([residual[index - lag, channel] for lag in range(1, order + 1)], axis=1)
            coefficients[:, channel] = np.linalg.lstsq(past, residual[index, channel], rcond=None)[0]
            innovation[:, channel] -= past @ coefficients[:, channel]
    return coefficients, innovation
