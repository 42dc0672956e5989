"""Averaging: what the mean over repeats of one series is worth, and what stays in it however many there are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from modeling.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Averaging:
    """One series of errors that was taken `runs` times: V1, the runs' mean variance, VR, their average's, about means.

    Derivation. Let a run be s_t + n_t, s the same in every run and n independent from run to run. Then V1 = s² + n²
    and VR = s² + n²/R as variances over time, so that n² = (V1 - VR) R / (R - 1) and s² = VR - n²/R. The latter is the
    mean product of two different runs, in which noise has no mean: it comes out below zero as often as above when s
    is nothing, and is kept so in `square`. `square_variance` is its sampling variance.
    """

    single: float
    average: float
    runs: int
    square_variance: float

    @classmethod
    def of(cls, errors: Array) -> Averaging:
        """From errors (R, N) of R >= 2 runs.

        Lines of a Fourier transform are independent whatever the noise's colour. With P_k the noise's power of a run at
        line k and A_k the average's line, s² = sum_k w_k (|A_k|² - P_k/R) varies by sum_k w_k² (P_k²/(R(R-1))
        + 2 |s_k|² P_k/R), the second part by noise that meets the remainder. P_k, from the runs' differences, has
        R - 1 degrees of freedom, hence P_k² R/(R-1) for the mean of its square, and for |s_k|² P_k the unbiased
        |A_k|² P_k - P_k² (R-1)/R².
        """
        runs, n = errors.shape
        inner = errors - errors.mean(axis=1, keepdims=True)
        lines = np.fft.rfft(inner, axis=1)[:, 1:] / n
        mean = lines.mean(axis=0)
        power = (np.abs(lines - mean) ** 2).sum(axis=0) / (runs - 1)
        # Lines stand for themselves and their mirror images; the last one of an even number has none, and one part.
        last = np.arange(1, len(power) + 1) * 2 == n
        weight, parts = np.where(last, 1.0, 2.0), np.where(last, 2.0, 1.0)
        alone = float(np.sum(weight**2 * parts * (power / runs) ** 2))
        both = np.abs(mean) ** 2 * power - power**2 * (runs - 1) / runs**2
        met = float(np.sum(weight**2 * parts * 2 * both / runs))
        single, average = float((inner**2).mean()), float((inner.mean(axis=0) ** 2).mean())
        return cls(single, average, runs, alone + max(met, 0.0))

    @classmethod
    def printed(cls, single: float, average: float, runs: int, *, samples: int) -> Averaging:
        """From the two variances alone, for white noise in `samples` independent samples of a run.

        Raises InputError for variances that no runs have: one run quieter than the average of several.
        """
        if not (runs >= 2 and single >= average > 0):
            raise InputError(
                what=f"{runs} runs of variance {single:g} do not have an average of variance {average:g}",
                where="Averaging.printed",
                remedy="give the mean variance of single runs, that of their average, and at least two runs",
            )
        noise = (single - average) * runs / (runs - 1)
        square = max(average - noise / runs, 0.0)
        variance = (2 * noise**2 / (runs * (runs - 1)) + 4 * square * noise / runs) / samples
        return cls(single, average, runs, variance)

    @property
    def noise(self) -> float:
        """Std of what differs from run to run, in one sample."""
        # Rounding leaves less than nothing of runs that are all the same.
        return float(np.sqrt(max(self.single - self.average, 0.0) * self.runs / (self.runs - 1)))

    @property
    def square(self) -> float:
        """The remainder's mean square as estimated; below zero by chance when there is none."""
        return self.average - self.noise**2 / self.runs

    @property
    def remainder(self) -> float:
        """RMS of what every run has in the same way, zero when the estimate of its square is not above."""
        return float(np.sqrt(max(self.square, 0.0)))

    @property
    def remainder_std(self) -> float:
        """Standard error of `remainder`; where that is small, of the root of the square's own error."""
        spread = float(np.sqrt(self.square_variance))
        return float(spread / (2 * max(self.remainder, np.sqrt(spread) / 2, 1e-300)))

    def interval(self, level: float = 0.95) -> tuple[float, float]:
        """Ends of the remainder's interval: roots of the square's, clipped at zero, which the lower end may be."""
        reach = float(norm.ppf(0.5 + level / 2)) * float(np.sqrt(self.square_variance))
        low, high = (float(np.sqrt(max(end, 0.0))) for end in (self.square - reach, self.square + reach))
        return low, high

    @property
    def gain(self) -> float:
        """V1 / VR, what averaging really brought; infinite when nothing is left, 1 when all runs are the same."""
        return self.single / self.average if self.average > 0 else float("inf" if self.single > 0 else 1.0)
