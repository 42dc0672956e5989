"""Parser of a formula's text into a syntax tree of the standard library's `ast`, constants folded."""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Collection, Iterable, Sequence
from fractions import Fraction
from functools import partial

from modeling.errors import quoted, suggestion
from modeling.formulas.functions import FORMULA_FUNCTIONS, FormulaFunction
from modeling.formulas.syntax_tree import LARGEST_EXPONENT, SUM, chain_links, child_nodes, exponent, signed_parts
from modeling.formulas.tokens import DEEPEST_NESTING, FormulaSource, python_text, too_deep

MOST_NODES = 300
"""Numbers, names and operations of a formula at most: SymPy then takes milliseconds."""
DEEPEST_TREE = 4 * DEEPEST_NESTING
"""Depth of the syntax tree at most: of each bracket a sum, a product and a power."""
FRACTION_TOLERANCE = 1e-12
"""Tolerance within which a float is taken for a fraction."""
NAMED_CONSTANTS = {"pi": math.pi}
"""Constants known in every formula."""
FILE_NAME = "<formula>"
"""Of the text in Python's audit events: it is compiled to a syntax tree, never to code."""


def parse_formula(source: FormulaSource, known: Collection[str]) -> ast.expr:
    """The syntax tree of a formula of the names `known`, and pi.

    Numbers, names, + - * / ^ (or **), brackets and calls of `FORMULA_FUNCTIONS` mean what they mean in Python.
    Constant parts are folded, in floating point. Nothing else is evaluated, and nothing is executed. Raises InputError,
    naming the column, for all other text.
    """
    tree = _parsed(source)
    _require_limits(tree, source)
    return _Folding(source, known).folded(tree)


def _parsed(source: FormulaSource) -> ast.expr:
    """The tree as Python parses it, its columns those of the formula."""
    text, columns = python_text(source)
    try:
        tree = ast.parse(text, FILE_NAME, mode="eval").body
    except (RecursionError, MemoryError):
        raise too_deep(source, 1) from None
    except SyntaxError as error:
        column = columns.get((error.offset or 0) - 1, len(source.text) + 1)
        found = quoted(source.text[column - 1 :]) if column <= len(source.text) else "the end"
        remedy = "complete the formula there: an operator between its terms, a bracket for every other"
        raise source.error(column, f"{error.msg} at {found}", remedy) from None
    for node in ast.walk(tree):
        if isinstance(node, ast.expr):
            node.col_offset = columns[node.col_offset]
        if isinstance(node, ast.Name):
            node.id = node.id.removesuffix("_")
    return tree


def _require_limits(tree: ast.expr, source: FormulaSource) -> None:
    pending, count = [(tree, 0)], 0
    while pending:
        node, depth = pending.pop()
        count += 1
        if depth > DEEPEST_TREE:
            raise too_deep(source, node.col_offset)
        if count > MOST_NODES:
            what = f"the formula has more than {MOST_NODES} numbers, names and operations"
            raise source.error(node.col_offset, what, "divide it into steps with `let`")
        pending += [(child, depth + 1) for child in child_nodes(node)]


