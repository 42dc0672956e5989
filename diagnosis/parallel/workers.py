"""Forked processes that run one program (SPMD) and share out its batches; results do not depend on their number."""

from __future__ import annotations

import gc
import io
import os
import pickle
import signal
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from math import inf
from mmap import mmap
from multiprocessing import current_process, get_context
from multiprocessing.connection import Connection
from multiprocessing.context import ForkProcess
from time import perf_counter
from typing import Any, Protocol, TypeVar

import numpy as np

from diagnosis.parallel.progress import CountCallback

Item = TypeVar("Item")
Result = TypeVar("Result")

MAX_BATCH = 4096
"""Items of a shared batch; longer batches are computed by every process in full."""
CACHED_BY_OTHERS = 0.2
"""Weight of the time that an item takes where only other processes had its label before: one leaves it to them, unless
it is five times as long as all that is left of its own."""
PR_SET_PDEATHSIG = 1
"""Option of `prctl` (prctl.h of Linux)."""
LARGE_ARRAY = 2**16
"""Bytes of an array that is sent by itself, without the copies that a pickle makes of it."""


def available_cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run_spmd(count: int, program: Callable[[Workers], Result]) -> Result:
    """Run a program in `count` processes (this one and forked copies of it, which end with it); return its result.

    Each runs the whole program (single program, multiple data) and keeps its own caches; only the items given to
    `Workers.map` are shared out. The program must do the same in every process. What copies write to the standard
    streams is lost; interrupts are handled by the original alone. Where forking is not safe (macOS, Windows, inside
    another worker) or fails (no more processes, open files or memory) the program runs in this process only.
    """
    if count < 2 or not _can_fork():
        return program(Workers())
    try:
        claims = _Claims()
    except OSError:
        return program(Workers())
    copies: list[tuple[ForkProcess, Connection]] = []
    try:
        with suppress(OSError):
            for rank in range(1, count):
                copies.append(_forked(program, rank, count, claims, [link for _, link in copies]))
        if len(copies) == count - 1:
            return program(Workers(0, count, claims, _LinksToCopies([link for _, link in copies])))
        _end(copies)
        copies.clear()
        return program(Workers())
    finally:
        _end(copies)
        claims.close()


@dataclass(frozen=True)
class WorkItem:
    """A labelled task of a batch with several kinds of task."""

    label: str
    work: Callable[[], Any]


