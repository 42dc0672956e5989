"""Random feasible trajectory of any series, scaled until it touches a limit."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from design.limits import LimitedQuantity, LimitUse, use_at_rest
from design.trajectories.trajectory import Array, Trajectory, TrajectorySeries
from modeling.errors import InputError
from modeling.kinematics.arm import Arm
from modeling.rig import Limits, Workspace

LIMIT_MARGIN = 1e-9
"""Share of its limits that a trajectory leaves unused, so that rounding does not carry it beyond."""
SCALE_BISECTIONS = 12
"""Bisections between a feasible and an infeasible scale: to 2.4e-4 of the interval."""
POSTURE_TRIALS = 200
"""Random postures tried at once: a workspace that holds a twentieth of them is missed once in 28 000 times."""
NARROWING, MOST_NARROWER = 0.7, 20
"""Where none is within the limits, as many are tried about the nearest so many times, each time in so much less of the
position limits: of an arm of which one posture in 7000 is within its torque limits, three seeds of three find some."""
POSTURE_CANDIDATES = 8
"""Feasible postures of which the one that uses its limits least is taken: random, and seldom at the boundary of the
workspace."""
MOTIONLESS = 1e-9
"""Coefficient directions with less than this share of the largest velocity power do not move, as an offset."""


def random_feasible_trajectory(
    series: TrajectorySeries,
    limits: Limits,
    *,
    workspace: Workspace | None = None,
    arm: Arm | None = None,
    tip_length: float | None = None,
    seed: int | Sequence[int] = 0,
) -> Trajectory:
    """A random trajectory of the series about a posture within the limits, scaled until it touches one of them.

    The posture is the middle of the position limits, or one of a few random ones when the tip is outside the workspace
    there. Coefficients are normal, with a covariance that makes the power of velocity the same in all directions (std
    1/h of harmonic h in a Fourier series). Joints that share no coefficient are scaled each by itself, so that each
    touches a limit; then all together until the tip is inside the workspace. The limits are kept at every instant.

    Raises InputError when no static posture of the series is within the limits and the workspace.
    """

    def used(coefficients: Array) -> LimitedQuantity:
        return LimitUse.of(Trajectory(series, coefficients), limits, workspace, arm, tip_length).worst

    rng = np.random.default_rng(seed)

    def at_rest(tried: Array) -> Array:
        q = np.array([series.evaluate(static, np.zeros(1), 0)[0] for static in tried])
        return use_at_rest(q, limits, workspace, arm, tip_length)

    posture = _static_posture(series, limits, at_rest, used, rng)
    moving = _draw(series, rng)
    moving *= _factors(series, limits, posture, moving) * (1 - LIMIT_MARGIN)
    whole = used(posture + moving).use <= 1
    scale = 1.0 if whole else _largest_feasible(lambda s: used(posture + s * moving).use <= 1)
    return Trajectory(series, posture + scale * moving)


def _draw(series: TrajectorySeries, rng: np.random.Generator) -> Array:
    """z (k,) with covariance G^+, where G is the mean over time of dB' dB: the velocity's power is z' G z."""
    velocity = series.basis(series.instants(8 * series.mixing.shape[1]), 1)
    power, axes = np.linalg.eigh(np.einsum("tjk,tjl->kl", velocity, velocity, optimize=True) / len(velocity))
    moves = power > MOTIONLESS * power[-1]
    drawn = axes[:, moves] @ (rng.standard_normal(moves.sum()) / np.sqrt(power[moves]))
    return np.where(series.adjustable, drawn, 0.0)


def _factors(series: TrajectorySeries, limits: Limits, posture: Array, moving: Array) -> Array:
    """(k,): the largest multiple of each coefficient that keeps the limits of all joints that share coefficients."""
    largest = np.full(series.joints, np.inf)
    for order, pairs in enumerate(limits.pairs.values()):
        room = pairs.T - np.array(series.enclosure(posture, order))
        reached = np.array(series.enclosure(moving, order))
        ratio = np.divide(room, reached, out=np.full(room.shape, np.inf), where=room * reached > 0)
        largest = np.minimum(largest, ratio.min(axis=0))
    return series.by_coefficient(largest)


def _static_posture(
    series: TrajectorySeries,
    limits: Limits,
    at_rest: Callable[[Array], Array],
    used: Callable[[Array], LimitedQuantity],
    rng: np.random.Generator,
) -> Array:
    """Coefficients of the static posture in the middle of the limits, or of the least limit use among a few.

    at_rest  the largest uses of limits (P,) in static postures by their coefficients (P, k)
    used     the limit that a motion uses most, by its coefficients
    """
    low, high = limits.position.T
    middle = series.rest((low + high) / 2)
    nearest = used(middle)
    if nearest.use <= 1:
        return middle
    tried = rng.uniform(low, high, (POSTURE_TRIALS, len(low)))
    statics = [series.rest(posture) for posture in tried]
    use = at_rest(np.array(statics))
    feasible = np.flatnonzero(use <= 1)[:POSTURE_CANDIDATES]
    best = int(feasible[use[feasible].argmin()] if len(feasible) else use.argmin())
    static, posture, least = statics[best], tried[best], use[best]
    for trial in range(0 if len(feasible) else MOST_NARROWER):
        spread = NARROWING**trial * (high - low) / 2
        tried = np.clip(posture + spread * rng.standard_normal((POSTURE_TRIALS, len(low))), low, high)
        statics = [series.rest(posture) for posture in tried]
        use = at_rest(np.array(statics))
        if use.min() < least:
            static, posture, least = statics[use.argmin()], tried[use.argmin()], use.min()
    at = used(static)
    if at.use <= 1:
        return static
    nearest = min(nearest, at, key=lambda limited: limited.use)
    raise InputError(
        what="no posture was found at which the series can be static within the limits: the nearest of"
        f" {1 + (1 + MOST_NARROWER) * POSTURE_TRIALS} is beyond {nearest.excess}",
        where="limits",
        remedy="widen that limit, or use a series with an offset",
    )


def _largest_feasible(feasible: Callable[[float], bool]) -> float:
    """The largest feasible scale between 0, which is feasible, and 1, which is not, by bisection."""
    low, high = 0.0, 1.0
    for _ in range(SCALE_BISECTIONS):
        middle = (low + high) / 2
        low, high = (middle, high) if feasible(middle) else (low, middle)
    return low
