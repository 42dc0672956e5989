"""Workers: processes that run one program in step and share out its long parts, with the same result at any number."""

from __future__ import annotations

import gc
import io
import os
import pickle
import signal
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from mmap import mmap
from multiprocessing import current_process, get_context
from multiprocessing.connection import Connection
from multiprocessing.context import ForkProcess
from time import perf_counter
from typing import Any, Protocol, TypeVar

from diagnosis.progress import Announce

Item = TypeVar("Item")
Result = TypeVar("Result")

MOST_AT_ONCE = 4096
"""Items of one batch; longer ones are done by every process alone."""


def cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def in_step(count: int, program: Callable[[Workers], Result]) -> Result:
    """What a program returns that so many processes run: this one, and copies of it (fork) that end with it.

    Each runs the whole program (single program, multiple data), and what it has prepared stays with it; only what is
    given to `Workers.map` is shared out. The program must do the same in every process. What copies write to the
    standard streams is lost; interrupts are left to the original. Where there is no safe copy (macOS, Windows, inside
    another's worker) the program runs here alone.
    """
    if count < 2 or not _can_copy():
        return program(Workers())
    context, claims = get_context("fork"), _Claims()
    copies: list[tuple[ForkProcess, Connection]] = []
    try:
        for rank in range(1, count):
            here, there = context.Pipe()
            member = Workers(rank, count, claims, _ToOriginal(there))
            not_its_own = [*(link for _, link in copies), here]
            copy = context.Process(target=_follow, args=(program, member, not_its_own), daemon=True)
            copy.start()
            there.close()
            copies.append((copy, here))
        return program(Workers(0, count, claims, _ToCopies([link for _, link in copies])))
    finally:
        for copy, _ in copies:
            copy.kill()
        for copy, link in copies:
            copy.join()
            link.close()
        claims.close()


@dataclass(frozen=True)
class Task:
    """A piece of work by its label, where one batch has several kinds."""

    label: str
    work: Callable[[], Any]


@dataclass(eq=False)
class Workers:
    """The processes that run a program in step, as one of them sees them; by default it is alone.

    rank    its number, 0 for the original
    count   how many they are
    claims  which items of a batch are taken
    links   to the others
    """

    rank: int = 0
    count: int = 1
    claims: _Claims | None = None
    links: _Links | None = None
    _batch: int = 0
    _busy: bool = False
    _mine: dict[str, float] = field(default_factory=dict)
    _others: set[str] = field(default_factory=set)

    def map(
        self,
        function: Callable[[Item], Result],
        items: Sequence[Item],
        *,
        label: Callable[[Item], str] | None = None,
        shared: Sequence[object] = (),
        announce: Announce | None = None,
    ) -> list[Result]:
        """The function of every item, in their order; whoever is free takes the next one.

        A process begins with items of a `label` that it had before: it may have kept something for them. `shared` are
        objects that results may contain, and that are not sent: each process has its own. An exception is raised as it
        was, in every process, the first item's first. A result that cannot be sent is made by each; what a killed copy
        had begun is made by the original, which also announces how many of how many are begun.
        """
        begun = announce if announce is not None and self.rank == 0 else _unsaid
        if self.claims is None or self.links is None or self._busy or not 1 < len(items) <= MOST_AT_ONCE:
            return [_announced(function, item, begun, place, len(items)) for place, item in enumerate(items)]
        self._batch += 1
        labels = [str(place) if label is None else label(item) for place, item in enumerate(items)]
        batch = _Batch((self._batch, getattr(function, "__qualname__", ""), *labels), list(shared))
        found: dict[int, Any] = {}
        sent: dict[int, bytes | None] = {}
        for place in self._order(labels):
            if self.claims.take(place, self._batch):
                begun(self.claims.taken(len(items), self._batch) - 1, len(items))
                start = perf_counter()
                found[place] = self._tried(function, items[place])
                if labels[place] not in self._others:
                    self._mine[labels[place]] = perf_counter() - start
                sent[place] = batch.packed(found[place])
        gathered = self.links.gather(batch, sent)
        if self.rank == 0:
            for place in set(range(len(items))).difference(gathered):
                found[place] = self._tried(function, items[place])
                gathered[place] = batch.packed(found[place])
        for place, packed in sorted(self.links.broadcast(gathered).items()):
            if place not in found:
                self._others.update({labels[place]} - self._mine.keys())
                found[place] = self._tried(function, items[place]) if packed is None else batch.unpacked(packed)
        return [_result(found[place]) for place in range(len(items))]

    def run(self, tasks: Sequence[Task], *, shared: Sequence[object] = ()) -> list[Any]:
        """The result of every task, in their order, as `map` has it."""
        return self.map(lambda task: task.work(), tasks, label=lambda task: task.label, shared=shared)

    def _order(self, labels: Sequence[str]) -> list[int]:
        """The places as a process takes them: those it may have kept something for, the longest first; new; others'."""
        begin = self.rank * len(labels) // self.count
        rotated = [*range(begin, len(labels)), *range(begin)]
        return sorted(rotated, key=lambda p: (-self._mine.get(labels[p], 0.0), labels[p] in self._others))

    def _tried(self, function: Callable[[Item], Result], item: Item) -> Result | _Raised:
        """The function's result or what it raised; a batch within it is done by this process alone."""
        self._busy = True
        try:
            return function(item)
        except Exception as error:
            return _Raised(error)
        finally:
            self._busy = False


