"""Parser: from the text of a formula to its tree, by recursive descent; what it does not know, it refuses."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from difflib import get_close_matches

from modeling.errors import InputError
from modeling.formula.constants import Signed, added, applied, multiplied, number, raised
from modeling.formula.functions import FUNCTIONS
from modeling.formula.source import Source
from modeling.formula.tokens import Kind, Token, tokens
from modeling.formula.tree import Name, Node

DEEPEST = 30
"""Brackets within brackets: a person loses count long before, and Python's stack never notices."""
MOST_NODES = 300
"""Numbers, names and operations of a formula: what SymPy then does with it takes milliseconds."""

CONSTANTS = {"pi": math.pi}
"""Names that every formula knows."""


def parse(source: Source, known: Collection[str]) -> Node:
    """The tree of a formula over the names `known`, and pi.

        sum     = product {("+" | "-") product}
        product = signed {("*" | "/") signed}
        signed  = ("+" | "-") signed | power
        power   = atom [("^" | "**") signed]        so that -x^2 = -(x^2), and powers group from the right
        atom    = number | name | name "(" sum {"," sum} ")" | "(" sum ")"

    Parts without names are evaluated, in floating point, as they are read. Nothing else is evaluated, and nothing is
    executed. Raises InputError, naming the column, for all other text.
    """
    return _Parser(source, known).parsed()


class _Parser:
    """One pass over the tokens of a formula."""

    def __init__(self, source: Source, known: Collection[str]) -> None:
        self.source, self.known = source, known
        self.tokens = tokens(source)
        self.place = self.count = 0

    @property
    def next(self) -> Token:
        return self.tokens[self.place]

    def parsed(self) -> Node:
        tree = self._sum(0)
        if self.next.kind is not Kind.END:
            raise self._unexpected("an operator", "put + - * / or ^ in between, and close only brackets that are open")
        return tree

    # ----------------------------------------------------------------------------------- the grammar

    def _sum(self, depth: int) -> Node:
        return self._chain(depth, {"+": 1, "-": -1}, self._product, added)

    def _product(self, depth: int) -> Node:
        return self._chain(depth, {"*": 1, "/": -1}, self._signed, multiplied)

    def _chain(
        self,
        depth: int,
        operators: dict[str, int],
        part: Callable[[int], Node],
        joined: Callable[[Source, Signed, int], Node],
    ) -> Node:
        column = self.next.column
        parts = [(1, part(depth))]
        while (operator := self._taken(*operators)) is not None:
            parts.append((operators[operator.text], part(depth)))
        return parts[0][1] if len(parts) == 1 else self._counted(joined(self.source, tuple(parts), column))

    def _signed(self, depth: int) -> Node:
        self._require_shallow(depth)
        sign = self._taken("+", "-")
        if sign is None:
            return self._power(depth)
        inner = self._signed(depth + 1)
        return inner if sign.text == "+" else self._counted(added(self.source, ((-1, inner),), sign.column))

    def _power(self, depth: int) -> Node:
        column = self.next.column
        base = self._atom(depth)
        if self._taken("^", "**") is None:
            return base
        at = self.next.column
        return self._counted(raised(self.source, base, self._signed(depth + 1), column, at))

    def _atom(self, depth: int) -> Node:
        token = self.next
        if token.kind is Kind.NUMBER:
            self.place += 1
            return self._counted(number(self.source, lambda: float(token.text), token.column))
        if token.kind is Kind.NAME:
            self.place += 1
            return self._call(token, depth) if self.next.text == "(" else self._counted(self._name(token))
        if self._taken("(") is None:
            raise self._unexpected("a number, a name or a bracket", "complete or shorten the formula there")
        inner = self._sum(depth + 1)
        self._require(")")
        return inner

    def _name(self, token: Token) -> Node:
        if token.text in self.known:
            return Name(token.text, token.column)
        if token.text in CONSTANTS:
            return number(self.source, lambda: CONSTANTS[token.text], token.column)
        remedy = f"call it as {FUNCTIONS[token.text].usage}" if token.text in FUNCTIONS else self._meant(token.text)
        raise self.source.refusal(token.column, f"{token} is no name that is known here", remedy)

    def _call(self, token: Token, depth: int) -> Node:
        if token.text not in FUNCTIONS:
            raise self._no_function(token)
        function = FUNCTIONS[token.text]
        self._require("(")
        arguments = [self._sum(depth + 1)]
        while self._taken(",") is not None:
            arguments.append(self._sum(depth + 1))
        self._require(")")
        if not function.least <= len(arguments) <= function.most:
            what = f"{function.name} has {len(arguments)} argument{'s' * (len(arguments) > 1)} here"
            raise self.source.refusal(token.column, what, f"call it as {function.usage}")
        return self._counted(applied(self.source, function, tuple(arguments), token.column))

    # ------------------------------------------------------------------------------- tokens and limits

    def _taken(self, *texts: str) -> Token | None:
        """The next token if it is one of these operators."""
        token = self.next
        if token.kind is not Kind.OPERATOR or token.text not in texts:
            return None
        self.place += 1
        return token

    def _counted(self, node: Node) -> Node:
        self.count += 1
        if self.count > MOST_NODES:
            what = f"the formula has more than {MOST_NODES} numbers, names and operations"
            raise self.source.refusal(node.column, what, "divide it into steps with `let`")
        return node

    def _require(self, text: str) -> None:
        if self._taken(text) is None:
            raise self._unexpected(f"'{text}'", "close every bracket that is open, and put operators between terms")

    def _require_shallow(self, depth: int) -> None:
        if depth > DEEPEST:
            what = f"brackets, signs and powers are more than {DEEPEST} deep here"
            raise self.source.refusal(self.next.column, what, "divide the formula into steps with `let`")

    # -------------------------------------------------------------------------------------- refusals

    def _unexpected(self, expected: str, remedy: str) -> InputError:
        return self.source.refusal(self.next.column, f"{expected} was expected, and {self.next} came", remedy)

    def _meant(self, name: str) -> str:
        choices = [*self.known, *CONSTANTS]
        close = get_close_matches(name, choices, n=2)
        shown = ", ".join(choices[:12]) + ", .." * (len(choices) > 12)
        return f"did you mean {' or '.join(close)}?" if close else f"use one of {shown}"

    def _no_function(self, token: Token) -> InputError:
        if token.text in self.known:
            remedy = "put an operator before the bracket"
            return self.source.refusal(self.next.column, f"{token} is no function", remedy)
        close = get_close_matches(token.text, FUNCTIONS, n=2)
        usages = ", ".join(FUNCTIONS[name].usage for name in close or FUNCTIONS)
        remedy = f"did you mean {usages}?" if close else f"use one of {usages}"
        return self.source.refusal(token.column, f"{token} is no function that is known here", remedy)
