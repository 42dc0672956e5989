"""TrajectorySeries, a trajectory parametrisation linear in its coefficients; Trajectory, one member of it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.sparse.csgraph import connected_components

from modeling.errors import InputError

Array = npt.NDArray[np.float64]


class TrajectorySeries(ABC):
    """A trajectory parametrisation q_j(t) = sum_w f_w(t) sum_k mixing_jwk z_k of n joints, by k coefficients z.

    The basis functions f_w are shared by the joints; `mixing` holds the share of each in each joint by coefficient.
    Both together are the basis B of q(t) = B(t) z, and every time derivative is linear in z too.
    """

    joints: int
    """The number of joints, n."""

    @property
    @abstractmethod
    def duration(self) -> float:
        """Duration of a trajectory, s; the period of a periodic one."""

    @property
    def periodic(self) -> bool:
        """Whether the trajectory continues periodically, without rest, after its duration."""
        return True

    @cached_property
    @abstractmethod
    def mixing(self) -> Array:
        """(n, W, k): the share of each function in each joint, by coefficient."""

    @property
    @abstractmethod
    def unity(self) -> Array:
        """(W,): the multiples of the functions that add up to the constant one."""

    @property
    def smoothness(self) -> float:
        """Order of the highest derivative that is finite everywhere: infinity where all are."""
        return np.inf

    @property
    def adjustable(self) -> npt.NDArray[np.bool_]:
        """(k,): the coefficients that a design chooses; the others are as `rest` has them."""
        return np.ones(self.size, dtype=bool)

    @property
    def breaks(self) -> Array:
        """Increasing instants from 0 to the duration, s, between which the functions are smooth."""
        return np.array([0.0, self.duration])

    @abstractmethod
    def functions(self, time: Array, order: int) -> Array:
        """(N, W): the derivatives of that order of the functions at the times (N,) in s."""

    @abstractmethod
    def enclosure(self, coefficients: Array, order: int) -> tuple[Array, Array]:
        """Bounds low (n,) and high (n,) of the derivative of that order at every instant, not only on a grid.

        Valid but for rounding, and wider than the range by at most 1e-4 of the half range.
        """

    @property
    def size(self) -> int:
        """The number of coefficients, k."""
        return int(self.mixing.shape[2])

    def basis(self, time: npt.ArrayLike, order: int) -> Array:
        """(N, n, k): the derivative of that order of q by each coefficient, at the times (N,) in s."""
        return np.tensordot(self.functions(np.asarray(time, dtype=float), order), self.mixing, axes=(1, 1))

    def evaluate(self, coefficients: Array, time: npt.ArrayLike, order: int) -> Array:
        """(N, n): the derivative of that order of q, without forming the whole basis."""
        return self.functions(np.asarray(time, dtype=float), order) @ (self.mixing @ coefficients).T

    def instants(self, samples: int) -> Array:
        """The sampling instants (N,), s: j T / N of a periodic series, else from the start to the end."""
        return np.linspace(0.0, self.duration, samples, endpoint=not self.periodic)

    def rest(self, posture: npt.ArrayLike) -> Array:
        """The coefficients (k,) of a static posture (n,), or of the nearest one that the series contains.

        mixing z = posture x unity in the sense of least squares: a series without an offset is static at zero only.
        """
        target = np.multiply.outer(np.asarray(posture, dtype=float), self.unity)
        solution = np.linalg.lstsq(self.mixing.reshape(target.size, -1), target.ravel(), rcond=None)[0]
        return np.asarray(solution, dtype=float)

    def by_coefficient(self, factors: Array) -> Array:
        """(k,): for each coefficient the least of the factors (n,) of all joints that it moves, directly or by joints
        that share coefficients: scaled by it, each joint of a motion is scaled as a whole.
        """
        owners = (self.mixing != 0).any(axis=1).astype(int)
        _, group = connected_components(owners @ owners.T)
        together = np.array([factors[group == g].min() for g in group])
        return np.asarray(together[owners.argmax(axis=0)], dtype=float)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A trajectory of a series, by its coefficients.

    Parameters
    ----------
    series : TrajectorySeries
        Its parametrisation.
    coefficients : array (k,)
        In the coordinate's unit (rad for a revolute joint).

    Raises
    ------
    InputError
        When the number of coefficients is not the series'.

    Examples
    --------
    >>> import truewrench as tw
    >>> motion = tw.Trajectory(tw.PaperSeries(period=5.0), [0.1] * 15)
    >>> motion.joints, motion.period
    (3, 5.0)
    """

    series: TrajectorySeries
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
        """Duration before the trajectory may be repeated, s."""
        return self.series.duration

    def evaluate(self, time: npt.ArrayLike) -> tuple[Array, Array, Array]:
        """q, dq, ddq, each (N, n), at the times (N,) in s."""
        return self.derivative(time, 0), self.derivative(time, 1), self.derivative(time, 2)

    def derivative(self, time: npt.ArrayLike, order: int) -> Array:
        """(N, n): the derivative of that order of q, at the times (N,) in s."""
        return self.series.evaluate(self.coefficients, time, order)

    def to_columns(self, samples: int) -> dict[str, Array]:
        """The columns of PLAN.csv (FORMATS): time, q1.., dq1.., ddq1.., each (N,), at the sampling instants."""
        columns = {"time": self.series.instants(samples)}
        for prefix, values in zip(("q", "dq", "ddq"), self.evaluate(columns["time"]), strict=True):
            columns |= {f"{prefix}{j + 1}": column for j, column in enumerate(values.T)}
        return columns

    def enclosure(self, order: int) -> tuple[Array, Array]:
        """Bounds low (n,) and high (n,) of the derivative of that order, at every instant."""
        return self.series.enclosure(self.coefficients, order)

    def projected(self, series: TrajectorySeries) -> Trajectory:
        """The nearest trajectory of another series, by least squares of q and dq period / (2 pi) over time.

        Raises InputError when it is of other joints.
        """
        if series.joints != self.joints:
            what = f"a series of {self.joints} joints was expected, and of {series.joints} came"
            raise InputError(what=what, where="projection", remedy="give a series with as many joints as the arm")
        return _nearest(series, lambda time, order: self.derivative(np.minimum(time, self.period), order))

    def odd(self) -> Trajectory:
        """The nearest trajectory of the series that is odd in time, q(T - t) - p = -(q(t) - p), about its mean
        posture p: the second half is the first one reversed and mirrored.
        """
        posture = self.derivative(self.series.instants(4 * self.series.mixing.shape[1]), 0).mean(axis=0)

        def values(time: Array, order: int) -> Array:
            reversed_ = (-1) ** order * self.derivative(self.period - time, order)
            return np.asarray((self.derivative(time, order) - reversed_) / 2 + (posture if order == 0 else 0.0))

        return _nearest(self.series, values)

    def scaled(self, factor: npt.ArrayLike) -> Trajectory:
        """The trajectory with its coefficients times a factor, or times one factor each (k,)."""
        return replace(self, coefficients=self.coefficients * np.asarray(factor, dtype=float))