class _Links(Protocol):
    """A process's links to those in step with it, for one batch after the other.

    Results are by place; None stands for one that cannot be sent.
    """

    def gather(self, batch: _Batch, sent: dict[int, bytes | None]) -> dict[int, bytes | None]:
        """Bring together at the original what each has made; elsewhere what was sent."""

    def broadcast(self, gathered: dict[int, bytes | None]) -> dict[int, bytes | None]:
        """All results, from the original to everybody."""


@dataclass(eq=False)
class _ToCopies:
    """The original's links: a copy that was killed, or that is not in step, is let go."""

    links: list[Connection]
    _had: dict[Connection, set[int]] = field(default_factory=dict)

    def gather(self, batch: _Batch, sent: dict[int, bytes | None]) -> dict[int, bytes | None]:
        gathered = dict(sent)
        for link in list(self.links):
            try:
                name, made = link.recv()
            except (EOFError, OSError):
                name, made = None, {}
            if name == batch.name:
                self._had[link] = set(made)
                gathered |= made
            else:
                self.links.remove(link)
        return gathered

    def broadcast(self, gathered: dict[int, bytes | None]) -> dict[int, bytes | None]:
        for link in list(self.links):
            try:
                link.send({p: made for p, made in gathered.items() if p not in self._had[link]})
            except OSError:
                self.links.remove(link)
        return gathered


@dataclass(eq=False)
class _ToOriginal:
    """A copy's link; the copy ends when the original has ended or has let it go."""

    link: Connection

    def gather(self, batch: _Batch, sent: dict[int, bytes | None]) -> dict[int, bytes | None]:
        try:
            self.link.send((batch.name, sent))
        except OSError:
            os._exit(0)
        return sent

    def broadcast(self, gathered: dict[int, bytes | None]) -> dict[int, bytes | None]:
        try:
            others: dict[int, bytes | None] = self.link.recv()
        except (EOFError, OSError):
            os._exit(0)
        return gathered | others


class _Claims:
    """Which items of a batch are taken, in memory that all processes have in common.

    Two that take an item at the same instant both make it: the same result, a little later.
    """

    def __init__(self) -> None:
        self._memory = mmap(-1, 4 * MOST_AT_ONCE)
        self._slots = memoryview(self._memory).cast("I")

    def take(self, place: int, batch: int) -> bool:
        """Take an item of a batch, unless somebody has."""
        if self._slots[place] == batch:
            return False
        self._slots[place] = batch
        return True

    def taken(self, total: int, batch: int) -> int:
        """How many of a batch's items are taken."""
        return sum(slot == batch for slot in self._slots[:total])

    def close(self) -> None:
        """Give the memory back."""
        self._slots.release()
        self._memory.close()


@dataclass(frozen=True)
class _Batch:
    """What one `map` is known by to all processes, and how its results are sent.

    name    equal in processes that are in step
    shared  objects that results refer to by their place in this list
    """

    name: tuple[int | str, ...]
    shared: list[object]

    def packed(self, result: object) -> bytes | None:
        """A result as it is sent; None for one that cannot be, or an exception that would not arrive as it is."""
        buffer = io.BytesIO()
        try:
            _Pickler(buffer, {id(thing): place for place, thing in enumerate(self.shared)}).dump(result)
            if isinstance(result, _Raised):
                self.unpacked(buffer.getvalue())
        except Exception:
            return None
        return buffer.getvalue()

    def unpacked(self, packed: bytes) -> Any:
        """A result as it was made."""
        return _Unpickler(io.BytesIO(packed), self.shared).load()


class _Pickler(pickle.Pickler):
    def __init__(self, file: io.BytesIO, places: Mapping[int, int]) -> None:
        super().__init__(file, protocol=pickle.HIGHEST_PROTOCOL)
        self._places = places

    def persistent_id(self, thing: object) -> int | None:
        return self._places.get(id(thing))


class _Unpickler(pickle.Unpickler):
    """Of what a copy of this process wrote into a pipe that nobody else has: no file is read."""

    def __init__(self, file: io.BytesIO, shared: Sequence[object]) -> None:
        super().__init__(file)
        self._shared = shared

    def persistent_load(self, place: int) -> object:
        return self._shared[place]


@dataclass(frozen=True)
class _Raised:
    """An exception in place of a result."""

    error: Exception


def _follow(program: Callable[[Workers], object], member: Workers, not_its_own: Sequence[Connection]) -> None:
    """What a copy does.

    It keeps no end of a link that is not its own, so that everybody notices when the original is gone. What it has from
    the original is not looked through for cycles: that would touch, and so copy, all of it.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    gc.freeze()
    for link in not_its_own:
        link.close()
    with open(os.devnull, "w") as nowhere:
        sys.stdout = sys.stderr = nowhere
        try:
            program(member)
        finally:
            os._exit(0)  # what it has open and buffered is the original's


def _can_copy() -> bool:
    return sys.platform.startswith("linux") and not current_process().daemon


def _unsaid(_begun: int, _total: int) -> None:
    """Announce nothing."""


def _announced(function: Callable[[Item], Result], item: Item, announce: Announce, place: int, total: int) -> Result:
    announce(place, total)
    return function(item)


def _result(found: Any) -> Any:
    if isinstance(found, _Raised):
        raise found.error
    return found
