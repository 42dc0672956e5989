"""Workers: independent parts of a diagnosis on several cores, with the same result whatever their number."""

from __future__ import annotations

import gc
import io
import os
import pickle
import signal
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.context import ForkProcess
from typing import Any, TypeVar

from diagnosis.progress import Announce

Item = TypeVar("Item")
Result = TypeVar("Result")

MOST_AT_ONCE = 256
"""Items of one batch, each handed out as one byte of a pipe; longer ones are done by this process alone."""


@dataclass(frozen=True)
class Workers:
    """So many processes: this one, and copies of it (fork) that live as long as one batch of work.

    A copy starts with everything that is in memory, so that nothing has to be sent to it. Where there is no safe copy
    (macOS, Windows, inside another's worker) all is done here.
    """

    count: int = 1

    @classmethod
    def all(cls) -> Workers:
        """One for each core that this process may use."""
        return cls(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1)

    def map(
        self,
        function: Callable[[Item], Result],
        items: Sequence[Item],
        *,
        shared: Iterable[object] = (),
        announce: Announce | None = None,
        keeps: Callable[[Item], bool] | None = None,
    ) -> list[Result]:
        """The function of every item, in their order; whoever is free takes the next one.

        This process begins with the items of which `keeps` is true: what they leave in memory is of use later, and what
        a copy has in memory goes with it. `shared` are objects that results may contain and that come back as
        themselves, not as copies. An exception comes back as it was raised, the first item's first. How many are begun
        of how many is announced. A result that cannot be sent is made here, and so are all of a copy that was killed.
        No copy outlives the call, whatever ends it.
        """
        begun = _unsaid if announce is None else announce
        copies = min(self.count, len(items), MOST_AT_ONCE) - 1
        if copies < 1 or len(items) > MOST_AT_ONCE or not _can_copy():
            return [_announced(function, item, begun, place, len(items)) for place, item in enumerate(items)]
        known = {id(thing): thing for thing in shared}
        queue = _Queue.of([keeps is not None and keeps(item) for item in items])
        context = get_context("fork")
        children: list[tuple[ForkProcess, Connection]] = []
        try:
            for _ in range(copies):
                here, there = context.Pipe(duplex=False)
                readers = [*(reader for _, reader in children), here]
                child = context.Process(target=_work, args=(function, items, queue, there, known, readers), daemon=True)
                child.start()
                there.close()
                children.append((child, here))
            found = dict(_taken(function, items, queue, queue.here, begun))
            for _, here in children:
                found |= _received(here, known)
        except BaseException:  # an interrupt, or an announcement that failed: nobody waits for the others' results
            for child, _ in children:
                child.kill()
            raise
        finally:
            for child, here in children:
                here.close()
                child.join()
            queue.close()
        for place, item in enumerate(items):
            if place not in found:  # whoever had taken it was killed, or could not send it
                found[place] = _tried(function, item)
        return [_result(found[place]) for place in range(len(items))]


@dataclass(frozen=True)
class _Raised:
    """An exception in place of a result."""

    error: Exception


@dataclass(frozen=True)
class _Queue:
    """The places of the items, each a byte in one of two pipes that everybody reads from.

    `here` (a descriptor) has those that the original begins with, `anywhere` those that copies begin with.
    """

    here: int
    anywhere: int

    @classmethod
    def of(cls, here: Sequence[bool]) -> _Queue:
        """Of as many items, and whether the original begins with them."""
        return cls(*(_filled([place for place, own in enumerate(here) if own is first]) for first in (True, False)))

    def next(self, first: int) -> int | None:
        """The next place, of that pipe as long as it has any; None when all are taken."""
        place = os.read(first, 1) or os.read(self.anywhere if first == self.here else self.here, 1)
        return place[0] if place else None

    def left(self) -> int:
        """How many places nobody has taken yet."""
        from fcntl import ioctl
        from termios import FIONREAD

        return sum(
            int.from_bytes(ioctl(pipe, FIONREAD, bytes(4)), sys.byteorder) for pipe in (self.here, self.anywhere)
        )

    def close(self) -> None:
        for pipe in (self.here, self.anywhere):
            os.close(pipe)


