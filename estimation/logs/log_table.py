"""Log table: named numeric columns of one source, as found there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
ROS_TOPIC, TF_CHAIN = "ROS topic", "tf chain"
"""Kinds of the tables of a ROS bag."""
NO_WRENCH = "no topic of geometry_msgs/WrenchStamped"


@dataclass(frozen=True, kw_only=True, eq=False)
class LogTable:
    """Columns (n,) of one source (a file, a sheet, a topic), in its units; NaN where a cell is empty or no number.

    texts     columns of text, with the first different values of each
    wrench_frame  the frame that the source states for its wrench; None where it states none
    unread    what else the source holds that no table was made of, such as topics of other types
    notes     what the reader had to do, as (what, number of cells or rows, whether samples were changed by it)
    """

    name: str
    kind: str
    columns: Mapping[str, Array]
    texts: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    wrench_frame: str | None = None
    notes: tuple[tuple[str, int, bool], ...] = ()
    unread: tuple[str, ...] = ()

    @property
    def rows(self) -> int:
        """The number of rows n."""
        return len(next(iter(self.columns.values()), ()))


def unique_names(names: Sequence[str]) -> list[str]:
    """The names, numbered where empty (`column_3`) and where they occur again (`x.2`)."""
    seen: dict[str, int] = {}
    found = []
    for place, name in enumerate(names, 1):
        base = name.strip() or f"column_{place}"
        seen[base] = seen.get(base, 0) + 1
        found.append(base if seen[base] == 1 else f"{base}.{seen[base]}")
    return found
