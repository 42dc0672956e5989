"""Random periodic trajectory within symmetric limits."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from design.trajectories.fourier import EHLICH_ZELLER_FACTOR, FreeSeries, fourier_trajectory
from design.trajectories.trajectory import Array, Trajectory
from modeling.errors import InputError


def random_periodic_trajectory(
    *,
    joints: int,
    position: npt.ArrayLike,
    velocity: npt.ArrayLike,
    acceleration: npt.ArrayLike,
    harmonics: int = 5,
    period: float = 5.0,
    seed: int | Sequence[int] = 0,
) -> Trajectory:
    """A random periodic trajectory, each joint scaled until it just touches the nearest of its limits.

    position      limits of q: a number or (n,), symmetric, or (n, 2) of [low, high] and centred between them
    velocity      limits of |dq|, a number or (n,)
    acceleration  limits of |ddq|, a number or (n,)

    Coefficients are normal with a standard deviation of 1/h, so that velocity has a flat spectrum. The limits hold at
    every instant, by the bound `EHLICH_ZELLER_FACTOR`; at least one of the three is used to within 2e-4 of it.

    Raises InputError when a limit is not positive, or a shape does not fit.
    """
    low, high = _position_limits(position, joints)
    limits = np.array([(high - low) / 2, _per_joint(velocity, joints), _per_joint(acceleration, joints)])
    if not (limits > 0).all():
        raise _unusable("every limit of position, velocity and acceleration has to be positive")
    rng = np.random.default_rng(seed)
    sine, cosine = rng.standard_normal((2, joints, harmonics)) / np.arange(1, harmonics + 1)
    series = FreeSeries(joints=joints, harmonics=tuple(range(1, harmonics + 1)), period=period, offset=False)
    waves = Trajectory(series, np.hstack([sine, cosine]).ravel()).evaluate(series.grid())
    factor = (limits / (EHLICH_ZELLER_FACTOR * np.abs(waves).max(axis=1))).min(axis=0)[:, None]
    return fourier_trajectory(offset=(low + high) / 2, sine=factor * sine, cosine=factor * cosine, period=period)


def _per_joint(limit: npt.ArrayLike, joints: int) -> Array:
    values = np.asarray(limit, dtype=float)
    if values.shape not in ((), (joints,)):
        raise _unusable(f"a limit is a number or one for each of the {joints} joints; got shape {values.shape}")
    return np.broadcast_to(values, (joints,)).astype(float)


def _position_limits(limit: npt.ArrayLike, joints: int) -> tuple[Array, Array]:
    values = np.asarray(limit, dtype=float)
    if values.ndim == 2:
        if values.shape != (joints, 2):
            raise _unusable(f"pairs of position limits need shape ({joints}, 2); got {values.shape}")
        return values[:, 0], values[:, 1]
    symmetric = _per_joint(values, joints)
    return -symmetric, symmetric


def _unusable(what: str) -> InputError:
    return InputError(what=what, where="random_periodic_trajectory", remedy="give positive limits of the right shape")
