"""Savitzky-Golay filter: value, rate and acceleration in the middle of a moving window (Savitzky and Golay, 1964)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import count
from typing import Self

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq

from modeling.errors import InputError

Array = NDArray[np.float64]

DERIVATIVE_COUNT = 3
"""Value, rate and acceleration."""
POLYNOMIAL_DEGREE = 4
"""The acceleration of a quartic is a parabola, which follows the peaks of a motion; a parabola's is constant."""
FREQUENCIES_PER_LOBE = 8
"""Frequencies per lobe of the frequency response, so that its first -3 dB crossing is not missed."""


@dataclass(frozen=True, kw_only=True)
class LocalPolynomial:
    """The polynomial that fits a window of samples best by least squares (Savitzky-Golay).

    Its value and derivatives in the middle are `kernels` times the 2 `half` + 1 samples. `of_delay` and `of_bandwidth`
    give the longest window for a delay or a bandwidth.

    Parameters
    ----------
    half : int
        Samples on either side of the middle one.
    dt : float
        Sampling interval, s.
    degree : int, optional
        Degree of the polynomial, by default 4.

    Raises
    ------
    InputError
        When the window has too few samples for its polynomial, the degree is below 2, or the step is not positive.

    Notes
    -----
    The kernels are symmetric, so that the phase is linear and the delay `delay` = half dt at every frequency.
    Polynomials up to `degree` are reproduced exactly; by symmetry, value and acceleration are exact for the next odd
    power too, the rate for the next even one.

    Examples
    --------
    >>> import truewrench as tw
    >>> window = tw.LocalPolynomial.of_delay(0.05, dt=0.01)
    >>> window.samples, window.kernels.shape, round(window.bandwidth, 2)
    (11, (3, 11), 16.17)
    >>> value, rate, acceleration = window.kernels @ [(0.01 * i) ** 2 for i in range(11)]  # t², 0.05 s ago
    >>> round(float(value), 4), round(float(rate), 4), round(float(acceleration), 4)
    (0.0025, 0.1, 2.0)
    """

    half: int
    dt: float
    degree: int = POLYNOMIAL_DEGREE

    def __post_init__(self) -> None:
        least = self.degree // 2
        _require(self.degree >= 2, f"degree {self.degree} has no acceleration", "give a degree of at least 2")
        _require(self.dt > 0, f"a step of {self.dt:g} s", "give a positive step")
        samples = f"{2 * self.half + 1} samples do not determine a polynomial of degree {self.degree}"
        _require(2 * self.half + 1 > self.degree, samples, f"wait {(least + self.degree % 2) * self.dt:g} s at least")

    @classmethod
    def of_delay(cls, delay: float, *, dt: float, degree: int = POLYNOMIAL_DEGREE) -> Self:
        """The longest window with a delay of at most `delay` (s)."""
        return cls(half=int(np.floor(delay / dt * (1 + 1e-9))), dt=dt, degree=degree)  # 1e-9: rounding of the ratio

    @classmethod
    def of_bandwidth(cls, frequency: float, *, dt: float, degree: int = POLYNOMIAL_DEGREE) -> Self:
        """The longest window that passes `frequency` (Hz) with at least 1/sqrt(2) of its amplitude.

        Raises InputError for a frequency beyond half the sample rate, or not positive.
        """
        possible = 0 < frequency <= 0.5 / dt
        _require(possible, f"a bandwidth of {frequency:g} Hz", f"give one up to half the sample rate, {0.5 / dt:g} Hz")
        shortest = (degree + 1) // 2
        too_long = next(n for n in count() if cls(half=shortest + 2**n, dt=dt, degree=degree).bandwidth < frequency)
        low, high = shortest, shortest + 2**too_long
        while high - low > 1:
            middle = (low + high) // 2
            fits = cls(half=middle, dt=dt, degree=degree).bandwidth >= frequency
            low, high = (middle, high) if fits else (low, middle)
        return cls(half=low, dt=dt, degree=degree)

    @property
    def samples(self) -> int:
        """Samples in the window."""
        return 2 * self.half + 1

    @property
    def delay(self) -> float:
        """Delay (s) of the results, at every frequency."""
        return self.half * self.dt

    @cached_property
    def kernels(self) -> Array:
        """Rows (3, samples), oldest sample first, that give value, rate and acceleration (per s, s²).

        In Legendre polynomials of the scaled time, -1 to 1, the fit is well conditioned for any window length.
        """
        place = np.arange(-self.half, self.half + 1) / self.half
        fit = np.linalg.pinv(legendre.legvander(place, self.degree))
        basis = np.eye(self.degree + 1)
        middle = np.stack([legendre.legval(0.0, legendre.legder(basis, order)) for order in range(DERIVATIVE_COUNT)])
        return np.asarray(middle @ fit / np.array([self.delay**order for order in range(DERIVATIVE_COUNT)])[:, None])

    @cached_property
    def norms(self) -> Array:
        """Std of value, rate and acceleration (3,) per std of white noise of the samples."""
        return np.asarray(np.linalg.norm(self.kernels, axis=1))

    def gain(self, frequency: ArrayLike, order: int = 0) -> Array:
        """Gain of the derivative of this order relative to the exact one at frequencies (k,) in Hz; real, 1 at zero.

        For a sine of angular frequency w: sum_i kernel_i exp(j w i dt) / (j w)^order, i = -half .. half.
        """
        w = 2 * np.pi * np.atleast_1d(np.asarray(frequency, dtype=float))
        ticks = np.arange(-self.half, self.half + 1) * self.dt
        wave = np.sin if order % 2 else np.cos
        sums = wave(np.outer(w, ticks)) @ self.kernels[order] * (-1) ** (order // 2)
        return np.asarray(np.divide(sums, w**order, out=np.ones(len(w)), where=w > 0))

    @cached_property
    def bandwidth(self) -> float:
        """The first frequency (Hz) with a gain of 1/sqrt(2) (-3 dB); half the sample rate without one."""
        grid = np.linspace(0.0, 0.5 / self.dt, FREQUENCIES_PER_LOBE * self.samples)
        below = np.flatnonzero(self.gain(grid) < np.sqrt(0.5))
        if not below.size:
            return float(grid[-1])
        return float(brentq(lambda f: self.gain(f)[0] - np.sqrt(0.5), grid[below[0] - 1], grid[below[0]]))


def _require(holds: bool, what: str, remedy: str) -> None:
    if not holds:
        raise InputError(what=what, where="window", remedy=remedy)
