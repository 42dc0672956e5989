"""Polytope: the coefficients of a series that keep the joints' limits at chosen instants."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from design.optimiser.rows import Rows, middle_and_half

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Block:
    """The rows of one joint: the coefficients (c,) that move it, A (R, c), middles (R,), and their place among all."""

    own: NDArray[np.intp]
    matrix: Array
    middle: Array
    place: slice


@dataclass(frozen=True, eq=False)
class Polytope:
    """-1 <= A z - middle <= 1 of `rows`, without their tip: one full block of A for each joint."""

    rows: Rows

    @cached_property
    def blocks(self) -> tuple[Block, ...]:
        """One for each joint."""
        found, at = list[Block](), 0
        for joint in range(self.rows.series.joints):
            own = np.flatnonzero(self.rows.series.mixing[joint].any(axis=0))
            matrix, middle = self._of(joint, own)
            found.append(Block(own, matrix, middle, slice(at, at + len(middle))))
            at += len(middle)
        return tuple(found)

    def __len__(self) -> int:
        return int(self.blocks[-1].place.stop)

    def change(self, step: Array) -> Array:
        """A step (R,): by how much a step (k,) of the coefficients moves the rows."""
        return np.concatenate([block.matrix @ step[block.own] for block in self.blocks])

    def slack(self, z: Array) -> Array:
        """(2, R): what is left to the high and to the low ends at z (k,); positive inside."""
        value = self.change(z) - np.concatenate([block.middle for block in self.blocks])
        return np.stack([1 - value, 1 + value])

    def pushed(self, multipliers: Array) -> Array:
        """A' (high - low) (k,) of multipliers (2, R)."""
        net, total = multipliers[0] - multipliers[1], np.zeros(self.rows.series.size)
        for block in self.blocks:
            total[block.own] += net[block.place] @ block.matrix
        return total

    def gram(self, weights: Array) -> Array:
        """A' diag(high + low) A (k, k) of weights (2, R) that are not negative."""
        root, size = np.sqrt(weights.sum(axis=0)), self.rows.series.size
        total = np.zeros((size, size))
        for block in self.blocks:
            scaled = block.matrix * root[block.place, None]
            total[np.ix_(block.own, block.own)] += scaled.T @ scaled
        return total

    def reach(self, still: Array, z: Array, margin: float) -> float | None:
        """The largest f up to 1 for which still + f (z - still) leaves a share `margin` of what `still` leaves.

        None where `still` (k,) is not inside itself.
        """
        room, there = self.slack(still), self.slack(z)
        if room.min() <= 0:
            return None
        used = (room - there) / room
        return float(min(1.0, (1 - margin) / max(float(used.max()), 1 - margin)))

    def _of(self, joint: int, own: NDArray[np.intp]) -> tuple[Array, Array]:
        mixing = self.rows.series.mixing[joint][:, own]
        parts, middles = list[Array](), list[Array]()
        for (order, j), times in self.rows.instants.items():
            if j == joint:
                middle, half = middle_and_half(self.rows.limits, order)
                parts.append(self.rows.series.functions(times, order) @ mixing / half[j])
                middles.append(np.full(len(times), middle[j] / half[j]))
        return np.vstack(parts), np.concatenate(middles)
