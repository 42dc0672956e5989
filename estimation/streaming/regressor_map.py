"""Regressor of a linear model over many samples, and its square-root information under white noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from estimation.least_squares.square_root_information import SquareRootInformation
from estimation.least_squares.tall_matrix_qr import TallMatrix, tall_matrix_r_factor
from modeling.chain.model import WrenchModel
from modeling.chain.regressor_basis import RegressorBasis
from modeling.chain.regressor_basis_derivation import regressor_basis

Array = NDArray[np.float64]


class FunctionsAndReadings(TallMatrix):
    """The d functions of the motion and, below them, the p readings of every sample.

    signals  (n,) each, in the order of the form's inputs; `wrench` (n, p)
    """

    def __init__(self, form: RegressorBasis, signals: tuple[Array, ...], wrench: Array) -> None:
        self.form, self.signals, self.wrench = form, signals, wrench
        self.functions = form.weights.shape[2]
        self.samples, self.width = len(wrench), self.functions + wrench.shape[1]

    def rows(self, start: int, end: int, out: Array) -> None:
        """Functions and readings from start to end."""
        self._write([signal[start:end] for signal in self.signals], self.wrench[start:end], out)

    def at(self, index: NDArray[np.intp]) -> Array:
        """Functions and readings of these samples."""
        out = np.empty((self.width, len(index)))
        self._write([signal[index] for signal in self.signals], self.wrench[index], out)
        return out

    def _write(self, signals: list[Array], wrench: Array, out: Array) -> None:
        self.form.evaluate(signals, out[: self.functions])
        out[self.functions :] = wrench.T


@dataclass(frozen=True, eq=False)
class RegressorMap:
    """Prediction Phi theta + offset of a model that is linear in its parameters, evaluated by NumPy.

    Samples come last: a channel's series is contiguous, for filters, and so is a column of all channels, for products.
    Either the whole of Phi is laid out, or, under white noise, none of it (`information`).
    """

    form: RegressorBasis

    @property
    def inputs(self) -> tuple[str, ...]:
        """Input signals of the model."""
        return self.form.inputs

    def __call__(self, signals: Mapping[str, Array], samples: int) -> Array:
        """Phi' of every sample, and the offset in the last place: (k + 1, p, n)."""
        functions = np.empty((self.form.weights.shape[2], samples))
        columns = [np.asarray(signals[name], dtype=np.float64) for name in self.inputs]
        self.form.evaluate(columns, functions)
        unknowns, channels, _ = self.form.weights.shape
        rows = np.zeros((unknowns, channels, samples))
        for i, c in np.argwhere(self.form.weights.any(axis=2)):
            for j in np.flatnonzero(self.form.weights[i, c]):
                rows[i, c] += self.form.weights[i, c, j] * functions[j]
        return rows

    def information(self, signals: Mapping[str, Array], wrench: Array, root: Array) -> SquareRootInformation:
        """Information of readings (n, p) on the parameters, under white noise of inverse Cholesky factor (p, p).

        With b (d + p) the functions of the motion and the readings of one sample, its whitened row of channel c is
        b' L_c, one column for each parameter and one for the residual, and L_c, root_c times the weights, is the same
        for all samples. With B = Q R of all samples, |B L_c x|² = |R L_c x|²: only R is computed from the samples, and
        the regressor Phi is never formed.
        """
        columns = tuple(np.asarray(signals[n], dtype=np.float64) for n in self.inputs)
        with np.errstate(all="ignore"):  # values that are not finite show up in the triangle
            triangle = tall_matrix_r_factor(FunctionsAndReadings(self.form, columns, wrench))
        size, channels = len(self.form.weights) - 1, len(root)
        if not np.isfinite(triangle).all():
            return SquareRootInformation(np.full((size, size), np.nan), np.full(size, np.nan), np.nan, wrench.size)
        weights = np.concatenate([self.form.weights, np.zeros((size + 1, channels, channels))], axis=2)
        weights[-1] = np.concatenate([-self.form.weights[-1], np.eye(channels)], axis=1)
        rows = np.einsum("ab,ce,ieb->cai", triangle, root, weights).reshape(-1, size + 1)
        return SquareRootInformation.of_triangle(rows, wrench.size)


@lru_cache(maxsize=128)
def linear_regressor_map(model: WrenchModel) -> RegressorMap | None:
    """Regressor map of a static model that is linear in its parameters, None for any other; derived once per model."""
    form = regressor_basis(model)
    return None if form is None else RegressorMap(form)


def required_signals(model: WrenchModel) -> tuple[str, ...]:
    """Input signals of a model; for a linear one from its cached map."""
    found = linear_regressor_map(model)
    return model.inputs if found is None else found.inputs