@dataclass(eq=False)
class Workers:
    """The processes that run one program, as seen by one of them; by default it is the only one.

    rank    its number, 0 for the original
    count   number of processes
    claims  items of the current batch that some process has taken
    links   pipes to the others
    """

    rank: int = 0
    count: int = 1
    claims: _Claims | None = None
    links: _Links | None = None
    _batch: int = 0
    _busy: bool = False
    _times: dict[str, float] = field(default_factory=dict)  # s, by label: the longest of any process
    _own: set[str] = field(default_factory=set)  # labels that this process had: its caches may serve them

    def map(
        self,
        function: Callable[[Item], Result],
        items: Sequence[Item],
        *,
        label: Callable[[Item], str] | None = None,
        guess: Callable[[Item], float] | None = None,
        shared: Sequence[object] = (),
        announce: CountCallback | None = None,
        last: bool = False,
    ) -> list[Result]:
        """The function of every item, in their order; each free process takes the next item (dynamic scheduling).

        A process takes the items first whose `label` took longest before, and prefers those that it had itself, as its
        caches may serve them. Before them come new labels, those of the largest `guess` (in any unit) first; an
        infinite guess holds whatever its label took before. `shared` are objects that results may refer to and that are
        not sent: each process has its own. An exception is raised unchanged in every process, that of the first item
        first. A result that cannot be pickled is computed by each process; items of a killed copy are computed by the
        original, which also announces how many items are begun. The arrays of a result must not be written to
        afterwards: they are sent when the batch is done. With the `last` batch of the program the copies end; the
        original goes on alone.
        """
        begun = announce if announce is not None and self.rank == 0 else _no_announcement
        if self.claims is None or self.links is None or self._busy or not 1 < len(items) <= MAX_BATCH:
            if last:
                self._end_copies()
            return [_announced(function, item, begun, place, len(items)) for place, item in enumerate(items)]
        self._batch += 1
        labels = [str(place) if label is None else label(item) for place, item in enumerate(items)]
        batch = _Batch((self._batch, getattr(function, "__qualname__", ""), *labels), list(shared))
        found: dict[int, Any] = {}
        sent: dict[int, _Packed | None] = {}
        guesses = [0.0 if guess is None else guess(item) for item in items]
        for place in self._order(labels, guesses):
            if self.claims.take(place, self._batch):
                begun(self.claims.taken(len(items), self._batch) - 1, len(items))
                start = perf_counter()
                found[place] = self._tried(function, items[place])
                seconds = perf_counter() - start
                self._own.add(labels[place])
                self._note_time(labels[place], seconds)
                sent[place] = batch.packed(found[place], seconds)
        gathered = self.links.gather(batch, sent)
        if last:
            self._end_copies()
        if self.rank == 0:
            for place in set(range(len(items))).difference(gathered):
                found[place] = self._tried(function, items[place])
                gathered[place] = batch.packed(found[place])
        for place, packed in sorted((gathered if self.links is None else self.links.broadcast(gathered)).items()):
            if place not in found:
                arrived = None if packed is None else batch.unpacked_or_none(packed)
                found[place] = self._tried(function, items[place]) if arrived is None else arrived[0]
                self._note_time(labels[place], 0.0 if packed is None else packed.seconds)
        return [_result(found[place]) for place in range(len(items))]

    def run(self, tasks: Sequence[WorkItem], *, shared: Sequence[object] = (), last: bool = False) -> list[Any]:
        """The result of every task, in their order, computed by `map`."""
        return self.map(lambda task: task.work(), tasks, label=lambda task: task.label, shared=shared, last=last)

    def _order(self, labels: Sequence[str], guesses: Sequence[float]) -> list[int]:
        """Order in which a process takes items: new labels of the largest guess, then labels that took longest.

        Processes that begin at one instant with one item would both take it: of new labels the first copy begins with
        the first, the next with the second, and the original with the last of so many, as it may come later to a batch.
        Items that are expected to take equally long are begun at different places.
        """

        def expected(place: int) -> float:
            if labels[place] not in self._own:
                return CACHED_BY_OTHERS * self._times[labels[place]]
            return inf if guesses[place] == inf else self._times[labels[place]]

        turn = (self.rank - 1) % self.count
        begin = turn * len(labels) // self.count
        everywhere = [*range(begin, len(labels)), *range(begin)]
        new = [place for place, label in enumerate(labels) if label not in self._times]
        new.sort(key=lambda place: -guesses[place])
        known = [place for place in everywhere if labels[place] in self._times]
        return [
            *new[turn : turn + 1],
            *new[:turn],
            *new[turn + 1 :],
            *sorted(known, key=lambda place: -expected(place)),
        ]

    def _end_copies(self) -> None:
        """End this process if it is a copy; the original shares out nothing any more. Not within a shared item."""
        if self.links is None or self._busy:
            return
        if self.rank > 0:
            os._exit(0)
        self.links = None

    def _note_time(self, label: str, seconds: float) -> None:
        self._times[label] = max(seconds, self._times.get(label, 0.0))

    def _tried(self, function: Callable[[Item], Result], item: Item) -> Result | _Raised:
        """The function's result or its exception; a nested batch is computed by this process alone.

        A copy for which memory is short ends instead: the original may have enough without it.
        """
        self._busy = True
        try:
            return function(item)
        except Exception as error:
            if self.rank > 0 and isinstance(error, MemoryError):
                os._exit(1)
            return _Raised(error)
        finally:
            self._busy = False


class _Links(Protocol):
    """A process's pipes to the others: gather and broadcast of one batch after the other.

    Results are by index; None stands for one that cannot be pickled.
    """

    def gather(self, batch: _Batch, sent: dict[int, _Packed | None]) -> dict[int, _Packed | None]:
        """At the original the results of all processes; elsewhere those that were sent."""

    def broadcast(self, gathered: dict[int, _Packed | None]) -> dict[int, _Packed | None]:
        """All results, from the original to every process."""


