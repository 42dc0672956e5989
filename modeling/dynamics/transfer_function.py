"""Transfer function as a delay and a rational function of s."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import reduce
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from modeling import symbolic as sp
from modeling.errors import InputError
from modeling.expressions.compilation import numpy_function
from modeling.expressions.laplace_variable import laplace

Array = NDArray[np.float64]
PolynomialCoefficients: TypeAlias = "tuple[sp.Expr, ...]"


@dataclass(frozen=True, eq=False)
class TransferFunction:
    """Numeric H(s) = exp(-s delay) numerator(s) / denominator(s).

    delay in s, negative for a lead; polynomial coefficients in SI units, highest power of s first.
    """

    delay: float
    numerator: Array
    denominator: Array

    @property
    def damped(self) -> bool:
        """Whether it is stable and proper: all poles in the left half plane, no differentiation."""
        stable = bool(self.denominator[-1] != 0 and np.all(self._time_constants.real > 0))
        return stable and len(self.numerator) <= len(self.denominator)

    @property
    def slowest_time_constant(self) -> float:
        """Slowest time constant (s), 0 without poles: |T|² / Re T of a pole -1/T."""
        return float(np.max(np.abs(self._time_constants) ** 2 / self._time_constants.real, initial=0.0))

    @property
    def _time_constants(self) -> NDArray[np.complex128]:
        # Roots of the reversed polynomial, so that a lag close to zero has a root near zero, not near infinity.
        return np.asarray(-np.roots(self.denominator[::-1]), dtype=complex)


@dataclass(frozen=True)
class SymbolicTransferFunction:
    """H(s) = exp(-s delay) numerator(s) / denominator(s), delay and coefficients in terms of the parameters."""

    delay: sp.Expr
    numerator: PolynomialCoefficients
    denominator: PolynomialCoefficients

    @classmethod
    def of(cls, transfer: sp.Expr) -> SymbolicTransferFunction:
        """Factorisation of a transfer function into factors exp(c - s delay) and a proper rational function.

        Raises InputError when there is none: roots of s, sums of delays, or an improper ratio, which would
        differentiate its input.
        """
        delay, ratio = reduce(_with_factor, sp.Mul.make_args(transfer), (sp.S.Zero, sp.S.One))
        numerator, denominator = sp.fraction(sp.together(ratio))
        if not (numerator.is_polynomial(laplace()) and denominator.is_polynomial(laplace())):
            raise _not_realisable(transfer)
        numerator, denominator = (tuple(sp.Poly(part, laplace()).all_coeffs()) for part in (numerator, denominator))
        if len(numerator) > len(denominator):
            raise _not_realisable(transfer)
        return cls(delay, numerator, denominator)

    @property
    def expression(self) -> sp.Expr:
        """The transfer function as one expression."""
        numerator, denominator = (sp.Poly(part, laplace()).as_expr() for part in (self.numerator, self.denominator))
        return sp.exp(-laplace() * self.delay) * numerator / denominator

    def at(self, values: Mapping[sp.Symbol, float]) -> TransferFunction:
        """Numeric transfer function at the parameters' values; zero leading coefficients are removed.

        Raises InputError when the result is not `damped`.
        """
        symbols = tuple(values)
        expressions = [self.delay, *self.numerator, *self.denominator]
        numbers = np.array(numpy_function(symbols, expressions)(*values.values()), dtype=float)
        numerator, denominator = np.split(numbers[1:], [len(self.numerator)])
        transfer = TransferFunction(float(numbers[0]), np.trim_zeros(numerator, "f"), np.trim_zeros(denominator, "f"))
        if not transfer.damped:
            raise InputError(
                what=f"with the coefficients {numerator.tolist()} over {denominator.tolist()} it is not stable",
                where=f"transfer function {self.expression}",
                remedy="fit it again with bounds, or leave the effect out",
            )
        return transfer


def _with_factor(split: tuple[sp.Expr, sp.Expr], factor: sp.Expr) -> tuple[sp.Expr, sp.Expr]:
    """Delay and rational part, multiplied by one more factor of H."""
    delay, ratio = split
    if not isinstance(factor, sp.exp) or not factor.has(laplace()):
        return delay, ratio * factor
    exponent = factor.exp.expand()
    slope = exponent.coeff(laplace(), 1)
    constant = sp.expand(exponent - slope * laplace())
    if slope.has(laplace()) or constant.has(laplace()):
        return delay, ratio * factor
    return delay - slope, ratio * sp.exp(constant)


def _not_realisable(transfer: sp.Expr) -> InputError:
    return InputError(
        what="it has no proper rational realisation with a delay",
        where=f"transfer function {transfer}",
        remedy="compensate whole recordings, or leave the effect out",
    )
