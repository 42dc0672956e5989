"""Linear joint-limit constraints as a polytope of coefficients."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class JointBlock:
    """Limits of one joint, -1 <= A z[own] - middle <= 1: indices own (c,) of the coefficients that move it, A (R, c),
    middle (R,), and the place of its rows among those of all joints."""

    own: NDArray[np.intp]
    matrix: Array
    middle: Array
    place: slice

    @cached_property
    def square(self) -> tuple[NDArray[np.intp], ...]:
        """The indices of a joint's coefficients by themselves."""
        return np.ix_(self.own, self.own)


@dataclass(frozen=True, eq=False)
class Polytope:
    """-1 <= A z - middle <= 1 for `size` coefficients z: one dense block of A for each joint."""

    blocks: tuple[JointBlock, ...]
    size: int

    def __len__(self) -> int:
        return int(self.blocks[-1].place.stop)

    def change(self, step: Array) -> Array:
        """A step (R,): the change of the rows by a step (k,) of the coefficients."""
        return np.concatenate([block.matrix @ step[block.own] for block in self.blocks])

    def slack(self, z: Array) -> Array:
        """(2, R): the slacks to the high and to the low limits at z (k,); positive inside."""
        value = self.change(z) - np.concatenate([block.middle for block in self.blocks])
        return np.stack([1 - value, 1 + value])

    def pushed(self, multipliers: Array) -> Array:
        """A' (high - low) (k,) of multipliers (2, R)."""
        net, total = multipliers[0] - multipliers[1], np.zeros(self.size)
        for block in self.blocks:
            total[block.own] += net[block.place] @ block.matrix
        return total

    def gram(self, weights: Array) -> Array:
        """A' diag(high + low) A (k, k) of weights (2, R) that are not negative."""
        root, total = np.sqrt(weights.sum(axis=0)), np.zeros((self.size, self.size))
        for block in self.blocks:
            scaled = block.matrix * root[block.place, None]
            total[block.square] += scaled.T @ scaled
        return total

    def reach(self, static: Array, z: Array, margin: float) -> float | None:
        """The largest f up to 1 for which static + f (z - static) leaves a share `margin` of the slacks of `static`.

        None where `static` (k,) is not inside itself.
        """
        slack = self.slack(static)
        if slack.min() <= 0:
            return None
        used = (slack - self.slack(z)) / slack
        return float(min(1.0, (1 - margin) / max(float(used.max()), 1 - margin)))
