"""Tokens: the numbers, names and operators that a formula's text is made of."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

from modeling.formula.source import Source
from modeling.shown import shown

LONGEST = 1000
"""Characters: a longer formula nobody reads, and `let` divides it into steps."""
LONGEST_NAME = 40
"""Characters, so that a refusal that names it still is one line."""

_TOKEN = re.compile(
    r"(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)"
    r"|(?P<name>[A-Za-z][A-Za-z0-9_]*)"
    r"|(?P<operator>\*\*|[-+*/^(),])"
    r"|(?P<space>[ \t\r\n]+)"
)

_INSTEAD: Mapping[str, str] = {
    **dict.fromkeys("·×", "write * for a product"),
    **dict.fromkeys("−–", "write - for a difference"),
    **dict.fromkeys("²³⁴", "write ^2 for a power"),
    **dict.fromkeys("<>=!", "use min, max or step(x, width): a formula has no comparisons"),
    **dict.fromkeys("[]{}", "use round brackets"),
    "÷": "write / for a quotient",
    "√": "write sqrt(x)",
    "|": "write abs(x)",
    "_": "begin names with a letter",
    "#": "write comments outside of the quotes",
    ".": "write numbers like 0.5, and names without a point",
}
"""How to say what other characters are mostly meant to say."""


class Kind(Enum):
    """What a token is."""

    NUMBER = "a number"
    NAME = "a name"
    OPERATOR = "an operator"
    END = "the end"


@dataclass(frozen=True)
class Token:
    """A piece of text at a column (from 1)."""

    kind: Kind
    text: str
    column: int

    def __str__(self) -> str:
        return "the end" if self.kind is Kind.END else shown(self.text)


def tokens(source: Source) -> list[Token]:
    """The tokens of a formula, the last of them the end.

    Raises InputError at the first character that is no part of a formula, or when there are too many.
    """
    if len(source.text) > LONGEST:
        what = f"the formula has {len(source.text)} characters"
        raise source.refusal(LONGEST + 1, what, f"use {LONGEST} at most, and `let` for what comes more than once")
    found, place = [], 0
    while place < len(source.text):
        match = _TOKEN.match(source.text, place)
        if match is None:
            character = source.text[place]
            remedy = _INSTEAD.get(character, "use numbers, names, + - * / ^ and round brackets")
            raise source.refusal(place + 1, f"{shown(character)} is no part of a formula", remedy)
        if match.lastgroup != "space":
            found.append(Token(Kind[str(match.lastgroup).upper()], match[0], place + 1))
        place = match.end()
    return [*found, Token(Kind.END, "", len(source.text) + 1)]
