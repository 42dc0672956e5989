"""Tokens of a formula's text: numbers, names and operators."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

from modeling.errors import quoted
from modeling.formulas.source import FormulaSource

LONGEST_FORMULA = 1000
"""Characters of a formula at most; `let` divides a longer one into steps."""
LONGEST_NAME = 40
"""Characters of a name at most, so that an error message stays one line."""

_TOKEN = re.compile(
    r"(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)"
    r"|(?P<name>[A-Za-z][A-Za-z0-9_]*)"
    r"|(?P<operator>\*\*|[-+*/^(),])"
    r"|(?P<space>[ \t\r\n]+)"
)

_REPLACEMENTS: Mapping[str, str] = {
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
"""Remedies for characters outside the grammar."""


class TokenKind(Enum):
    """Kind of a token."""

    NUMBER = "a number"
    NAME = "a name"
    OPERATOR = "an operator"
    END = "the end"


@dataclass(frozen=True)
class Token:
    """A piece of text at a column (from 1)."""

    kind: TokenKind
    text: str
    column: int

    def __str__(self) -> str:
        return "the end" if self.kind is TokenKind.END else quoted(self.text)


def tokenize(source: FormulaSource) -> list[Token]:
    """The tokens of a formula, the last of them the end.

    Raises InputError at the first invalid character, or when the text is too long.
    """
    if len(source.text) > LONGEST_FORMULA:
        what = f"the formula has {len(source.text)} characters"
        raise source.error(LONGEST_FORMULA + 1, what, f"use {LONGEST_FORMULA} at most, and `let` for repeated parts")
    found, place = [], 0
    while place < len(source.text):
        match = _TOKEN.match(source.text, place)
        if match is None:
            character = source.text[place]
            remedy = _REPLACEMENTS.get(character, "use numbers, names, + - * / ^ and round brackets")
            raise source.error(place + 1, f"{quoted(character)} is not allowed in a formula", remedy)
        if match.lastgroup != "space":
            found.append(Token(TokenKind[str(match.lastgroup).upper()], match[0], place + 1))
        place = match.end()
    return [*found, Token(TokenKind.END, "", len(source.text) + 1)]
