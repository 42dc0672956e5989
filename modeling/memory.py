"""Memory: a transfer function as a delay and a ratio of polynomials in s, from which it can be run sample by sample."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import reduce
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from modeling import symbolic as sp
from modeling.chain import laplace
from modeling.emission import numpy_function
from modeling.errors import InputError

Array = NDArray[np.float64]
Coefficients: TypeAlias = "tuple[sp.Expr, ...]"


@dataclass(frozen=True, eq=False)
class Transfer:
    """H(s) = exp(-s delay) numerator(s) / denominator(s) in numbers.

    delay in s, negative for a lead; polynomials by their coefficients (SI, powers of s), the highest power first.
    """

    delay: float
    numerator: Array
    denominator: Array

    @property
    def damped(self) -> bool:
        """Whether what was put in dies away, and none of it is differentiated."""
        stable = bool(self.denominator[-1] != 0 and np.all(self._times.real > 0))
        return stable and len(self.numerator) <= len(self.denominator)

    @property
    def lasting(self) -> float:
        """Time (s) in which the slowest part dies away by a factor e, 0 without memory: |T|² / Re T of a pole -1/T."""
        return float(np.max(np.abs(self._times) ** 2 / self._times.real, initial=0.0))

    @property
    def _times(self) -> NDArray[np.complex128]:
        # Of the reversed polynomial, so that a lag of nearly nothing has a pole near zero and not near infinity.
        return np.asarray(-np.roots(self.denominator[::-1]), dtype=complex)


@dataclass(frozen=True)
class Memory:
    """H(s) = exp(-s delay) numerator(s) / denominator(s), delay and coefficients in terms of the parameters."""

    delay: sp.Expr
    numerator: Coefficients
    denominator: Coefficients

    @classmethod
    def of(cls, transfer: sp.Expr) -> Memory:
        """The split of a transfer function: its factors exp(c - s delay) on one side, the others on the other.

        Raises InputError when that is not all there is: roots of s, sums of delays, or a ratio that grows with s, which
        would differentiate its input.
        """
        delay, ratio = reduce(_with_factor, sp.Mul.make_args(transfer), (sp.S.Zero, sp.S.One))
        numerator, denominator = sp.fraction(sp.together(ratio))
        if not (numerator.is_polynomial(laplace()) and denominator.is_polynomial(laplace())):
            raise _unsplit(transfer)
        above, below = (tuple(sp.Poly(part, laplace()).all_coeffs()) for part in (numerator, denominator))
        if len(above) > len(below):
            raise _unsplit(transfer)
        return cls(delay, above, below)

    @property
    def expression(self) -> sp.Expr:
        """The transfer function again."""
        above, below = (sp.Poly(part, laplace()).as_expr() for part in (self.numerator, self.denominator))
        return sp.exp(-laplace() * self.delay) * above / below

    def at(self, values: Mapping[sp.Symbol, float]) -> Transfer:
        """In numbers, at the parameters' values; vanishing leading coefficients are left out.

        Raises InputError when the ratio is not `damped` then.
        """
        symbols = tuple(values)
        expressions = [self.delay, *self.numerator, *self.denominator]
        numbers = np.array(numpy_function(symbols, expressions)(*values.values()), dtype=float)
        above, below = np.split(numbers[1:], [len(self.numerator)])
        transfer = Transfer(float(numbers[0]), np.trim_zeros(above, "f"), np.trim_zeros(below, "f"))
        if not transfer.damped:
            raise InputError(
                what=f"with the coefficients {above.tolist()} over {below.tolist()} it does not die away",
                where=f"memory {self.expression}",
                remedy="fit it again with bounds, or leave the effect out",
            )
        return transfer


def _with_factor(split: tuple[sp.Expr, sp.Expr], factor: sp.Expr) -> tuple[sp.Expr, sp.Expr]:
    """Delay and ratio with one more factor of H in them."""
    delay, ratio = split
    if not isinstance(factor, sp.exp) or not factor.has(laplace()):
        return delay, ratio * factor
    exponent = factor.exp.expand()
    slope = exponent.coeff(laplace(), 1)
    constant = sp.expand(exponent - slope * laplace())
    if slope.has(laplace()) or constant.has(laplace()):
        return delay, ratio * factor
    return delay - slope, ratio * sp.exp(constant)


def _unsplit(transfer: sp.Expr) -> InputError:
    return InputError(
        what="not a delay times a ratio of polynomials in s that stays finite: it cannot be run sample by sample",
        where=f"memory {transfer}",
        remedy="compensate whole recordings, or leave the effect out",
    )
