"""Straight-line programs with common subexpressions shared, and their forward-mode derivatives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

from modeling import symbolic as sp
from modeling.expressions.intermediate_variables import Definitions
from modeling.expressions.operation_count import OperationCount, count_operations

LONGEST_PRODUCT = 3
"""Exponent above which a power is computed by squaring; up to it both take as many multiplications."""


@dataclass(frozen=True, eq=False)
class StraightLineProgram:
    """Steps `(symbol, expression)` in order of evaluation, and results.

    An expression holds inputs and the symbols of earlier steps. In a `shared` program the base of every power is a
    symbol, so that a product of it needs no subexpression twice.
    """

    steps: Definitions
    results: tuple[sp.Expr, ...]

    @classmethod
    def of(cls, expressions: Sequence[sp.Expr], definitions: Definitions = ()) -> Self:
        """The results `expressions` with the `definitions` that they depend on, nothing shared yet."""
        return cls(definitions, tuple(expressions))

    @property
    def free_symbols(self) -> set[sp.Symbol]:
        """The inputs of the program."""
        expressions = [*(expression for _, expression in self.steps), *self.results]
        free = {symbol for expression in expressions for symbol in expression.free_symbols}
        return free - {symbol for symbol, _ in self.steps}

    @cached_property
    def shared(self) -> StraightLineProgram:
        """The same program with common subexpressions as steps, and without dead steps."""
        defined, own = [symbol for symbol, _ in self.steps], [expression for _, expression in self.steps]
        reserved = set(defined)  # cse avoids the symbols within the expressions, not those of the steps
        names = (symbol for symbol in sp.numbered_symbols("shared_", real=True) if symbol not in reserved)
        common, reduced = sp.cse([*own, *self.results], symbols=names, order="canonical")
        found = dict(common) | dict(zip(defined, reduced, strict=False))
        trivial = _trivial(found)
        steps = {symbol: e.xreplace(trivial) for symbol, e in found.items() if symbol not in trivial}
        return _straightened(steps, [e.xreplace(trivial) for e in reduced[len(defined) :]])

    @cached_property
    def operations(self) -> OperationCount:
        """Operations of one evaluation, each step once."""
        return OperationCount.sum([count_operations(e) for e in (*(e for _, e in self.steps), *self.results)])

    @cached_property
    def operations_unshared(self) -> OperationCount:
        """Operations when each result is evaluated by itself, steps repeated wherever they occur."""
        known: dict[sp.Symbol, OperationCount] = {}
        for symbol, expression in self.steps:
            known[symbol] = count_operations(expression, known)
        return OperationCount.sum([count_operations(result, known) for result in self.results])


def _trivial(steps: dict[sp.Symbol, sp.Expr]) -> dict[sp.Symbol, sp.Expr]:
    """Steps that are a symbol or a number up to the sign, to be substituted."""
    trivial = {symbol: e for symbol, e in steps.items() if (-e).is_Atom or e.is_Atom}
    for symbol, expression in trivial.items():
        while expression.free_symbols & trivial.keys():
            expression = expression.xreplace(trivial)
        trivial[symbol] = expression
    return trivial


def _straightened(steps: dict[sp.Symbol, sp.Expr], results: Sequence[sp.Expr]) -> StraightLineProgram:
    """The steps that the results need, in order of evaluation, with powers of symbols only."""
    powers = _Powers()
    for symbol in _in_order(steps, results):
        powers.steps[symbol] = powers.rewritten(steps[symbol])
    finished = tuple(powers.rewritten(result) for result in results)
    return StraightLineProgram(tuple(powers.steps.items()), finished)


def _in_order(steps: dict[sp.Symbol, sp.Expr], results: Sequence[sp.Expr]) -> list[sp.Symbol]:
    """The steps that the results need, each after those that it depends on."""
    ordered: dict[sp.Symbol, None] = {}
    pending = [symbol for result in reversed(results) for symbol in _by_name(result)]
    while pending:
        symbol = pending.pop()
        if symbol in ordered or symbol not in steps:
            continue
        missing = [other for other in _by_name(steps[symbol]) if other in steps and other not in ordered]
        if missing:
            pending += [symbol, *missing]
        else:
            ordered[symbol] = None
    return list(ordered)


def _by_name(expression: sp.Expr) -> list[sp.Symbol]:
    return sorted(expression.free_symbols, key=lambda symbol: str(symbol.name), reverse=True)


class _Powers:
    """Steps, with those added for powers: bases, roots, and squares of higher powers."""

    def __init__(self) -> None:
        self.steps: dict[sp.Symbol, sp.Expr] = {}
        self._names: dict[sp.Expr, sp.Symbol] = {}

    def rewritten(self, expression: sp.Expr) -> sp.Expr:
        """The expression with every base a symbol, and no power above LONGEST_PRODUCT."""
        if expression.is_Atom:
            return expression
        parts = tuple(self.rewritten(argument) for argument in expression.args)
        if isinstance(expression, sp.Pow) and parts[1].is_Rational:
            return self._power(parts[0], parts[1])
        return expression if parts == expression.args else expression.func(*parts)

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


def forward_derivative(program: StraightLineProgram, symbols: Sequence[sp.Symbol]) -> StraightLineProgram:
    """The program of d result_i / d symbol_j, result by result, by forward-mode differentiation.

    Of a step e(x, .., theta) it is de/dtheta plus the sum of de/dx dx/dtheta over all earlier steps x.
    """
    steps, results = (
        [(s, PartialDerivatives(e)) for s, e in program.steps],
        [PartialDerivatives(e) for e in program.results],
    )
    found, columns = list(program.steps), []
    for number, symbol in enumerate(symbols):
        known: dict[sp.Symbol, sp.Expr] = {symbol: sp.S.One}
        for step, partials in steps:
            rate = partials.along(known)
            if rate != 0:
                known[step] = sp.Symbol(f"rate_{number}_{step.name}", real=True)
                found.append((known[step], rate))
        columns.append([partials.along(known) for partials in results])
    return StraightLineProgram.of([column[i] for i in range(len(results)) for column in columns], tuple(found))


@dataclass(frozen=True, eq=False)
class PartialDerivatives:
    """The partial derivatives of an expression, computed when first needed."""

    expression: sp.Expr

    @cached_property
    def _by(self) -> dict[sp.Symbol, sp.Expr | None]:
        return dict.fromkeys(sorted(self.expression.free_symbols, key=lambda s: str(s.name)))

    def along(self, known: Mapping[sp.Symbol, sp.Expr]) -> sp.Expr:
        """The directional derivative, with the derivatives `known` of its symbols and zero for the others."""
        total = sp.S.Zero
        for symbol in self._by:
            if symbol in known:
                total += self._partial(symbol) * known[symbol]
        return total

    def _partial(self, symbol: sp.Symbol) -> sp.Expr:
        partial = self._by[symbol]
        if partial is None:
            partial = self._by[symbol] = self.expression.diff(symbol)
        return partial
