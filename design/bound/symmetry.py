"""Symmetry: changes of sign that leave what a state says, and whether it is viable, as they were."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from design.bound.viability import ViableStates

Array = NDArray[np.float64]
STATES = 64
"""Random states at which a symmetry is looked for: enough to meet every entry of the information."""
SAME = 1e-9
"""Share of the largest value to which two informations agree that differ by rounding only."""


class Change(Enum):
    """Signs of (q, dq, ddq), and of h where d/dt h is to stay as it is: time reversed, or the arm mirrored."""

    REVERSAL = (1, -1, 1)
    MIRROR = (-1, -1, -1)

    @property
    def parity(self) -> int:
        """The sign by which h changes when d/dt h does not change."""
        return -1 if self is Change.REVERSAL else 1


@dataclass(frozen=True, eq=False)
class Symmetry:
    """A change of the states, and the signs (k,) of the parameters by which the information answers it.

    With Phi'Phi(g x) = S Phi'Phi(x) S for the change g and S = diag(signs), a measure and its image have the same
    ln det, and their mean no smaller one: the best measure is invariant. So is the dual, D = S D S, and only h for
    which d/dt h does not change are of use. A bound from such D and h is a bound with or without the symmetry.
    """

    change: Change
    signs: Array


def symmetries(gram: Callable[[Array], Array], viable: ViableStates, seed: int) -> tuple[Symmetry, ...]:
    """The symmetries, found numerically at random states; `gram` gives Phi'Phi (N, k, k) of states (N, 3n)."""
    rng = np.random.default_rng(seed)
    q, dq = viable.phase(rng.uniform(-1, 1, (STATES, 2 * viable.joints)))
    states = np.hstack([q, dq, viable.vertices[rng.integers(len(viable.vertices), size=STATES)]])
    before = gram(states)
    found = []
    for change in Change:
        after = gram(states * np.repeat(change.value, viable.joints))
        signs = _signs(before, after)
        if signs is not None and _symmetric(viable, change):
            found.append(Symmetry(change, signs))
    return tuple(found)


def with_images(states: Array, weights: Array, found: tuple[Symmetry, ...]) -> tuple[Array, Array]:
    """The measure on states (N, 3n) with weights (N,), half of it replaced by its image under each symmetry."""
    for symmetry in found:
        signs = np.repeat(symmetry.change.value, states.shape[1] // 3)
        states, weights = np.vstack([states, states * signs]), np.concatenate([weights, weights]) / 2
    return states, weights


def _symmetric(viable: ViableStates, change: Change) -> bool:
    """Whether the limits of what changes its sign are symmetric."""
    pairs = (viable.limits.position, viable.limits.velocity, viable.limits.acceleration)
    return all(s > 0 or np.allclose(p[:, 0], -p[:, 1]) for s, p in zip(change.value, pairs, strict=True))


def _signs(before: Array, after: Array) -> Array | None:
    """The signs s with after_ij = s_i s_j before_ij, the first parameter's and any free one +1; None without."""
    k = before.shape[1]
    product = np.einsum("nij,nij->ij", before, after)
    tolerance = SAME * np.einsum("nij,nij->ij", before, before)
    signs, known = np.ones(k), {0}
    while len(known) < k:
        linked = [(i, j) for i in known for j in range(k) if j not in known and abs(product[i, j]) > tolerance[i, j]]
        i, j = linked[0] if linked else (0, next(j for j in range(k) if j not in known))
        signs[j] = signs[i] * np.sign(product[i, j]) if linked else 1.0
        known.add(j)
    error = np.abs(after - np.multiply.outer(signs, signs) * before).max()
    return signs if error <= SAME * np.abs(before).max() else None
