"""Rows of a survey as a Parquet table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pyarrow as pa
from pyarrow import parquet

from truewrench.surveying.survey_row import BY_CHANNEL, SurveyRow

_SIZES = pa.list_(
    pa.struct(
        [
            ("effect", pa.string()),
            ("parameter", pa.string()),
            ("value", pa.float64()),
            ("std", pa.float64()),
            ("unit", pa.string()),
        ]
    )
)
SCHEMA = pa.schema(
    [
        ("file", pa.string()),
        ("recorded", pa.timestamp("us")),
        ("recorded_from", pa.string()),
        ("verdict", pa.string()),
        ("added", pa.list_(pa.string())),
        ("sizes", _SIZES),
        ("parameters", _SIZES),
        ("tool_unknown", pa.string()),
        ("misfit_before", pa.float64()),
        ("misfit", pa.float64()),
        *((name, pa.map_(pa.string(), pa.float64())) for name in BY_CHANNEL),
        ("seconds", pa.float64()),
        ("error", pa.string()),
    ]
)
"""Of survey.parquet: errors by channel and sizes in the units of FORMATS, local times without a zone."""


def parquet_table(rows: Sequence[SurveyRow]) -> pa.Table:
    """The table, one row per recording."""
    data = [row.to_data() for row in rows]
    for line, row in zip(data, rows, strict=True):
        line["recorded"] = None if row.time is None else row.time.moment
        line |= {name: list(line[name].items()) for name in BY_CHANNEL}
    return pa.Table.from_pylist(data, schema=SCHEMA)


def write_parquet(rows: Sequence[SurveyRow], path: Path) -> None:
    """Write the table as Parquet."""
    parquet.write_table(parquet_table(rows), path)
