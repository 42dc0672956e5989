"""One-pass fit of recordings or chunks by summed square-root information."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import Executor, Future
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from estimation.least_squares.estimates import Estimates, require_positive_mass
from estimation.least_squares.levenberg_marquardt import levenberg_marquardt
from estimation.least_squares.square_root_information import SquareRootInformation
from estimation.parameter_layout import require_known_start
from estimation.recordings.recording import Recording
from estimation.streaming.chunk import Chunk
from estimation.streaming.chunk_information import (
    RecordingOrChunk,
    information_from,
    linear_regressor_map,
    required_signals,
    run_name,
)
from estimation.streaming.long_log import LongLog
from modeling.chain.model import WrenchModel
from modeling.errors import InputError
from modeling.noise import NoiseModel
from modeling.parameter import Parameter
from modeling.rig import Convention, Rig

if TYPE_CHECKING:
    from estimation.least_squares.constraints import Constraints


Array = NDArray[np.float64]
RunKey = str | int

MOST_BLOCKS, FEWEST_BLOCKS = 128, 48
"""Parts of a run whose scatter is looked at; of more, neighbours are joined, so that they are long. With fewer, their
scatter is known to no better than a tenth."""
SMALLEST_VARIANCE = 1e-300
"""That something can be divided by the root of."""
MAX_PENDING_PARTS = 2 * (os.cpu_count() or 1)
"""Parts submitted to an executor and not yet added: two per worker."""


@dataclass(frozen=True, eq=False)
class StreamedFit(Estimates):
    """Parameters of a model estimated from streamed recordings or chunks, under known noise.

    theta       (k,) the model's parameters; its biases, and recording-specific effects, are those of the first run
    covariance  (k, k) for the noise given; `identifiable` (k,) whether a parameter is identifiable
    triangle    square-root information on theta of all parts, the zero of every other run eliminated
    where       name of the first run; `rig` of a recording or a log
    blocks      information on theta of successive parts of the first run; none of a model that is not linear
    """

    model: WrenchModel
    noise: NoiseModel
    theta: Array
    covariance: Array
    identifiable: NDArray[np.bool_]
    converged: bool
    triangle: SquareRootInformation
    where: str
    rig: Rig | None
    blocks: tuple[SquareRootInformation, ...] = ()

    @property
    def unknowns(self) -> tuple[Parameter, ...]:
        """The model's parameters."""
        return self.model.parameters

    @cached_property
    def information(self) -> SquareRootInformation:
        """Square-root information on theta of all parts."""
        return self.triangle

    @property
    def misfit(self) -> float:
        """Reduced chi-square; 1 when the residual is the given noise alone."""
        remaining = self.triangle.shifted(self.theta)
        return remaining.cost / max(remaining.rows - int(self.scaled_svd.regular.sum()), 1)

    @property
    def reduced_chi_square(self) -> float:
        """The same as `misfit`."""
        return self.misfit

    def in_scatter_of_blocks(self, least: Array) -> StreamedFit:
        """The fit with no std below `least` (k,), nor that which the blocks of its run show, whatever colour noise has.

        With g the gradient of a block at theta and C the covariance, it is that of C g over G blocks, each as good as
        independent of the next: C (sum g g') C G / (G - k), as k combinations of the gradients add up to zero. What the
        model lacks scatters, too. Not of fewer than `FEWEST_BLOCKS`.
        """
        std = least
        if len(self.blocks) >= FEWEST_BLOCKS:
            gradients = np.stack([block.root.T @ (block.target - block.root @ self.theta) for block in self.blocks])
            steps, free = gradients @ self.covariance, len(self.blocks) - int(self.identifiable.sum())
            std = np.maximum(std, np.sqrt((steps**2).sum(axis=0) * len(self.blocks) / free))
        stated = np.sqrt(np.maximum(np.diag(self.covariance), SMALLEST_VARIANCE))
        ratio = np.where(self.identifiable, np.maximum(std / stated, 1.0), 1.0)
        return replace(self, covariance=self.covariance * np.outer(ratio, ratio))


