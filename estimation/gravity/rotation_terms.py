"""Terms of the forces in the turning of a tool about its sensor, whatever its first moment."""

from __future__ import annotations

from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from estimation.least_squares.column_space import orthonormal_basis
from estimation.recordings.recording import Recording

Array = NDArray[np.float64]


def rotation_terms(recording: Recording, every: slice) -> Array:
    """Angular accelerations and products of angular velocities (n, k) in these rows: m (alpha x r + omega x omega x r)
    is made of them."""
    signals = recording.signals
    if recording.dimension == 2:
        return np.stack([signals["ddphi"][every], signals["dphi"][every] ** 2], axis=1)
    omega, alpha = ([signals[prefix + axis][every] for axis in "xyz"] for prefix in ("w", "al"))
    products = [first * second for first, second in combinations_with_replacement(omega, 2)]
    return np.stack([*alpha, *products], axis=1)


def without_terms(rows: Array, terms: Array) -> Array:
    """What the terms (n, k), fitted by least squares with a constant, leave of rows (n, m).

    A fit of what is left to what is left is that of a fit with these terms (Frisch and Waugh, Econometrica 1, 1933).
    """
    rows, basis = rows - rows.mean(axis=0), orthonormal_basis(terms - terms.mean(axis=0))
    return np.asarray(rows - basis @ (basis.T @ rows))
