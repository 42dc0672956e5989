"""Incomplete vector: columns that would be a wrench or an orientation, if none of them were missing."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from estimation.logs.columns.column_pattern import PATTERNS, ColumnPattern, Quantity
from estimation.logs.columns.column_units import name_and_unit
from estimation.logs.log_table import LogTable
from modeling.errors import cut

LEAST_SHARE = 0.5
"""Of a vector's columns that are there, below which its name is chance."""


def columns_by_stem(pattern: ColumnPattern, table: LogTable) -> dict[str, dict[str, str]]:
    """Columns of a table that match a pattern, by stem and part."""
    found: dict[str, dict[str, str]] = {}
    for name in table.columns:
        match = pattern.matched(name_and_unit(name)[0])
        if match is not None:
            found.setdefault(match[0].lower(), {}).setdefault(match[1], name)
    return found


@dataclass(frozen=True)
class IncompleteVector:
    """Columns that are there, and the names that lack."""

    present: tuple[str, ...]
    missing: tuple[str, ...]

    @property
    def share(self) -> float:
        """Of the columns that are there."""
        return len(self.present) / (len(self.present) + len(self.missing))

    def __str__(self) -> str:
        present, missing = (tuple(map(cut, names)) for names in (self.present, self.missing))
        shown = present if len(present) < 4 else (present[0], "..", present[-1])
        verb = "is" if len(missing) == 1 else "are"
        listed = ", ".join(shown).replace(", .., ", " .. ")
        return f"beside {listed}, {', '.join(missing)} {verb} missing"


def nearest_vector(tables: Iterable[LogTable], quantities: Sequence[Quantity]) -> IncompleteVector | None:
    """The incomplete vector of these quantities that lacks least, the best pattern first; None without any."""
    patterns = [p for p in PATTERNS if p.quantity in quantities and len(p.parts) > 2]
    found = [
        incomplete
        for pattern in patterns
        for table in tables
        for members in columns_by_stem(pattern, table).values()
        if (incomplete := _incomplete(pattern, members)) is not None
    ]
    return max((v for v in found if v.share > LEAST_SHARE), key=lambda v: v.share, default=None)


def _incomplete(pattern: ColumnPattern, members: dict[str, str]) -> IncompleteVector | None:
    """What of a pattern's parts is there; None where all are, or numbers beyond them."""
    parts = pattern.parts
    if parts[0] == "0" and "0" not in members and str(len(parts)) in members:
        parts = tuple(str(int(part) + 1) for part in parts)
    lacking = [part for part in parts if part not in members]
    if not lacking or not set(members) <= set(parts):
        return None
    present = tuple(members[part] for part in parts if part in members)
    return IncompleteVector(present, tuple(_name_of(pattern, part, members) for part in lacking))


def _name_of(pattern: ColumnPattern, part: str, members: dict[str, str]) -> str:
    """The name that a column would have: that of another part of its kind, with its own part in the other's place."""
    for other, name in members.items():
        match = re.fullmatch(pattern.regex, name, re.IGNORECASE)
        if match is not None and other[:-1] == part[:-1]:
            start, end = match.span("part")
            return name[:start] + part[-(end - start) :] + name[end:]
    return part
