"""Background: a fit as a new effect sees it, with what is left and the directions that are taken already."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from estimation.fit import Fit, Problem
from estimation.interval import orthonormal

Array = NDArray[np.float64]

DRAWS = 100
SEED = 0
"""Draws of pure noise from which a supremum over nuisance values takes its number of trials."""


@dataclass(frozen=True, eq=False)
class Background:
    """A fit as seen by a new column: what is left, and the directions that are taken already."""

    fit: Fit

    @cached_property
    def problem(self) -> Problem:
        """The whitened problem of the fit."""
        return Problem(self.fit.layout, self.fit.recordings, self.fit.noise)

    @cached_property
    def _evaluated(self) -> tuple[Array, Array]:
        return self.problem.evaluate(self.fit.theta)

    @cached_property
    def basis(self) -> Array:
        """Orthonormal basis (rows, r) of the derivative's columns."""
        return orthonormal(self._evaluated[1])

    def doubt_of(self, fitted: Array) -> Array:
        """Doubt (g,) of the chi-square that each column of fitted rows (rows, g) takes away, by where it comes from."""
        shares = fitted**2 / np.maximum((fitted**2).sum(axis=0), 1e-300)
        parts = np.split(shares, np.cumsum([n.whitener.rows for n in self.fit.noise])[:-1])
        return np.asarray(sum(n.doubt_of(part) for n, part in zip(self.fit.noise, parts, strict=True)))

    @cached_property
    def residual(self) -> Array:
        """Whitened residual (rows,) with those directions taken out."""
        raw = self._evaluated[0]
        return np.asarray(raw - self.basis @ (self.basis.T @ raw))

    @cached_property
    def draws(self) -> Array:
        """Pure noise (rows, DRAWS) with the directions taken out; always the same, so that a p-value repeats."""
        noise = np.random.default_rng(SEED).standard_normal((len(self.residual), DRAWS))
        return np.asarray(noise - self.basis @ (self.basis.T @ noise))

    @property
    def cost(self) -> float:
        """Whitened chi-square of the fit."""
        return float(self._evaluated[0] @ self._evaluated[0])