class InformationSum:
    """Sum of the information of parts. Every run has its own zero, eliminated for all but the first.

    |R1 b + R2 x - z|² with R upper triangular: without its first rows and columns it is the minimum over b for every x.
    A recording's zero is eliminated at once; for chunks, in any order, one triangle per run is stored to the end.
    """

    def __init__(self, model: WrenchModel, others: WrenchModel) -> None:
        place = {p.name: i for i, p in enumerate(model.parameters)}
        self.size, self.zeros = len(place), len(model.biases)
        self.index = np.array([place[p.name] for p in others.parameters], dtype=np.intp)
        self.first = SquareRootInformation.empty(self.size)
        self.other_recordings = SquareRootInformation.empty(len(self.index) - self.zeros)
        self.other_runs: dict[RunKey, SquareRootInformation] = {}
        self.blocks: list[SquareRootInformation] = []

    def add(self, key: RunKey, is_first: bool, information: SquareRootInformation) -> None:
        """Add the information of a part of that run: a number for a recording, a name for a chunk's run."""
        if is_first:
            self.first = self.first + information
            self.blocks.append(information)
            if len(self.blocks) > MOST_BLOCKS:  # an odd one stays by itself
                pairs = zip(self.blocks[:-1:2], self.blocks[1::2], strict=True)
                self.blocks = [*(one + next_one for one, next_one in pairs), *self.blocks[len(self.blocks) // 2 * 2 :]]
        elif isinstance(key, int):
            self.other_recordings = self.other_recordings + information.eliminated(self.zeros)
        else:
            self.other_runs[key] = self.other_runs[key] + information if key in self.other_runs else information

    def total(self) -> SquareRootInformation:
        """Information of all parts on the model's parameters."""
        others = self.other_recordings
        for information in self.other_runs.values():
            others = others + information.eliminated(self.zeros)
        return self.first + others.spread(self.index[self.zeros :], self.size)


InformationCall = tuple[RecordingOrChunk, WrenchModel, NoiseModel, Array | None]


@dataclass(frozen=True, eq=False)
class StreamedProblem:
    """The least-squares problem of a model and of streamed recordings or chunks."""

    model: WrenchModel
    noise: NoiseModel
    parts: Iterable[RecordingOrChunk]
    executor: Executor | None

    def information(self, theta: Array | None) -> SquareRootInformation:
        """One pass: information of all parts on a step from theta, or on the parameters of a linear model (None)."""
        return self.summed(theta).total()

    def summed(self, theta: Array | None) -> InformationSum:
        """The same before it is added up."""
        model = replace(self.model)  # without its caches, which are long to transfer
        others = replace(model, effects=tuple(e for e in model.effects if not e.per_recording))
        total = InformationSum(model, others)
        at = None if theta is None else theta[total.index]
        first_run: RunKey | None = None
        for key, information in _evaluated(self._calls((model, theta), (others, at)), self.executor):
            first_run = key if first_run is None else first_run
            total.add(key, key == first_run, information)
        return total

    def _calls(
        self, first: tuple[WrenchModel, Array | None], others: tuple[WrenchModel, Array | None]
    ) -> Iterator[tuple[RunKey, InformationCall]]:
        """Run and arguments of `information_from` for every part; the first run has a model of its own."""
        first_run: RunKey | None = None
        needed = {model: required_signals(model) for model, _ in (first, others)}
        for number, source in enumerate(self.parts):
            key: RunKey = source.run if isinstance(source, Chunk) else number
            first_run = key if first_run is None else first_run
            model, theta = first if key == first_run else others
            used = source.with_signals(needed[model]) if isinstance(source, Chunk) else source
            yield key, (used, model, self.noise, theta)


def _evaluated(
    calls: Iterable[tuple[RunKey, InformationCall]], executor: Executor | None
) -> Iterator[tuple[RunKey, SquareRootInformation]]:
    """Information of each part, in order, so that sums do not depend on timing; at most `MAX_PENDING_PARTS` pending."""
    if executor is None:
        yield from ((key, information_from(*call)) for key, call in calls)
        return
    pending: deque[tuple[RunKey, Future[SquareRootInformation]]] = deque()
    try:
        for key, call in calls:
            pending.append((key, executor.submit(information_from, *call)))
            if len(pending) >= MAX_PENDING_PARTS:
                yield pending[0][0], pending.popleft()[1].result()
        while pending:
            yield pending[0][0], pending.popleft()[1].result()
    finally:
        for _, future in pending:
            future.cancel()


def fit_streamed(
    model: WrenchModel,
    recordings: RecordingOrChunk | Iterable[RecordingOrChunk],
    noise: NoiseModel,
    *,
    start: Mapping[str, float] | None = None,
    executor: Executor | None = None,
    constraints: Constraints | None = None,
) -> StreamedFit:
    """`estimate_streamed` of one part or several; InputError for constraints or a negative mass."""
    if constraints is not None:
        what = "a streamed fit does not support constraints"
        raise InputError(what=what, where="constraints", remedy="fit recordings without a NoiseModel")
    parts = (recordings,) if isinstance(recordings, Recording | Chunk) else recordings
    fitted = estimate_streamed(model, parts, noise, start=start, executor=executor)
    require_positive_mass(fitted.parameters["m"], model.convention, fitted.where)
    return fitted


def estimate_streamed(
    model: WrenchModel,
    parts: Iterable[RecordingOrChunk],
    noise: NoiseModel,
    *,
    start: Mapping[str, float] | None = None,
    executor: Executor | None = None,
) -> StreamedFit:
    """Estimate a model's parameters from parts larger than memory: one pass when the model is linear in them.

    Any other takes Levenberg-Marquardt steps, each a pass. Raises InputError when there is no part, when a nonlinear
    model would need another pass over an iterator, when the convention is AUTO, and as `information_from`.
    """
    if isinstance(parts, LongLog):
        parts = parts.with_signals(required_signals(model))
    where, rig, again = _first_and_all(parts)
    if model.convention is Convention.AUTO:
        what = "a streamed fit cannot decide the sign convention"
        remedy = 'state convention = "on_tool" or "on_sensor" under [sensor] in the rig'
        raise InputError(what=what, where=where, remedy=remedy)
    require_known_start(start or (), model, model.parameters)
    is_linear = linear_regressor_map(model) is not None
    if again is not parts and not is_linear:
        what = "the model is not linear in its parameters and needs several passes"
        raise InputError(what=what, where="recordings", remedy="give a sequence, which can be iterated again")
    stream = StreamedProblem(model, noise, again, executor)
    parts_summed = stream.summed(None) if is_linear else None
    linear = None if parts_summed is None else parts_summed.total()
    low, high = (np.array([p.bounds[i] for p in model.parameters]) for i in (0, 1))
    begin = np.array([(start or {}).get(p.name, p.nominal) for p in model.parameters])
    minimum = levenberg_marquardt(stream.information if linear is None else linear.shifted, begin, (low, high))
    return StreamedFit(
        model=model,
        noise=noise,
        theta=minimum.theta,
        covariance=minimum.covariance,
        identifiable=minimum.identifiable,
        converged=minimum.converged,
        triangle=minimum.information,
        where=where,
        rig=rig,
        blocks=() if parts_summed is None else tuple(parts_summed.blocks),
    )


def _first_and_all(parts: Iterable[RecordingOrChunk]) -> tuple[str, Rig | None, Iterable[RecordingOrChunk]]:
    """Name and rig of the first part, and all parts: themselves, or an iterator with the first one prepended."""
    iterator = iter(parts)
    first = next(iterator, None)
    if first is None:
        raise InputError(what="no recording was given", where="recordings", remedy="give at least one")
    rig = parts.rig if isinstance(parts, LongLog) else first.rig if isinstance(first, Recording) else None
    return run_name(first), rig, _prepended([first], iterator) if iterator is parts else parts


def _prepended(first: list[RecordingOrChunk], others: Iterator[RecordingOrChunk]) -> Iterator[RecordingOrChunk]:
    """The first parts, then the others of an iterator; no reference to a yielded part is held."""
    while first:
        yield first.pop(0)
    yield from others
