"""Reader of HDF5 files, MATLAB's of version 7.3 among them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.logs.array_bundle import tables_of_arrays
from estimation.logs.log_reader import LogReader, require_size
from estimation.logs.log_table import LogTable
from estimation.logs.source_file import SourceFile

MAGIC = b"\x89HDF\r\n\x1a\n"
MATLAB_OFFSET = 512
"""Bytes of MATLAB's own header in front of HDF5."""
MOST_CELLS = 100
NO_SAMPLES = ("char", "cell", "struct", "function_handle")


class Hdf5(LogReader):
    """HDF5; datasets by their paths, MATLAB's cells by what they refer to. External links are not followed."""

    title = "HDF5, MATLAB 7.3"
    rank = -1

    def recognises(self, source: SourceFile) -> bool:
        """By HDF5's signature, at the start or behind MATLAB's header."""
        return MAGIC in (source.head[:8], source.head[MATLAB_OFFSET : MATLAB_OFFSET + 8])

    def tables(self, source: SourceFile) -> list[LogTable]:
        """Every numeric dataset; those of one length in one table."""
        import h5py  # slow to import

        arrays: dict[str, NDArray[Any]] = {}
        with source.on_disk() as path, h5py.File(path, "r") as file:

            def collect(name: str, item: Any) -> None:
                if not isinstance(item, h5py.Dataset) or name.startswith("#refs#"):
                    return
                if h5py.check_ref_dtype(item.dtype) is not None:
                    for place, reference in enumerate(np.ravel(item[()])[:MOST_CELLS], 1):
                        target = file[reference]
                        if isinstance(target, h5py.Dataset):
                            self._add(f"{name}{{{place}}}", target, arrays, str(source.path))
                else:
                    self._add(name, item, arrays, str(source.path))

            file.visititems(collect)
        kind = "MATLAB 7.3" if source.head.startswith(b"MATLAB") else "HDF5"
        return tables_of_arrays(arrays, name=source.name, kind=kind, where=str(source.path))

    @staticmethod
    def _add(name: str, dataset: Any, arrays: dict[str, NDArray[Any]], where: str) -> None:
        kind = dataset.attrs.get("MATLAB_class", b"")
        text = kind.decode() if isinstance(kind, bytes) else str(kind)
        if text in NO_SAMPLES or dataset.shape is None or "MATLAB_empty" in dataset.attrs:
            return
        if dataset.dtype.kind not in "fiubV" or dataset.ndim == 0 or dataset.external:
            return
        require_size(dataset.size, where)
        arrays[name.strip("/").replace("/", ".")] = dataset[()]
