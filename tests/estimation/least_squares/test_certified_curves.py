"""Levenberg-Marquardt on the certified nonlinear data of NIST's StRD: all 27 sets, from both starts."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from estimation.least_squares.levenberg_marquardt import LeastSquaresMinimum, levenberg_marquardt
from estimation.least_squares.square_root_information import SquareRootInformation
from tests.shared.places import NIST

Array = NDArray[np.float64]
Numbers = NDArray[Any]
"""In extended precision (19 digits, where the processor has it), or in double."""

NONLINEAR = tomllib.loads((NIST / "nonlinear.toml").read_text(encoding="utf-8"), parse_float=np.longdouble)
Curve = Callable[[Numbers, Numbers], Numbers]


def _lanczos(b: Numbers, x: Numbers) -> Numbers:
    return np.asarray(sum(b[i] * np.exp(-b[i + 1] * x) for i in (0, 2, 4)))


def _gauss(b: Numbers, x: Numbers) -> Numbers:
    peaks = (b[i] * np.exp(-(((x - b[i + 1]) / b[i + 2]) ** 2)) for i in (2, 5))
    return np.asarray(b[0] * np.exp(-b[1] * x) + sum(peaks))


def _chwirut(b: Numbers, x: Numbers) -> Numbers:
    return np.asarray(np.exp(-b[0] * x) / (b[1] + b[2] * x))


def _rational(b: Numbers, x: Numbers) -> Numbers:
    """Polynomials of one degree, the lower one beginning with 1."""
    degree = len(b) // 2
    return np.asarray(np.polyval(b[degree::-1], x) / (1 + x * np.polyval(b[:degree:-1], x)))


def _enso(b: Numbers, x: Numbers) -> Numbers:
    turns = [2 * np.pi * x / period for period in (12, b[3], b[6])]
    parts = [b[i] * np.cos(t) + b[i + 1] * np.sin(t) for i, t in zip((1, 4, 7), turns, strict=True)]
    return np.asarray(b[0] + sum(parts))


CURVES: Mapping[str, Curve] = {
    "misra1a": lambda b, x: b[0] * (1 - np.exp(-b[1] * x)),
    "misra1b": lambda b, x: b[0] * (1 - (1 + b[1] * x / 2) ** -2),
    "misra1c": lambda b, x: b[0] * (1 - (1 + 2 * b[1] * x) ** -0.5),
    "misra1d": lambda b, x: b[0] * b[1] * x / (1 + b[1] * x),
    "danwood": lambda b, x: b[0] * x ** b[1],
    "boxbod": lambda b, x: b[0] * (1 - np.exp(-b[1] * x)),
    "chwirut1": _chwirut,
    "chwirut2": _chwirut,
    "eckerle4": lambda b, x: b[0] / b[1] * np.exp(-(((x - b[2]) / b[1]) ** 2) / 2),
    "enso": _enso,
    "gauss1": _gauss,
    "gauss2": _gauss,
    "gauss3": _gauss,
    "nelson": lambda b, x: b[0] - b[1] * x[0] * np.exp(-b[2] * x[1]),  # the logarithm of y
    "kirby2": _rational,
    "hahn1": _rational,
    "lanczos1": _lanczos,
    "lanczos2": _lanczos,
    "lanczos3": _lanczos,
    "mgh09": lambda b, x: b[0] * (x**2 + x * b[1]) / (x**2 + x * b[2] + b[3]),
    "mgh10": lambda b, x: b[0] * np.exp(b[1] / (x + b[2])),
    "mgh17": lambda b, x: b[0] + b[1] * np.exp(-x * b[3]) + b[2] * np.exp(-x * b[4]),
    "rat42": lambda b, x: b[0] / (1 + np.exp(b[1] - b[2] * x)),
    "rat43": lambda b, x: b[0] / (1 + np.exp(b[1] - b[2] * x)) ** (1 / b[3]),
    "roszman1": lambda b, x: b[0] - b[1] * x - np.arctan(b[2] / (x - b[3])) / np.pi,
    "thurber": _rational,
    "bennett5": lambda b, x: b[0] * (b[1] + x) ** (-1 / b[2]),
}
FINE = 1e-5
"""Of the residual: a noise with which a hundredth of a std, where a fit has converged, is the sixth digit or less."""
SETTLED = 1e-3
"""Of chi-square, above the certified minimum: ten times what the last step may gain, for steps that follow it."""
NOT_CONVERGED = {
    *(("boxbod", 0), ("eckerle4", 0), ("mgh09", 0), ("mgh10", 0), ("mgh17", 0)),
    *(("lanczos1", 0), ("lanczos2", 0), ("lanczos3", 0), ("mgh10", 1), ("bennett5", 0), ("bennett5", 1), ("nelson", 0)),
}
"""Set and start from which a fit says that it has not arrived, or what is not identifiable. From the first five no step
leads to the minimum (they end where the curve is flat in a parameter); the others are on their way after the 40 steps
of a fit: 56 (MGH10) to 88 (Lanczos1) arrive, of Bennett5's valley 1000 do not."""


