"""Markdown of a report: escaped text, and tables."""

from __future__ import annotations

import re
from typing import Any

from markupsafe import Markup

from modeling.table import Table

_SPECIAL = re.compile(r"([\\`*_{}\[\]<>#|~!$&])")
_LINE_BREAKS = re.compile(r"[\s\x00-\x1f\x85\u2028\u2029]+")


def markdown_text(value: Any) -> Any:
    """A value as Markdown that shows it as it is: special characters are escaped, line breaks are spaces.

    What is Markdown already, a `Markup`, stays.
    """
    if isinstance(value, Markup) or not isinstance(value, str):
        return value
    return _SPECIAL.sub(r"\\\1", _LINE_BREAKS.sub(" ", value))


def markdown_table(table: Table) -> Markup:
    """The table in Markdown, with an empty heading where it has none."""
    columns = table.filled.columns
    headings = [markdown_text(c.typeset_heading) for c in columns]
    rules = ["---:" if c.format else "---" for c in columns]
    rows = [[markdown_text(c.typeset(v)) for c, v in zip(columns, row, strict=True)] for row in table.filled.rows]
    return Markup("\n".join(f"| {' | '.join(cells)} |" for cells in [headings, rules, *rows]))  # escaped
