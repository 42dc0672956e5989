"""Atomic file replacement, output folders, terminal progress line."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from shutil import get_terminal_size

from modeling.errors import InputError

ERASE_LINE = "\r\x1b[K"
"""Carriage return and erase-line sequence of a terminal."""


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


@contextmanager
def progress_line() -> Iterator[Callable[[str], None]]:
    """Callback for progress messages: one line of a terminal, erased at the end; no output without a terminal."""
    stream = sys.stderr
    if not stream.isatty():
        yield lambda _message: None
        return

    def show(message: str) -> None:
        stream.write(ERASE_LINE + f"{message} ..."[: get_terminal_size().columns - 1])
        stream.flush()

    try:
        yield show
    finally:
        stream.write(ERASE_LINE)
        stream.flush()
