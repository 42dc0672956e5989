"""Square-root information: the triangle to which the rows of a least-squares problem shrink, and which adds."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.linalg.blas import dtrsm

Array = NDArray[np.float64]

PLAIN = 1e-11
"""kappa² eps up to which one Cholesky will do: the relative rounding of the information that it leaves."""
ORTHONORMAL = 0.1
"""Distance of Q'Q from 1 below which Q's condition is under 1.1, so that a second Cholesky is exact to rounding."""
EPS = float(np.finfo(np.float64).eps)


class Method(Enum):
    """How rows are brought to a triangle."""

    CHOLESKY = "Cholesky"
    HOUSEHOLDER = "Householder"


@dataclass(frozen=True, eq=False)
class Factors:
    """Columns A (n, k) as Q R: R = `root` (k, k) upper triangular, Q = `basis` `inner`^-1 orthonormal.

    basis  (n, k) and `inner` (k, k), upper triangular: A and R themselves, or columns that are orthonormal already and
           what is left to put right in them
    """

    basis: Array
    inner: Array
    root: Array
    method: Method

    def coordinates(self, vector: Array) -> Array:
        """Q' v, (k,)."""
        return np.asarray(solve_triangular(self.inner, self.basis.T @ vector, trans="T", check_finite=False))

    def span(self, coordinates: Array) -> Array:
        """Q c, (n,)."""
        return np.asarray(self.basis @ solve_triangular(self.inner, coordinates, check_finite=False))

    def split(self, target: Array) -> tuple[Array, Array]:
        """Coordinates Q' b (k,), and b - Q Q' b (n,); projected twice, so that what is left has no part in Q."""
        first = self.coordinates(target)
        rest = target - self.span(first)
        second = self.coordinates(rest)
        return first + second, rest - self.span(second)


def factored(columns: Array, method: Method | None = None) -> Factors:
    """The factors of columns A (n, k), n >= k, by the quickest method that is exact enough, unless one is asked for.

    Products of tall matrices are several times faster than Householder's reflections, but A'A = R'R has lost the
    condition squared: R is exact to kappa² eps, kappa the condition of the columns scaled to unit length. Below `PLAIN`
    that is enough, since the coordinates are refined with the residual in A itself (corrected seminormal equations:
    Björck, Linear Algebra Appl. 88/89, 1987). Above, Q1 = A R^-1 has Q1'Q1 = 1 + O(kappa² eps), and while that is close
    to 1, up to kappa of about 1e7, a second Cholesky, of Q1'Q1, makes R = R2 R1 exact to rounding (CholeskyQR2:
    Yamamoto, Nakatsukasa, Yanagisawa, Fukaya, ETNA 44, 2015). It is looked at, not assumed. Otherwise Householder.
    Raises LinAlgError when Cholesky is asked for and not possible.
    """
    if method is not Method.HOUSEHOLDER:
        found = _by_cholesky(columns)
        if found is not None:
            return found
        if method is Method.CHOLESKY:
            raise np.linalg.LinAlgError("the columns are too nearly dependent for their Gram matrix")
    scale = _scale(np.linalg.norm(columns, axis=0))
    scaled: Array = columns / scale
    basis, root = (np.asarray(part, dtype=np.float64) for part in np.linalg.qr(scaled))
    return Factors(basis, np.eye(len(scale), dtype=np.float64), np.asarray(root * scale), Method.HOUSEHOLDER)


def _by_cholesky(columns: Array) -> Factors | None:
    gram = columns.T @ columns
    scale = _scale(np.sqrt(np.diag(gram)))
    try:
        first = np.linalg.cholesky(gram / np.outer(scale, scale)).T * scale
        if np.linalg.cond(first / np.linalg.norm(first, axis=0)) ** 2 * EPS < PLAIN:
            return Factors(columns, first, first, Method.CHOLESKY)
        basis: Array = np.asarray(dtrsm(1.0, first, columns.T, trans_a=1).T)
        gram = basis.T @ basis
        if not np.linalg.norm(gram - np.eye(len(gram))) < ORTHONORMAL:  # or not finite
            return None
        second: Array = np.asarray(np.linalg.cholesky(gram).T, dtype=np.float64)
    except np.linalg.LinAlgError:
        return None
    return Factors(basis, second, second @ first, Method.CHOLESKY)


