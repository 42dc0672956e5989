"""Transfer function as a delay and a rational function of s."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import reduce
from typing import TypeAlias

import numpy as np
import scipy  # loads scipy.fft with its first use
from numpy.typing import NDArray

from modeling import symbolic as sp
from modeling.compiled.straight_line_program import laplace
from modeling.compiled.symbolic_vector import numpy_function
from modeling.dynamics.motion_record import MotionRecord
from modeling.errors import InputError

Array = NDArray[np.float64]

FILTER_BATCH = 50_000
"""Numbers filtered at once: with their Fourier lines they fit in a core's cache."""


def through_transfer_function(record: MotionRecord, series: Array, slope: int | None = None) -> Array:
    """A series (samples, ...) filtered by H(s), or by H's derivative in its parameter number `slope`.

    A motion that repeats without pause is in its periodic steady state. A single run is extended on both sides by
    its point reflections before it is transformed. In static poses H(0) = 1.
    """
    if not series.size:
        return series
    if record.dt is None:
        return series if slope is None else np.zeros_like(series)
    runs = [_filtered_run(record, run, slope) for run in record.runs(series)]
    return runs[0] if len(runs) == 1 else np.concatenate(runs)


def _filtered_run(record: MotionRecord, series: Array, slope: int | None) -> Array:
    assert record.dt is not None
    before, after = (0, 0) if record.clock.periodic else _extension(len(series))
    length = before + len(series) + after
    omega = np.asarray(2 * np.pi * np.fft.rfftfreq(length, record.dt), dtype=np.float64)
    gain, slopes = record.transfer(omega, record.theta)
    factor = gain if slope is None else slopes[slope]
    columns, ends = series.T.reshape(-1, len(series)), _Ends.of(before, after)
    filtered = np.zeros(columns.shape)
    moving = np.flatnonzero(columns.any(axis=1))  # what is zero stays zero: most of a load's derivatives
    for first in range(0, len(moving), at_once := max(1, FILTER_BATCH // length)):
        batch = moving[first : first + at_once]
        lines = scipy.fft.rfft(ends.added_to(columns[batch]))
        lines *= factor
        filtered[batch] = scipy.fft.irfft(lines, n=length, overwrite_x=True)[:, before : length - after]
    return filtered.reshape(series.T.shape).T


def _extension(samples: int) -> tuple[int, int]:
    """Samples before and after a run: an eighth of it, and as many more as a fast Fourier transform needs."""
    least = min(samples - 1, max(64, samples // 8))
    after = scipy.fft.next_fast_len(samples + 2 * least, real=True) - samples - least
    return least, min(after, samples - 1)


@dataclass(frozen=True, eq=False)
class _Ends:
    """Ends of a run, cross-faded so that it closes periodically.

    rise  (before,) weights of the point reflection at the start, from 0 to 1
    fall  (after,) weights of that at the end, from 1 to 0
    """

    rise: Array
    fall: Array

    @classmethod
    def of(cls, before: int, after: int) -> _Ends:
        """Of as many samples before and after a run; 0 for a run that is periodic already."""
        rise, fall = np.cos(np.linspace(0, np.pi, before)), np.cos(np.linspace(0, np.pi, after))
        return cls(0.5 - 0.5 * rise, 0.5 + 0.5 * fall)

    def added_to(self, series: Array) -> Array:
        """Series (c, n) extended by their point reflections at both ends, (c, before + n + after)."""
        before, after, samples = len(self.rise), len(self.fall), series.shape[1]
        if not before:
            return series
        whole = np.empty((len(series), before + samples + after))
        first, inside, last = np.split(whole, [before, before + samples], axis=1)
        middle = (series[:, :1] + series[:, -1:]) / 2
        inside[:] = series
        np.subtract(2 * series[:, :1] - middle, series[:, before:0:-1], out=first)
        np.subtract(2 * series[:, -1:] - middle, series[:, -2 : -after - 2 : -1], out=last)
        for extension, weights in ((first, self.rise), (last, self.fall)):
            extension *= weights
            extension += middle
        return whole


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
        numerator, denominator = (
            tuple(sp.Poly(polynomial, laplace()).all_coeffs()) for polynomial in (numerator, denominator)
        )
        if len(numerator) > len(denominator):
            raise _not_realisable(transfer)
        return cls(delay, numerator, denominator)

    @property
    def expression(self) -> sp.Expr:
        """The transfer function as one expression."""
        numerator, denominator = (
            sp.Poly(coefficients, laplace()).as_expr() for coefficients in (self.numerator, self.denominator)
        )
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
