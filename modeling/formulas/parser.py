"""Parser of a formula's text into a syntax tree of the standard library's `ast`, constants folded."""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from fractions import Fraction
from functools import partial

from modeling import symbolic as sp
from modeling.errors import InputError, quoted, suggestion

# Text of a formula with its location, and the same as Python writes it, token by token.


LONGEST_FORMULA = 1000
"""Characters of a formula at most; `let` divides a longer one into steps."""
LONGEST_NAME = 40
"""Characters of a name at most, so that an error message stays one line."""
DEEPEST_NESTING = 30
"""Depth of nested brackets at most; within Python's recursion limit."""

NUMBER = r"(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
"""Pattern of a number without a sign."""
NAME = r"[A-Za-z][A-Za-z0-9_]*"
"""Pattern of a name."""
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


# Walks over a formula's syntax tree, whose `col_offset` are columns (from 1) of the formula's text.
#
# Its nodes are those of the standard library's `ast`, of five kinds: Constant (a float), Name, UnaryOp (a minus),
# BinOp (a sum, a product or a power with a constant exponent) and Call (of a formula function).


LARGEST_EXPONENT = 8
"""Bound on numerator and denominator of an exponent: no law of physics has more, and 9^9^9 would never end."""
SUM = (ast.Add, ast.Sub)
"""Operators of a sum."""
PRODUCT = (ast.Mult, ast.Div)
"""Operators of a product."""


def chain_links(node: ast.BinOp) -> list[ast.BinOp]:
    """The operations of a sum a + b - c, or a product a * b / c, the leftmost first; a power alone."""
    kind = next((kind for kind in (SUM, PRODUCT) if isinstance(node.op, kind)), ())
    links = [node]
    while isinstance(links[-1].left, ast.BinOp) and isinstance(links[-1].left.op, kind):
        links.append(links[-1].left)
    return links[::-1]


def signed_parts(node: ast.BinOp) -> list[tuple[int, ast.expr]]:
    """The terms of a sum, each with its sign, or the factors of a product, with -1 for divisors."""
    links = chain_links(node)
    return [(1, links[0].left), *((-1 if isinstance(n.op, ast.Sub | ast.Div) else 1, n.right) for n in links)]


def exponent(power: ast.BinOp) -> Fraction:
    """The constant exponent of a power."""
    assert isinstance(power.right, ast.Constant)
    assert isinstance(power.right.value, float)
    return Fraction(power.right.value).limit_denominator(LARGEST_EXPONENT)


def child_nodes(node: ast.expr) -> list[ast.expr]:
    """The terms, factors, arguments, or base and exponent of a node."""
    match node:
        case ast.BinOp(op=ast.Pow()):
            return [node.left, node.right]
        case ast.BinOp():
            return [child for _, child in signed_parts(node)]
        case ast.UnaryOp():
            return [node.operand]
        case ast.Call():
            return node.args
        case _:
            return []


def nodes_in(tree: ast.expr) -> Iterator[ast.expr]:
    """Every node of a tree, the root first; a sum or product of many parts is one."""
    pending = [tree]
    while pending:
        node = pending.pop()
        yield node
        pending.extend(child_nodes(node))


def names_in(tree: ast.expr) -> frozenset[str]:
    """The names in a tree, without those of functions."""
    return frozenset(node.id for node in nodes_in(tree) if isinstance(node, ast.Name))


# Functions that a formula may call: in SymPy, on floats, and their rule for units.


MOST_ARGUMENTS = 8
"""Arguments of min and max at most."""


class UnitRule(Enum):
    """Units of a function's arguments, and the unit of its value."""

    NUMBER = "dimensionless (or an angle) in, dimensionless out"
    SAME = "arguments of one unit in, the same unit out"
    RATIO = "arguments of one unit in, dimensionless out"
    ROOT = "the root of the argument's unit out"


