"""Output: a file that is either whole or not there, and a line of progress that only a terminal sees."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from shutil import get_terminal_size

from modeling.errors import InputError

CLEARED = "\r\x1b[K"
"""Back to the beginning of a terminal's line, and erase it."""


def folder(path: Path) -> Path:
    """The folder of that path, made where it is missing.

    Raises InputError when there can be none.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _unwritable(path, error, "give --out a folder that can be made") from None
    if not os.access(path, os.W_OK | os.X_OK):
        raise InputError(what="nothing can be written there", where=str(path), remedy="give --out another folder")
    return path


def require_folder(path: Path) -> None:
    """Refuse a folder that cannot be written or made, before any work is done for it.

    Raises InputError.
    """
    there = next(place for place in (path.absolute(), *path.absolute().parents) if os.path.lexists(place))
    if not there.is_dir():
        raise InputError(what="is no folder", where=str(there), remedy="give --out another place")
    if not os.access(there, os.W_OK | os.X_OK):
        raise InputError(what="nothing can be written there", where=str(there), remedy="give --out another place")


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A path beside `path` to write to: it takes the place of `path` when the block ends well, else it goes.

    Missing folders are made. What is no ordinary file (a device, a pipe) is written as it is. Raises InputError when
    it cannot be written.
    """
    target = Path(os.path.realpath(path))
    ordinary = target.is_file() or not target.exists()
    beside = target.with_name(f".{target.name}.{os.getpid()}.tmp") if ordinary else target
    try:
        if ordinary:
            target.parent.mkdir(parents=True, exist_ok=True)
        yield beside
        if ordinary:
            beside.replace(target)
    except OSError as error:
        raise _unwritable(path, error, "give --out a path that can be written") from None
    finally:
        if beside != target:
            with suppress(OSError):
                beside.unlink()


def _unwritable(path: Path, error: OSError, remedy: str) -> InputError:
    return InputError(what=error.strerror or "cannot be written", where=str(path), remedy=remedy)


@contextmanager
def progress_line() -> Iterator[Callable[[str], None]]:
    """What takes messages of progress: one line of a terminal that each rewrites and the end erases; else nothing."""
    stream = sys.stderr
    if not stream.isatty():
        yield lambda _message: None
        return

    def show(message: str) -> None:
        stream.write(CLEARED + f"{message} ..."[: get_terminal_size().columns - 1])
        stream.flush()

    try:
        yield show
    finally:
        stream.write(CLEARED)
        stream.flush()
