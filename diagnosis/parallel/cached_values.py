"""Cached properties that all workers compute at once, each a part of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from diagnosis.parallel.workers import Workers


@dataclass(frozen=True, eq=False)
class CachedValue:
    """A `functools.cached_property` of an object that every process has: its `name`, and a label for the workers."""

    label: str
    owner: object
    name: str

    def get(self) -> Any:
        """The value, computed unless it is cached."""
        return getattr(self.owner, self.name)


def compute_by_all(workers: Workers, values: Sequence[CachedValue], *, shared: Sequence[object] = ()) -> None:
    """Compute cached properties, shared out among the workers; every process has them cached then.

    Which of them a process has already may differ between processes, so that all are items; such a process keeps its
    own. `shared` as in `Workers.map`, whose exceptions are raised.
    """
    found = workers.map(CachedValue.get, values, label=lambda value: value.label, shared=shared)
    for value, result in zip(values, found, strict=True):
        vars(value.owner).setdefault(value.name, result)
