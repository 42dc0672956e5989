"""Source file: a file of a robot's log, decompressed, with its first bytes to recognise it by."""

from __future__ import annotations

import bz2
import gzip
import lzma
import tempfile
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import BinaryIO, cast

from modeling.errors import InputError

HEAD_BYTES = 1 << 20
LARGEST_BINARY = 4 << 30
"""Bytes to which a compressed binary file may grow: a larger one is refused before it fills the disk."""
COMPRESSED = {".gz": b"\x1f\x8b", ".bz2": b"BZh", ".xz": b"\xfd7zXZ\x00", ".zip": b"PK\x03\x04"}
ZIP_FORMATS = (".xlsx", ".xlsm", ".npz")
"""Formats that are zip files themselves."""
DAMAGED = (EOFError, OSError, zlib.error, lzma.LZMAError, zipfile.BadZipFile, RuntimeError, NotImplementedError)


@dataclass(frozen=True)
class SourceFile:
    """A file or folder at `path`; it may be compressed by gzip, bzip2, xz or zip."""

    path: Path

    @property
    def name(self) -> str:
        """Its name without folders, for messages and tables."""
        return self.path.name

    @cached_property
    def compression(self) -> str | None:
        """The suffix of the compression that its first bytes show."""
        if self.path.is_dir() or self.path.suffix.lower() in ZIP_FORMATS:
            return None
        start = self._raw_start()
        return next((suffix for suffix, magic in COMPRESSED.items() if start.startswith(magic)), None)

    @cached_property
    def suffix(self) -> str:
        """Its suffix in lower case, without that of the compression."""
        name = Path(self.path.stem) if self.path.suffix.lower() in COMPRESSED else self.path
        return name.suffix.lower()

    @cached_property
    def head(self) -> bytes:
        """The first bytes, decompressed; none of a folder. Raises InputError when the file cannot be read."""
        if self.path.is_dir():
            return b""
        with self.opened() as stream:
            return stream.read(HEAD_BYTES)

    def error(self, what: str, remedy: str) -> InputError:
        """An InputError about this file."""
        return InputError(what=what, where=str(self.path), remedy=remedy)

    @contextmanager
    def opened(self) -> Iterator[BinaryIO]:
        """The decompressed bytes; InputError when they cannot be read, or the compressed file is damaged."""
        try:
            with self._open() as stream:
                yield stream
        except DAMAGED as error:
            reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
            raise self.error(f"cannot be read: {reason}", "give a log file that is whole and may be read") from None

    def _open(self) -> BinaryIO:
        if self.compression == ".zip":
            archive = zipfile.ZipFile(self.path)
            members = [m for m in archive.namelist() if not m.endswith("/") and not m.startswith("__MACOSX")]
            if len(members) != 1:
                raise self.error(f"a zip file with {len(members)} files", "unpack it, and give the files")
            return cast(BinaryIO, archive.open(members[0]))
        if self.compression == ".gz":
            return cast(BinaryIO, gzip.open(self.path))
        if self.compression == ".bz2":
            return cast(BinaryIO, bz2.open(self.path))
        return cast(BinaryIO, lzma.open(self.path)) if self.compression == ".xz" else self.path.open("rb")

    @contextmanager
    def on_disk(self) -> Iterator[Path]:
        """A path to the decompressed file: its own, or that of a temporary copy with its own suffix."""
        if self.compression is None:
            yield self.path
            return
        with self._temporary_copy() as copy:
            yield copy

    @contextmanager
    def _temporary_copy(self) -> Iterator[Path]:
        with ExitStack() as temporary:
            try:
                folder = temporary.enter_context(tempfile.TemporaryDirectory(ignore_cleanup_errors=True))
                copy = Path(folder) / f"log{self.suffix}"
                with copy.open("wb") as out:
                    for block in self._blocks():
                        out.write(block)
                        if out.tell() > LARGEST_BINARY:
                            raise self.error("decompresses to more than 4 GiB", "decompress it, and give the file")
            except OSError as error:
                what = f"its decompressed copy cannot be written: {error.strerror or error}"
                raise self.error(what, "free space for temporary files, or set TMPDIR to another folder") from error
            yield copy

    def _blocks(self) -> Iterator[bytes]:
        with self.opened() as stream:
            while block := stream.read(HEAD_BYTES):
                yield block

    def require_members(self, largest: int) -> None:
        """InputError when the members of a format that is a zip file itself say that they are larger together."""
        try:
            with zipfile.ZipFile(self.path) as archive:
                size = sum(member.file_size for member in archive.infolist())
        except DAMAGED:
            return  # the format's own library says what is wrong
        if size > largest:
            what = f"decompresses to {size / 2**30:.3g} GiB, and at most {largest / 2**30:.3g} GiB are read"
            raise self.error(what, "save the log in parts, or as CSV or Parquet")

    def _raw_start(self) -> bytes:
        try:
            with self.path.open("rb") as stream:
                return stream.read(16)
        except OSError as error:
            reason = error.strerror or "cannot be read"
            raise self.error(reason, "give the path of a log file") from None