def _filled(places: Sequence[int]) -> int:
    """The reading end of a pipe with these bytes in it."""
    read, write = os.pipe()
    os.write(write, bytes(places))
    os.close(write)
    return read


def _can_copy() -> bool:
    from multiprocessing import current_process

    return sys.platform.startswith("linux") and not current_process().daemon


def _unsaid(_begun: int, _total: int) -> None:
    """Announce nothing."""


def _announced(function: Callable[[Item], Result], item: Item, announce: Announce, place: int, total: int) -> Result:
    announce(place, total)
    return function(item)


def _taken(
    function: Callable[[Item], Result], items: Sequence[Item], queue: _Queue, first: int, announce: Announce | None
) -> Iterable[tuple[int, Result | _Raised]]:
    while (place := queue.next(first)) is not None:
        if announce is not None:
            announce(len(items) - queue.left() - 1, len(items))
        yield place, _tried(function, items[place])


def _tried(function: Callable[[Item], Result], item: Item) -> Result | _Raised:
    try:
        return function(item)
    except Exception as error:
        return _Raised(error)


def _result(found: Any) -> Any:
    if isinstance(found, _Raised):
        raise found.error
    return found


def _work(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    queue: _Queue,
    there: Connection,
    known: Mapping[int, object],
    readers: Sequence[Connection],
) -> None:
    """What a copy does; its memory has the shared objects at the addresses of the original's.

    Results are sent when nothing is left to do: a pipe is soon full, and the original reads it after its own work. An
    interrupt is the original's to answer. A copy whose original is gone goes too, after the item that it has begun: no
    copy keeps a pipe's reading end open, so that sending fails instead of waiting for ever.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    gc.disable()  # looking for cycles would touch, and so copy, all the memory that is shared with the original
    original, messages = os.getppid(), []
    for reader in readers:
        reader.close()
    for place, result in _taken(function, items, queue, queue.anywhere, None):
        if os.getppid() != original:
            return
        message = _message(place, result, known)
        if message is not None:
            messages.append(message)
    try:
        for message in messages:
            there.send_bytes(message)
    except OSError:
        return
    there.close()


def _message(place: int, result: object, known: Mapping[int, object]) -> bytes | None:
    """A result as it is sent; None for one that cannot be, or an exception that would not arrive as it is."""
    buffer = io.BytesIO()
    try:
        _Pickler(buffer, known).dump((place, result))
        if isinstance(result, _Raised):
            _Unpickler(io.BytesIO(buffer.getvalue()), known).load()
    except Exception:
        return None
    return buffer.getvalue()


def _received(here: Connection, known: Mapping[int, object]) -> dict[int, Any]:
    """What a copy sent until it ended; one that is killed while it sends leaves part of a message."""
    found: dict[int, Any] = {}
    while True:
        try:
            message = here.recv_bytes()
        except (EOFError, OSError):
            return found
        place, result = _Unpickler(io.BytesIO(message), known).load()
        found[place] = result


class _Pickler(pickle.Pickler):
    def __init__(self, file: io.BytesIO, known: Mapping[int, object]) -> None:
        super().__init__(file, protocol=pickle.HIGHEST_PROTOCOL)
        self._known = known

    def persistent_id(self, thing: object) -> int | None:
        return id(thing) if id(thing) in self._known else None


class _Unpickler(pickle.Unpickler):
    """Of what a copy of this process wrote into a pipe that nobody else has: no file is read."""

    def __init__(self, file: io.BytesIO, known: Mapping[int, object]) -> None:
        super().__init__(file)
        self._known = known

    def persistent_load(self, key: int) -> object:
        return self._known[key]
