"""Process of one page that does the numerical work: the page stays quick, and what takes long can be cancelled."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import traceback
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from queue import SimpleQueue
from threading import Lock, Thread
from typing import Any

from diagnosis.study import Study
from modeling.errors import InputError
from truewrench.workbench.study_actions import StudyActions

Request = Mapping[str, Any]
"""What the page asks for: `do` names it, the rest are its arguments."""
GRACE = 5.0
"""Seconds after which a process that does not stop is ended."""
LEAST_MEMORY = 4 << 30
"""Bytes of addresses that a process may have on any machine: libraries reserve more than they use."""
AGAIN = 0.1
"""Seconds after which what was cancelled and goes on is cancelled again: Python drops exceptions within finalisers, and
in what it runs right after a fork, which is where it handles a signal that came during the fork."""
CANCEL = getattr(signal, "SIGUSR1", None)
"""Signal that cancels; where the system has none, the process is ended."""


@dataclass(frozen=True)
class Started:
    """The process takes requests, and can be cancelled."""


@dataclass(frozen=True)
class Progress:
    """A stage of the work, in words."""

    text: str


@dataclass(frozen=True)
class Done:
    """The answer."""

    answer: Any


@dataclass(frozen=True)
class Refused:
    """What is wrong, where, and the remedy."""

    what: str
    where: str
    remedy: str


@dataclass(frozen=True)
class Cancelled:
    """The work was cancelled; the study is as before."""


@dataclass(frozen=True)
class Ended:
    """The process is no more, and with it the study."""


Message = Started | Progress | Done | Refused | Cancelled | Ended


class CancelRequest(BaseException):
    """Raised within the work by the signal that cancels."""


# ------------------------------------------------------------------------------------- in the page's process


def prepare() -> None:
    """Import once what every process needs, in a server process that the others are forked from."""
    context = _context()
    if context.get_start_method() == "forkserver":
        context.set_forkserver_preload(["truewrench.workbench.study_actions"])
        from multiprocessing.forkserver import ensure_running

        ensure_running()


def _context() -> Any:
    return get_context("forkserver" if sys.platform != "win32" else "spawn")


class StudyProcess:
    """The process of one page, from the page's side.

    Parameters
    ----------
    receive : callable
        Called with each message, in a thread of its own.
    """

    def __init__(self, receive: Callable[[Message], None]) -> None:
        context = _context()
        self._connection, self._other = context.Pipe()
        self._process = context.Process(target=work, args=(self._other,), daemon=False)
        self._receive, self._started, self._unwanted = receive, False, False
        Thread(target=self._run, daemon=True).start()

    def ask(self, request: Request) -> None:
        """Send a request; its messages follow."""
        self._connection.send(dict(request))

    def cancel(self) -> None:
        """Cancel what is under way; a process that has not started is ended."""
        if not self._started:
            self._unwanted = True
        elif CANCEL is None:
            self._process.terminate()
        elif self._process.is_alive() and self._process.pid is not None:
            os.kill(self._process.pid, CANCEL)

    def end(self) -> Thread:
        """Cancel, and end the process, in a thread."""
        thread = Thread(target=self._end)
        thread.start()
        return thread

    def _end(self) -> None:
        with suppress(OSError, ValueError):
            self.cancel()
            self._connection.send(None)
        with suppress(AssertionError):  # it has not started, and is ended when it does
            self._process.join(GRACE)
            if self._process.is_alive():
                self._process.kill()
                self._process.join()

    def _run(self) -> None:
        """Start the process, which waits for what all of them share, and pass its messages on."""
        self._process.start()
        self._other.close()
        while True:
            try:
                message = self._connection.recv()
            except (EOFError, OSError, TypeError):
                self._receive(Ended())
                return
            self._started = self._started or isinstance(message, Started)
            if self._unwanted:
                self._process.kill()
                self._receive(Cancelled())
                self._receive(Ended())
                return
            if not isinstance(message, Started):
                self._receive(message)


class StudyThread:
    """Who answers the requests of a page about a study of this process, as `StudyProcess` does from another.

    Parameters
    ----------
    receive : callable
        Called with each message, in the thread.
    study : Study
        Of a notebook, which goes on with it.
    """

    def __init__(self, receive: Callable[[Message], None], study: Study) -> None:
        self._receive, self._lock, self._working = receive, Lock(), False
        self._requests: SimpleQueue[Request | None] = SimpleQueue()
        self._thread = Thread(target=self._run, args=(study,), daemon=True)
        self._thread.start()

    def ask(self, request: Request) -> None:
        """Send a request; its messages follow."""
        self._requests.put(request)

    def cancel(self) -> None:
        """Cancel what is under way, as soon as a function of Python is called or a loop goes on."""
        with self._lock:
            if self._working:
                self._raise(CancelRequest)

    def end(self) -> Thread:
        """Cancel, and end the thread."""
        self._requests.put(None)
        self.cancel()
        return self._thread

    def _raise(self, error: type[BaseException] | None) -> None:
        """Raise in the thread; nothing takes back what was not raised yet."""
        raised = None if error is None else ctypes.py_object(error)
        ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(self._thread.ident or 0), raised)

    def _run(self, study: Study) -> None:
        actions = StudyActions(lambda text: self._receive(Progress(text)), study)
        while (request := self._requests.get()) is not None:
            self._receive(self._answered(actions, request))

    def _answered(self, actions: StudyActions, request: Request) -> Message:
        try:
            with self._lock:
                self._working = True
            message = _message(actions, request)
            self._rest()
        except CancelRequest:  # as the answer was there
            self._rest()
            return Cancelled()
        return message

    def _rest(self) -> None:
        with self._lock:
            self._working = False
            self._raise(None)


# ------------------------------------------------------------------------------------- in the process itself


def work(connection: Connection) -> None:
    """Answer requests until the page is gone."""
    busy = _cancellable()
    _bound_memory()

    connection.send(Started())
    actions = StudyActions(lambda text: connection.send(Progress(text)))
    while True:
        try:
            request = connection.recv()
        except (EOFError, OSError):
            return
        if request is None:
            return
        message = _answer(actions, request, busy)
        try:
            connection.send(message)
        except OSError:
            return


def _bound_memory() -> None:
    """Half of the machine's memory: a file that unpacks to more is an error of this process alone."""
    if sys.platform == "win32":
        return
    import resource

    whole = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    most, hard = max(whole // 2, LEAST_MEMORY), resource.getrlimit(resource.RLIMIT_AS)[1]
    resource.setrlimit(resource.RLIMIT_AS, (most if hard < 0 else min(most, hard), hard))


def _cancellable() -> list[bool]:
    """Whether work is under way, as the signal's handler sees it; an interrupt of the terminal is the server's."""
    busy = [False]

    def cancel(_number: int, _frame: object) -> None:
        if busy[0]:
            signal.setitimer(signal.ITIMER_REAL, AGAIN)
            if not _is_being_cancelled(sys.exception()):  # what cleans up is let finish
                raise CancelRequest

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if CANCEL is not None:
        signal.signal(CANCEL, cancel)
        signal.signal(signal.SIGALRM, cancel)
    return busy


def _is_being_cancelled(error: BaseException | None) -> bool:
    """Whether an exception that is handled is a cancellation, or came up while one was handled."""
    while error is not None and not isinstance(error, CancelRequest):
        error = error.__context__
    return error is not None


def _answer(actions: Any, request: Request, busy: list[bool]) -> Message:
    try:
        return _message(actions, request, busy)
    finally:
        if CANCEL is not None:
            signal.setitimer(signal.ITIMER_REAL, 0)


def _message(actions: Any, request: Request, busy: list[bool] | None = None) -> Message:
    busy = [False] if busy is None else busy
    try:
        busy[0] = True
        try:
            answer = actions.answer(request)
        finally:
            busy[0] = False
        return Done(answer)
    except CancelRequest:
        return Cancelled()
    except InputError as error:
        return Refused(error.what, error.where, error.remedy)
    except MemoryError:
        return Refused("the memory that is free does not suffice", "recording", "give a shorter recording")
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(place.filename).name}, line {place.lineno}"
        what = f"internal error of truewrench, {type(error).__name__}: {error}"
        return Refused(what, where, "report it with the recording")
