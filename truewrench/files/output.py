"""Atomic file replacement, output folders, progress on a terminal or in a log."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from enum import Enum
from functools import partial
from pathlib import Path
from shutil import get_terminal_size
from threading import Event, Thread
from time import monotonic

from modeling.errors import InputError

ERASE_LINE = "\r\x1b[K"
"""Carriage return and erase-line sequence of a terminal."""
REPORT_FILES = ("report.html", "report.md")
"""Files in the folder of a report."""
LINE_INTERVAL = 5.0
"""Time (s) between lines of one stage in a log."""
FIRST_LINE, NEXT_LINES = 10.0, 60.0
"""Time (s) after which work says, without a terminal, that it goes on, and how often it does so then."""


class ProgressStyle(Enum):
    """How a command reports its progress on stderr."""

    TERMINAL = "terminal"  # one line that is overwritten; without a terminal a line of long work, and one a minute
    LINES = "lines"  # a line of each stage, with the time since the start
    SILENT = "silent"


_STYLE = ContextVar("progress style", default=ProgressStyle.TERMINAL)
_BEGIN: ContextVar[float | None] = ContextVar("start of the command", default=None)
"""When the command began (s of the monotonic clock): lines of a log count from there."""
_STAGE: ContextVar[list[str] | None] = ContextVar("what a command without a terminal does", default=None)
"""Its last message, alone in the list."""


@contextmanager
def progress_style(style: ProgressStyle) -> Iterator[None]:
    """Progress of this style for the time of one command."""
    stage = ["reading"] if style is ProgressStyle.TERMINAL and not sys.stderr.isatty() else None
    set_style, set_begin, set_stage = _STYLE.set(style), _BEGIN.set(monotonic()), _STAGE.set(stage)
    over = Event()
    if stage is not None:
        Thread(target=_say_that_it_goes_on, args=(stage, over), daemon=True).start()
    try:
        yield
    finally:
        over.set()
        _STYLE.reset(set_style)
        _BEGIN.reset(set_begin)
        _STAGE.reset(set_stage)


def _say_that_it_goes_on(stage: list[str], over: Event) -> None:
    """A line with the last message after FIRST_LINE seconds, and others every NEXT_LINES, until the work is over."""
    elapsed = pause = FIRST_LINE
    while not over.wait(pause):
        say(f"{elapsed:7.1f} s  {stage[0]}")
        pause = NEXT_LINES
        elapsed += pause


def make_folder(path: Path) -> Path:
    """Create the folder if it is missing, and return it.

    Raises InputError when it cannot be created or written.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _unwritable(path, error, "give --out a folder that can be created") from None
    if not os.access(path, os.W_OK | os.X_OK):
        raise InputError(what="nothing can be written there", where=str(path), remedy="give --out another folder")
    return path


def require_writable_folder(path: Path) -> None:
    """Check before any work that a folder can be created and written.

    Raises InputError.
    """
    there = next(place for place in (path.absolute(), *path.absolute().parents) if os.path.lexists(place))
    if not there.is_dir():
        raise InputError(what="is not a folder", where=str(there), remedy="give --out another place")
    if not os.access(there, os.W_OK | os.X_OK):
        raise InputError(what="nothing can be written there", where=str(there), remedy="give --out another place")


