"""Progress callbacks and remaining time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from time import monotonic
from typing import TypeVar

T = TypeVar("T")

Progress = Callable[[str], None]
"""Called with one line of text."""
CountCallback = Callable[[int, int], None]
"""Called with the number of items begun and their total."""

MIN_REMAINING = 2.0
"""Remaining time (s) below which it is not reported."""


def silent(_message: str) -> None:
    """Report no progress."""


def counted(items: Sequence[T], announce: CountCallback | None) -> Iterator[T]:
    """The items, each announced as it is begun."""
    for done, item in enumerate(items):
        if announce is not None:
            announce(done, len(items))
        yield item


def count_progress(progress: Progress, doing: str) -> CountCallback:
    """Callback that reports one batch: "score tests given the rigid tool: 7 of 24, about 12 s remaining"."""
    begin = monotonic()

    def announce(done: int, total: int) -> None:
        remaining = (monotonic() - begin) / done * (total - done) if done else 0.0
        duration = f"{remaining:.0f} s" if remaining < 100 else f"{remaining / 60:.0f} min"
        time = f", about {duration} remaining" if remaining >= MIN_REMAINING else ""
        progress(f"{doing}: {done} of {total}{time}")

    return announce
