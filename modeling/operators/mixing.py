"""Mixing: Anderson's method for equations x = x + f(x), which combines the steps taken so far (J. ACM 12, 1965)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MEMORY = 32
"""Steps that are combined, if nothing else is said."""

DEPENDENT = 1e-14
"""Singular values of the scaled Gram matrix, against the largest, below which steps say nothing new."""


class Mixing:
    """Steps for an unknown (n,) from what is missing there, f: near a solution as good as GMRES (Walker and Ni 2011).

    With dx the steps taken and df what they changed, the next step is f less the combination of dx + df whose df comes
    closest to f. The Gram matrix of the df, scaled to ones on its diagonal, gains a row with each step.
    """

    def __init__(self, size: int, memory: int = MEMORY) -> None:
        self._changes = np.empty((memory, size))
        self._sums = np.empty((memory, size))
        self._gram = np.zeros((memory, memory))
        self._taken: tuple[Array, Array] | None = None
        self._count = 0

    def step(self, missing: Array) -> Array:
        """The step (n,) to take where f is `missing` (n,), after all steps that it gave before were taken."""
        if self._taken is not None:
            self._remember(*self._taken, missing)
        step = missing - self._combined(missing)
        self._taken = step, missing
        return step

    def _remember(self, step: Array, before: Array, missing: Array) -> None:
        place, kept = self._count % len(self._gram), min(self._count + 1, len(self._gram))
        np.subtract(missing, before, out=self._changes[place])
        np.add(step, self._changes[place], out=self._sums[place])
        self._gram[place, :kept] = self._gram[:kept, place] = self._changes[:kept] @ self._changes[place]
        self._count += 1

    def _combined(self, missing: Array) -> Array | float:
        kept = min(self._count, len(self._gram))
        scale = np.sqrt(np.diag(self._gram)[:kept])
        if not kept or not scale.all():
            return 0.0
        gram = self._gram[:kept, :kept] / np.outer(scale, scale)
        weights = np.linalg.lstsq(gram, self._changes[:kept] @ missing / scale, rcond=DEPENDENT)[0] / scale
        return np.asarray(weights @ self._sums[:kept])
