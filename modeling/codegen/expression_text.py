"""Expressions in the syntax shared by C and Python, by SymPy's code printer."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from functools import cache, reduce
from math import isfinite
from typing import Any, NamedTuple

from modeling import symbolic as sp
from modeling.errors import InputError
from modeling.expressions.straight_line_program import StraightLineProgram

FUNCTION_NAMES = {"Abs": "fabs", "Max": "fmax", "Min": "fmin", "Heaviside": "step"}
"""SymPy's functions whose name in generated code is another one: C's, where C has it."""
FUNCTIONS = (
    *("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "exp", "log", "sign"),
    *FUNCTION_NAMES,
)
"""SymPy's functions that generated code has."""


@cache
def _printer_class() -> type[Any]:
    """SymPy's code printer, adapted where its text would cost more operations or lose digits; loaded when needed."""
    from sympy.printing.codeprinter import CodePrinter
    from sympy.printing.precedence import PRECEDENCE

    class ExpressionPrinter(CodePrinter):  # type: ignore[misc]
        """Numbers as the shortest text that reads back the same, integer powers as products, pairwise fmax and fmin.

        names      of the symbols
        functions  formats by name, for functions that are not called as in C
        """

        def __init__(self, names: Mapping[sp.Symbol, str], functions: Mapping[str, str]) -> None:
            super().__init__({"order": "none"})
            self.names, self.functions = names, functions

        def _print(self, expr: sp.Basic, **options: Any) -> str:
            return _number_text(float(expr)) if expr.is_number else super()._print(expr, **options)

        def _print_Symbol(self, expr: sp.Symbol) -> str:  # noqa: N802
            return self.names[expr]

        def _print_Pow(self, expr: sp.Pow, rational: bool = False) -> str:  # noqa: N802
            base, exponent = expr.args
            if exponent.is_Rational and exponent.is_negative:
                return f"1.0/{self.parenthesize(1 / expr, PRECEDENCE['Pow'])}"
            if exponent.is_Integer:
                return "(" + "*".join([self.parenthesize(base, PRECEDENCE["Pow"])] * int(exponent)) + ")"
            return self._call("sqrt", base) if exponent == sp.S.Half else self._call("pow", base, exponent)

        def _print_Function(self, expr: sp.Expr) -> str:  # noqa: N802
            name = type(expr).__name__
            if name == "DiracDelta":
                return "0.0"  # the derivative of a step: zero everywhere but at the step
            if name not in FUNCTIONS:
                what = f"the function {name} has no counterpart in generated code"
                raise InputError(what=what, where="emit", remedy="leave the effect out")
            return self._call(FUNCTION_NAMES.get(name, name), *expr.args[: 1 if name == "Heaviside" else None])

        _print_Max = _print_Min = _print_sign = _print_Function  # noqa: N815

        def _call(self, name: str, *arguments: sp.Expr) -> str:
            texts = [self._print(argument) for argument in arguments]
            if name in ("fmax", "fmin"):
                return reduce(self.functions.get(name, name + "({}, {})").format, texts)
            pattern = self.functions.get(name)
            return f"{name}({', '.join(texts)})" if pattern is None else pattern.format(*texts)

    return ExpressionPrinter


def _number_text(value: float) -> str:
    """The shortest decimal text that reads back as the same number; InputError when it is not finite."""
    if not isfinite(value):
        raise InputError(what="a constant that is not finite", where="emit", remedy="leave the effect out")
    return repr(value)


class Assignment(NamedTuple):
    """A variable and the text of its value."""

    name: str
    text: str


def assignments_of(
    program: StraightLineProgram, names: Mapping[sp.Symbol, str], functions: Mapping[str, str]
) -> tuple[list[Assignment], list[str]]:
    """The assignments of a program, to t0, t1, .. in order, and the texts of its results."""
    steps = {symbol: f"t{number}" for number, (symbol, _) in enumerate(program.steps)}
    printed = _printer_class()({**names, **steps}, functions)._print
    lines = [Assignment(steps[symbol], printed(expression)) for symbol, expression in program.steps]
    return lines, [printed(result) for result in program.results]


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
