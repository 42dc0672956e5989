"""Recursive-descent parser of a formula's text into a syntax tree; everything outside the grammar is an error."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from difflib import get_close_matches

from modeling.errors import InputError
from modeling.formulas.constant_folding import (
    SignedTerms,
    folded_call,
    folded_number,
    folded_power,
    folded_product,
    folded_sum,
)
from modeling.formulas.functions import FORMULA_FUNCTIONS
from modeling.formulas.source import FormulaSource
from modeling.formulas.syntax_tree import Name, Node
from modeling.formulas.tokens import Token, TokenKind, tokenize

DEEPEST_NESTING = 30
"""Depth of nested brackets, signs and powers at most; within Python's recursion limit."""
MOST_NODES = 300
"""Numbers, names and operations of a formula at most: SymPy then takes milliseconds."""

NAMED_CONSTANTS = {"pi": math.pi}
"""Constants known in every formula."""


def parse_formula(source: FormulaSource, known: Collection[str]) -> Node:
    """The syntax tree of a formula of the names `known`, and pi.

        sum     = product {("+" | "-") product}
        product = signed {("*" | "/") signed}
        signed  = ("+" | "-") signed | power
        power   = atom [("^" | "**") signed]        so that -x^2 = -(x^2), and powers group from the right
        atom    = number | name | name "(" sum {"," sum} ")" | "(" sum ")"

    Constant parts are folded, in floating point. Nothing else is evaluated, and nothing is executed. Raises InputError,
    naming the column, for all other text.
    """
    return _Parser(source, known).parsed()


class _Parser:
    """One pass over the tokens of a formula."""

    def __init__(self, source: FormulaSource, known: Collection[str]) -> None:
        self.source, self.known = source, known
        self.tokens = tokenize(source)
        self.place = self.count = 0

    @property
    def next(self) -> Token:
        return self.tokens[self.place]

    def parsed(self) -> Node:
        tree = self._sum(0)
        if self.next.kind is not TokenKind.END:
            raise self._unexpected("an operator", "put + - * / or ^ in between, or remove an unmatched bracket")
        return tree

    # ----------------------------------------------------------------------------------- the grammar

    def _sum(self, depth: int) -> Node:
        return self._chain(depth, {"+": 1, "-": -1}, self._product, folded_sum)

    def _product(self, depth: int) -> Node:
        return self._chain(depth, {"*": 1, "/": -1}, self._signed, folded_product)

    def _chain(
        self,
        depth: int,
        operators: dict[str, int],
        part: Callable[[int], Node],
        joined: Callable[[FormulaSource, SignedTerms, int], Node],
    ) -> Node:
        column = self.next.column
        parts = [(1, part(depth))]
        while (operator := self._accept(*operators)) is not None:
            parts.append((operators[operator.text], part(depth)))
        return parts[0][1] if len(parts) == 1 else self._counted(joined(self.source, tuple(parts), column))

    def _signed(self, depth: int) -> Node:
        self._require_depth(depth)
        sign = self._accept("+", "-")
        if sign is None:
            return self._power(depth)
        inner = self._signed(depth + 1)
        return inner if sign.text == "+" else self._counted(folded_sum(self.source, ((-1, inner),), sign.column))

    def _power(self, depth: int) -> Node:
        column = self.next.column
        base = self._atom(depth)
        if self._accept("^", "**") is None:
            return base
        at = self.next.column
        return self._counted(folded_power(self.source, base, self._signed(depth + 1), column, at))

    def _atom(self, depth: int) -> Node:
        token = self.next
        if token.kind is TokenKind.NUMBER:
            self.place += 1
            return self._counted(folded_number(self.source, lambda: float(token.text), token.column))
        if token.kind is TokenKind.NAME:
            self.place += 1
            return self._call(token, depth) if self.next.text == "(" else self._counted(self._name(token))
        if self._accept("(") is None:
            raise self._unexpected("a number, a name or a bracket", "complete the formula there")
        inner = self._sum(depth + 1)
        self._require(")")
        return inner

    def _name(self, token: Token) -> Node:
        if token.text in self.known:
            return Name(token.text, token.column)
        if token.text in NAMED_CONSTANTS:
            return folded_number(self.source, lambda: NAMED_CONSTANTS[token.text], token.column)
        remedy = (
            f"call it as {FORMULA_FUNCTIONS[token.text].usage}"
            if token.text in FORMULA_FUNCTIONS
            else self._suggestion(token.text)
        )
        raise self.source.error(token.column, f"{token} is not a known name", remedy)

    def _call(self, token: Token, depth: int) -> Node:
        if token.text not in FORMULA_FUNCTIONS:
            raise self._unknown_function(token)
        function = FORMULA_FUNCTIONS[token.text]
        self._require("(")
        arguments = [self._sum(depth + 1)]
        while self._accept(",") is not None:
            arguments.append(self._sum(depth + 1))
        self._require(")")
        if not function.least <= len(arguments) <= function.most:
            what = f"{function.name} is called with {len(arguments)} argument{'s' * (len(arguments) > 1)}"
            raise self.source.error(token.column, what, f"call it as {function.usage}")
        return self._counted(folded_call(self.source, function, tuple(arguments), token.column))

    # ------------------------------------------------------------------------------- tokens and limits

    def _accept(self, *texts: str) -> Token | None:
        """Consume and return the next token if it is one of these operators."""
        token = self.next
        if token.kind is not TokenKind.OPERATOR or token.text not in texts:
            return None
        self.place += 1
        return token

    def _counted(self, node: Node) -> Node:
        self.count += 1
        if self.count > MOST_NODES:
            what = f"the formula has more than {MOST_NODES} numbers, names and operations"
            raise self.source.error(node.column, what, "divide it into steps with `let`")
        return node

    def _require(self, text: str) -> None:
        if self._accept(text) is None:
            raise self._unexpected(f"'{text}'", "close every open bracket, and put operators between terms")

    def _require_depth(self, depth: int) -> None:
        if depth > DEEPEST_NESTING:
            what = f"brackets, signs and powers are nested more than {DEEPEST_NESTING} deep"
            raise self.source.error(self.next.column, what, "divide the formula into steps with `let`")

    # -------------------------------------------------------------------------------------- errors

    def _unexpected(self, expected: str, remedy: str) -> InputError:
        return self.source.error(self.next.column, f"expected {expected}, found {self.next}", remedy)

    def _suggestion(self, name: str) -> str:
        choices = [*self.known, *NAMED_CONSTANTS]
        close = get_close_matches(name, choices, n=2)
        names = ", ".join(choices[:12]) + ", .." * (len(choices) > 12)
        return f"did you mean {' or '.join(close)}?" if close else f"use one of {names}"

    def _unknown_function(self, token: Token) -> InputError:
        if token.text in self.known:
            remedy = "put an operator before the bracket"
            return self.source.error(self.next.column, f"{token} is not a function", remedy)
        close = get_close_matches(token.text, FORMULA_FUNCTIONS, n=2)
        usages = ", ".join(FORMULA_FUNCTIONS[name].usage for name in close or FORMULA_FUNCTIONS)
        remedy = f"did you mean {usages}?" if close else f"use one of {usages}"
        return self.source.error(token.column, f"{token} is not a known function", remedy)
