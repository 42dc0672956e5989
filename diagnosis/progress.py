"""Progress: what is being done, how much of it is done, and how long the rest may take."""

from __future__ import annotations

from collections.abc import Callable
from time import monotonic

Progress = Callable[[str], None]
"""Takes one line."""
Announce = Callable[[int, int], None]
"""Takes how many items of how many were begun."""

SHORTEST = 2.0
"""Seconds below which nobody needs to know how long it takes."""


def silent(_message: str) -> None:
    """Report no progress."""


def counted(progress: Progress, doing: str) -> Announce:
    """What announces the items of one piece of work: "screen beside the rigid tip: 7 of 24, about 12 s left"."""
    begin = monotonic()

    def announce(done: int, total: int) -> None:
        left = (monotonic() - begin) / done * (total - done) if done else 0.0
        rest = f", about {left:.0f} s left" if left >= SHORTEST else ""
        progress(f"{doing}: {done} of {total}{rest}")

    return announce
