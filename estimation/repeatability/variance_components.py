"""Systematic and random part of repeated errors, from the variance of runs and of their average."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.distributions import normal_isf
from modeling.errors import InputError
from modeling.significance import LEVELS

Array = NDArray[np.float64]


@dataclass(frozen=True)
class VarianceComponents:
    """One series of errors in `runs` repeats: V1, the runs' mean variance, and VR, their average's, about the means.

    Derivation. Let a run be s_t + n_t, the systematic s the same in every run and the random n independent from run to
    run. Then V1 = s² + n² and VR = s² + n²/R as variances over time, so that n² = (V1 - VR) R / (R - 1) and
    s² = VR - n²/R. The latter is the mean product of two different runs, in which noise has mean zero: an unbiased
    estimate (`square`), negative half of the time when s = 0. `square_variance` is its sampling variance.
    """

    single: float
    average: float
    runs: int
    square_variance: float

    @classmethod
    def of(cls, errors: Array) -> VarianceComponents:
        """From errors (R, N) of R >= 2 runs.

        Lines of a Fourier transform are independent whatever the noise's colour. With P_k the noise's power of a run at
        line k and A_k the average's line, s² = sum_k w_k (|A_k|² - P_k/R) varies by sum_k w_k² (P_k²/(R(R-1))
        + 2 |s_k|² P_k/R), the second part from the product of noise and systematic part. P_k, from the runs'
        differences, has R - 1 degrees of freedom, hence P_k² R/(R-1) for the mean of its square, and for |s_k|² P_k the
        unbiased |A_k|² P_k - P_k² (R-1)/R².
        """
        runs, n = errors.shape
        centred = errors - errors.mean(axis=1, keepdims=True)
        lines = np.fft.rfft(centred, axis=1)[:, 1:] / n
        mean = lines.mean(axis=0)
        power = (np.abs(lines - mean) ** 2).sum(axis=0) / (runs - 1)
        # Each line counts for its conjugate too; the Nyquist line has none, and only a real part.
        nyquist = np.arange(1, len(power) + 1) * 2 == n
        weight, parts = np.where(nyquist, 1.0, 2.0), np.where(nyquist, 2.0, 1.0)
        noise_variance = float(np.sum(weight**2 * parts * (power / runs) ** 2))
        product = np.abs(mean) ** 2 * power - power**2 * (runs - 1) / runs**2
        cross_variance = float(np.sum(weight**2 * parts * 2 * product / runs))
        single, average = float((centred**2).mean()), float((centred.mean(axis=0) ** 2).mean())
        return cls(single, average, runs, noise_variance + max(cross_variance, 0.0))

    @classmethod
    def printed(cls, single: float, average: float, runs: int, *, samples: int) -> VarianceComponents:
        """From the two variances alone, for white noise in `samples` independent samples of a run.

        Raises InputError for impossible variances: a run's below that of the average of several.
        """
        if not (runs >= 2 and single >= average > 0):
            raise InputError(
                what=f"{runs} runs of variance {single:g} do not have an average of variance {average:g}",
                where="VarianceComponents.printed",
                remedy="give the mean variance of single runs, that of their average, and at least two runs",
            )
        noise = (single - average) * runs / (runs - 1)
        square = max(average - noise / runs, 0.0)
        variance = (2 * noise**2 / (runs * (runs - 1)) + 4 * square * noise / runs) / samples
        return cls(single, average, runs, variance)

    @property
    def noise(self) -> float:
        """Std of the random part, per sample."""
        # Rounding can make the difference negative for identical runs.
        return float(np.sqrt(max(self.single - self.average, 0.0) * self.runs / (self.runs - 1)))

    @property
    def square(self) -> float:
        """Unbiased estimate of the systematic part's mean square; it can be negative."""
        return self.average - self.noise**2 / self.runs

    @property
    def remainder(self) -> float:
        """RMS of the systematic part; zero where the estimate of its square is not positive."""
        return float(np.sqrt(max(self.square, 0.0)))

    @property
    def remainder_std(self) -> float:
        """Standard error of `remainder` by the delta method, limited where `remainder` is small."""
        spread = float(np.sqrt(self.square_variance))
        return float(spread / (2 * max(self.remainder, np.sqrt(spread) / 2, 1e-300)))

    def interval(self, level: float = LEVELS.confidence) -> tuple[float, float]:
        """Confidence interval of the systematic RMS: square roots of the interval of `square`, clipped at zero."""
        half_width = float(normal_isf(0.5 - level / 2)) * float(np.sqrt(self.square_variance))
        low, high = (float(np.sqrt(max(end, 0.0))) for end in (self.square - half_width, self.square + half_width))
        return low, high

    @property
    def gain(self) -> float:
        """V1 / VR, the variance reduction by averaging; infinite for VR = 0, 1 when all runs are identical."""
        return self.single / self.average if self.average > 0 else float("inf" if self.single > 0 else 1.0)