def _nearest(series: TrajectorySeries, values: Callable[[Array, int], Array]) -> Trajectory:
    """The trajectory of a series nearest to q and dq, given as `values` (N, n) of times (N,) and order."""
    time = series.instants(4 * series.mixing.shape[1])
    basis, target = [], []
    for order in (0, 1):
        scale = (series.duration / (2 * np.pi)) ** order
        basis.append(scale * series.basis(time, order).reshape(-1, series.size))
        target.append(scale * values(time, order).ravel())
    chosen, matrix, solution = series.adjustable, np.vstack(basis), np.zeros(series.size)
    if not chosen.all():
        solution = np.where(chosen, 0.0, series.rest(np.zeros(series.joints)))
    left = np.concatenate(target) - matrix @ solution
    solution[chosen] = np.linalg.lstsq(matrix[:, chosen], left, rcond=None)[0]
    return Trajectory(series, solution)


def require_positive_duration(value: float, *, name: str, where: str) -> None:
    """InputError unless the duration `value` is a positive number of seconds."""
    if not (np.isfinite(value) and value > 0):
        what = f"a positive {name} in s was expected, and {value} came"
        raise InputError(what=what, where=where, remedy=f"give the {name} in s")


# Guaranteed bounds of a function between grid points, from a bound on its second derivative.


TIGHTNESS = 2e-5
"""Target margin as a share of the half range: five times tighter than `TrajectorySeries.enclosure` guarantees."""
COARSE_POINTS = 32
"""Points between two breaks of the coarse grid, which only determines the spacing of the fine one."""
MOST_POINTS = 100_000
"""Points of the finest grid, so that a nearly constant function takes a tenth of a second at most."""


PIECE_INSET = 1e-12
"""Inset of a piece's first and last point, as a share of the duration, so that they are on its side of a jump."""


def grid_bound(
    values: Callable[[Array], Array], second: Array, breaks: Array, margin: Array | None = None
) -> tuple[Array, Array]:
    """Bounds low (n,) and high (n,) of functions `values` (time (N,) to (N, n)) between the first and the last break.

    Between two points h apart a function differs from its chord by at most h²/8 times the largest absolute value of
    its second derivative there (the error of linear interpolation), and the chord stays between its ends. `second`
    (P, n) bounds that derivative in each of the P pieces between the breaks (P + 1,), where the functions and their
    derivatives may jump; the grid is as fine in each piece as makes this at most `margin` (n,), `TIGHTNESS` of the
    half range unless given.
    """
    if margin is None:
        coarse = values(_grid(breaks, np.full(len(second), COARSE_POINTS)))
        margin = TIGHTNESS * (coarse.max(axis=0) - coarse.min(axis=0)) / 2
    squared = np.divide(8 * margin, second, out=np.full(second.shape, np.inf), where=second > 0)
    steps = np.maximum(np.sqrt(squared.min(axis=1)), (breaks[-1] - breaks[0]) / MOST_POINTS)
    counts = np.maximum(np.ceil(np.diff(breaks) / steps), 1).astype(int)
    excess = np.repeat((np.diff(breaks) / counts)[:, None] ** 2 / 8 * second, counts + 1, axis=0)
    inside, at_breaks = values(_grid(breaks, counts)), values(breaks)
    low, high = np.vstack([inside - excess, at_breaks]), np.vstack([inside + excess, at_breaks])
    return low.min(axis=0), high.max(axis=0)


def _grid(breaks: Array, counts: Array) -> Array:
    """Times that divide each piece between breaks into a number of equal parts, its ends included."""
    inside = PIECE_INSET * (breaks[-1] - breaks[0])
    pieces = zip(breaks[:-1] + inside, breaks[1:] - inside, counts + 1, strict=True)
    return np.concatenate([np.linspace(first, last, count) for first, last, count in pieces])
