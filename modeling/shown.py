"""Shown: what a user wrote, as an error message may repeat it."""

from __future__ import annotations

LONGEST = 40
"""Characters, so that a message that repeats it still is one line."""


def shown(text: object) -> str:
    """The text in quotes, cut short; what a terminal would not print, or would obey, is escaped."""
    found = str(text)
    cut = found[:LONGEST] + "..." * (len(found) > LONGEST)
    return f"'{cut}'" if cut.isprintable() else ascii(cut)
