"""Reader of NumPy's .npy and .npz files; arrays of objects are pickles, and never opened."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.logs.array_bundle import tables_of_arrays
from estimation.logs.log_reader import LogReader
from estimation.logs.log_table import LogTable
from estimation.logs.source_file import SourceFile
from modeling.errors import InputError

MAGIC = b"\x93NUMPY"
LARGEST_ARCHIVE = 1 << 30
"""Bytes of all arrays of an .npz together."""


class NumpyArrays(LogReader):
    """One array, or a zip file of several."""

    title = "NumPy .npy or .npz"

    def recognises(self, source: SourceFile) -> bool:
        """By NumPy's magic string, or a zip file that is named .npz."""
        return source.head.startswith(MAGIC) or (source.suffix == ".npz" and source.head.startswith(b"PK"))

    def tables(self, source: SourceFile) -> list[LogTable]:
        """The arrays; a single one has columns without names."""
        with source.on_disk() as path:
            if source.compression is None and not source.head.startswith(MAGIC):
                source.require_members(LARGEST_ARCHIVE)
            arrays = self._arrays(path, single=source.head.startswith(MAGIC))
            return tables_of_arrays(arrays, name=source.name, kind="NumPy array", where=str(source.path))

    @staticmethod
    def _arrays(path: Path, *, single: bool) -> dict[str, NDArray[Any]]:
        if single:
            with path.open("rb") as stream:
                if b"|O'" in stream.read(1000):
                    what = "an array of Python objects is a pickle, which can run programs and is never opened"
                    raise InputError(what=what, where=str(path), remedy="save the numbers as arrays of numbers")
            return {
                "": np.load(path, allow_pickle=False, mmap_mode="r")
            }  # a header that lies about its size fails here
        # NumPy leaves a file that it opened itself open when it is no archive.
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
