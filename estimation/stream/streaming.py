"""Streaming: a fit over any number of parts in one pass, in the memory of a few, wherever they are worked on."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import Executor, Future
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from estimation.linear.descent import minimise
from estimation.linear.estimate import Estimates
from estimation.linear.square_root import SquareRoot
from estimation.recording import Recording
from estimation.stream.chunk import Chunk
from estimation.stream.long_log import LongLog
from estimation.stream.noise_model import NoiseModel
from estimation.stream.regressor_map import inputs_of, linear
from estimation.stream.statistics import Part, information_of, name_of
from estimation.weight import require_positive
from modeling.errors import InputError
from modeling.model import WrenchModel
from modeling.parameter import Parameter
from modeling.rig import Convention, Rig

if TYPE_CHECKING:
    from estimation.constrained import Constraints

Array = NDArray[np.float64]
Key = str | int

IN_FLIGHT = 2 * (os.cpu_count() or 1)
"""Parts handed to an executor and not yet added: each worker has one more waiting."""


@dataclass(frozen=True, eq=False)
class StreamedFit(Estimates):
    """A model with its parameters estimated from parts that were not kept, under noise that was known beforehand.

    theta       (k,) the model's parameters; its biases, and effects that belong to one run, are the first run's
    covariance  (k, k) for the noise given; `shown` (k,) whether the parts tell a parameter apart from all others
    triangle    what all parts say of theta, the zero of every other run eliminated
    where       name of the first run, and `rig` of a recording or a log
    """

    model: WrenchModel
    noise: NoiseModel
    theta: Array
    covariance: Array
    shown: NDArray[np.bool_]
    converged: bool
    triangle: SquareRoot
    where: str
    rig: Rig | None

    @property
    def unknowns(self) -> tuple[Parameter, ...]:
        """The model's parameters."""
        return self.model.parameters

    @property
    def information(self) -> SquareRoot:
        """What all parts say of theta, in one triangle."""
        return self.triangle

    @property
    def misfit(self) -> float:
        """Whitened chi-square over its degrees of freedom; 1 when nothing but the noise given is left."""
        left = self.triangle.moved(self.theta)
        return left.cost / max(left.rows - int(self.sight.seen.sum()), 1)


class Ledger:
    """Adds up what parts say. Every run has its own zero, and that of all but the first is eliminated.

    |R1 b + R2 x - z|² with R upper triangular: without its first rows and columns it is the least over b for every x.
    A recording's zero goes at once; of chunks, which may come in any order, one triangle per run is kept to the end.
    """

    def __init__(self, model: WrenchModel, others: WrenchModel) -> None:
        place = {p.name: i for i, p in enumerate(model.parameters)}
        self.size, self.zeros = len(place), len(model.biases)
        self.index = np.array([place[p.name] for p in others.parameters], dtype=np.intp)
        self.first = SquareRoot.nothing(self.size)
        self.rest = SquareRoot.nothing(len(self.index) - self.zeros)
        self.open: dict[Key, SquareRoot] = {}

    def add(self, key: Key, home: bool, found: SquareRoot) -> None:
        """Add what a part of that run says: a number for a recording, a name for a chunk's run."""
        if home:
            self.first = self.first + found
        elif isinstance(key, int):
            self.rest = self.rest + found.eliminated(self.zeros)
        else:
            self.open[key] = self.open[key] + found if key in self.open else found

    def total(self) -> SquareRoot:
        """What all parts say of the model's parameters."""
        rest = self.rest
        for found in self.open.values():
            rest = rest + found.eliminated(self.zeros)
        return self.first + rest.spread(self.index[self.zeros :], self.size)


Call = tuple[Part, WrenchModel, NoiseModel, Array | None]


@dataclass(frozen=True, eq=False)
class Stream:
    """The least-squares problem of a model and of parts that pass by."""

    model: WrenchModel
    noise: NoiseModel
    parts: Iterable[Part]
    executor: Executor | None

    def information(self, theta: Array | None) -> SquareRoot:
        """One pass: what all parts say of a step from theta, or of the parameters of a linear model (None)."""
        model = replace(self.model)  # without all that it has derived already, which is long to send
        others = replace(model, effects=tuple(e for e in model.effects if not e.per_recording))
        ledger = Ledger(model, others)
        at = None if theta is None else theta[ledger.index]
        home: Key | None = None
        for key, found in _worked_on(self._calls((model, theta), (others, at)), self.executor):
            home = key if home is None else home
            ledger.add(key, key == home, found)
        return ledger.total()

    def _calls(
        self, first: tuple[WrenchModel, Array | None], others: tuple[WrenchModel, Array | None]
    ) -> Iterator[tuple[Key, Call]]:
        """Run and arguments of `information_of` for every part; the first run has a model of its own."""
        home: Key | None = None
        needed = {model: inputs_of(model) for model, _ in (first, others)}
        for number, part in enumerate(self.parts):
            key: Key = part.run if isinstance(part, Chunk) else number
            home = key if home is None else home
            model, theta = first if key == home else others
            yield key, (part.needing(needed[model]) if isinstance(part, Chunk) else part, model, self.noise, theta)


