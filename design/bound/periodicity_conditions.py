"""Linear conditions of periodicity: functions h(q, dq) whose time derivative has mean zero."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from math import prod
from typing import Any

import numpy as np

from design.bound.symmetry import SignChange
from design.bound.viable_states import ViableStates
from modeling import symbolic as sp
from modeling.expressions.compilation import casadi_expressions


@dataclass(frozen=True, kw_only=True)
class PolynomialDegrees:
    """Largest total degree of the polynomials h: of one joint's q and dq, of two joints', of more joints'.

    0 leaves such h out. Time grows with the square of the number of conditions; none of them loosens the bound.
    """

    each: int = 8
    pair: int = 6
    more: int = 4

    def of(self, joints: int) -> int:
        """The largest degree of an h of this number of joints."""
        return (self.each, self.pair, self.more)[min(joints, 3) - 1]


@dataclass(frozen=True, eq=False, kw_only=True)
class PeriodicityConditions:
    """h = prod_j T_a(q_j) T_b(dq_j) with Chebyshev polynomials T of q and dq scaled to [-1, 1] by their limits.

    Along a trajectory d/dt h(q, dq) = sum_j (dh/dq_j dq_j + dh/ddq_j ddq_j), written L h; over a period it integrates
    to h(end) - h(start) = 0. `changes` are the symmetries of the problem: h for which L h changes sign under one of
    them have mean zero under every symmetric measure already, and are left out.
    """

    viable: ViableStates
    degrees: PolynomialDegrees
    changes: tuple[SignChange, ...] = ()

    @cached_property
    def exponents(self) -> tuple[tuple[int, ...], ...]:
        """The degrees of each h in (q_1 .. q_n, dq_1 .. dq_n)."""
        n, highest = self.viable.joints, max(self.degrees.each, self.degrees.pair, self.degrees.more)
        return tuple(e for e in _powers(2 * n, highest) if self._useful(np.array(e)))

    def _useful(self, powers: Any) -> bool:
        n = self.viable.joints
        q, dq = powers[:n], powers[n:]
        moving = np.count_nonzero(q + dq)
        if not 0 < powers.sum() <= self.degrees.of(int(moving) or 1):
            return False
        signs = {change: change.value[0] ** q.sum() * change.value[1] ** dq.sum() for change in self.changes}
        return all(sign == change.parity for change, sign in signs.items())

    def __len__(self) -> int:
        return len(self.exponents)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Such as "T2(q1) T1(dq3)"."""
        n = self.viable.joints
        symbols = [f"{order}{j}" for order in ("q", "dq") for j in range(1, n + 1)]
        return tuple(" ".join(f"T{d}({s})" for d, s in zip(e, symbols, strict=True) if d) for e in self.exponents)

    def graph(self, q: Any, dq: Any) -> Any:
        """All h as a CasADi column (K,) of q and dq, CasADi columns (n,)."""
        import casadi as ca

        factors = [*_chebyshev(q, self.viable.limits.position, self._highest)]
        factors += _chebyshev(dq, self.viable.limits.velocity, self._highest)
        terms = [prod([f[d] for f, d in zip(factors, e, strict=True) if d], start=ca.SX(1)) for e in self.exponents]
        return ca.vertcat(ca.SX(0, 1), *terms)

    @property
    def _highest(self) -> int:
        return max((max(e) for e in self.exponents), default=0)


def _powers(variables: int, total: int) -> Iterator[tuple[int, ...]]:
    """All exponents of a number of variables up to a total degree."""
    if variables == 0:
        yield ()
        return
    for first in range(total + 1):
        yield from ((first, *rest) for rest in _powers(variables - 1, total - first))


def _chebyshev(values: Any, pairs: Any, degree: int) -> list[list[Any]]:
    """T_0 .. T_degree of each of the values (n,), scaled from [low, high] to [-1, 1]."""
    z = sp.Symbol("z", real=True)
    polynomials = [sp.horner(sp.chebyshevt_poly(d, z)) for d in range(degree + 1)]
    scaled = [(2 * values[j] - low - high) / (high - low) for j, (low, high) in enumerate(pairs)]
    return [casadi_expressions({z: value}, polynomials) for value in scaled]
