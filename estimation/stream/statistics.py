"""Statistics of a part: what a recording or a chunk says of the parameters, in one triangle, under known noise."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from estimation.linear.square_root import SquareRoot
from estimation.recording import Recording
from estimation.stream.chunk import Chunk, chunks
from estimation.stream.noise_model import NoiseModel
from estimation.stream.regressor_map import RegressorMap, linear
from modeling.errors import InputError
from modeling.model import WrenchModel

Array = NDArray[np.float64]
Part = Recording | Chunk

PIECE = 8192
"""Samples that are worked on at once: their rows stay in a processor's cache, and memory does not grow with parts."""


def information_of(part: Part, model: WrenchModel, noise: NoiseModel, theta: Array | None) -> SquareRoot:
    """What a part says of the model's parameters; of a step from theta, unless None for a model that is linear.

    Raises InputError when it lacks a signal, has other channels, memory that a chunk does not carry, too little
    history for the noise, or a value that is not finite.
    """
    require_channels(part, model, noise)
    map_ = linear(model) if theta is None else None
    total = SquareRoot.nothing(len(model.parameters))
    if map_ is not None and noise.is_white:
        for run in _runs(part):
            _require_signals(run, map_.inputs)
            total = total + map_.information(run.signals, run.wrench, noise.root)
    else:
        for rows, history in _series(part, model, noise, theta, map_):
            white = noise.whitened(rows, history)
            if white.shape[-1]:
                total = total + SquareRoot.of(white[:-1].reshape(len(white) - 1, -1).T, white[-1].ravel())
    if not np.isfinite(total.cost + total.root.sum()):
        what = "a signal or a reading is not finite"
        raise InputError(what=what, where=name_of(part), remedy="leave such rows out, or begin a new run after them")
    return total


def name_of(part: Part) -> str:
    """The recording's name or the chunk's run."""
    return part.name if isinstance(part, Recording) else part.run


def require_channels(part: Part, model: WrenchModel, noise: NoiseModel) -> None:
    """Raise InputError when part, model and noise do not speak of the same channels, or a chunk's history is short."""
    count = len(model.channels)
    if part.wrench.shape[1] != count or (isinstance(part, Recording) and part.channels != model.channels):
        what = f"it has {part.wrench.shape[1]} channels, the model {', '.join(model.channels)}"
        remedy = "use planar() for fx, fy, tau and spatial() for six axes"
        raise InputError(what=what, where=name_of(part), remedy=remedy)
    if len(noise.covariance) != count:
        what = f"the noise has {len(noise.covariance)} channels and the model {count}"
        raise InputError(what=what, where="noise", remedy=f"give it for {', '.join(model.channels)}")
    if isinstance(part, Chunk) and (0 < part.history < noise.memory or part.history % noise.block):
        what = f"its {part.history} rows of history are not the {noise.memory} that the noise remembers"
        raise InputError(what=what, where=part.run, remedy=f"cut chunks with an overlap of {noise.memory}")


def _runs(part: Part) -> Iterator[Chunk]:
    """The samples after the history, each run of a recording at once."""
    if isinstance(part, Chunk):
        yield part.part(part.history, len(part.wrench)) if part.history else part
    else:
        yield from chunks(part, part.samples)


def _series(
    part: Part, model: WrenchModel, noise: NoiseModel, theta: Array | None, map_: RegressorMap | None
) -> Iterator[tuple[Array, int]]:
    """Derivative in each parameter and, last, measured minus predicted, (k + 1, p, n), stretch by stretch."""
    if map_ is None and not _instantaneous(model):
        yield from _remembered(part, model, theta)
        return
    size = PIECE // noise.block * noise.block + noise.block  # not below the memory either
    size = max(size, noise.memory)
    cut = part.pieces(size, noise.memory) if isinstance(part, Chunk) else chunks(part, size, noise.memory)
    for piece in cut:
        if map_ is not None:
            _require_signals(piece, map_.inputs)
            rows = map_(piece.signals, len(piece.wrench))
            rows[-1] = piece.wrench.T - rows[-1]
            yield rows, piece.history
        else:
            yield _rows(piece, model, theta), piece.history


def _instantaneous(model: WrenchModel) -> bool:
    from modeling.prediction import compiled  # slow to import

    return compiled(model).instantaneous


def _require_signals(piece: Chunk, inputs: Iterable[str]) -> None:
    """Raise InputError when a chunk lacks one of these signals."""
    for name in inputs:
        if name not in piece.signals:
            remedy = "record it, or leave the effect out"
            raise InputError(what=f"the model needs the signal '{name}'", where=piece.run, remedy=remedy)


def _rows(piece: Chunk, model: WrenchModel, theta: Array | None) -> Array:
    from modeling.prediction import compiled  # slow to import

    samples, prediction = len(piece.wrench), compiled(model)
    _require_signals(piece, model.inputs)
    at = np.zeros(len(model.parameters)) if theta is None else theta
    parts = [e.tangent(piece.signals, at, samples) for e in (prediction.load, prediction.zero)]
    return _stacked(piece.wrench, parts[0][0] + parts[1][0], parts[0][1] + parts[1][1])


def _remembered(part: Part, model: WrenchModel, theta: Array | None) -> Iterator[tuple[Array, int]]:
    """Of a recording whose model remembers: its whole series at once, and separate runs apart."""
    if isinstance(part, Chunk):
        what = "the model remembers what came before a chunk, and a chunk does not carry it"
        raise InputError(what=what, where=part.run, remedy="give whole recordings, or leave that effect out")
    from estimation.response import respond  # slow to import

    response = respond(model, part, np.zeros(len(model.parameters)) if theta is None else theta)
    rows = _stacked(part.wrench, response.value, response.derivative)
    for run in np.split(rows, 1 if part.continuous else part.repeats, axis=-1):
        yield run, 0


def _stacked(wrench: Array, value: Array, derivative: Array) -> Array:
    """(k + 1, p, n) of (n, p) and (n, p, k)."""
    return np.concatenate([derivative.transpose(2, 1, 0), (wrench - value).T[None]])
