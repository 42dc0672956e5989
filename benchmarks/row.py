"""Row: one thing compared with what a user would use instead of it, as a ratio measured in one run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

from modeling.table import Column, Table

COLUMNS = (
    *map(Column, ("task", "truewrench", "instead", "quantity")),
    *(Column(name, format=".3g") for name in ("ratio", "from", "to")),
)
LEGEND = "ratio: the other's time, memory or evaluations over truewrench's; median, smallest and largest of the rounds"


@dataclass(frozen=True, kw_only=True)
class Row:
    """How many times more of `quantity` the other way takes, once for each round; below 1 it takes less."""

    task: str
    ours: str
    instead: str
    quantity: str
    ratios: tuple[float, ...]

    @property
    def cells(self) -> tuple[str | float, ...]:
        """The entries under `COLUMNS`."""
        return (
            self.task,
            self.ours,
            self.instead,
            self.quantity,
            median(self.ratios),
            min(self.ratios),
            max(self.ratios),
        )


def table(rows: Sequence[Row]) -> str:
    """The rows under their header, and what a ratio is."""
    return f"{Table.of(COLUMNS, [row.cells for row in rows])}\n\n{LEGEND}"