@dataclass(frozen=True)
class FormulaFunction:
    """A function; `usage` is its call, `least` and `most` its number of arguments.

    expression  its SymPy expression, of functions that NumPy, CasADi and C have
    number      its value on floats, for constant arguments; ValueError or OverflowError where undefined
    """

    usage: str
    least: int
    most: int
    rule: UnitRule
    expression: Callable[..., sp.Expr]
    number: Callable[..., float]

    @property
    def name(self) -> str:
        """Its name."""
        return self.usage.partition("(")[0]


def _unevaluated(name: str) -> Callable[..., sp.Expr]:
    """SymPy's function of that name, unevaluated: sorting or simplifying nested arguments would take seconds."""
    return lambda *arguments: getattr(sp, name)(*arguments, evaluate=False)


def _root(x: sp.Expr) -> sp.Expr:
    return sp.Pow(x, sp.S.Half, evaluate=False)


def _sign(x: sp.Expr, width: sp.Expr) -> sp.Expr:
    return sp.tanh(x / width, evaluate=False)


def _step(x: sp.Expr, width: sp.Expr) -> sp.Expr:
    return (1 + _sign(x, width)) / 2


FORMULA_FUNCTIONS: Mapping[str, FormulaFunction] = {
    function.name: function
    for function in (
        FormulaFunction("sin(x)", 1, 1, UnitRule.NUMBER, _unevaluated("sin"), math.sin),
        FormulaFunction("cos(x)", 1, 1, UnitRule.NUMBER, _unevaluated("cos"), math.cos),
        FormulaFunction("tan(x)", 1, 1, UnitRule.NUMBER, _unevaluated("tan"), math.tan),
        FormulaFunction("tanh(x)", 1, 1, UnitRule.NUMBER, _unevaluated("tanh"), math.tanh),
        FormulaFunction("exp(x)", 1, 1, UnitRule.NUMBER, _unevaluated("exp"), math.exp),
        FormulaFunction("sqrt(x)", 1, 1, UnitRule.ROOT, _root, math.sqrt),
        FormulaFunction("abs(x)", 1, 1, UnitRule.SAME, _unevaluated("Abs"), math.fabs),
        FormulaFunction("min(a, b, ..)", 2, MOST_ARGUMENTS, UnitRule.SAME, _unevaluated("Min"), min),
        FormulaFunction("max(a, b, ..)", 2, MOST_ARGUMENTS, UnitRule.SAME, _unevaluated("Max"), max),
        FormulaFunction("atan2(y, x)", 2, 2, UnitRule.RATIO, _unevaluated("atan2"), math.atan2),
        FormulaFunction("sign(x, width)", 2, 2, UnitRule.RATIO, _sign, lambda x, width: math.tanh(x / width)),
        FormulaFunction("step(x, width)", 2, 2, UnitRule.RATIO, _step, lambda x, width: (1 + math.tanh(x / width)) / 2),
    )
}
"""By name. A step has no derivative for a fit: sign(x, width) is tanh(x / width), from -1 to 1 over some widths, and
step(x, width) is (1 + sign(x, width)) / 2. min, max and abs are continuous, and exact."""


# SymPy expression of a formula's syntax tree, built node by node, never from text.


LARGEST_INTEGER = 1000
"""Integers up to this stay integers, so that x/2 prints as written; larger ones become floats."""
LARGEST_FLOAT = 1e300
"""Bound on numbers that SymPy computes, near the largest float."""


def to_sympy(tree: ast.expr, values: Mapping[str, sp.Expr], source: FormulaSource) -> sp.Expr:
    """The formula with expressions for its names.

    Raises InputError, naming the column, where it simplifies to no finite real number, as in 1/(x - x).
    """
    match tree:
        case ast.Constant(value=float(value)):
            return sp.Integer(int(value)) if value == int(value) and abs(value) <= LARGEST_INTEGER else sp.Float(value)
        case ast.Name(id=name):
            return values[name]
    try:
        built = _combined(tree, values, source)
        strange = built.has(sp.zoo, sp.nan, sp.oo, sp.S.NegativeInfinity, sp.I)
        if not strange and all(map(_is_representable, (built, *built.args))):
            return built
    except (ValueError, TypeError):
        pass  # SymPy cannot compare infinite or complex values
    raise source.error(tree.col_offset, "it simplifies to no finite real number", "correct the formula there")


