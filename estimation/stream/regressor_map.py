"""Regressor map: what a linear model predicts for a stretch of samples, laid out for filters and products."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from estimation.linear.square_root import SquareRoot
from estimation.linear.tall_root import BLOCK, Columns, tall_root
from modeling.model import WrenchModel
from modeling.regressor_form import RegressorForm, regressor_form

Array = NDArray[np.float64]


class MotionAndReadings(Columns):
    """The d functions of the motion and, below them, the p readings of every sample.

    signals  (n,) each, in the order of the form's inputs; `wrench` (n, p)
    """

    def __init__(self, form: RegressorForm, signals: tuple[Array, ...], wrench: Array) -> None:
        self.form, self.signals, self.wrench = form, signals, wrench
        self.functions = form.weights.shape[2]
        self.samples, self.width = len(wrench), self.functions + wrench.shape[1]
        self.scratch = form.functions.scratch(min(self.samples, BLOCK))

    def rows(self, start: int, end: int, out: Array) -> None:
        """Functions and readings from start to end."""
        self._write([signal[start:end] for signal in self.signals], self.wrench[start:end], self.scratch, out)

    def at(self, index: NDArray[np.intp]) -> Array:
        """Functions and readings of these samples."""
        out = np.empty((self.width, len(index)))
        scratch = self.form.functions.scratch(len(index))
        self._write([signal[index] for signal in self.signals], self.wrench[index], scratch, out)
        return out

    def _write(self, signals: list[Array], wrench: Array, scratch: Array, out: Array) -> None:
        self.form.functions.into(out[: self.functions], signals, scratch)
        out[self.functions :] = wrench.T


@dataclass(frozen=True, eq=False)
class RegressorMap:
    """Prediction Phi theta + offset of a model that is linear in its parameters, evaluated by NumPy.

    Samples come last: a channel's series is contiguous, for filters, and so is a column of all channels, for products.
    Either the whole of Phi is laid out, or, under white noise, none of it (`information`).
    """

    form: RegressorForm

    @property
    def inputs(self) -> tuple[str, ...]:
        """The signals that the model takes."""
        return self.form.inputs

    def __call__(self, signals: Mapping[str, Array], samples: int) -> Array:
        """Phi' of every sample, and the offset in the last place: (k + 1, p, n)."""
        functions = np.empty((self.form.weights.shape[2], samples))
        program = self.form.functions
        columns = [np.asarray(signals[name], dtype=np.float64) for name in self.inputs]
        program.into(functions, columns, program.scratch(samples))
        unknowns, channels, _ = self.form.weights.shape
        rows = np.zeros((unknowns, channels, samples))
        for i, c in np.argwhere(self.form.weights.any(axis=2)):
            for j in np.flatnonzero(self.form.weights[i, c]):
                rows[i, c] += self.form.weights[i, c, j] * functions[j]
        return rows

    def information(self, signals: Mapping[str, Array], wrench: Array, root: Array) -> SquareRoot:
        """What n samples of readings (n, p) say of the parameters, under white noise with the inverse factor (p, p).

        With b (d + p) the functions of the motion and the readings of one sample, its whitened row of channel c is
        b' L_c, one column for each parameter and one for measured minus predicted, and L_c, root_c times the weights,
        is the same for all samples. With B = Q R of all samples, |B L_c x|² = |R L_c x|²: the samples are gone through
        for R alone, and Phi is never there.
        """
        columns = tuple(np.asarray(signals[n], dtype=np.float64) for n in self.inputs)
        with np.errstate(all="ignore"):  # what is not finite is found in the triangle
            triangle = tall_root(MotionAndReadings(self.form, columns, wrench))
        size, channels = len(self.form.weights) - 1, len(root)
        if not np.isfinite(triangle).all():
            return SquareRoot(np.full((size, size), np.nan), np.full(size, np.nan), np.nan, wrench.size)
        made = np.concatenate([self.form.weights, np.zeros((size + 1, channels, channels))], axis=2)
        made[-1] = np.concatenate([-self.form.weights[-1], np.eye(channels)], axis=1)
        rows = np.einsum("ab,ce,ieb->cai", triangle, root, made).reshape(-1, size + 1)
        return SquareRoot.of_triangle(rows, wrench.size)


@lru_cache(maxsize=128)
def linear(model: WrenchModel) -> RegressorMap | None:
    """The map of a model without memory that is linear in its parameters, None of any other; derived once per model."""
    form = regressor_form(model)
    return None if form is None else RegressorMap(form)


def inputs_of(model: WrenchModel) -> tuple[str, ...]:
    """The signals that a model takes, of a linear one without deriving it again."""
    found = linear(model)
    return model.inputs if found is None else found.inputs
