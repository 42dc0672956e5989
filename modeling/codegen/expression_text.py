"""Expressions in the syntax shared by C and Python, with minimal parentheses."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import isfinite
from typing import NamedTuple

from modeling import symbolic as sp
from modeling.errors import InputError
from modeling.expressions.arithmetic import Arithmetic
from modeling.expressions.straight_line_program import StraightLineProgram

SUM, PRODUCT, ATOM = range(3)
"""Precedence of a text's outermost operator, lowest first."""


class TextFragment(NamedTuple):
    """A text and the precedence of its outermost operator."""

    text: str
    precedence: int

    def within(self, precedence: int) -> str:
        """The text, in parentheses where its precedence is lower than that."""
        return self.text if self.precedence >= precedence else f"({self.text})"


@dataclass(frozen=True)
class TextArithmetic(Arithmetic[TextFragment]):
    """Expressions as text; `names` of the symbols, `functions` formats by name where C's call syntax is not used."""

    names: Mapping[sp.Symbol, str]
    functions: Mapping[str, str]

    def number(self, value: float) -> TextFragment:
        """The shortest decimal text that reads back as the same number; InputError when it is not finite."""
        if not isfinite(value):
            raise InputError(what="a constant that is not finite", where="emit", remedy="leave the effect out")
        return TextFragment(repr(value), ATOM)

    def symbol(self, symbol: sp.Symbol) -> TextFragment:
        """Its name."""
        return TextFragment(self.names[symbol], ATOM)

    def add(self, left: TextFragment, right: TextFragment) -> TextFragment:
        """left + right."""
        return TextFragment(f"{left.text} + {right.within(PRODUCT)}", SUM)

    def subtract(self, left: TextFragment, right: TextFragment) -> TextFragment:
        """left - right."""
        return TextFragment(f"{left.text} - {right.within(PRODUCT)}", SUM)

    def multiply(self, left: TextFragment, right: TextFragment) -> TextFragment:
        """left * right."""
        return TextFragment(f"{left.within(PRODUCT)} * {right.within(ATOM)}", PRODUCT)

    def divide(self, left: TextFragment, right: TextFragment) -> TextFragment:
        """left / right."""
        return TextFragment(f"{left.within(PRODUCT)} / {right.within(ATOM)}", PRODUCT)

    def negate(self, value: TextFragment) -> TextFragment:
        """-value, with the precedence of a sum."""
        return TextFragment(f"-{value.within(PRODUCT)}", SUM)

    def power(self, base: TextFragment, exponent: int) -> TextFragment:
        """base * base * ..; in a shared program the base is a name."""
        return TextFragment(" * ".join([base.within(ATOM)] * exponent), PRODUCT)

    def call(self, name: str, *arguments: TextFragment) -> TextFragment:
        """name(arguments)."""
        texts = [argument.text for argument in arguments]
        pattern = self.functions.get(name)
        return TextFragment(f"{name}({', '.join(texts)})" if pattern is None else pattern.format(*texts), ATOM)


class Assignment(NamedTuple):
    """A variable and the text of its value."""

    name: str
    text: str


def assignments_of(
    program: StraightLineProgram, names: Mapping[sp.Symbol, str], functions: Mapping[str, str]
) -> tuple[list[Assignment], list[str]]:
    """The assignments of a program, to t0, t1, .. in order, and the texts of its results."""
    steps = {symbol: f"t{number}" for number, (symbol, _) in enumerate(program.steps)}
    arithmetic = TextArithmetic({**names, **steps}, functions)
    lines = [Assignment(steps[symbol], arithmetic.of(expression).text) for symbol, expression in program.steps]
    return lines, [arithmetic.of(result).text for result in program.results]


def identifiers(names: Iterable[str], prefix: str) -> list[str]:
    """A distinct identifier, valid in every target, for each name: the prefix, then letters, digits, underscores."""
    found: list[str] = []
    for name in names:
        plain = prefix + "".join(c if c.isascii() and c.isalnum() else "_" for c in name)
        while plain in found:
            plain += "_"
        found.append(plain)
    return found


def comment_text(text: str) -> str:
    """Text in one ASCII line that cannot end a comment or a string of any target, nor form a trigraph."""
    line = " ".join(text.split()).replace("\\", "/").replace('"', "'")
    plain = "".join(c if c.isascii() and c.isprintable() else ASCII_REPLACEMENTS.get(c, "?") for c in line)
    return re.sub(r"\?(?=\?)|\*(?=/)|/(?=\*)", r"\g<0> ", plain)


ASCII_REPLACEMENTS = {"²": "2", "³": "3", "°": "deg ", "·": " ", "⁴": "4", "–": "-", "×": "x", "±": "+-"}
"""Replacements, in comments, of characters outside ASCII."""