def _scale(lengths: Array) -> Array:
    """Powers of two nearest to the columns' lengths: scaling by them rounds nothing; 1 for what is zero."""
    return np.asarray(np.exp2(np.round(np.log2(np.where(lengths > 0, lengths, 1.0)))), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class SquareRoot:
    """All that least squares needs to know of whitened rows A x = b: |A x - b|² = |R x - z|² + power.

    root    (k, k) upper triangular R, R'R = A'A the Fisher information
    target  (k,) z
    power   what no x explains
    rows    number of rows, less the unknowns eliminated
    They add: the rows of two sets are stacked, and (R1 z1; R2 z2) is brought to a triangle again (Bierman,
    Factorization Methods for Discrete Sequential Estimation, 1977), in any order and grouping.
    """

    root: Array
    target: Array
    power: float
    rows: int
    method: Method = Method.HOUSEHOLDER

    @classmethod
    def of(cls, columns: Array, target: Array, method: Method | None = None) -> Self:
        """Of whitened rows: columns (n, k) and target (n,)."""
        short = columns.shape[1] - len(columns)
        filled = np.pad(columns, ((0, short), (0, 0))) if short > 0 else columns
        factors = factored(filled, method)
        coordinates, rest = factors.split(np.pad(target, (0, short)) if short > 0 else target)
        return cls(factors.root, coordinates, float(rest @ rest), len(target), factors.method)

    @classmethod
    def of_triangle(cls, rows: Array, count: int) -> SquareRoot:
        """Of `count` rows that have shrunk already: `rows` (m, k + 1) of R and z, with all that they left in them."""
        return _triangle(rows, 0.0, count, Method.CHOLESKY)

    @classmethod
    def nothing(cls, size: int) -> Self:
        """Of no rows: what is added to changes nothing."""
        return cls(np.zeros((size, size)), np.zeros(size), 0.0, 0, Method.CHOLESKY)

    @property
    def cost(self) -> float:
        """Chi-square at x = 0, |b|²."""
        return float(self.target @ self.target) + self.power

    def __add__(self, other: SquareRoot) -> SquareRoot:
        """Of the rows of both."""
        stacked = np.vstack([np.column_stack([s.root, s.target]) for s in (self, other)])
        both = all(s.method is Method.CHOLESKY for s in (self, other))
        return _triangle(
            stacked, self.power + other.power, self.rows + other.rows, Method.CHOLESKY if both else Method.HOUSEHOLDER
        )

    def moved(self, step: Array) -> SquareRoot:
        """Of the same rows for x counted from `step` (k,) on."""
        return replace(self, target=self.target - self.root @ step)

    def held(self, strength: float) -> SquareRoot:
        """With a row more for each unknown, `strength` times its column's length, that holds it at 0 (Levenberg)."""
        lengths = np.linalg.norm(self.root, axis=0)
        rows = np.diag(strength * np.where(lengths > 0, lengths, 1.0))
        return self + SquareRoot(rows, np.zeros(len(rows)), 0.0, 0, self.method)

    def only(self, kept: NDArray[np.bool_] | NDArray[np.intp]) -> SquareRoot:
        """With the other unknowns held at 0; an index also sorts."""
        return _triangle(np.column_stack([self.root[:, kept], self.target]), self.power, self.rows, self.method)

    def spread(self, index: NDArray[np.intp], size: int) -> SquareRoot:
        """As information on more unknowns (size), where the own ones stand at `index`."""
        wide = np.zeros((len(self.target), size))
        wide[:, index] = self.root
        return _triangle(np.column_stack([wide, self.target]), self.power, self.rows, self.method)

    def eliminated(self, count: int) -> SquareRoot:
        """On all but the first `count` unknowns, whatever those are.

        |R x - z|² = |R11 x1 + R12 x2 - z1|² + |R22 x2 - z2|²; x1 makes the first term vanish for every x2.
        """
        return replace(
            self,
            root=self.root[count:, count:],
            target=self.target[count:],
            rows=self.rows - count,
        )


def _triangle(stacked: Array, power: float, rows: int, method: Method) -> SquareRoot:
    """Of rows (R z), with the power that other rows left: those of R that are to spare give theirs to it."""
    size = stacked.shape[1] - 1
    short = max(0, size + 1 - len(stacked))
    filled = np.vstack([stacked, np.zeros((short, size + 1))]) if short else stacked
    root = np.asarray(np.linalg.qr(filled, mode="r"))
    return SquareRoot(root[:size, :size], root[:size, size], power + float(root[size, size] ** 2), rows, method)
