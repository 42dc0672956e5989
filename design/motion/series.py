"""Series: a family of joint motions, linear in its coefficients; Motion: one of its members."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from modeling.errors import InputError

Array = npt.NDArray[np.float64]


class Series(ABC):
    """A family of motions q_j(t) = sum_w f_w(t) sum_k mixing_jwk z_k of n joints, by k coefficients z.

    The functions of time f_w are shared by the joints; `mixing` says which coefficient gives how much of each to
    which joint. Both together are the basis B of q(t) = B(t) z, and every derivative by time is linear in z too.
    """

    joints: int
    """The number of joints, n."""

    @property
    @abstractmethod
    def duration(self) -> float:
        """How long a motion takes, s; the period of a periodic one."""

    @property
    def periodic(self) -> bool:
        """Whether the motion goes on without a rest after its duration."""
        return True

    @cached_property
    @abstractmethod
    def mixing(self) -> Array:
        """(n, W, k): how much of each function each coefficient gives to each joint."""

    @property
    @abstractmethod
    def unity(self) -> Array:
        """(W,): the multiples of the functions that add up to the constant one."""

    @property
    def smoothness(self) -> float:
        """The highest derivative that is finite everywhere: infinity where all are."""
        return np.inf

    @property
    def breaks(self) -> Array:
        """Increasing instants from 0 to the duration, s, between which the functions are smooth."""
        return np.array([0.0, self.duration])

    @abstractmethod
    def functions(self, time: Array, order: int) -> Array:
        """(N, W): the derivatives of that order of the functions at the times (N,) in s."""

    @abstractmethod
    def enclosure(self, coefficients: Array, order: int) -> tuple[Array, Array]:
        """Bounds low (n,) and high (n,) that the derivative of that order keeps at every instant, not only on a grid.

        True but for rounding, and wider than what is reached by at most 1e-4 of the half range.
        """

    @property
    def size(self) -> int:
        """The number of coefficients, k."""
        return int(self.mixing.shape[2])

    def basis(self, time: npt.ArrayLike, order: int) -> Array:
        """(N, n, k): the derivative of that order of q by each coefficient, at the times (N,) in s."""
        return np.tensordot(self.functions(np.asarray(time, dtype=float), order), self.mixing, axes=(1, 1))

    def evaluate(self, coefficients: Array, time: npt.ArrayLike, order: int) -> Array:
        """(N, n): the derivative of that order of q, without making the whole basis."""
        return self.functions(np.asarray(time, dtype=float), order) @ (self.mixing @ coefficients).T

    def instants(self, samples: int) -> Array:
        """The sampling instants (N,), s: j T / N of a periodic series, else from the start to the end."""
        return np.linspace(0.0, self.duration, samples, endpoint=not self.periodic)

    def rest(self, posture: npt.ArrayLike) -> Array:
        """The coefficients (k,) of standing still at a posture (n,), or as near to it as the series can stand still.

        mixing z = posture x unity in the sense of least squares: a series without an offset stands still at zero.
        """
        target = np.multiply.outer(np.asarray(posture, dtype=float), self.unity)
        solution = np.linalg.lstsq(self.mixing.reshape(target.size, -1), target.ravel(), rcond=None)[0]
        return np.asarray(solution, dtype=float)


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion of a series: its coefficients (k,), in the coordinate's unit (rad for a joint).

    Raises InputError when the number of coefficients is not the series'.
    """

    series: Series
    coefficients: Array

    def __post_init__(self) -> None:
        coefficients = np.array(self.coefficients, dtype=float)
        if coefficients.shape != (self.series.size,):
            raise InputError(
                what=f"{self.series.size} coefficients were expected, and an array of shape {coefficients.shape} came",
                where=type(self.series).__name__,
                remedy="give as many coefficients as the series has",
            )
        coefficients.flags.writeable = False
        object.__setattr__(self, "coefficients", coefficients)

    @property
    def joints(self) -> int:
        """The number of joints, n."""
        return self.series.joints

    @property
    def period(self) -> float:
        """How long the motion takes before it may be repeated, s."""
        return self.series.duration

    def evaluate(self, time: npt.ArrayLike) -> tuple[Array, Array, Array]:
        """q, dq, ddq, each (N, n), at the times (N,) in s."""
        return self.derivative(time, 0), self.derivative(time, 1), self.derivative(time, 2)

    def derivative(self, time: npt.ArrayLike, order: int) -> Array:
        """(N, n): the derivative of that order of q, at the times (N,) in s."""
        return self.series.evaluate(self.coefficients, time, order)

    def trajectory(self, samples: int) -> dict[str, Array]:
        """The columns of PLAN.csv (FORMATS): time, q1.., dq1.., ddq1.., each (N,), at the sampling instants."""
        columns = {"time": self.series.instants(samples)}
        for prefix, values in zip(("q", "dq", "ddq"), self.evaluate(columns["time"]), strict=True):
            columns |= {f"{prefix}{j + 1}": column for j, column in enumerate(values.T)}
        return columns

    def enclosure(self, order: int) -> tuple[Array, Array]:
        """Bounds low (n,) and high (n,) of the derivative of that order, at every instant."""
        return self.series.enclosure(self.coefficients, order)

    def projected(self, series: Series) -> Motion:
        """The nearest motion of another series, by least squares of position and velocity (in period / 2 pi) over time.

        Raises InputError when it is of other joints.
        """
        if series.joints != self.joints:
            what = f"a series of {self.joints} joints was expected, and of {series.joints} came"
            raise InputError(what=what, where="projection", remedy="give a series of the same arm")
        return _nearest(series, lambda time, order: self.derivative(np.minimum(time, self.period), order))

    def odd(self) -> Motion:
        """The nearest motion of the series whose second half is its first one backwards and mirrored: the part of it
        that is odd in time, q(T - t) - p = -(q(t) - p), about its mean posture p.
        """
        posture = self.derivative(self.series.instants(4 * self.series.mixing.shape[1]), 0).mean(axis=0)

        def values(time: Array, order: int) -> Array:
            back = (-1) ** order * self.derivative(self.period - time, order)
            return np.asarray((self.derivative(time, order) - back) / 2 + (posture if order == 0 else 0.0))

        return _nearest(self.series, values)

    def scaled(self, factor: npt.ArrayLike) -> Motion:
        """The motion with its coefficients times a factor, or times one factor each (k,)."""
        return replace(self, coefficients=self.coefficients * np.asarray(factor, dtype=float))


def _nearest(series: Series, values: Callable[[Array, int], Array]) -> Motion:
    """The motion of a series nearest to q and dq, `values` of times (N,) and of the order: (N, n)."""
    time = series.instants(4 * series.mixing.shape[1])
    basis, target = [], []
    for order in (0, 1):
        scale = (series.duration / (2 * np.pi)) ** order
        basis.append(scale * series.basis(time, order).reshape(-1, series.size))
        target.append(scale * values(time, order).ravel())
    solution = np.linalg.lstsq(np.vstack(basis), np.concatenate(target), rcond=None)[0]
    return Motion(series, solution)


def positive(value: float, *, name: str, where: str) -> None:
    """InputError unless the duration `value` is a positive number of seconds."""
    if not (np.isfinite(value) and value > 0):
        what = f"a positive {name} in s was expected, and {value} came"
        raise InputError(what=what, where=where, remedy=f"give the {name} in s")
