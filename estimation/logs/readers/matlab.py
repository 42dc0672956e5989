"""Reader of MATLAB files up to version 7: variables, structs and cells of numeric arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.logs.array_bundle import tables_of_arrays
from estimation.logs.log_reader import LogReader
from estimation.logs.log_table import LogTable
from estimation.logs.source_file import SourceFile

DEEPEST = 6
"""Levels of structs and cells that are looked into."""


class Matlab(LogReader):
    """MATLAB .mat of version 5 to 7; version 7.3 is HDF5."""

    title = "MATLAB .mat"

    def recognises(self, source: SourceFile) -> bool:
        """By its header; version 7.3 states it too."""
        return source.head.startswith(b"MATLAB 5.0 MAT-file")

    def tables(self, source: SourceFile) -> list[LogTable]:
        """Every numeric array; those of one length in one table, but the elements of a cell each in its own."""
        from scipy.io import loadmat  # slow to import

        with source.on_disk() as path:
            variables = loadmat(path, struct_as_record=False, squeeze_me=True)
        arrays: dict[str, NDArray[Any]] = {}
        for name, value in variables.items():
            if not name.startswith("__"):
                collect_arrays(name, value, arrays)
        return tables_of_arrays(arrays, name=source.name, kind="MATLAB", where=str(source.path))


def collect_arrays(name: str, value: Any, found: dict[str, NDArray[Any]], depth: int = 0) -> None:
    """Add the numeric arrays in a value of `loadmat` by their paths: `struct.field`, `cell{1}`."""
    if depth > DEEPEST:
        return
    fields = getattr(value, "_fieldnames", None)
    if fields is not None:
        for field in fields:
            collect_arrays(f"{name}.{field}", getattr(value, field), found, depth + 1)
    elif isinstance(value, np.ndarray) and value.dtype == object:
        for place, element in enumerate(value.ravel()[:100], 1):
            collect_arrays(f"{name}{{{place}}}", element, found, depth + 1)
    elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
        found[name] = value
