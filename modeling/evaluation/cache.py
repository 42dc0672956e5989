"""Disk cache of derivations, keyed by model, source and library versions.

An entry is one JSON file, named by the hash of everything that its result depends on: the request, the source of
`modeling` as loaded, and the versions of the libraries. A change of any gives another name, so that no entry is stale;
a process whose source has been replaced on the disk writes none. Files are written under a temporary name and renamed,
so that several processes may share the folder; an entry that fails its checksum is derived again. Without a readable or
writable folder everything works uncached.
"""

from __future__ import annotations

import json
import logging
import os
import tempfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from functools import lru_cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from time import time
from typing import Any, TypeVar

from modeling.checksum import sha256_of, verified, with_checksum

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
            return [canonical_data(part) for part in thing]
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
CACHE_FORMAT = 1
CACHE_BYTES = 200_000_000
"""Size limit of all entries together; beyond it the least recently used are removed."""
TRIMMED_SHARE = 0.8
"""Share of the limit to which entries are then trimmed."""
TRIM_INTERVAL = 64
"""The size is checked after one in so many writes."""
LIBRARIES = ("sympy", "casadi", "pydantic")
SUFFIX = ".json"

log = logging.getLogger(__name__)


def cached(what: PlainData, derive: Callable[[], PlainData], read: Callable[[PlainData], T]) -> T:
    """`read` of the data that `derive` returns, or that the cache holds for the same `what`.

    `what` is plain data with everything that the result depends on besides source and libraries. `read` raises
    ValueError, KeyError or TypeError for unexpected data, which are then derived again.
    """
    cache = DerivationCache.of_environment()
    name = "" if cache is None else _name(what)
    if cache is not None and (found := cache.get(name)) is not None:
        with suppress(ValueError, KeyError, TypeError):
            return read(found)
    text = json.dumps(derive())
    if cache is not None and source_digest(PACKAGE) == LOADED_SOURCE:
        cache.put(name, text)
    return read(json.loads(text))


@dataclass(frozen=True)
class DerivationCache:
    """Entries in a folder, created with the first."""

    folder: Path
    largest: int = CACHE_BYTES

    @classmethod
    def of_environment(cls) -> DerivationCache | None:
        """The cache in the folder of `TRUEWRENCH_CACHE`, or in the platform's; None when switched off."""
        named = os.environ.get(CACHE_VARIABLE)
        if named is None:
            folder = _platform_folder()
            return None if folder is None else cls(folder)
        if named.strip().lower() in ("", "off"):
            return None
        try:
            return cls(Path(named).expanduser())
        except RuntimeError:  # `~` without a home, or of an unknown user
            return None

    def get(self, name: str) -> PlainData | None:
        """The data of an entry; None where there is none, or its checksum fails."""
        path = self._path(name)
        try:
            text = verified(path.read_bytes())
            if text is None:
                return None
            with suppress(OSError):
                os.utime(path)  # time of last use, for trimming
            data = json.loads(text)
        except (OSError, ValueError, RecursionError):
            return None
        return data if isinstance(data, dict) else None

    def put(self, name: str, text: str) -> None:
        """Write an entry atomically; a folder that cannot be written is no error."""
        path = self._path(name)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            handle, temporary = tempfile.mkstemp(dir=path.parent, suffix=".part")
            try:
                with os.fdopen(handle, "wb") as file:
                    file.write(with_checksum(text.encode()))
                os.replace(temporary, path)
            except BaseException:
                with suppress(OSError):
                    os.unlink(temporary)
                raise
            if int(name[:8], 16) % TRIM_INTERVAL == 0:
                self.trim()
        except OSError as error:
            log.debug("no entry was written to %s: %s", self.folder, error)

    def trim(self) -> None:
        """Remove the least recently used entries when all together exceed the limit."""
        entries = []
        for path in self.folder.glob("*/*"):
            with suppress(OSError):  # another process may have removed it
                status = path.stat()
                entries.append((status.st_mtime, status.st_size, path))
        size = sum(entry[1] for entry in entries)
        if size <= self.largest:
            return
        for _, bytes_freed, path in sorted(entries):
            if size <= TRIMMED_SHARE * self.largest:
                break
            with suppress(OSError):
                path.unlink()
                size -= bytes_freed

    def _path(self, name: str) -> Path:
        return self.folder / name[:2] / (name[2:] + SUFFIX)


def _name(what: PlainData) -> str:
    return sha256_of(json.dumps([CACHE_FORMAT, *_origins(), what], sort_keys=True).encode())


@lru_cache(maxsize=1)
def _origins() -> tuple[str, ...]:
    """Common to all keys: the versions of the libraries, and the source of `modeling`."""
    return (*map(_version, LIBRARIES), LOADED_SOURCE)


def source_digest(package: Path) -> str:
    """A hash of the names and contents of all modules of a package that can be read."""
    lines = []
    for path in sorted(package.rglob("*.py")):
        with suppress(OSError):  # an editor's lock, which is a link to nothing, or a module being replaced
            lines.append(f"{path.relative_to(package).as_posix()} {sha256_of(path.read_bytes())}\n")
    return sha256_of("".join(lines).encode())


def _version(library: str) -> str:
    """Name and version: the name of the metadata (wheel or egg) that were installed beside the library.

    `importlib.metadata` reads them, too, but its import takes as long as a fit.
    """
    spec = find_spec(library)
    origin = None if spec is None else spec.origin
    found = [] if origin is None else [path.stem for path in Path(origin).parents[1].glob(f"{library}-*.*-info")]
    return found[0] if len(found) == 1 else f"{library} {import_module(library).__version__}"


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
