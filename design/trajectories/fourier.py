"""Finite Fourier series trajectories: equation 22.10 (chapter 22, "Characterization of the Dynamical Model of a Force
Sensor for Robot Manipulators", Bassi et al.), and independent joints."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import numpy.typing as npt

from design.trajectories.trajectory import Array, Trajectory, TrajectorySeries, require_positive_duration
from modeling.errors import InputError

CHAPTER_OPTIMUM_DEGREES = (
    12.99, 8.95, -0.43, 5.72, 7.97, 11.42, 3.16, 1.92, 9.49, -1.68, 4.40, 10.27, -1.33, 2.85, 2.01,
)  # fmt: skip
"""x_opt of equation 22.17, in degrees: an inference, from joint peaks of 42, 44 and 35 degrees."""

SHARED_HARMONICS = (1, 2, 3)
"""Harmonics of equation 22.10 whose coefficients all joints share."""
OWN_HARMONICS = (4, 5, 6)
"""Harmonics of equation 22.10 with coefficients of each joint."""

POINTS_PER_WAVE = 256
"""Points of a grid to the shortest wave."""
EHLICH_ZELLER_FACTOR = 1 / float(np.cos(np.pi / POINTS_PER_WAVE))
"""A trigonometric polynomial of degree H stays below its largest absolute value on M equally spaced points of a period
divided by cos(pi H / M) (Ehlich and Zeller, Math. Z. 86 (1964) 41-44); 7.5e-5 more with 256 points to a wave."""


class FourierSeries(TrajectorySeries):
    """Trajectories in the basis 1, sin(h w t) .., cos(h w t) .., w = 2 pi / period, for some harmonics h."""

    period: float
    """s"""

    @property
    def duration(self) -> float:
        """The period, s."""
        return self.period

    @property
    @abstractmethod
    def waves(self) -> tuple[int, ...]:
        """The harmonics h."""

    @property
    def unity(self) -> Array:
        """The first function is one."""
        return np.asarray(np.eye(1, 1 + 2 * len(self.waves))[0], dtype=float)

    def functions(self, time: Array, order: int) -> Array:
        """(N, 1 + 2 H): each derivative multiplies by h w and turns sin into cos, -sin, -cos."""
        return _functions(self.waves, self.duration, time, order)

    def grid(self) -> Array:
        """Times over one period, 256 to a wave of the highest harmonic, s."""
        return _grid(self.waves, self.duration)

    def enclosure(self, coefficients: Array, order: int) -> tuple[Array, Array]:
        """The extremes on the grid, their half range times `EHLICH_ZELLER_FACTOR`.

        Less the middle of these extremes the derivative is a trigonometric polynomial of the same degree, whose
        largest absolute value on the grid is their half range.
        """
        values = _functions_on_grid(tuple(self.waves), self.duration, order) @ (self.mixing @ coefficients).T
        low, high = values.min(axis=0), values.max(axis=0)
        middle, half = (low + high) / 2, (high - low) / 2 * EHLICH_ZELLER_FACTOR
        return middle - half, middle + half


def _functions(waves: Sequence[int], duration: float, time: Array, order: int) -> Array:
    rate = 2 * np.pi / duration * np.array(waves, dtype=float)
    angle = np.multiply.outer(time, rate)
    sin, cos = np.sin(angle), np.cos(angle)
    first, second = ((sin, cos), (cos, -sin), (-sin, -cos), (-cos, sin))[order % 4]
    constant = np.full((len(time), 1), float(order == 0))
    return np.hstack([constant, rate**order * first, rate**order * second])


def _grid(waves: Sequence[int], duration: float) -> Array:
    return np.linspace(0.0, duration, POINTS_PER_WAVE * max(waves), endpoint=False)


@lru_cache(maxsize=8)
def _functions_on_grid(waves: tuple[int, ...], duration: float, order: int) -> Array:
    """Kept: the limits of every motion that is tried ask for the same. Not to be written to."""
    values = _functions(waves, duration, _grid(waves, duration), order)
    values.flags.writeable = False
    return values


@dataclass(frozen=True, kw_only=True)
class FreeSeries(FourierSeries):
    """Independent joints: q_j(t) = offset_j + sum_h sine_jh sin(h w t) + cosine_jh cos(h w t).

    Coefficients: joint by joint the offset (unless `offset` is False), the sines and the cosines of the harmonics, in
    the coordinate's unit.

    Parameters
    ----------
    joints : int
        Number n of joints.
    harmonics : tuple of int
        Multiples h of the fundamental frequency w = 2 pi / period.
    period : float
        In s.
    offset : bool, optional
        Whether each joint has an offset, by default True.

    Raises
    ------
    InputError
        For a period or harmonics that are not positive, and a harmonic that is given twice.

    Examples
    --------
    >>> import truewrench as tw
    >>> series = tw.FreeSeries(joints=3, harmonics=(1, 2, 3), period=5.0)
    >>> series.size
    21
    """

    joints: int
    harmonics: tuple[int, ...]
    period: float
    offset: bool = True

    def __post_init__(self) -> None:
        require_positive_duration(self.period, name="period", where="FreeSeries")
        object.__setattr__(self, "harmonics", tuple(int(h) for h in self.harmonics))
        if not self.harmonics or min(self.harmonics) < 1 or len(set(self.harmonics)) < len(self.harmonics):
            what = f"different harmonics from 1 on were expected, and {self.harmonics} came"
            raise InputError(what=what, where="FreeSeries", remedy="give harmonics such as (1, 2, 3)")

    @property
    def waves(self) -> tuple[int, ...]:
        """The harmonics."""
        return self.harmonics

    def __str__(self) -> str:
        offset = "an offset and " if self.offset else ""
        return (
            f"each joint with {offset}{len(self.harmonics)} harmonics up to {max(self.harmonics) / self.period:.3g} Hz"
        )

    @cached_property
    def mixing(self) -> Array:
        """Every joint has its own coefficient of every basis function."""
        one = np.eye(1 + 2 * len(self.harmonics))[:, 0 if self.offset else 1 :]
        each = np.multiply.outer(np.eye(self.joints), one)  # joint, joint of the coefficient, function, coefficient
        return each.transpose(0, 2, 1, 3).reshape(self.joints, len(one), -1)


@dataclass(frozen=True, kw_only=True)
class PaperSeries(FourierSeries):
    """The trajectory of equation 22.10, for n joints.

    Sines and cosines of harmonics 1..3 shared by all joints, and sines of harmonics 4..6 for each. Coefficients in rad:
    x1..x3 the shared sines, x4..x6 the shared cosines, then three sines joint by joint, x7..x9, x10..x12 and x13..x15
    of the chapter's arm.

    Parameters
    ----------
    joints : int, optional
        Number n of joints, by default 3.
    period : float
        In s.

    Raises
    ------
    InputError
        For a period that is not positive.

    Notes
    -----
    Of the four natural orders of x1..x6 only this one gives x_opt of 22.17 joint peaks of 42, 44 and 35 degrees (sine
    and cosine interleaved: 45, 44 and 34).

    Examples
    --------
    >>> import truewrench as tw
    >>> tw.PaperSeries(period=10.0).size
    15
    """

    joints: int = 3
    period: float

    def __post_init__(self) -> None:
        require_positive_duration(self.period, name="period", where="PaperSeries")

    @property
    def waves(self) -> tuple[int, ...]:
        """Harmonics 1..6."""
        return SHARED_HARMONICS + OWN_HARMONICS

    @property
    def chapter_optimum(self) -> Trajectory:
        """The chapter's optimum, x_opt of 22.17, whose coefficients are degrees; of three joints."""
        return Trajectory(self, np.radians(CHAPTER_OPTIMUM_DEGREES))

    def __str__(self) -> str:
        return f"the series of equation 22.10, up to {max(self.waves) / self.period:.3g} Hz"

    @cached_property
    def mixing(self) -> Array:
        """All joints have the shared coefficients; each its own sines."""
        shared, separate, count = len(SHARED_HARMONICS), len(OWN_HARMONICS), len(self.waves)
        mixing = np.zeros((self.joints, 1 + 2 * count, 2 * shared + separate * self.joints))
        mixing[:, 1 : 1 + shared, :shared] = np.eye(shared)
        mixing[:, 1 + count : 1 + count + shared, shared : 2 * shared] = np.eye(shared)
        for j in range(self.joints):
            start = 2 * shared + separate * j
            mixing[j, 1 + shared : 1 + count, start : start + separate] = np.eye(separate)
        return mixing


def fourier_trajectory(
    *, offset: npt.ArrayLike, sine: npt.ArrayLike, cosine: npt.ArrayLike, period: float
) -> Trajectory:
    """The trajectory of a FreeSeries with these offsets (n,) and sines and cosines (n, H) of harmonics 1 .. H.

    Raises InputError when the shapes do not fit or the period is not positive.
    """
    offsets, sines, cosines = (np.asarray(values, dtype=float) for values in (offset, sine, cosine))
    if sines.ndim != 2 or sines.shape != cosines.shape or sines.shape[:1] != offsets.shape:
        raise InputError(
            what=f"shapes (n,), (n, H), (n, H) were expected, and {offsets.shape}, {sines.shape}, {cosines.shape} came",
            where="fourier_trajectory",
            remedy="give offset, sine and cosine of each joint",
        )
    series = FreeSeries(joints=len(offsets), harmonics=tuple(range(1, sines.shape[1] + 1)), period=period)
    return Trajectory(series, np.hstack([offsets[:, None], sines, cosines]).ravel())


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