class _Folding:
    """One pass over a tree: names, functions and exponents are checked, constant parts evaluated."""

    def __init__(self, source: FormulaSource, known: Collection[str]) -> None:
        self.source, self.known = source, known

    def folded(self, node: ast.expr) -> ast.expr:
        match node:
            case ast.Constant():
                return self._evaluated(node, [node], float)
            case ast.Name():
                return self._name(node)
            case ast.UnaryOp(op=ast.UAdd(), operand=operand):
                return self.folded(operand)
            case ast.UnaryOp(op=ast.USub()):
                node.operand = self.folded(node.operand)
                return self._evaluated(node, [node.operand], lambda x: -x)
            case ast.BinOp(op=ast.Pow()):
                return self._power(node)
            case ast.BinOp(op=ast.Add() | ast.Sub() | ast.Mult() | ast.Div()):
                return self._chain(node)
            case ast.Call(func=ast.Name(id=name), keywords=[]):
                function = self._function(name, node)
                node.args = [self.folded(argument) for argument in node.args]
                return self._evaluated(node, node.args, function.number)
            case _:
                what = f"a {type(node).__name__.lower()} is not allowed in a formula"
                remedy = "use numbers, names, + - * / ^, brackets, and commas between a function's arguments"
                raise self.source.error(node.col_offset, what, remedy)

    def _evaluated(self, node: ast.expr, parts: Sequence[ast.expr], compute: Callable[..., float]) -> ast.expr:
        """The node, or `compute` of the values of its parts where all are numbers.

        In floats, as integers could grow without bound. Raises InputError when it is undefined or not finite.
        """
        values = [part.value for part in parts if isinstance(part, ast.Constant)]
        if len(values) < len(parts):
            return node
        try:
            value = float(compute(*values))
        except ZeroDivisionError:
            raise self.source.error(node.col_offset, "division by zero", "correct the numbers there") from None
        except (ValueError, OverflowError):
            value = math.nan
        if not math.isfinite(value):
            raise self.source.error(node.col_offset, "the value is not a finite number", "correct the numbers there")
        return ast.Constant(value, lineno=1, col_offset=node.col_offset)

    def _chain(self, node: ast.BinOp) -> ast.expr:
        """A sum or product of any number of parts, without recursion over them."""
        links = chain_links(node)
        links[0].left = self.folded(links[0].left)
        for link in links:
            link.right = self.folded(link.right)
        signs, parts = zip(*signed_parts(node), strict=True)
        compute = _signed_sum if isinstance(node.op, SUM) else _signed_product
        return self._evaluated(node, parts, partial(compute, signs))

    def _power(self, node: ast.BinOp) -> ast.expr:
        """A power with a small constant exponent."""
        node.left, node.right = self.folded(node.left), self.folded(node.right)
        remedy = f"use a constant such as 2, -3 or 1/2 of numbers up to {LARGEST_EXPONENT}, and exp(x) for other powers"
        match node.right:
            case ast.Constant(value=float(value)):
                power = exponent(node)
                if abs(power.numerator) > LARGEST_EXPONENT or abs(float(power) - value) >= FRACTION_TOLERANCE:
                    what = f"the exponent {value:.6g} is out of range"
                    raise self.source.error(node.right.col_offset, what, remedy)
                return self._evaluated(node, [node.left], partial(_real_power, power))
            case _:
                raise self.source.error(node.right.col_offset, "the exponent is not a constant", remedy)

    # ------------------------------------------------------------------------------------------- names

    def _name(self, node: ast.Name) -> ast.expr:
        if node.id in self.known:
            return node
        if node.id in NAMED_CONSTANTS:
            return ast.Constant(NAMED_CONSTANTS[node.id], lineno=1, col_offset=node.col_offset)
        remedy = suggestion(node.id, [*self.known, *NAMED_CONSTANTS])
        if node.id in FORMULA_FUNCTIONS:
            remedy = f"call it as {FORMULA_FUNCTIONS[node.id].usage}"
        raise self.source.error(node.col_offset, f"{quoted(node.id)} is not a known name", remedy)

    def _function(self, name: str, call: ast.Call) -> FormulaFunction:
        """The function of a call, with as many arguments as it takes."""
        if name not in FORMULA_FUNCTIONS:
            if name in self.known:
                bracket = self.source.text.index("(", call.col_offset) + 1
                raise self.source.error(
                    bracket, f"{quoted(name)} is not a function", "put an operator before the bracket"
                )
            remedy = suggestion(name, FORMULA_FUNCTIONS, lambda n: FORMULA_FUNCTIONS[n].usage)
            raise self.source.error(call.col_offset, f"{quoted(name)} is not a known function", remedy)
        function, count = FORMULA_FUNCTIONS[name], len(call.args)
        if not function.least <= count <= function.most:
            what = f"{name} is called with {count} argument{'s' * (count > 1)}"
            raise self.source.error(call.col_offset, what, f"call it as {function.usage}")
        return function


def _signed_sum(signs: Iterable[int], *values: float) -> float:
    return sum(sign * value for sign, value in zip(signs, values, strict=True))


def _signed_product(signs: Iterable[int], *values: float) -> float:
    return math.prod(value if sign > 0 else 1 / value for sign, value in zip(signs, values, strict=True))


def _real_power(power: Fraction, base: float) -> float:
    if base < 0 and power.denominator > 1:
        raise ValueError("a root of a negative number is not real")
    return float(base ** (int(power) if power.denominator == 1 else float(power)))