def require_writable_files(written: Iterable[Path], read: Iterable[Path]) -> None:
    """Check before any work that files can be written, each once, and none that is read, by whatever name.

    Links, hard ones too, and relative paths are other names of one file. A device or a pipe may be both. Of a LeRobot
    data set every file is read, and what is new in it would be taken for a part of it. Raises InputError.
    """
    read = list(read)
    inputs = {identity: path for path in read if (identity := _file_identity(path)) is not None}
    data_sets = [folder.resolve() for path in read if (folder := _data_set_of(path)) is not None]
    places = set[str]()
    for path in written:
        if path.exists() and not path.is_file() and not path.is_dir():
            continue
        if (place := os.path.realpath(path)) in places:
            what = "two results would have this name"
            raise InputError(what=what, where=str(path), remedy="give each another name")
        places.add(place)
        require_writable_folder(path.parent)
        if any(path.resolve().is_relative_to(folder) for folder in data_sets):
            raise InputError(what="is inside the data set", where=str(path), remedy="give --out a place beside it")
        if path.is_dir():
            raise InputError(what="is a folder", where=str(path), remedy="give --out the name of a file")
        if (identity := _file_identity(path)) in inputs:
            what = f"the result would replace {inputs[identity]}, which is read"
            raise InputError(what=what, where=str(path), remedy="give the result another name or folder")


def _data_set_of(path: Path) -> Path | None:
    """The folder of the LeRobot data set that a path is, or an episode of which it names; None of any other."""
    folders = [path, *path.parents][:4] if path.name.startswith("episode_") else [path]
    return next((folder for folder in folders if (folder / "meta" / "info.json").is_file()), None)


def _file_identity(path: Path) -> tuple[int, int] | None:
    """Device and inode of a regular file; None of anything else, or where there is none."""
    if not path.is_file():
        return None
    status = path.stat()
    return status.st_dev, status.st_ino


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """A temporary path in the folder of `path`: renamed to `path` on success, deleted on an exception.

    Missing folders are created. A device or a pipe is written directly. Raises InputError when it cannot be written.
    """
    target = Path(os.path.realpath(path))
    ordinary = target.is_file() or not target.exists()
    temporary = target.with_name(f".{target.name}.{os.getpid()}.tmp") if ordinary else target
    try:
        if ordinary:
            target.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        if ordinary:
            temporary.replace(target)
    except OSError as error:
        raise _unwritable(path, error, "give --out a path that can be written") from None
    finally:
        if temporary != target:
            with suppress(OSError):
                temporary.unlink()


def _unwritable(path: Path, error: OSError, remedy: str) -> InputError:
    return InputError(what=error.strerror or "cannot be written", where=str(path), remedy=remedy)


def say(text: str) -> None:
    """A line on stderr. Where nobody reads it any more, or it cannot be written, the work goes on."""
    with suppress(OSError):
        print(text, file=sys.stderr, flush=True)


@contextmanager
def progress_line() -> Iterator[Callable[[str], None]]:
    """Callback for progress messages, in the style of the command.

    On a terminal one line, erased at the end; without one, a line after ten seconds and one a minute. Else lines for a
    log.
    """
    style, stage = _STYLE.get(), _STAGE.get()
    if style is ProgressStyle.LINES:
        yield _log_lines()
    elif style is ProgressStyle.SILENT or not sys.stderr.isatty():
        yield partial(_keep, stage)
    else:
        with _overwritten_line() as show:
            yield show


def _keep(stage: list[str] | None, message: str) -> None:
    if stage is not None:
        stage[0] = message


def _log_lines() -> Callable[[str], None]:
    """A line of each new stage; of a stage that counts, one in LINE_INTERVAL seconds. Times are since the start."""
    said_at = monotonic()
    begin = said_at if (started := _BEGIN.get()) is None else started
    said = ""

    def show(message: str) -> None:
        nonlocal said, said_at
        now, stage = monotonic(), message.partition(":")[0]
        if stage != said or now - said_at >= LINE_INTERVAL:
            say(f"{now - begin:7.1f} s  {message}")
            said, said_at = stage, now

    return show


@contextmanager
def _overwritten_line() -> Iterator[Callable[[str], None]]:
    stream = sys.stderr

    def write(text: str) -> None:
        with suppress(OSError):  # the terminal is gone
            stream.write(text)
            stream.flush()

    try:
        yield lambda message: write(ERASE_LINE + f"{message} ..."[: get_terminal_size().columns - 1])
    finally:
        write(ERASE_LINE)
