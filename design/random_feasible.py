"""A random motion of any series, as large as the limits allow."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import islice

import numpy as np
from scipy.sparse.csgraph import connected_components

from design.limit_use import LimitUse
from design.motion.series import Array, Motion, Series
from modeling.errors import InputError
from modeling.kinematics import Arm
from modeling.rig import Limits, Workspace

ROUNDING = 1e-9
"""What a motion is kept away from its limits, as a share, so that rounding does not carry it beyond."""
HALVINGS = 12
"""Of the interval between a scale that is feasible and one that is not: 2.4e-4 of it remains."""
POSTURES = 200
"""Postures that are tried at random: a workspace that holds a twentieth of them is missed once in 28 000 times."""
FEW = 8
"""Postures of which the one with the most room is taken: still random, and seldom at the edge of the workspace."""
STILL = 1e-9
"""Directions with less than this share of the largest velocity's power do not move, as an offset."""


def random_feasible(
    series: Series,
    limits: Limits,
    *,
    workspace: Workspace | None = None,
    arm: Arm | None = None,
    tip_length: float | None = None,
    seed: int | Sequence[int] = 0,
) -> Motion:
    """A random motion of the series about a posture within the limits, scaled until it touches one of them.

    The posture is the middle of the position limits, or one of a few random ones when the tip is outside the workspace
    there. Coefficients are normal, with a covariance that makes the power of velocity the same in all directions (std
    1/h of harmonic h in a Fourier series). Joints that share no coefficient are scaled each by itself, so that each
    touches a limit; then all together until the tip is inside the workspace. The limits are kept at every instant.

    Raises InputError when the series cannot stand still within the limits and the workspace.
    """

    def use(coefficients: Array) -> float:
        return LimitUse.of(Motion(series, coefficients), limits, workspace, arm, tip_length).worst.use

    rng = np.random.default_rng(seed)
    middle = _middle(series, limits, use, rng)
    moving = _draw(series, rng)
    moving *= _factors(series, limits, middle, moving) * (1 - ROUNDING)
    scale = 1.0 if use(middle + moving) <= 1 else _largest(lambda s: use(middle + s * moving) <= 1)
    return Motion(series, middle + scale * moving)


def _draw(series: Series, rng: np.random.Generator) -> Array:
    """z (k,) with covariance G^+, where G is the mean over time of dB' dB: the velocity's power is z' G z."""
    velocity = series.basis(series.instants(8 * series.mixing.shape[1]), 1)
    power, axes = np.linalg.eigh(np.einsum("tjk,tjl->kl", velocity, velocity, optimize=True) / len(velocity))
    moves = power > STILL * power[-1]
    return np.asarray(axes[:, moves] @ (rng.standard_normal(moves.sum()) / np.sqrt(power[moves])), dtype=float)


def _factors(series: Series, limits: Limits, middle: Array, moving: Array) -> Array:
    """(k,): the largest multiple of each coefficient that keeps the limits of all joints that it is tied to."""
    largest = np.full(series.joints, np.inf)
    for order, pairs in enumerate((limits.position, limits.velocity, limits.acceleration, limits.jerk)):
        if pairs is not None:
            room = pairs.T - series.evaluate(middle, np.zeros(1), order)
            reached = np.array(series.enclosure(moving, order))
            ratio = np.divide(room, reached, out=np.full(room.shape, np.inf), where=room * reached > 0)
            largest = np.minimum(largest, ratio.min(axis=0))
    owners = (series.mixing != 0).any(axis=1).astype(int)
    _, group = connected_components(owners @ owners.T)
    together = np.array([largest[group == g].min() for g in group])
    return np.asarray(together[owners.argmax(axis=0)], dtype=float)


def _middle(series: Series, limits: Limits, use: Callable[[Array], float], rng: np.random.Generator) -> Array:
    """The coefficients of standing still in the middle of the limits, or where of a few postures there is most room."""
    low, high = limits.position.T
    middle = series.rest((low + high) / 2)
    if use(middle) <= 1:
        return middle
    tried = (series.rest(rng.uniform(low, high)) for _ in range(POSTURES))
    fitting = list(islice((still for still in tried if use(still) <= 1), FEW))
    if not fitting:
        raise InputError(
            what="no posture was found where the series stands still within the position limits and the workspace",
            where="limits",
            remedy="use a series with an offset, or a larger workspace",
        )
    return min(fitting, key=use)


def _largest(feasible: Callable[[float], bool]) -> float:
    """A scale between 0, which is feasible, and 1, which is not, that is feasible and nearly not."""
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if feasible(middle) else (low, middle)
    return low
