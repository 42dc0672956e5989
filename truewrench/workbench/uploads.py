"""Files that the browser sends: bounded in size and number, in a temporary folder that goes with the page."""

from __future__ import annotations

import bz2
import gzip
import lzma
import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from tempfile import mkdtemp
from zipfile import BadZipFile, ZipFile, is_zipfile

from modeling.errors import InputError

MOST_BYTES = 200_000_000
"""Of one file."""
MOST_IN_FOLDER = 600_000_000
"""Of all files of one page."""
MOST_FILES = 20
"""Of one page."""
MOST_UNPACKED = 1_000_000_000
"""Bytes that the members of an archive may have together."""
LARGEST_RATIO = 200
"""Unpacked to packed bytes: tables of numbers as text are packed by ten, zeros by a thousand."""
LONGEST_NAME = 80
GZIP, BZIP2, XZ = b"\x1f\x8b", b"BZ", b"\xfd7"
"""First bytes of compressed files."""


class UploadFolder:
    """Files of one page, under names of their own choice but in a folder of ours.

    Examples
    --------
    >>> folder = UploadFolder()
    >>> name, path = folder.place("../../etc/passwd")
    >>> name
    'passwd'
    >>> folder.remove()
    """

    def __init__(self) -> None:
        self._folder = Path(mkdtemp(prefix="truewrench-"))
        self._files: dict[str, Path] = {}

    @property
    def bytes(self) -> int:
        """Of all files together, those that are still coming and those made here among them."""
        return sum(path.stat().st_size for path in self._folder.rglob("*") if path.is_file())

    def require_room(self, size: int) -> None:
        """InputError where a file of so many bytes is too many or too much."""
        if size > MOST_BYTES:
            remedy = "give a shorter recording, or use `truewrench fit --stream`"
            what = f"larger than {MOST_BYTES // 1_000_000} MB"
            raise InputError(what=what, where="upload", remedy=remedy)
        if len(self._files) >= MOST_FILES or self.bytes + size > MOST_IN_FOLDER:
            limit = f"{MOST_FILES} files, {MOST_IN_FOLDER // 1_000_000} MB"
            raise InputError(what=f"this page has {limit} already", where="upload", remedy="open a new page")

    def place(self, name: str) -> tuple[str, Path]:
        """Name and path for a new file; the name loses folders and whatever is no letter, digit or mark."""
        last = re.split(r"[/\\]", name)[-1]
        plain = re.sub(r"[^\w .()+-]", "_", last).strip(" .")[-LONGEST_NAME:] or "recording"
        return plain, self.folder() / plain

    def folder(self) -> Path:
        """A new folder, which goes with the page."""
        return Path(mkdtemp(dir=self._folder))

    def keep(self, path: Path) -> str:
        """Number of a file that has been written; InputError for an archive that unpacks to too much."""
        require_moderate_archive(path)
        number = str(len(self._files))
        self._files[number] = path
        return number

    def discard(self, path: Path) -> None:
        """Remove a file that was placed and is not kept."""
        shutil.rmtree(path.parent, ignore_errors=True)

    def path(self, number: str) -> str:
        """The file of that number; InputError for none."""
        if number not in self._files:
            raise InputError(what="the file is not here", where="upload", remedy="choose it again")
        return str(self._files[number])

    def named(self, text: str) -> str:
        """A text with the names of our files for their paths."""
        return re.sub(re.escape(str(self._folder)) + r"(/[^/\s:]+)?/", "", text)

    def remove(self) -> None:
        """Remove the folder."""
        shutil.rmtree(self._folder, ignore_errors=True)


def require_moderate_archive(path: Path) -> None:
    """InputError for an archive, or a compressed file, that unpacks to more than memory should hold."""
    for recognise, size in UNPACKED:
        if recognise(path):
            unpacked = size(path)
            if unpacked > MOST_UNPACKED or unpacked > LARGEST_RATIO * max(path.stat().st_size, 50_000):
                what = f"unpacks to {unpacked / 1e6:.0f} MB or more, from {path.stat().st_size / 1e6:.3g} MB"
                raise InputError(what=what, where=path.name, remedy="unpack it, and choose the recording itself")


def _zip_size(path: Path) -> int:
    """Of the members as they unpack, not as the archive says; InputError for a broken one."""
    try:
        with ZipFile(path) as archive:
            stated = sum(member.file_size for member in archive.infolist())
            return stated if stated > MOST_UNPACKED else sum(_length(archive.open(m)) for m in archive.infolist())
    except (BadZipFile, NotImplementedError, RuntimeError, OSError, ValueError):
        raise InputError(what="a broken archive", where=path.name, remedy="write it again") from None


def _length(stream: object) -> int:
    """Bytes that a stream unpacks to, up to the limit."""
    total = 0
    with stream as opened:  # type: ignore[attr-defined]
        while total <= MOST_UNPACKED and (block := opened.read(1 << 20)):
            total += len(block)
    return total


def _compressed_size(path: Path) -> int:
    openers: dict[bytes, Callable[[Path], object]] = {GZIP: gzip.open, BZIP2: bz2.open, XZ: lzma.open}
    opener = openers[_start(path)]
    try:
        return _length(opener(path))
    except (OSError, EOFError, lzma.LZMAError):
        raise InputError(what="a broken compressed file", where=path.name, remedy="write it again") from None


def _start(path: Path) -> bytes:
    with path.open("rb") as stream:
        return stream.read(2)


def _is_compressed(path: Path) -> bool:
    return os.path.getsize(path) > 2 and _start(path) in (GZIP, BZIP2, XZ)


UNPACKED: tuple[tuple[Callable[[Path], bool], Callable[[Path], int]], ...] = (
    (lambda path: bool(is_zipfile(path)), _zip_size),
    (_is_compressed, _compressed_size),
)
"""How archives are recognised, and how large they are unpacked."""