@dataclass(frozen=True, eq=False)
class Reference:
    """A certified data set: x (n,) or (2, n), y (n,), two starts (2, k), estimate and std (k,), size of the residual.

    In extended precision, as the residual of Lanczos1 is 1e-13 of its data.
    """

    curve: Curve
    x: Numbers
    y: Numbers
    starts: Numbers
    estimate: Numbers
    std: Numbers
    noise: Any

    @classmethod
    def of(cls, name: str) -> Reference:
        facts = NONLINEAR[name]
        x, y, starts, estimate, std = (
            np.array(facts[key], dtype=np.longdouble) for key in ("x", "y", "starts", "estimate", "std")
        )
        noise = np.sqrt(facts["sum_of_squares"] / (len(y) - len(estimate)))
        return cls(CURVES[name], x, np.log(y) if name == "nelson" else y, starts, estimate, std, noise)

    @property
    def freedom(self) -> int:
        return len(self.y) - len(self.estimate)

    def rounding(self, precision: type[np.floating[Any]]) -> float:
        """What rounding of the data changes the chi-square by, at most, relative to it."""
        return float(2 * np.finfo(precision).eps * np.abs(self.y).max() / self.noise)

    def jacobian(self, b: Numbers) -> Numbers:
        """Columns (n, k) at b (k,) by a complex step, exact to rounding, in the precision of b."""
        step, x = b.dtype.type(1e-30), self.x.astype(b.dtype)
        return np.column_stack(
            [self.curve(b + 1j * step * one, x).imag / step for one in np.eye(len(b), dtype=b.dtype)]
        )


def refitted(known: Reference, start: int, share: float) -> LeastSquaresMinimum:
    """The minimum from one of the two starts, in double precision, with a noise of this share of the residual.

    Steps without gain are tried by the chi-square alone.
    """
    x, y, begin = (np.asarray(values, dtype=np.float64) for values in (known.x, known.y, known.starts[start]))
    noise = share * float(known.noise)

    def residual(b: Array) -> Array:
        return np.asarray((y - known.curve(b, x)) / noise)

    def information(b: Array) -> SquareRootInformation:
        columns = known.jacobian(b)
        if not np.isfinite(columns).all():
            raise np.linalg.LinAlgError("no prediction")
        return SquareRootInformation.of(columns / noise, residual(b))

    def chi_square(b: Array) -> float:
        return float(residual(b) @ residual(b))

    free = np.full(len(begin), np.inf)
    with np.errstate(all="ignore"):  # what overflows has no prediction
        return levenberg_marquardt(information, begin, (-free, free), chi_square=chi_square)


def agrees(values: Numbers, certified: Numbers, relative: float) -> None:
    np.testing.assert_allclose(values.astype(np.float64), certified.astype(np.float64), rtol=relative)


def test_all_sets_are_there() -> None:
    assert len(NONLINEAR) == 27
    assert set(NONLINEAR) == set(CURVES)


@pytest.mark.parametrize("name", CURVES)
def test_certified_minimum_is_that_of_the_data_typed_in(name: str) -> None:
    """A Gauss-Newton step from the certified estimate, of eleven digits, moves ten of them nowhere; std; chi-square.

    Std follow the last digit of the estimate: nine.
    """
    known = Reference.of(name)
    columns, residual = known.jacobian(known.estimate), known.y - known.curve(known.estimate, known.x)
    lengths, size = np.linalg.norm(columns.astype(np.float64), axis=0), np.abs(residual).max()
    orthonormal, triangle = np.linalg.qr((columns / lengths).astype(np.float64))
    step = np.linalg.solve(triangle, orthonormal.T @ (residual / size).astype(np.float64)) * size / lengths
    agrees(known.estimate + step, known.estimate, 3e-10)
    agrees(known.noise * np.linalg.norm(np.linalg.inv(triangle), axis=1) / lengths, known.std, 1e-9)
    left = (known.y - known.curve(known.estimate + step, known.x)) / known.noise
    assert float(left @ left) == pytest.approx(known.freedom, rel=3e-10 + known.rounding(np.longdouble))


@pytest.mark.parametrize("start", [0, 1])
@pytest.mark.parametrize("name", CURVES)
def test_a_fit_has_converged_only_where_it_has(name: str, start: int) -> None:
    """Six digits, of the std four, or it says that it has not converged or what is not identifiable.

    Eckerle's first start, where the peak is outside the data, once ended at 340 times the least sum of squares.
    """
    known = Reference.of(name)
    for share in (1.0, FINE):
        minimum = refitted(known, start, share)
        arrived = minimum.converged and bool(minimum.identifiable.all())
        if arrived and share == 1.0:
            assert minimum.cost < known.freedom * (1 + known.rounding(np.float64)) + SETTLED
        elif arrived:
            agrees(minimum.theta, known.estimate, 1e-6)
            agrees(np.sqrt(np.diag(minimum.covariance)) / share, known.std, 1e-4)
        if share == 1.0:
            assert arrived == ((name, start) not in NOT_CONVERGED)
