"""Anderson acceleration of a fixed-point iteration (J. ACM 12, 1965)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ANDERSON_DEPTH = 32
"""Default number of previous steps that are combined."""

GRAM_TOLERANCE = 1e-14
"""Relative tolerance of the singular values of the scaled Gram matrix: smaller ones are linearly dependent steps."""


class AndersonMixing:
    """Accelerated steps of x <- x + f(x), x (n,); near a solution equivalent to GMRES (Walker and Ni 2011).

    With dx the previous steps and df the changes of f, the next step is f minus the linear combination of dx + df whose
    df is closest to f (least squares). The Gram matrix of the df, scaled to a unit diagonal, gains a row per step.
    """

    def __init__(self, size: int, depth: int = ANDERSON_DEPTH) -> None:
        self._changes = np.empty((depth, size))
        self._sums = np.empty((depth, size))
        self._gram = np.zeros((depth, depth))
        self._last: tuple[Array, Array] | None = None
        self._count = 0

    def step(self, residual: Array) -> Array:
        """The step (n,) for f = `residual` (n,), provided that all previous steps were applied."""
        if self._last is not None:
            self._store(*self._last, residual)
        step = residual - self._correction(residual)
        self._last = step, residual
        return step

    def _store(self, step: Array, before: Array, residual: Array) -> None:
        place, stored = self._count % len(self._gram), min(self._count + 1, len(self._gram))
        np.subtract(residual, before, out=self._changes[place])
        np.add(step, self._changes[place], out=self._sums[place])
        self._gram[place, :stored] = self._gram[:stored, place] = self._changes[:stored] @ self._changes[place]
        self._count += 1

    def _correction(self, residual: Array) -> Array | float:
        stored = min(self._count, len(self._gram))
        scale = np.sqrt(np.diag(self._gram)[:stored])
        if not stored or not scale.all():
            return 0.0
        gram = self._gram[:stored, :stored] / np.outer(scale, scale)
        weights = np.linalg.lstsq(gram, self._changes[:stored] @ residual / scale, rcond=GRAM_TOLERANCE)[0] / scale
        return np.asarray(weights @ self._sums[:stored])