@dataclass(eq=False)
class _LinksToCopies:
    """The original's pipes; a copy that was killed, or that runs another batch, is dropped."""

    links: list[Connection]
    _had: dict[Connection, set[int]] = field(default_factory=dict)

    def gather(self, batch: _Batch, sent: dict[int, _Packed | None]) -> dict[int, _Packed | None]:
        gathered = dict(sent)
        for link in list(self.links):
            try:
                name, made = _receive(link)
            except (EOFError, OSError):
                name, made = None, {}
            if name == batch.name:
                self._had[link] = set(made)
                gathered |= made
            else:
                self.links.remove(link)
        return gathered

    def broadcast(self, gathered: dict[int, _Packed | None]) -> dict[int, _Packed | None]:
        for link in list(self.links):
            try:
                _send(link, {p: made for p, made in gathered.items() if p not in self._had[link]})
            except OSError:
                self.links.remove(link)
        return gathered


@dataclass(eq=False)
class _LinkToOriginal:
    """A copy's pipe; the copy exits when the original has ended or has dropped it."""

    link: Connection

    def gather(self, batch: _Batch, sent: dict[int, _Packed | None]) -> dict[int, _Packed | None]:
        try:
            _send(self.link, (batch.name, sent))
        except OSError:
            os._exit(0)
        return sent

    def broadcast(self, gathered: dict[int, _Packed | None]) -> dict[int, _Packed | None]:
        try:
            others: dict[int, _Packed | None] = _receive(self.link)
        except (EOFError, OSError):
            os._exit(0)
        return gathered | others


class _Claims:
    """Items of a batch that some process has taken, in shared memory.

    Two processes that take an item at the same instant both compute it: the same result, a little later.
    """

    def __init__(self) -> None:
        self._memory = mmap(-1, 4 * MAX_BATCH)
        self._slots = memoryview(self._memory).cast("I")

    def take(self, place: int, batch: int) -> bool:
        """Take an item of a batch; False if it is taken already."""
        if self._slots[place] == batch:
            return False
        self._slots[place] = batch
        return True

    def taken(self, total: int, batch: int) -> int:
        """Number of a batch's items that are taken."""
        return sum(slot == batch for slot in self._slots[:total])

    def close(self) -> None:
        """Release the shared memory."""
        self._slots.release()
        self._memory.close()


@dataclass(frozen=True)
class _Batch:
    """Identity of one `map` call across processes, and serialisation of its results.

    name    equal in all processes that run the same batch
    shared  objects that results refer to by their index in this list
    """

    name: tuple[int | str, ...]
    shared: list[object]

    def packed(self, result: object, seconds: float = 0.0) -> _Packed | None:
        """A result that took so long, pickled; None for one that cannot be, or an exception that would not unpickle."""
        file, buffers = io.BytesIO(), _Buffers()
        try:
            _Pickler(file, buffers, {id(thing): place for place, thing in enumerate(self.shared)}).dump(result)
            packed = _Packed(file.getvalue(), buffers.large, seconds)
            if isinstance(result, _Raised):
                self.unpacked(packed)
        except Exception:
            return None
        return packed

    def unpacked_or_none(self, packed: _Packed) -> tuple[Any] | None:
        """A result unpickled, in a tuple; None for one that cannot be."""
        try:
            return (self.unpacked(packed),)
        except Exception:
            return None

    def unpacked(self, packed: _Packed) -> Any:
        """A result unpickled."""
        return _Unpickler(packed, self.shared).load()


@dataclass(frozen=True)
class _Packed:
    """A pickled result that took so many seconds; its large arrays are not copied into the pickle, but follow it."""

    pickled: bytes
    arrays: Sequence[memoryview]
    seconds: float = 0.0

    def __reduce__(self) -> tuple[object, ...]:
        return _Packed, (self.pickled, [pickle.PickleBuffer(array) for array in self.arrays], self.seconds)