def _worked_on(calls: Iterable[tuple[Key, Call]], executor: Executor | None) -> Iterator[tuple[Key, SquareRoot]]:
    """What each part says, in their order, so that sums do not depend on who is quickest; few are held at once."""
    if executor is None:
        yield from ((key, information_of(*call)) for key, call in calls)
        return
    waiting: deque[tuple[Key, Future[SquareRoot]]] = deque()
    try:
        for key, call in calls:
            waiting.append((key, executor.submit(information_of, *call)))
            if len(waiting) >= IN_FLIGHT:
                yield waiting[0][0], waiting.popleft()[1].result()
        while waiting:
            yield waiting[0][0], waiting.popleft()[1].result()
    finally:
        for _, future in waiting:
            future.cancel()


def fit_parts(
    model: WrenchModel,
    recordings: Part | Iterable[Part],
    noise: NoiseModel,
    *,
    start: Mapping[str, float] | None = None,
    executor: Executor | None = None,
    constraints: Constraints | None = None,
) -> StreamedFit:
    """`streamed` of one part or of several, refused where the mass comes out negative, or under constraints."""
    if constraints is not None:
        what = "parts that are not kept cannot be fitted under constraints"
        raise InputError(what=what, where="constraints", remedy="fit recordings without a NoiseModel")
    parts = (recordings,) if isinstance(recordings, Recording | Chunk) else recordings
    passed = streamed(model, parts, noise, start=start, executor=executor)
    require_positive(passed.parameters["m"], model.convention, passed.where)
    return passed


def streamed(
    model: WrenchModel,
    parts: Iterable[Part],
    noise: NoiseModel,
    *,
    start: Mapping[str, float] | None = None,
    executor: Executor | None = None,
) -> StreamedFit:
    """Estimate a model's parameters from parts that need not fit into memory: one pass when it is linear in them.

    Any other takes Gauss-Newton steps, each a pass. Raises InputError when there is no part, when a model that is not
    linear would need another pass over an iterator, when the convention is left to the data, and as `information_of`.
    """
    if isinstance(parts, LongLog):
        parts = parts.needing(inputs_of(model))
    where, rig, again = _begun(parts)
    if model.convention is Convention.AUTO:
        what = "parts that pass by cannot decide the sign convention"
        remedy = 'state convention = "on_tool" or "on_sensor" under [sensor] in the rig'
        raise InputError(what=what, where=where, remedy=remedy)
    is_linear = linear(model) is not None
    if again is not parts and not is_linear:
        what = "the model is not linear in its parameters and needs several passes"
        raise InputError(what=what, where="recordings", remedy="give a sequence, which can be gone through again")
    stream = Stream(model, noise, again, executor)
    known = stream.information(None) if is_linear else None
    low, high = (np.array([p.bounds[i] for p in model.parameters]) for i in (0, 1))
    begin = np.array([(start or {}).get(p.name, p.nominal) for p in model.parameters])
    found = minimise(stream.information if known is None else known.moved, begin, (low, high))
    return StreamedFit(
        model=model,
        noise=noise,
        theta=found.theta,
        covariance=found.covariance,
        shown=found.shown,
        converged=found.converged,
        triangle=found.information,
        where=where,
        rig=rig,
    )


def _begun(parts: Iterable[Part]) -> tuple[str, Rig | None, Iterable[Part]]:
    """Name and rig of the first part, and all parts: themselves, or an iterator that gives the first one again."""
    passes = iter(parts)
    first = next(passes, None)
    if first is None:
        raise InputError(what="no recording was given", where="recordings", remedy="give at least one")
    rig = parts.rig if isinstance(parts, LongLog) else first.rig if isinstance(first, Recording) else None
    return name_of(first), rig, _resumed([first], passes) if passes is parts else parts


def _resumed(taken: list[Part], passes: Iterator[Part]) -> Iterator[Part]:
    """Parts that were taken from an iterator already, then the rest; nothing that has passed is held on to."""
    while taken:
        yield taken.pop(0)
    yield from passes
