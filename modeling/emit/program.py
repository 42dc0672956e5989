"""Program: expressions as straight-line code, one named step after another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

from modeling import symbolic as sp
from modeling.emit.operations import Counting, Operations
from modeling.steps import Definitions

LONGEST_PRODUCT = 3
"""Factors from which on a power is made of squares: up to it both take as many multiplications."""


@dataclass(frozen=True, eq=False)
class Program:
    """Steps `(symbol, expression)` in the order in which they can be evaluated, and results made of them.

    An expression holds inputs and the symbols of steps before it. No power of a step has a base that would have to be
    written twice: the base is then a step of its own.
    """

    steps: Definitions
    results: tuple[sp.Expr, ...]

    @classmethod
    def of(cls, expressions: Sequence[sp.Expr], definitions: Definitions = ()) -> Self:
        """The results `expressions` and the `definitions` that they are written with, each as it stands."""
        return cls(definitions, tuple(expressions))

    @property
    def free_symbols(self) -> set[sp.Symbol]:
        """The inputs that are taken."""
        expressions = [*(expression for _, expression in self.steps), *self.results]
        free = {symbol for expression in expressions for symbol in expression.free_symbols}
        return free - {symbol for symbol, _ in self.steps}

    @cached_property
    def shared(self) -> Program:
        """The same with every subexpression that occurs twice as a step, and no step that nothing is made of."""
        named, own = [symbol for symbol, _ in self.steps], [expression for _, expression in self.steps]
        taken = set(named)  # cse spares the names that occur in what it is given, and not those of the steps
        names = (symbol for symbol in sp.numbered_symbols("shared_", real=True) if symbol not in taken)
        common, reduced = sp.cse([*own, *self.results], symbols=names, order="canonical")
        found = dict(common) | dict(zip(named, reduced, strict=False))
        same = _same(found)
        steps = {symbol: e.xreplace(same) for symbol, e in found.items() if symbol not in same}
        return _straightened(steps, [e.xreplace(same) for e in reduced[len(named) :]])

    @cached_property
    def operations(self) -> Operations:
        """What one evaluation takes, each step once."""
        counting = Counting()
        return Operations.sum([counting.of(e) for e in (*(e for _, e in self.steps), *self.results)])

    @cached_property
    def operations_unshared(self) -> Operations:
        """What it would take to evaluate every result by itself, each step again wherever it occurs."""
        known: dict[sp.Symbol, Operations] = {}
        for symbol, expression in self.steps:
            known[symbol] = Counting(known).of(expression)
        counting = Counting(known)
        return Operations.sum([counting.of(result) for result in self.results])


def _same(steps: dict[sp.Symbol, sp.Expr]) -> dict[sp.Symbol, sp.Expr]:
    """Steps that are another symbol, or a number, up to the sign: they need no name."""
    same = {symbol: e for symbol, e in steps.items() if (-e).is_Atom or e.is_Atom}
    for symbol, expression in same.items():
        while expression.free_symbols & same.keys():
            expression = expression.xreplace(same)
        same[symbol] = expression
    return same


def _straightened(steps: dict[sp.Symbol, sp.Expr], results: Sequence[sp.Expr]) -> Program:
    """Steps in an order in which they can be evaluated, those alone that the results need, powers made of steps."""
    powers = _Powers()
    for symbol in _in_order(steps, results):
        powers.steps[symbol] = powers.written(steps[symbol])
    finished = tuple(powers.written(result) for result in results)
    return Program(tuple(powers.steps.items()), finished)


def _in_order(steps: dict[sp.Symbol, sp.Expr], results: Sequence[sp.Expr]) -> list[sp.Symbol]:
    """The steps that the results need, each after those that it is made of."""
    ordered: dict[sp.Symbol, None] = {}
    waiting = [symbol for result in reversed(results) for symbol in _by_name(result)]
    while waiting:
        symbol = waiting.pop()
        if symbol in ordered or symbol not in steps:
            continue
        before = [other for other in _by_name(steps[symbol]) if other in steps and other not in ordered]
        if before:
            waiting += [symbol, *before]
        else:
            ordered[symbol] = None
    return list(ordered)


def _by_name(expression: sp.Expr) -> list[sp.Symbol]:
    return sorted(expression.free_symbols, key=lambda symbol: str(symbol.name), reverse=True)


class _Powers:
    """Steps to which those are added that powers need: their bases, roots, and squares of long products."""

    def __init__(self) -> None:
        self.steps: dict[sp.Symbol, sp.Expr] = {}
        self._names: dict[sp.Expr, sp.Symbol] = {}

    def written(self, expression: sp.Expr) -> sp.Expr:
        """The expression with every base a symbol, and no power above LONGEST_PRODUCT."""
        if expression.is_Atom:
            return expression
        parts = [self.written(argument) for argument in expression.args]
        if isinstance(expression, sp.Pow) and parts[1].is_Rational:
            return self._power(parts[0], parts[1])
        return expression.func(*parts)

    def _power(self, base: sp.Expr, exponent: sp.Rational) -> sp.Expr:
        if exponent.q == 2 and abs(exponent.p) > 1:
            base, exponent = sp.sqrt(base), 2 * exponent
        count = abs(int(exponent)) if exponent.is_Integer else 0
        if count < 2:
            return base**exponent
        base = self._named(base)
        if count > LONGEST_PRODUCT:
            half = self._named(self._power(base, sp.Integer(count // 2)))
            whole = half**2 * base ** (count % 2)
        else:
            whole = base**count
        return whole if exponent > 0 else 1 / whole

    def _named(self, expression: sp.Expr) -> sp.Expr:
        if expression.is_Atom:
            return expression
        if expression not in self._names:
            self._names[expression] = sp.Symbol(f"power_{len(self._names)}", real=True)
            self.steps[self._names[expression]] = expression
        return self._names[expression]