@dataclass(frozen=True)
class _Buffers:
    """The large buffers of a pickle, which the pickler leaves out of it where this returns False (PEP 574)."""

    large: list[memoryview] = field(default_factory=list)

    def __call__(self, buffer: pickle.PickleBuffer) -> bool:
        view = buffer.raw()
        if view.nbytes < LARGE_ARRAY:
            return True
        self.large.append(view)
        return False


def _send(link: Connection, message: object) -> None:
    """Send a message: its pickle with the sizes of its large buffers, then each of them."""
    buffers = _Buffers()
    pickled = pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL, buffer_callback=buffers)
    link.send((pickled, [view.nbytes for view in buffers.large]))
    for view in buffers.large:
        link.send_bytes(view)


def _receive(link: Connection) -> Any:
    """The next message; EOFError or OSError where the other end was closed."""
    pickled, sizes = link.recv()
    buffers = [np.empty(size, dtype=np.uint8).data for size in sizes]
    for buffer in buffers:
        link.recv_bytes_into(buffer)
    return _Unpickler(_Packed(pickled, buffers), ()).load()


class _Pickler(pickle.Pickler):
    def __init__(self, file: io.BytesIO, buffers: _Buffers, places: Mapping[int, int]) -> None:
        super().__init__(file, protocol=pickle.HIGHEST_PROTOCOL, buffer_callback=buffers)
        self._places = places

    def persistent_id(self, thing: object) -> int | None:
        return self._places.get(id(thing))


class _Unpickler(pickle.Unpickler):
    """Reads only what a copy of this process wrote into a private pipe, never a file."""

    def __init__(self, packed: _Packed, shared: Sequence[object]) -> None:
        super().__init__(io.BytesIO(packed.pickled), buffers=packed.arrays)
        self._shared = shared

    def persistent_load(self, place: int) -> object:
        return self._shared[place]


@dataclass(frozen=True)
class _Raised:
    """An exception in place of a result."""

    error: Exception


def _forked(
    program: Callable[[Workers], object], rank: int, count: int, claims: _Claims, earlier: Sequence[Connection]
) -> tuple[ForkProcess, Connection]:
    """A copy of this process that runs the program, and the pipe to it; OSError where there can be none."""
    context = get_context("fork")
    here, there = context.Pipe()
    try:
        member = Workers(rank, count, claims, _LinkToOriginal(there))
        arguments = (program, member, [*earlier, here], os.getpid())
        copy = context.Process(target=_run_copy, args=arguments, daemon=True)
        copy.start()
    except OSError:
        here.close()
        raise
    finally:
        there.close()
    return copy, here


def _end(copies: Sequence[tuple[ForkProcess, Connection]]) -> None:
    for copy, _ in copies:
        copy.kill()
    for copy, link in copies:
        copy.join()
        link.close()


def _run_copy(
    program: Callable[[Workers], object], member: Workers, inherited: Sequence[Connection], original: int
) -> None:
    """Body of a forked copy.

    It closes inherited pipe ends, so that every copy notices the end of the original, and excludes inherited objects
    from garbage collection, which would touch and so copy all their memory pages.
    """
    _end_with(original)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    gc.freeze()
    for link in inherited:
        link.close()
    with open(os.devnull, "w") as nowhere:
        sys.stdout = sys.stderr = nowhere
        try:
            program(member)
        finally:
            os._exit(0)  # open files and buffers belong to the original


def _end_with(original: int) -> None:
    """Let the system kill this copy when the thread of the original that forked it has ended, in whatever way."""
    from ctypes import CDLL

    prctl = getattr(CDLL(None), "prctl", None)
    if prctl is not None:
        prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != original:
        os._exit(0)


def _can_fork() -> bool:
    return sys.platform.startswith("linux") and not current_process().daemon


def _no_announcement(_begun: int, _total: int) -> None:
    """Announce nothing."""


def _announced(
    function: Callable[[Item], Result], item: Item, announce: CountCallback, place: int, total: int
) -> Result:
    announce(place, total)
    return function(item)


def _result(found: Any) -> Any:
    if isinstance(found, _Raised):
        raise found.error
    return found
