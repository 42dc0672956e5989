"""Square-root information of a recording or chunk under known noise."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from estimation.least_squares.square_root_information import SquareRootInformation
from estimation.recordings.recording import Recording
from estimation.streaming.chunk import Chunk, chunks
from estimation.streaming.regressor_map import RegressorMap, linear_regressor_map
from modeling.chain.model import WrenchModel
from modeling.errors import InputError
from modeling.noise.autoregressive_noise import NoiseModel

Array = NDArray[np.float64]
RecordingOrChunk = Recording | Chunk

SAMPLES_PER_PIECE = 8192
"""Samples processed together: their rows fit into a processor's cache, and memory is bounded."""


def information_from(
    part: RecordingOrChunk, model: WrenchModel, noise: NoiseModel, theta: Array | None
) -> SquareRootInformation:
    """Information of a recording or chunk on a step from theta; on the parameters themselves of a linear model (None).

    Raises InputError when it lacks a signal, has other channels, too little history for the noise or a value that is
    not finite, and for a chunk under a model with dynamics.
    """
    require_channels(part, model)
    _require_matching_noise(part, model, noise)
    map_ = linear_regressor_map(model) if theta is None else None
    total = SquareRootInformation.empty(len(model.parameters))
    if map_ is not None and noise.is_white:
        for run in _runs(part):
            _require_signals(run, map_.inputs)
            total = total + map_.information(run.signals, run.wrench, noise.root)
    else:
        for rows, history in _series(part, model, noise, theta, map_):
            white = noise.whitened_chunk(rows, history)
            if white.shape[-1]:
                total = total + SquareRootInformation.of(white[:-1].reshape(len(white) - 1, -1).T, white[-1].ravel())
    if not np.isfinite(total.cost + total.root.sum()):
        what = "a signal or a reading is not finite"
        raise InputError(what=what, where=run_name(part), remedy="leave such rows out, or begin a new run after them")
    return total


def run_name(part: RecordingOrChunk) -> str:
    """The recording's name or the chunk's run."""
    return part.name if isinstance(part, Recording) else part.run


def require_channels(part: RecordingOrChunk, model: WrenchModel) -> None:
    """Raise InputError when a recording's channels, or the number of a chunk's, are not those of the model."""
    count = len(model.channels)
    if part.wrench.shape[1] != count or (isinstance(part, Recording) and part.channels != model.channels):
        own = f"it has {part.wrench.shape[1]} channels"
        own = f"its channels are {', '.join(part.channels)}" if isinstance(part, Recording) else own
        what = f"{own}, the model's {', '.join(model.channels)}"
        remedy = "use planar() for fx, fy, tau and spatial() for six axes"
        raise InputError(what=what, where=run_name(part), remedy=remedy)


def _require_matching_noise(part: RecordingOrChunk, model: WrenchModel, noise: NoiseModel) -> None:
    """Raise InputError when noise and model have different channels, or a chunk's history is too short."""
    count = len(model.channels)
    if len(noise.covariance) != count:
        what = f"the noise has {len(noise.covariance)} channels and the model {count}"
        raise InputError(what=what, where="noise", remedy=f"give it for {', '.join(model.channels)}")
    if isinstance(part, Chunk) and (0 < part.history < noise.memory or part.history % noise.block):
        what = f"it has {part.history} rows of history, the autoregressive noise needs {noise.memory}"
        raise InputError(what=what, where=part.run, remedy=f"cut chunks with an overlap of {noise.memory}")


def _runs(part: RecordingOrChunk) -> Iterator[Chunk]:
    """The samples after the history, each run of a recording as a whole."""
    if isinstance(part, Chunk):
        yield part.part(part.history, len(part.wrench)) if part.history else part
    else:
        yield from chunks(part, part.samples)


def _series(
    part: RecordingOrChunk, model: WrenchModel, noise: NoiseModel, theta: Array | None, map_: RegressorMap | None
) -> Iterator[tuple[Array, int]]:
    """Sensitivities and, last, the residual, (k + 1, p, n), piece by piece, each with its rows of history."""
    if map_ is None and not _instantaneous(model):
        yield from _dynamic_rows(part, model, theta)
        return
    size = SAMPLES_PER_PIECE // noise.block * noise.block + noise.block
    size = max(size, noise.memory)
    pieces = part.pieces(size, noise.memory) if isinstance(part, Chunk) else chunks(part, size, noise.memory)
    for piece in pieces:
        if map_ is not None:
            _require_signals(piece, map_.inputs)
            rows = map_(piece.signals, len(piece.wrench))
            rows[-1] = piece.wrench.T - rows[-1]
            yield rows, piece.history
        else:
            yield _rows(piece, model, theta), piece.history


def _instantaneous(model: WrenchModel) -> bool:
    from modeling.chain.prediction import compiled_prediction  # slow to import

    return compiled_prediction(model).instantaneous


def _require_signals(piece: Chunk, inputs: Iterable[str]) -> None:
    """Raise InputError when a chunk lacks one of these signals."""
    for name in inputs:
        if name not in piece.signals:
            remedy = "record it, or leave the effect out"
            raise InputError(what=f"the model needs the signal '{name}'", where=piece.run, remedy=remedy)


def _rows(piece: Chunk, model: WrenchModel, theta: Array | None) -> Array:
    from modeling.chain.prediction import compiled_prediction  # slow to import

    samples, prediction = len(piece.wrench), compiled_prediction(model)
    _require_signals(piece, model.inputs)
    at = np.zeros(len(model.parameters)) if theta is None else theta
    parts = [e.tangent(piece.signals, at, samples) for e in (prediction.load, prediction.bias)]
    return _stacked(piece.wrench, parts[0][0] + parts[1][0], parts[0][1] + parts[1][1])


def _dynamic_rows(part: RecordingOrChunk, model: WrenchModel, theta: Array | None) -> Iterator[tuple[Array, int]]:
    """Rows of a recording under a model with dynamics: the whole series, split into separate runs."""
    if isinstance(part, Chunk):
        what = "the model has dynamics, and a chunk does not hold the motion before it"
        raise InputError(
            what=what, where=part.run, remedy="give whole recordings, or leave the effect with dynamics out"
        )
    from estimation.model_response import model_response  # slow to import

    response = model_response(model, part, np.zeros(len(model.parameters)) if theta is None else theta)
    rows = _stacked(part.wrench, response.value, response.derivative)
    for run in np.split(rows, 1 if part.continuous else part.repeats, axis=-1):
        yield run, 0


def _stacked(wrench: Array, value: Array, derivative: Array) -> Array:
    """(k + 1, p, n) of (n, p) and (n, p, k)."""
    return np.concatenate([derivative.transpose(2, 1, 0), (wrench - value).T[None]])
