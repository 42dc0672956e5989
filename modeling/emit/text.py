"""Text: expressions in the notation that C and Python share, with no more parentheses than they need."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import isfinite
from typing import NamedTuple

from modeling import symbolic as sp
from modeling.emit.arithmetic import Arithmetic
from modeling.emit.program import Program
from modeling.errors import InputError

SUM, PRODUCT, ATOM = range(3)
"""How tightly a text holds together."""


class Piece(NamedTuple):
    """A text, and how tightly it holds together."""

    text: str
    binding: int

    def within(self, binding: int) -> str:
        """The text in parentheses where it holds together less than that."""
        return self.text if self.binding >= binding else f"({self.text})"


@dataclass(frozen=True)
class Notation(Arithmetic[Piece]):
    """Expressions as text; `names` are those of symbols, `functions` formats by name where a language has its own."""

    names: Mapping[sp.Symbol, str]
    functions: Mapping[str, str]

    def number(self, value: float) -> Piece:
        """The shortest decimals that are this number again; InputError when it is none."""
        if not isfinite(value):
            raise InputError(what="a constant that is not finite", where="emit", remedy="leave the effect out")
        return Piece(repr(value), ATOM)

    def symbol(self, symbol: sp.Symbol) -> Piece:
        """Its name."""
        return Piece(self.names[symbol], ATOM)

    def add(self, left: Piece, right: Piece) -> Piece:
        """left + right."""
        return Piece(f"{left.text} + {right.within(PRODUCT)}", SUM)

    def subtract(self, left: Piece, right: Piece) -> Piece:
        """left - right."""
        return Piece(f"{left.text} - {right.within(PRODUCT)}", SUM)

    def multiply(self, left: Piece, right: Piece) -> Piece:
        """left * right."""
        return Piece(f"{left.within(PRODUCT)} * {right.within(ATOM)}", PRODUCT)

    def divide(self, left: Piece, right: Piece) -> Piece:
        """left / right."""
        return Piece(f"{left.within(PRODUCT)} / {right.within(ATOM)}", PRODUCT)

    def negate(self, value: Piece) -> Piece:
        """-value; a sum to whatever stands around it."""
        return Piece(f"-{value.within(PRODUCT)}", SUM)

    def power(self, base: Piece, exponent: int) -> Piece:
        """base * base * ..: the base is a name, or a program has made it one."""
        return Piece(" * ".join([base.within(ATOM)] * exponent), PRODUCT)

    def call(self, name: str, *arguments: Piece) -> Piece:
        """name(arguments)."""
        texts = [argument.text for argument in arguments]
        form = self.functions.get(name)
        return Piece(f"{name}({', '.join(texts)})" if form is None else form.format(*texts), ATOM)


class Line(NamedTuple):
    """A name and the text of what it stands for."""

    name: str
    text: str


def lines_of(
    program: Program, names: Mapping[sp.Symbol, str], functions: Mapping[str, str]
) -> tuple[list[Line], list[str]]:
    """The steps of a program, named t0, t1, .. in order, and the texts of its results."""
    steps = {symbol: f"t{number}" for number, (symbol, _) in enumerate(program.steps)}
    notation = Notation({**names, **steps}, functions)
    lines = [Line(steps[symbol], notation.of(expression).text) for symbol, expression in program.steps]
    return lines, [notation.of(result).text for result in program.results]


def identifiers(names: Iterable[str], prefix: str) -> list[str]:
    """A name of its own in any language for each: the prefix, then letters, digits and underscores."""
    found: list[str] = []
    for name in names:
        plain = prefix + "".join(c if c.isascii() and c.isalnum() else "_" for c in name)
        while plain in found:
            plain += "_"
        found.append(plain)
    return found


def comment(text: str) -> str:
    """Text in one line that can end no comment and no string, and is no trigraph, of any language that is emitted."""
    line = " ".join(text.split()).replace("\\", "/").replace('"', "'")
    plain = "".join(c if c.isascii() and c.isprintable() else REPLACED.get(c, "?") for c in line)
    return re.sub(r"\?(?=\?)|\*(?=/)|/(?=\*)", r"\g<0> ", plain)


REPLACED = {"²": "2", "³": "3", "°": "deg ", "·": " ", "⁴": "4", "–": "-", "×": "x", "±": "+-"}
"""What stands in comments for signs that are not in every compiler's character set."""