def _combined(tree: ast.expr, values: Mapping[str, sp.Expr], source: FormulaSource) -> sp.Expr:
    match tree:
        case ast.UnaryOp():
            return -to_sympy(tree.operand, values, source)
        case ast.BinOp(op=ast.Pow()):
            power = exponent(tree)
            return to_sympy(tree.left, values, source) ** sp.Rational(power.numerator, power.denominator)
        case ast.BinOp(op=ast.Add() | ast.Sub()):
            return sp.Add(*(sign * to_sympy(child, values, source) for sign, child in signed_parts(tree)))
        case ast.BinOp():
            return sp.Mul(*(to_sympy(child, values, source) ** sign for sign, child in signed_parts(tree)))
        case ast.Call(func=ast.Name(id=name)):
            function = FORMULA_FUNCTIONS[name]
            built = function.expression(*(to_sympy(child, values, source) for child in tree.args))
            if built.is_number and built.is_finite is None:  # atan2(1, 0) unevaluated
                return sp.Float(function.number(*map(float, built.args)))
            return built
        case _:
            raise TypeError(f"{type(tree).__name__} is not an operation")


def _is_representable(expression: sp.Expr) -> bool:
    """Whether a part is not a number, or is a number within the range of floats."""
    if not expression.is_number:
        return True
    return bool(expression.is_finite and expression.is_real and abs(expression) < LARGEST_FLOAT)


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


def parse_formula(source: FormulaSource, names: Collection[str]) -> ast.expr:
    """The syntax tree of a formula of these `names`, and pi.

    Numbers, names, + - * / ^ (or **), brackets and calls of `FORMULA_FUNCTIONS` mean what they mean in Python.
    Constant parts are folded, in floating point. Nothing else is evaluated, and nothing is executed. Raises InputError,
    naming the column, for all other text.
    """
    tree = _parsed(source)
    _require_limits(tree, source)
    return _Folding(source, names).folded(tree)


def _parsed(source: FormulaSource) -> ast.expr:
    """The tree as Python parses it, its columns those of the formula."""
    text, columns = python_text(source)
    try:
        tree = ast.parse(text, FILE_NAME, mode="eval").body
    except (RecursionError, MemoryError):
        raise too_deep(source, 1) from None
    except SyntaxError as error:
        column = columns.get((error.offset or 0) - 1, len(source.text) + 1)
        at = quoted(source.text[column - 1 :]) if column <= len(source.text) else "the end"
        remedy = "complete the formula there: an operator between its terms, a bracket for every other"
        raise source.error(column, f"{error.msg} at {at}", remedy) from None
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

    def __init__(self, source: FormulaSource, names: Collection[str]) -> None:
        self.source, self.names = source, names

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

    def _evaluated(self, node: ast.expr, operands: Sequence[ast.expr], compute: Callable[..., float]) -> ast.expr:
        """The node, or `compute` of the values of its parts where all are numbers.

        In floats, as integers could grow without bound. Raises InputError when it is undefined or not finite.
        """
        values = [operand.value for operand in operands if isinstance(operand, ast.Constant)]
        if len(values) < len(operands):
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
        if node.id in self.names:
            return node
        if node.id in NAMED_CONSTANTS:
            return ast.Constant(NAMED_CONSTANTS[node.id], lineno=1, col_offset=node.col_offset)
        remedy = suggestion(node.id, [*self.names, *NAMED_CONSTANTS])
        if node.id in FORMULA_FUNCTIONS:
            remedy = f"call it as {FORMULA_FUNCTIONS[node.id].usage}"
        raise self.source.error(node.col_offset, f"{quoted(node.id)} is not a known name", remedy)

    def _function(self, name: str, call: ast.Call) -> FormulaFunction:
        """The function of a call, with as many arguments as it takes."""
        if name not in FORMULA_FUNCTIONS:
            if name in self.names:
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
