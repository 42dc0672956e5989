"""Sign symmetries of the information and of the viable states."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from design.bound.viable_states import ViableStates

Array = NDArray[np.float64]
RANDOM_STATES = 64
"""Random states at which a symmetry is tested: enough for every entry of the information to be nonzero."""
SYMMETRY_TOLERANCE = 1e-9
"""Relative tolerance of the equality of two information matrices: rounding."""


class SignChange(Enum):
    """Signs of (q, dq, ddq): time reversal, or mirroring of the arm."""

    REVERSAL = (1, -1, 1)
    MIRROR = (-1, -1, -1)

    @property
    def parity(self) -> int:
        """The sign change of an h whose d/dt h is invariant."""
        return -1 if self is SignChange.REVERSAL else 1


@dataclass(frozen=True, eq=False)
class Symmetry:
    """A sign change of the states, and the signs (k,) of the parameters under which the information is equivariant.

    With Phi'Phi(g x) = S Phi'Phi(x) S for the change g and S = diag(signs), a measure and its image have the same
    ln det, and their mean no smaller one: an optimal measure is invariant. So is the dual, D = S D S, and only h with
    invariant d/dt h are useful. A bound from such D and h is valid with or without the symmetry.
    """

    change: SignChange
    signs: Array


def symmetries(gram: Callable[[Array], Array], viable: ViableStates, seed: int) -> tuple[Symmetry, ...]:
    """The symmetries, found numerically at random states; `gram` gives Phi'Phi (N, k, k) of states (N, 3n)."""
    rng = np.random.default_rng(seed)
    q, dq = viable.phase(rng.uniform(-1, 1, (RANDOM_STATES, 2 * viable.joints)))
    states = np.hstack([q, dq, viable.vertices[rng.integers(len(viable.vertices), size=RANDOM_STATES)]])
    before = gram(states)
    found = []
    for change in SignChange:
        after = gram(states * np.repeat(change.value, viable.joints))
        signs = _signs(before, after)
        if signs is not None and _symmetric(viable, change):
            found.append(Symmetry(change, signs))
    return tuple(found)


def symmetrised_measure(states: Array, weights: Array, found: tuple[Symmetry, ...]) -> tuple[Array, Array]:
    """The measure on states (N, 3n) with weights (N,), half of it replaced by its image under each symmetry."""
    for symmetry in found:
        signs = np.repeat(symmetry.change.value, states.shape[1] // 3)
        states, weights = np.vstack([states, states * signs]), np.concatenate([weights, weights]) / 2
    return states, weights


def _symmetric(viable: ViableStates, change: SignChange) -> bool:
    """Whether the limits of the quantities that change sign are symmetric."""
    pairs = (viable.limits.position, viable.limits.velocity, viable.limits.acceleration)
    return all(s > 0 or np.allclose(p[:, 0], -p[:, 1]) for s, p in zip(change.value, pairs, strict=True))


def _signs(before: Array, after: Array) -> Array | None:
    """The signs s with after_ij = s_i s_j before_ij, the first parameter's and any free one +1; None without."""
    k = before.shape[1]
    product = np.einsum("nij,nij->ij", before, after)
    tolerance = SYMMETRY_TOLERANCE * np.einsum("nij,nij->ij", before, before)
    signs, known = np.ones(k), {0}
    while len(known) < k:
        linked = [(i, j) for i in known for j in range(k) if j not in known and abs(product[i, j]) > tolerance[i, j]]
        i, j = linked[0] if linked else (0, next(j for j in range(k) if j not in known))
        signs[j] = signs[i] * np.sign(product[i, j]) if linked else 1.0
        known.add(j)
    error = np.abs(after - np.multiply.outer(signs, signs) * before).max()
    return signs if error <= SYMMETRY_TOLERANCE * np.abs(before).max() else None
