"""Straight-line programs with common subexpressions shared, and their forward-mode derivatives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property, reduce
from operator import add
from typing import Self, TypeAlias

from modeling import symbolic as sp


def laplace() -> sp.Symbol:
    """The Laplace variable s of transfer functions, in 1/s."""
    return sp.Symbol("s")


@dataclass(frozen=True, kw_only=True)
class OperationCount:
    """Numbers of additions and subtractions, multiplications, divisions and function calls."""

    sums: int = 0
    products: int = 0
    quotients: int = 0
    calls: int = 0

    def __add__(self, other: OperationCount) -> OperationCount:
        return OperationCount(**{f.name: getattr(self, f.name) + getattr(other, f.name) for f in fields(self)})

    @property
    def total(self) -> int:
        """Number of all operations."""
        return self.sums + self.products + self.quotients + self.calls

    @classmethod
    def sum(cls, parts: list[OperationCount]) -> Self:
        """Sum over all parts."""
        return reduce(add, parts, cls())

    def __str__(self) -> str:
        parts = f"{self.sums} + -, {self.products} *, {self.quotients} /, {self.calls} functions"
        return f"{self.total} ({parts})"


def count_operations(expression: sp.Expr, counts: Mapping[sp.Symbol, OperationCount] | None = None) -> OperationCount:
    """Operations to evaluate an expression as generated code does; a symbol counts as in `counts`, else zero.

    A sign counts zero, a quotient one whatever its factors; a power takes the products of exponentiation by squaring.
    """
    counts = {} if counts is None else counts
    if expression.is_Symbol:
        return counts.get(expression, OperationCount())
    if expression.is_number or isinstance(expression, sp.DiracDelta):
        return OperationCount()
    if expression.is_Mul and expression.as_coeff_Mul()[0].is_negative:
        return count_operations(-expression, counts)
    operations, operands = _own_operations(expression)
    return OperationCount.sum([operations, *(count_operations(operand, counts) for operand in operands)])


def _own_operations(expression: sp.Expr) -> tuple[OperationCount, Sequence[sp.Expr]]:
    """The operations on the parts of an expression, and these parts."""
    parts = expression.args
    if expression.is_Add:
        return OperationCount(sums=len(parts) - 1), parts
    if expression.is_Mul:
        below = [1 / factor for factor in parts if _is_inverse(factor)]
        above = [factor for factor in parts if not _is_inverse(factor)]
        products = max(len(above) - 1, 0) + max(len(below) - 1, 0)
        return OperationCount(products=products, quotients=bool(below)), [*above, *below]
    if _is_inverse(expression):
        return OperationCount(quotients=1), [1 / expression]
    if expression.is_Pow and expression.exp.is_Integer:
        digits = bin(int(expression.exp))[2:]
        return OperationCount(products=len(digits) - 1 + digits.count("1") - 1), [expression.base]
    if expression.is_Pow and expression.exp == sp.S.Half:
        return OperationCount(calls=1), [expression.base]
    if isinstance(expression, sp.Heaviside):
        return OperationCount(calls=1), parts[:1]
    pairwise = isinstance(expression, (sp.Max, sp.Min))
    return OperationCount(calls=len(parts) - 1 if pairwise else 1), parts


def _is_inverse(factor: sp.Expr) -> bool:
    """Whether it is a power with a negative exponent."""
    return bool(factor.is_Pow and factor.exp.is_Rational and factor.exp.is_negative)


Definitions: TypeAlias = "tuple[tuple[sp.Symbol, sp.Expr], ...]"


class IntermediateVariables:
    """Intermediate variables in order of evaluation, each a function of inputs and of earlier variables.

    `moving` maps inputs to their time derivatives: q1 -> dq1, dq1 -> ddq1; other inputs are constant in time.
    With `named` False no variables are introduced and expressions stay whole: for short ones meant to be read.
    """

    def __init__(self, moving: Mapping[sp.Symbol, sp.Expr], *, named: bool = True, prefix: str = "step_") -> None:
        self._named, self._prefix = named, prefix
        self._steps: dict[sp.Symbol, sp.Expr] = {}
        self._names: dict[sp.Expr, sp.Symbol] = {}
        self._rates: dict[sp.Symbol, sp.Expr] = dict(moving)

    @property
    def definitions(self) -> Definitions:
        """The intermediate variables so far, in order."""
        return tuple(self._steps.items())

    def let(self, expression: sp.Expr) -> sp.Expr:
        """A new intermediate variable for the expression; numbers and symbols are returned as they are."""
        expression = sp.sympify(expression)
        if not self._named or expression.is_Atom:
            return expression
        if expression not in self._names:
            name = sp.Symbol(f"{self._prefix}{len(self._steps)}", real=True)
            self._steps[name], self._names[expression] = expression, name
        return self._names[expression]

    def held(self, expression: sp.Expr) -> sp.Expr:
        """A new intermediate variable for the expression, constant in time."""
        name = sp.Symbol(f"{self._prefix}{len(self._steps)}", real=True)
        self._steps[name], self._rates[name] = expression, sp.S.Zero
        return name

    def rate(self, expression: sp.Expr) -> sp.Expr:
        """The time derivative of e(x, y, ..): de/dx dx/dt + de/dy dy/dt + .."""
        return self.let(self._derivative(expression))

    def _derivative(self, expression: sp.Expr) -> sp.Expr:
        if expression.is_Symbol:
            return self._rate_of(expression)
        if expression.is_Add:
            return sp.Add(*map(self._derivative, expression.args))
        if expression.is_Mul:
            factors = expression.args
            derivatives = map(self._derivative, factors)
            return sp.Add(*(d * sp.Mul(*factors[:i], *factors[i + 1 :]) for i, d in enumerate(derivatives) if d != 0))
        symbols = sorted(expression.free_symbols, key=lambda symbol: symbol.name)
        return sp.Add(*(expression.diff(symbol) * self._rate_of(symbol) for symbol in symbols))

    def _rate_of(self, symbol: sp.Symbol) -> sp.Expr:
        if symbol not in self._rates:
            defined = symbol in self._steps
            self._rates[symbol] = self.rate(self._steps[symbol]) if defined else sp.S.Zero
        return self._rates[symbol]


def symbols_of(definitions: Definitions, expressions: sp.Matrix) -> set[sp.Symbol]:
    """The symbols of the expressions, and of the definitions that they depend on."""
    symbols = set(expressions.free_symbols)
    for symbol, expression in reversed(definitions):
        if symbol in symbols:
            symbols |= expression.free_symbols
    return symbols


def required_definitions(definitions: Definitions, expressions: sp.Matrix) -> Definitions:
    """The definitions that the expressions depend on, in order."""
    required = symbols_of(definitions, expressions)
    return tuple((symbol, expression) for symbol, expression in definitions if symbol in required)


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
        defined, expressions = [symbol for symbol, _ in self.steps], [expression for _, expression in self.steps]
        reserved = set(defined)  # cse avoids the symbols within the expressions, not those of the steps
        names = (symbol for symbol in sp.numbered_symbols("shared_", real=True) if symbol not in reserved)
        common, reduced = sp.cse([*expressions, *self.results], symbols=names, order="canonical")
        definitions = dict(common) | dict(zip(defined, reduced, strict=False))
        trivial = _trivial(definitions)
        steps = {symbol: e.xreplace(trivial) for symbol, e in definitions.items() if symbol not in trivial}
        return _straightened(steps, [e.xreplace(trivial) for e in reduced[len(defined) :]])

    @cached_property
    def operations(self) -> OperationCount:
        """Operations of one evaluation, each step once."""
        return OperationCount.sum([count_operations(e) for e in (*(e for _, e in self.steps), *self.results)])

    @cached_property
    def operations_unshared(self) -> OperationCount:
        """Operations when each result is evaluated by itself, steps repeated wherever they occur."""
        counts: dict[sp.Symbol, OperationCount] = {}
        for symbol, expression in self.steps:
            counts[symbol] = count_operations(expression, counts)
        return OperationCount.sum([count_operations(result, counts) for result in self.results])


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
    derivative_steps, columns = list(program.steps), []
    for number, symbol in enumerate(symbols):
        derivatives: dict[sp.Symbol, sp.Expr] = {symbol: sp.S.One}
        for step, partials in steps:
            rate = partials.along(derivatives)
            if rate != 0:
                derivatives[step] = sp.Symbol(f"rate_{number}_{step.name}", real=True)
                derivative_steps.append((derivatives[step], rate))
        columns.append([partials.along(derivatives) for partials in results])
    return StraightLineProgram.of(
        [column[i] for i in range(len(results)) for column in columns], tuple(derivative_steps)
    )


@dataclass(frozen=True, eq=False)
class PartialDerivatives:
    """The partial derivatives of an expression, computed when first needed."""

    expression: sp.Expr

    @cached_property
    def _by(self) -> dict[sp.Symbol, sp.Expr | None]:
        return dict.fromkeys(sorted(self.expression.free_symbols, key=lambda s: str(s.name)))

    def along(self, derivatives: Mapping[sp.Symbol, sp.Expr]) -> sp.Expr:
        """The directional derivative, with the `derivatives` of its symbols and zero for the others."""
        total = sp.S.Zero
        for symbol in self._by:
            if symbol in derivatives:
                total += self._partial(symbol) * derivatives[symbol]
        return total

    def _partial(self, symbol: sp.Symbol) -> sp.Expr:
        partial = self._by[symbol]
        if partial is None:
            partial = self._by[symbol] = self.expression.diff(symbol)
        return partial
