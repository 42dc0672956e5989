"""Square-root information of a recording or chunk under known noise."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from estimation.least_squares.square_root_information import SquareRootInformation, TallMatrix, tall_matrix_r_factor
from estimation.model_response import model_response
from estimation.recordings.recording import CHANNELS_REMEDY, Recording, require_channels
from estimation.streaming.chunk import Chunk, chunks
from modeling.chain.model import WrenchModel
from modeling.chain.prediction import compiled_prediction
from modeling.chain.regressor import RegressorBasis, regressor_basis
from modeling.errors import InputError
from modeling.noise import NoiseModel

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
    regressor = linear_regressor_map(model)
    return model.inputs if regressor is None else regressor.inputs


RecordingOrChunk = Recording | Chunk

SAMPLES_PER_PIECE = 8192
"""Samples processed together: their rows fit into a processor's cache, and memory is bounded."""


def information_from(
    source: RecordingOrChunk, model: WrenchModel, noise: NoiseModel, theta: Array | None
) -> SquareRootInformation:
    """Information of a recording or chunk on a step from theta; on the parameters themselves of a linear model (None).

    Raises InputError when it lacks a signal, has other channels, too little history for the noise or a value that is
    not finite, and for a chunk under a model with dynamics.
    """
    _require_channels(source, model)
    _require_matching_noise(source, model, noise)
    map_ = linear_regressor_map(model) if theta is None else None
    total = SquareRootInformation.empty(len(model.parameters))
    if map_ is not None and noise.is_white:
        for run in _runs(source):
            _require_signals(run, map_.inputs)
            total = total + map_.information(run.signals, run.wrench, noise.root)
    else:
        for rows, history in _series(source, model, noise, theta, map_):
            white = noise.whitened_chunk(rows, history)
            if white.shape[-1]:
                total = total + SquareRootInformation.of(white[:-1].reshape(len(white) - 1, -1).T, white[-1].ravel())
    if not np.isfinite(total.cost + total.root.sum()):
        what = "a signal or a reading is not finite"
        raise InputError(what=what, where=run_name(source), remedy="leave such rows out, or begin a new run after them")
    return total


def run_name(source: RecordingOrChunk) -> str:
    """The recording's name or the chunk's run."""
    return source.name if isinstance(source, Recording) else source.run


def _require_channels(source: RecordingOrChunk, model: WrenchModel) -> None:
    """Raise InputError when a recording's channels, or the number of a chunk's, are not those of the model."""
    if isinstance(source, Recording):
        require_channels(source, model)
    elif source.wrench.shape[1] != len(model.channels):
        what = f"it has {source.wrench.shape[1]} channels, the model's {', '.join(model.channels)}"
        raise InputError(what=what, where=source.run, remedy=CHANNELS_REMEDY)


def _require_matching_noise(source: RecordingOrChunk, model: WrenchModel, noise: NoiseModel) -> None:
    """Raise InputError when noise and model have different channels, or a chunk's history is too short."""
    count = len(model.channels)
    if len(noise.covariance) != count:
        what = f"the noise has {len(noise.covariance)} channels and the model {count}"
        raise InputError(what=what, where="noise", remedy=f"give it for {', '.join(model.channels)}")
    if isinstance(source, Chunk) and (0 < source.history < noise.memory or source.history % noise.block):
        what = f"it has {source.history} rows of history, the autoregressive noise needs {noise.memory}"
        raise InputError(what=what, where=source.run, remedy=f"cut chunks with an overlap of {noise.memory}")


def _runs(source: RecordingOrChunk) -> Iterator[Chunk]:
    """The samples after the history, each run of a recording as a whole."""
    if isinstance(source, Chunk):
        yield source.part(source.history, len(source.wrench)) if source.history else source
    else:
        yield from chunks(source, source.samples)


def _series(
    source: RecordingOrChunk, model: WrenchModel, noise: NoiseModel, theta: Array | None, map_: RegressorMap | None
) -> Iterator[tuple[Array, int]]:
    """Sensitivities and, last, the residual, (k + 1, p, n), piece by piece, each with its rows of history."""
    if map_ is None and not _instantaneous(model):
        yield from _dynamic_rows(source, model, theta)
        return
    size = SAMPLES_PER_PIECE // noise.block * noise.block + noise.block
    size = max(size, noise.memory)
    pieces = source.pieces(size, noise.memory) if isinstance(source, Chunk) else chunks(source, size, noise.memory)
    for piece in pieces:
        if map_ is not None:
            _require_signals(piece, map_.inputs)
            rows = map_(piece.signals, len(piece.wrench))
            rows[-1] = piece.wrench.T - rows[-1]
            yield rows, piece.history
        else:
            yield _rows(piece, model, theta), piece.history


def _instantaneous(model: WrenchModel) -> bool:
    return compiled_prediction(model).instantaneous


def _require_signals(piece: Chunk, inputs: Iterable[str]) -> None:
    """Raise InputError when a chunk lacks one of these signals."""
    for name in inputs:
        if name not in piece.signals:
            remedy = "record it, or leave the effect out"
            raise InputError(what=f"the model needs the signal '{name}'", where=piece.run, remedy=remedy)


def _rows(piece: Chunk, model: WrenchModel, theta: Array | None) -> Array:
    samples, prediction = len(piece.wrench), compiled_prediction(model)
    _require_signals(piece, model.inputs)
    at = np.zeros(len(model.parameters)) if theta is None else theta
    parts = [e.tangent(piece.signals, at, samples) for e in (prediction.load, prediction.bias)]
    return _stacked(piece.wrench, parts[0][0] + parts[1][0], parts[0][1] + parts[1][1])


def _dynamic_rows(source: RecordingOrChunk, model: WrenchModel, theta: Array | None) -> Iterator[tuple[Array, int]]:
    """Rows of a recording under a model with dynamics: the whole series, split into separate runs."""
    if isinstance(source, Chunk):
        what = "the model has dynamics, and a chunk does not hold the motion before it"
        raise InputError(
            what=what, where=source.run, remedy="give whole recordings, or leave the effect with dynamics out"
        )
    response = model_response(model, source, np.zeros(len(model.parameters)) if theta is None else theta)
    rows = _stacked(source.wrench, response.value, response.derivative)
    for run in np.split(rows, 1 if source.continuous else source.repeats, axis=-1):
        yield run, 0


def _stacked(wrench: Array, value: Array, derivative: Array) -> Array:
    """(k + 1, p, n) of (n, p) and (n, p, k)."""
    return np.concatenate([derivative.transpose(2, 1, 0), (wrench - value).T[None]])
