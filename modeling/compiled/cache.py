"""Disk cache of derivations, keyed by model, source and library versions.

Kept for what it saves: with every derivation anew a `diagnose` takes 1.9 times as long in the plane, 1.4 times in six
axes (CPU time of whole commands, medians of 5, 28 November 2026).

An entry is one JSON file, named by the hash of everything that its result depends on: the request, the source of
`modeling` as loaded, and the versions of the libraries. A change of any gives another name, so that no entry is stale;
a process whose source has been replaced on the disk writes none. Files are written under a temporary name and renamed,
so that several processes may share the folder; what is not JSON is derived again. Without a readable or writable folder
everything works uncached.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import lru_cache
from pathlib import Path
from time import time
from typing import Any, TypeVar


def sha256_of(content: bytes) -> str:
    """SHA-256 in hexadecimal."""
    return hashlib.sha256(content).hexdigest()


def with_checksum(content: bytes) -> bytes:
    """The content below a line with its SHA-256."""
    return sha256_of(content).encode() + b"\n" + content


def verified(stored: bytes) -> bytes | None:
    """The content of what `with_checksum` made; None where either was changed or cut."""
    checksum, _, content = stored.partition(b"\n")
    return content if checksum == sha256_of(content).encode() else None


PACKAGE_PREFIX = "modeling."


def canonical_data(thing: object) -> Any:
    """Canonical plain data: equal for equal objects, different for others.

    Raises TypeError for a type outside this package, whose derivations may depend on more than its data.
    """
    match thing:
        case None | bool() | int() | str():
            return thing
        case float():
            return float(thing)
        case tuple() | list():
            return [canonical_data(element) for element in thing]
        case Mapping():
            return {"mapping": sorted([canonical_data(key), canonical_data(value)] for key, value in thing.items())}
    kind = type(thing)
    name = f"{kind.__module__}.{kind.__qualname__}"
    if not name.startswith(PACKAGE_PREFIX) or "<locals>" in name:
        raise TypeError(f"{name} has no canonical data")
    if isinstance(thing, Enum):
        return [name, thing.name]
    if is_dataclass(thing):
        return [name, *([field.name, canonical_data(getattr(thing, field.name))] for field in fields(thing))]
    raise TypeError(f"{name} has no canonical data")


T = TypeVar("T")
PlainData = Mapping[str, Any]

CACHE_VARIABLE = "TRUEWRENCH_CACHE"
"""The environment variable that names the folder; empty or "off" for none. The platform's cache folder by default."""
CACHE_FORMAT = 2
"""Part of an entry's name: entries of another format are not read."""
CACHE_BYTES = 200_000_000
"""Size limit of all entries together; beyond it the least recently used are removed."""
TRIMMED_SHARE = 0.8
"""Share of the limit to which entries are then trimmed."""
TRIM_INTERVAL = 64
"""The size is checked after one in so many writes."""
LIBRARIES = ("sympy", "casadi", "pydantic")
"""Libraries whose version is part of an entry's name."""


def cached(key: PlainData, derive: Callable[[], PlainData], read: Callable[[PlainData], T]) -> T:
    """`read` of the data that `derive` returns, or that the cache holds under the same `key`.

    `key` is plain data with everything that the result depends on besides source and libraries. `read` raises
    ValueError, KeyError or TypeError for unexpected data, which are then derived again.
    """
    folder = _folder()
    if folder is None:
        return read(json.loads(json.dumps(derive())))
    name = sha256_of(json.dumps([CACHE_FORMAT, *_origins(), key], sort_keys=True).encode())
    path = folder / name[:2] / f"{name[2:]}.json"
    with suppress(OSError, ValueError, KeyError, TypeError, RecursionError):
        stored = read(json.loads(path.read_bytes()))
        with suppress(OSError):
            os.utime(path)  # time of last use, for trimming
        return stored
    text = json.dumps(derive())
    if source_digest(PACKAGE) == LOADED_SOURCE:
        with suppress(OSError):  # a folder that cannot be written is no error
            _write(path, text)
            if int(name[:8], 16) % TRIM_INTERVAL == 0:
                trim(folder)
    return read(json.loads(text))


def _write(path: Path, text: str) -> None:
    """Write an entry atomically."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, suffix=".part")
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
        os.replace(temporary, path)
    except BaseException:
        with suppress(OSError):
            os.unlink(temporary)
        raise


def trim(folder: Path, largest: int = CACHE_BYTES) -> None:
    """Remove the least recently used entries when all together exceed the limit, bytes."""
    entries = []
    for path in folder.glob("*/*"):
        with suppress(OSError):  # another process may have removed it
            status = path.stat()
            entries.append((status.st_mtime, status.st_size, path))
    size = sum(entry[1] for entry in entries)
    if size <= largest:
        return
    for _, bytes_freed, path in sorted(entries):
        if size <= TRIMMED_SHARE * largest:
            break
        with suppress(OSError):
            path.unlink()
            size -= bytes_freed


def _folder() -> Path | None:
    """The folder of `TRUEWRENCH_CACHE`, or the platform's; None when switched off, or where there is no home."""
    named = os.environ.get(CACHE_VARIABLE)
    if named is None:
        return _platform_folder()
    if named.strip().lower() in ("", "off"):
        return None
    try:
        return Path(named).expanduser()
    except RuntimeError:  # `~` without a home, or of an unknown user
        return None


@lru_cache(maxsize=1)
def _origins() -> tuple[str, ...]:
    """Common to all keys: the versions of the libraries, and the source of `modeling`."""
    from importlib.metadata import version  # not for `--help`

    return (*(f"{library} {version(library)}" for library in LIBRARIES), LOADED_SOURCE)


def source_digest(package: Path) -> str:
    """A hash of the names and contents of all modules of a package that can be read."""
    lines = []
    for path in sorted(package.rglob("*.py")):
        with suppress(OSError):  # an editor's lock, which is a link to nothing, or a module being replaced
            lines.append(f"{path.relative_to(package).as_posix()} {sha256_of(path.read_bytes())}\n")
    return sha256_of("".join(lines).encode())


@lru_cache(maxsize=1)
def _platform_folder() -> Path | None:
    """The platform's cache folder; None where there is no home directory."""
    from platformdirs import user_cache_path

    try:
        folder = user_cache_path("truewrench", appauthor=False)
    except (OSError, RuntimeError, KeyError):
        return None
    return folder if folder.is_absolute() else None


LOADED_AT = time()
"""When this process loaded this module, and about then the rest of the source, s."""
PACKAGE = Path(__file__).parents[1]
LOADED_SOURCE = source_digest(PACKAGE)
"""Of the source as this process loads it: read here, as the disk may hold another version at the first lookup."""
