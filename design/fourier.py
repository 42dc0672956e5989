"""Periodic joint motions as finite Fourier series: the family of equation 22.10 and its free relative."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

CHAPTER_OPTIMUM_DEGREES = (
    12.99, 8.95, -0.43, 5.72, 7.97, 11.42, 3.16, 1.92, 9.49, -1.68, 4.40, 10.27, -1.33, 2.85, 2.01,
)  # fmt: skip
"""x_opt of equation 22.17, in degrees: an inference, from joint peaks of 42, 44 and 35 degrees."""

JOINT_HARMONICS = 3
POINTS_PER_WAVE = 256


@dataclass(frozen=True, kw_only=True, eq=False)
class FourierMotion:
    """A motion q_j(t) = offset_j + sum_h sine_jh sin(h w t) + cosine_jh cos(h w t), with w = 2 pi / period.

    offset (n,), sine and cosine (n, H) in the coordinate's unit (rad for a joint), harmonics h = 1 .. H;
    period in s.

    Raises ValueError when the shapes do not fit or the period is not positive.
    """

    offset: Array
    sine: Array
    cosine: Array
    period: float

    def __post_init__(self) -> None:
        if self.sine.shape != self.cosine.shape or self.sine.shape[:1] != self.offset.shape:
            shapes = f"offset {self.offset.shape}, sine {self.sine.shape}, cosine {self.cosine.shape}"
            raise ValueError(f"a Fourier motion needs shapes (n,), (n, H), (n, H); got {shapes}")
        if not self.period > 0:
            raise ValueError(f"the period has to be positive, in s; got {self.period}")

    @property
    def joints(self) -> int:
        """The number of coordinates, n."""
        return len(self.offset)

    @property
    def harmonics(self) -> int:
        """The highest harmonic, H."""
        return int(self.sine.shape[1])

    def evaluate(self, time: npt.ArrayLike) -> tuple[Array, Array, Array]:
        """q, dq, ddq, each (N, n), at the times (N,) in s: the series and its exact derivatives by time."""
        rate = 2 * np.pi / self.period * np.arange(1, self.harmonics + 1)
        angle: Array = np.asarray(time, dtype=np.float64)[:, None] * rate
        sin, cos = np.sin(angle), np.cos(angle)
        q = self.offset + sin @ self.sine.T + cos @ self.cosine.T
        dq = cos @ (rate * self.sine).T - sin @ (rate * self.cosine).T
        ddq = -sin @ (rate**2 * self.sine).T - cos @ (rate**2 * self.cosine).T
        return q, dq, ddq

    def grid(self) -> Array:
        """Times over one period, 256 to a wave of the highest harmonic, s."""
        count = POINTS_PER_WAVE * max(self.harmonics, 1)
        return np.linspace(0.0, self.period, count, endpoint=False)

    def peak(self) -> tuple[Array, Array, Array]:
        """The largest |q|, |dq|, |ddq| of each joint, each (n,), on `grid`.

        The true peak is at most 1 / cos(pi/256) times as large (8e-5 more): a trigonometric polynomial of
        degree H stays below its largest value on M equally spaced points divided by cos(pi H / M) (Ehlich and
        Zeller 1964).
        """
        q, dq, ddq = self.evaluate(self.grid())
        return _largest(q), _largest(dq), _largest(ddq)

    def scaled(self, factor: npt.ArrayLike) -> FourierMotion:
        """The motion times a factor, or times one factor per joint (n,), offset included."""
        factors = np.broadcast_to(np.asarray(factor, dtype=float), self.offset.shape)
        column = factors[:, None]
        return replace(self, offset=self.offset * factors, sine=self.sine * column, cosine=self.cosine * column)


def chapter_series(coefficients: npt.ArrayLike, period: float) -> FourierMotion:
    """The motion of three joints by equation 22.10 with its 15 coefficients, in rad; period in s.

    x1..x3 are the sines and x4..x6 the cosines of harmonics 1..3, shared by all joints; x7..x9, x10..x12 and
    x13..x15 the sines of harmonics 4..6 of joint 1, 2 and 3. Of the four natural orders of x1..x6 only this
    one gives x_opt of 22.17 joint peaks of 42, 44 and 35 degrees (sine and cosine interleaved: 45, 44 and
    34).

    Raises ValueError when there are not 15 coefficients.
    """
    x = np.asarray(coefficients, dtype=float)
    if x.shape != (15,):
        raise ValueError(f"equation 22.10 has 15 coefficients; got an array of shape {x.shape}")
    shared_sine, shared_cosine, own_sine = x[:3], x[3:6], x[6:].reshape(3, JOINT_HARMONICS)
    sine = np.hstack([np.tile(shared_sine, (3, 1)), own_sine])
    cosine = np.hstack([np.tile(shared_cosine, (3, 1)), np.zeros((3, JOINT_HARMONICS))])
    return FourierMotion(offset=np.zeros(3), sine=sine, cosine=cosine, period=period)


def random_motion(
    *,
    joints: int,
    position: npt.ArrayLike,
    velocity: npt.ArrayLike,
    acceleration: npt.ArrayLike,
    harmonics: int = 5,
    period: float = 5.0,
    seed: int | Sequence[int] = 0,
) -> FourierMotion:
    """A random periodic motion, each joint scaled until it just touches the nearest of its limits.

    position      limits of q: a number or (n,), symmetric, or (n, 2) of [low, high] and centred between them
    velocity      limits of |dq|, a number or (n,)
    acceleration  limits of |ddq|, a number or (n,)

    Coefficients are normal with a standard deviation of 1/h, so that velocity has a flat spectrum. The limits
    are kept between the points of the grid too, by the bound of `FourierMotion.peak`; at least one of the
    three is used to within 2e-4 of it.

    Raises ValueError when a limit is not positive, or a shape does not fit.
    """
    low, high = _position_limits(position, joints)
    limits = np.array([(high - low) / 2, _per_joint(velocity, joints), _per_joint(acceleration, joints)])
    if not (limits > 0).all():
        raise ValueError("every limit of position, velocity and acceleration has to be positive")
    rng = np.random.default_rng(seed)
    weight = 1 / np.arange(1, harmonics + 1)
    sine, cosine = rng.standard_normal((2, joints, harmonics)) * weight
    free = FourierMotion(offset=np.zeros(joints), sine=sine, cosine=cosine, period=period)
    bound = np.array(free.peak()) / np.cos(np.pi / POINTS_PER_WAVE)
    return replace(free.scaled((limits / bound).min(axis=0)), offset=(low + high) / 2)


def _largest(series: Array) -> Array:
    """The largest absolute value of each column."""
    return np.asarray(np.abs(series).max(axis=0), dtype=float)


def _per_joint(limit: npt.ArrayLike, joints: int) -> Array:
    values = np.asarray(limit, dtype=float)
    if values.shape not in ((), (joints,)):
        raise ValueError(f"a limit is a number or one for each of the {joints} joints; got shape {values.shape}")
    return np.broadcast_to(values, (joints,)).astype(float)


def _position_limits(limit: npt.ArrayLike, joints: int) -> tuple[Array, Array]:
    values = np.asarray(limit, dtype=float)
    if values.ndim == 2:
        if values.shape != (joints, 2):
            raise ValueError(f"pairs of position limits need shape ({joints}, 2); got {values.shape}")
        return values[:, 0], values[:, 1]
    symmetric = _per_joint(values, joints)
    return -symmetric, symmetric
