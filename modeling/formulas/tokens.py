"""Text of a formula with its location, and the same as Python writes it, token by token."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from modeling.errors import InputError, quoted

LONGEST_FORMULA = 1000
"""Characters of a formula at most; `let` divides a longer one into steps."""
LONGEST_NAME = 40
"""Characters of a name at most, so that an error message stays one line."""
DEEPEST_NESTING = 30
"""Depth of nested brackets at most; within Python's recursion limit."""

NUMBER, NAME = r"(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?", r"[A-Za-z][A-Za-z0-9_]*"
"""Patterns of a number without a sign, and of a name."""
_TOKEN = re.compile(
    rf"(?P<number>{NUMBER})|(?P<name>{NAME})"
    r"|(?P<operator>\*\*|[-+*/^(),])|(?P<space>[ \t\r\n]+)"
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


@dataclass(frozen=True)
class FormulaSource:
    """A formula's text; `where` is its location (file, effect and key) in error messages."""

    text: str
    where: str = "formula"

    def error(self, column: int, what: str, remedy: str) -> InputError:
        """An error about the character at `column`, counted from 1."""
        return InputError(what=what, where=f"{self.where}, column {column}", remedy=remedy)


def python_text(source: FormulaSource) -> tuple[str, dict[int, int]]:
    """The formula as Python writes it, and the column in the formula of each place where a token begins there.

    Python means the same by each token, in all its versions: a name gets a trailing underscore, so that it is no
    keyword, a number becomes a float, and ^ becomes **.
    Raises InputError at a character outside the grammar, and for a text that is too long or too deeply nested.
    """
    text, columns, place, depth = "", {}, 0, 0
    if len(source.text) > LONGEST_FORMULA:
        what = f"the formula has {len(source.text)} characters"
        raise source.error(LONGEST_FORMULA + 1, what, f"use {LONGEST_FORMULA} at most, and `let` for repeated parts")
    while place < len(source.text):
        match = _TOKEN.match(source.text, place)
        if match is None:
            remedy = _REPLACEMENTS.get(source.text[place], "use numbers, names, + - * / ^ and round brackets")
            raise source.error(place + 1, f"{quoted(source.text[place])} is not allowed in a formula", remedy)
        depth += {"(": 1, ")": -1}.get(match[0], 0)
        if depth > DEEPEST_NESTING:
            raise too_deep(source, place + 1)
        columns[len(text)] = place + 1
        text += _REWRITTEN[str(match.lastgroup)](match[0])
        place = match.end()
    return text.rstrip(), columns


_REWRITTEN: Mapping[str, Callable[[str], str]] = {
    "number": lambda text: f"{float(text)!r} ".replace("inf", "1e999"),
    "name": lambda text: f"{text}_ ",
    "operator": lambda text: text.replace("^", "**") + " ",
    "space": lambda text: "",
}


def too_deep(source: FormulaSource, column: int) -> InputError:
    """The error for a formula nested too deep."""
    what = f"brackets, signs and powers are nested more than {DEEPEST_NESTING} deep"
    return source.error(column, what, "divide the formula into steps with `let`")
