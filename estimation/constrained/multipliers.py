"""Multipliers: how hard each constraint that a point rests on pushes it back."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from estimation.constrained.edge import Edge, smat
from estimation.linear.descent import UNSHOWN

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

LOST = 1e-9
"""Part of a slope that is lost to rounding."""


@dataclass(frozen=True, eq=False)
class Multipliers:
    """The slope that a point is held against, and the constraints that hold it, in whitened unknowns.

    slope    (k,) gradient of chi-square and prior, per std
    columns  (k, c) the edge's normals, of unit length
    sizes    (c,) their lengths before
    """

    edge: Edge
    slope: Array
    columns: Array
    sizes: Array

    @classmethod
    def of(cls, edge: Edge, gradient: Array) -> Self:
        """Of a gradient (k,) in the unknowns."""
        normals = edge.normals @ edge.local.basis
        lengths = np.linalg.norm(normals, axis=1)
        sizes = np.where(lengths > 0, lengths, 1.0)
        return cls(edge, edge.local.basis.T @ gradient, (normals / sizes[:, None]).T, sizes)

    @cached_property
    def strengths(self) -> Array:
        """Multipliers (c,) of the unit normals, chi-square per std, that come nearest to the slope.

        Constraints that rest on one another (a mass held at 0 by its end and by the pseudo-inertia) could share the
        push in many ways. The simplest account that will do is taken: the ends alone, the pseudo-inertia alone, it
        with the ends that say something else, all.
        """
        is_end = np.arange(len(self.sizes)) < len(self.edge.ends)
        apart = is_end & ~_within(self.columns, self.columns[:, ~is_end])
        every = np.ones_like(is_end)
        accounts = [
            (found, self._left(found)) for found in map(self._account, (is_end, ~is_end, ~is_end | apart, every))
        ]
        good_enough = 2 * min(left for _, left in accounts) + LOST * (1 + float(np.linalg.norm(self.slope)))
        return next(found for found, left in accounts if left <= good_enough)

    def _account(self, used: Flags) -> Array:
        """The multipliers of the normals in use, with the signs that they must have.

        One zero of the pseudo-inertia has a number for its multiplier, and non-negative least squares do. Of several it
        is a positive semidefinite matrix, of which the slope may leave entries open: the nearest to the cone program's
        that gives the slope.
        """
        found = np.zeros(len(used))
        if self.edge.rank > 1 and used[len(self.edge.ends) :].any():
            found[used] = (self.edge.guess * self.sizes)[used]
            found[used] += np.linalg.lstsq(self.columns[:, used], self.slope - self.columns @ found)[0]
            return found
        both = used & self.edge.either_way
        signed = np.concatenate([self.columns[:, used], -self.columns[:, both]], axis=1)
        if signed.size:
            from scipy.optimize import nnls  # slow to import, and few constraints press

            values, _ = nnls(signed, self.slope)
            found[used] = values[: used.sum()]
            found[both] -= values[used.sum() :]
        return found

    def _left(self, strengths: Array) -> float:
        return float(np.linalg.norm(self.slope - self.columns @ strengths)) + self.wrong_sign(strengths)

    def wrong_sign(self, strengths: Array) -> float:
        """The most negative of the multipliers (c,) that must not be, chi-square per std, as a positive number.

        A matrix keeps its signs when it is brought to unit size, row and column alike.
        """
        ends, rank = len(self.edge.ends), self.edge.rank
        signed = strengths[:ends][~self.edge.either_way[:ends]]
        size = np.sqrt(np.diag(smat(self.sizes[ends:], rank)))
        inner = np.linalg.eigvalsh(smat((strengths / self.sizes)[ends:], rank) * np.outer(size, size))
        return -float(min(signed.min(initial=0.0), inner.min(initial=0.0)))


def _within(columns: Array, span: Array) -> Flags:
    """Which unit columns lie in the span of others."""
    left, singular, _ = np.linalg.svd(span, full_matrices=False)
    basis = left[:, singular > UNSHOWN]
    return np.asarray(np.linalg.norm(columns - basis @ (basis.T @ columns), axis=0) < np.sqrt(UNSHOWN))
