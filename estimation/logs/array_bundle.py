"""Bundle of arrays by name, as MATLAB, NumPy and HDF5 files hold them: those of equal length are a table."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.logs.log_reader import require_columns, require_size
from estimation.logs.log_table import Array, LogTable, unique_names

MOST_COLUMNS_OF_ARRAY = 64
"""A two-dimensional array with more columns, and as many rows, is an image or a matrix, not a log."""


def columns_of_array(name: str, array: NDArray[Any]) -> dict[str, Array]:
    """The columns (n,) of one array: along its longest dimension; `name[i]` for those of a matrix, row by row.

    A structured array gives one column a field. Nothing of text, objects, scalars and images.
    """
    if array.dtype.names:
        fields = [columns_of_array(f"{name}.{field}" if name else field, array[field]) for field in array.dtype.names]
        return {key: column for field in fields for key, column in field.items()}
    if array.dtype.kind not in "fiub" or array.ndim == 0:
        return {}
    array = array if array.ndim < 3 else array.squeeze()
    if array.ndim == 0 or array.size == 0:
        return {}
    samples = int(np.argmax(array.shape))
    rows = np.moveaxis(array, samples, 0).reshape(array.shape[samples], -1)
    if rows.shape[1] > MOST_COLUMNS_OF_ARRAY and rows.shape[1] > rows.shape[0] // 4:
        return {}
    if array.ndim == 1 or rows.shape[1] == 1:
        return {name or "column_1": rows[:, 0].astype(np.float64)}
    return {f"{name}[{i}]" if name else f"column_{i + 1}": rows[:, i].astype(np.float64) for i in range(rows.shape[1])}


def tables_of_arrays(arrays: Mapping[str, NDArray[Any]], *, name: str, kind: str, where: str) -> list[LogTable]:
    """One table for each length that occurs, the arrays' columns in it."""
    require_size(sum(array.size for array in arrays.values()), where)
    by_rows: dict[int, dict[str, Array]] = {}
    for key, array in arrays.items():
        for column, values in columns_of_array(key, array).items():
            by_rows.setdefault(len(values), {})[column] = values
    samples = {rows: columns for rows, columns in by_rows.items() if rows >= 3}
    tables = []
    for rows, columns in samples.items():
        require_columns(len(columns), where)
        title = name if len(samples) == 1 else f"{name}:{rows}"
        named = dict(zip(unique_names(list(columns)), columns.values(), strict=True))
        tables.append(LogTable(name=title, kind=kind, columns=named))
    return tables
