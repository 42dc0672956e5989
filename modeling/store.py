"""Store: results of derivations on disk, found again by what they were derived from.

An entry is one file of JSON under a name that is the hash of everything that the result depends on: what was asked
for, the source of this package, the versions of the libraries that derive. What has changed has another name, so that
nothing is ever out of date. Files are written beside and renamed, so that several processes may share the folder; a
file that is not what was written is derived again. Where nothing can be read or written, everything works without.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
import tempfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")
Data = Mapping[str, Any]

VARIABLE = "TRUEWRENCH_CACHE"
"""The environment variable that names the folder; empty or "off" for none. The platform's cache folder by default."""
FORMAT = 1
LARGEST = 200_000_000
"""Bytes of all entries together; beyond, those that were not used for longest are removed."""
KEPT = 0.8
"""Share of that which is left then."""
COUNTED = 64
"""Entries are counted after every so many that were written."""
LIBRARIES = ("sympy", "casadi", "pydantic")
SUFFIX = ".json"

log = logging.getLogger(__name__)


def stored(what: Data, derive: Callable[[], Data], read: Callable[[Data], T]) -> T:
    """What `read` makes of the data that `derive` gives, or once gave for the same `what`.

    `what` is plain data that says all that the result depends on besides source and libraries. `read` raises
    ValueError, KeyError or TypeError for data that are not what it expects, which are then derived again.
    """
    store = Store.of_environment()
    name = "" if store is None else _name(what)
    if store is not None and (found := store.get(name)) is not None:
        with suppress(ValueError, KeyError, TypeError):
            return read(found)
    text = json.dumps(derive())
    if store is not None:
        store.put(name, text)
    return read(json.loads(text))


@dataclass(frozen=True)
class Store:
    """Entries in a folder, which comes to be with the first."""

    folder: Path
    largest: int = LARGEST

    @classmethod
    def of_environment(cls) -> Store | None:
        """The store that `TRUEWRENCH_CACHE` names, or the platform's; None where there is to be none."""
        named = os.environ.get(VARIABLE)
        if named is None:
            folder = _platform_folder()
            return None if folder is None else cls(folder)
        return None if named.strip().lower() in ("", "off") else cls(Path(named).expanduser())

    def get(self, name: str) -> Data | None:
        """The data of an entry; None where there is none, or not the whole of what was written."""
        path = self._path(name)
        try:
            content = path.read_bytes()
            digest, _, text = content.partition(b"\n")
            if digest.decode("ascii", "replace") != _digest(text):
                return None
            with suppress(OSError):
                os.utime(path)  # it was used: what was not goes first
            data = json.loads(text)
        except (OSError, ValueError, RecursionError):
            return None
        return data if isinstance(data, dict) else None

    def put(self, name: str, text: str) -> None:
        """Write an entry, whole or not at all; a store that takes none is no error."""
        path = self._path(name)
        content = text.encode()
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            handle, beside = tempfile.mkstemp(dir=path.parent, suffix=".part")
            try:
                with os.fdopen(handle, "wb") as file:
                    file.write(_digest(content).encode() + b"\n" + content)
                os.replace(beside, path)
            except BaseException:
                with suppress(OSError):
                    os.unlink(beside)
                raise
            if int(name[:8], 16) % COUNTED == 0:
                self.trim()
        except OSError as error:
            log.debug("nothing is kept in %s: %s", self.folder, error)

    def trim(self) -> None:
        """Remove what was not used for longest, when everything together is larger than it may be."""
        entries = []
        for path in self.folder.glob("*/*"):
            with suppress(OSError):  # another process may have removed it
                state = path.stat()
                entries.append((state.st_mtime, state.st_size, path))
        size = sum(entry[1] for entry in entries)
        if size <= self.largest:
            return
        for _, own, path in sorted(entries):
            if size <= KEPT * self.largest:
                break
            with suppress(OSError):
                path.unlink()
                size -= own

    def _path(self, name: str) -> Path:
        return self.folder / name[:2] / (name[2:] + SUFFIX)


def _name(what: Data) -> str:
    return _digest(json.dumps([FORMAT, *_origins(), what], sort_keys=True).encode())


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


@lru_cache(maxsize=1)
def _origins() -> tuple[str, ...]:
    """What all derivations depend on: the versions of the libraries, and the source of this package."""
    return (*map(_version, LIBRARIES), source_digest(Path(__file__).parent))


def source_digest(package: Path) -> str:
    """A hash of the names and contents of all modules of a package."""
    source = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        source.update(f"{path.relative_to(package).as_posix()} {_digest(path.read_bytes())}\n".encode())
    return source.hexdigest()


def _version(library: str) -> str:
    try:
        return f"{library} {version(library)}"
    except PackageNotFoundError:
        return f"{library} {import_module(library).__version__}"


@lru_cache(maxsize=1)
def _platform_folder() -> Path | None:
    """The platform's folder for what can be made again; None where nobody has a home."""
    from platformdirs import user_cache_path

    try:
        folder = user_cache_path("truewrench", appauthor=False)
    except (OSError, RuntimeError, KeyError):
        return None
    return folder if folder.is_absolute() else None
