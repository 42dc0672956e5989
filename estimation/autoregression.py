"""Autoregression fitted to a residual by least squares, the order by Akaike's criterion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modeling.noise import NoiseModel, NoiseSource

Array = NDArray[np.float64]

AUTOREGRESSION_ORDERS = (0, 1, 2, 4, 8, 15, 30)
"""Orders tried on a residual."""
ROUNDING_UNIT = float(np.finfo(float).eps)
ROWS_AT_ONCE = 16384
"""Samples that are factorised together with their past: a few tens of megabytes, whatever the length of a record."""
SMALLEST_STD = 1e-150
"""Std of a residual that is constant; its square is above the smallest number."""


def fit_autoregression(residual: Array, event_free: NDArray[np.bool_]) -> NoiseModel:
    """Autoregression of a residual (n, p) where it is `event_free` (n,), the order by Akaike's criterion.

    Each channel has its own coefficients; the innovations have a joint covariance. White noise for a short residual.
    """
    n, p = residual.shape
    usable = {order: _with_event_free_past(event_free, order) for order in AUTOREGRESSION_ORDERS if order <= n // 20}
    usable = {order: rows for order, rows in usable.items() if rows.sum() >= 10 * (order + p)}
    past = _Past.of(residual, usable)
    best, least = NoiseModel.white(np.maximum(residual.std(axis=0), SMALLEST_STD)), np.inf
    for order, rows in usable.items():
        coefficients = past.coefficients(order, rows)
        innovation = _innovations(residual, coefficients)[:, rows[order:]]
        covariance = innovation @ innovation.T / max(1, innovation.shape[1] - order)
        covariance += 1e-12 * np.eye(p) * max(np.trace(covariance) / p, 1e-300)
        criterion = rows.sum() * np.linalg.slogdet(covariance)[1] + 2 * order * p
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


def _innovations(residual: Array, coefficients: Array) -> Array:
    """Innovations (p, n - order) of a residual (n, p)."""
    pairs = zip(residual.T, coefficients.T, strict=True)
    return np.stack([np.convolve(series, np.append(1.0, -filter_), "valid") for series, filter_ in pairs])


@dataclass(frozen=True, eq=False)
class _Past:
    """Samples of a residual and their past, factorised once for all orders.

    residual  (n, p)
    rows      (n,) which samples have enough past for the highest order m
    roots     (p, m + 1, m + 1) upper triangular factors of their past and themselves, by channel
    """

    residual: Array
    rows: NDArray[np.bool_]
    roots: Array

    @classmethod
    def of(cls, residual: Array, usable: Mapping[int, NDArray[np.bool_]]) -> _Past:
        """Of the samples (n,) that are usable for each order."""
        highest = max(usable, default=0)
        rows = usable.get(highest, np.zeros(len(residual), dtype=bool))
        roots = np.zeros((residual.shape[1], highest + 1, highest + 1))
        places = np.flatnonzero(rows)
        for first in range(0, len(places), ROWS_AT_ONCE):
            past = _with_past(residual, places[first : first + ROWS_AT_ONCE], highest)
            roots = np.asarray(np.linalg.qr(np.concatenate([roots, past], axis=1), mode="r"))
        return cls(residual, rows, roots)

    def coefficients(self, order: int, rows: NDArray[np.bool_]) -> Array:
        """Least-squares coefficients (order, p) over the samples `rows`: those of the factors, and a few more."""
        more = _with_past(self.residual, np.flatnonzero(rows & ~self.rows), order)
        stacked = np.concatenate([self.roots[:, :, [*range(order), -1]], more], axis=1)
        left, sizes, right = np.linalg.svd(stacked[:, :, :order], full_matrices=False)
        along = np.einsum("pro,pr->po", left, stacked[:, :, order])
        regular = sizes > ROUNDING_UNIT * rows.sum() * sizes[:, :1]
        along = np.where(regular, along / np.where(regular, sizes, 1.0), 0.0)
        return np.asarray(np.einsum("pso,ps->op", right, along))


def _with_past(residual: Array, places: NDArray[np.intp], order: int) -> Array:
    """The `order` predecessors of samples, the latest first, then the samples themselves: (p, samples, order + 1)."""
    return residual.T[:, places[:, None] - [*range(1, order + 1), 0]]
