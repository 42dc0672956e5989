"""Results as plain data, which JSON can write."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from estimation.fit import Fit
from estimation.streaming.streamed_fit import StreamedFit
from modeling.number_format import finite
from modeling.table import Cell, Table, Tabular, Value


def plain_data(result: Any) -> dict[str, Any]:
    """A fit as the data of its model file, another result as that of its own file, else its table and remarks."""
    if isinstance(result, Fit | StreamedFit):
        from truewrench.files.model_file import ModelFile

        return ModelFile.of(result).to_data()
    if isinstance(result, Table):
        return table_data(result)
    own = getattr(result, "to_data", None)
    found = _tabular_data(result) if own is None else own()
    plain: dict[str, Any] = _plain(found)
    return plain


def table_data(table: Table) -> dict[str, Any]:
    """Columns with their units, and rows."""
    columns = [{"name": column.name, "unit": column.unit} for column in table.columns]
    plain: dict[str, Any] = _plain({"columns": columns, "rows": [[_value(v) for v in row] for row in table.rows]})
    return plain


def _tabular_data(result: Tabular) -> dict[str, Any]:
    return {"result": type(result).__name__, "table": table_data(result.table), "remarks": result.remarks()}


def _value(value: Value) -> float | str | None:
    return value.value if isinstance(value, Cell) else value


def _plain(value: Any) -> Any:
    """Mappings, lists, numbers, text and None alone."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return finite(value.item() if isinstance(value, np.generic) else value)
