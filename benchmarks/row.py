"""Row: one thing compared with what a user would use instead of it, as a ratio measured in one run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

HEADER = ("task", "truewrench", "instead", "quantity", "ratio", "from", "to")
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
    def cells(self) -> tuple[str, ...]:
        """The row as text, under `HEADER`."""
        numbers = (median(self.ratios), min(self.ratios), max(self.ratios))
        return (self.task, self.ours, self.instead, self.quantity, *(f"{n:.3g}" for n in numbers))


def table(rows: Sequence[Row]) -> str:
    """The rows under their header, numbers to the right, and what a ratio is."""
    lines = [HEADER, *(row.cells for row in rows)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(HEADER))]
    text = [
        "  ".join(c.rjust(w) if i > 3 else c.ljust(w) for i, (c, w) in enumerate(zip(line, widths, strict=True)))
        for line in lines
    ]
    return "\n".join([*text, "", LEGEND])
