"""ErrorRow: the errors of one series in every run of a motion, and what averaging the runs is worth to it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.noise import Noise
from estimation.recording import Recording
from estimation.repeats.averaging import Averaging
from estimation.spectrum import Spectrum

Array = NDArray[np.float64]

FINE = 4
"""Times the record's own lines over which a spectrum is turned into covariances, lest its ends meet."""


@dataclass(frozen=True, eq=False)
class ErrorRow:
    """Errors of one series (measured minus predicted) in its `unit`.

    means, variances   (R,) of every run, the variance about the run's own mean
    average_mean       mean of the runs' average
    averaging          what averaging the runs brought, and the remainder it cannot remove
    noise_gain         what it brings for the noise alone by the noise's spectrum; None when that is not known
    """

    name: str
    unit: str
    means: Array
    variances: Array
    average_mean: float
    averaging: Averaging
    noise_gain: float | None

    @classmethod
    def of(cls, name: str, unit: str, errors: Array, noise_gain: float | None = None) -> ErrorRow:
        """From errors (R, N)."""
        averaging = Averaging.of(errors)
        return cls(
            name, unit, errors.mean(axis=1), errors.var(axis=1), float(errors.mean()), averaging, noise_gain
        )  # fmt: skip

    def row(self) -> tuple[str, ...]:
        """Name, unit, mean error and variance of a run and of the average, noise, remainder and gains, as text."""
        a = self.averaging
        low, high = a.interval()
        return (
            self.name, self.unit, f"{self.means.mean():.4g}", f"{a.single:.4g}", f"{a.average:.4g}", f"{a.noise:.4g}",
            f"{a.remainder:.3g} ± {a.remainder_std:.2g}", f"{low:.3g} to {high:.3g}", f"{a.gain:.3g}", f"{a.runs}",
            "-" if self.noise_gain is None else f"{self.noise_gain:.3g}",
        )  # fmt: skip

    def to_data(self) -> dict[str, Any]:
        """All figures by name; infinite ones are null."""
        a = self.averaging
        return {
            "name": self.name,
            "unit": self.unit,
            "mean_of_run": self.means.tolist(),
            "variance_of_run": self.variances.tolist(),
            "mean_of_average": self.average_mean,
            "variance_of_runs": a.single,
            "variance_of_average": a.average,
            "runs": a.runs,
            "noise": a.noise,
            "remainder": a.remainder,
            "remainder_std": a.remainder_std,
            "remainder_interval": list(a.interval()),
            "gain": a.gain if np.isfinite(a.gain) else None,
            "noise_gain": self.noise_gain,
        }


def noise_gains(recording: Recording, noise: Noise) -> list[float | None]:
    """How many times quieter, by the noise's spectrum S, the runs' average is than a run, per channel.

    With the autocovariance r of S, noise of R runs of N samples without a pause has in their average the covariance
    c(t) = sum_m (R - |m|) r(t + m N) / R² of samples t apart. About its own mean a series of covariance c varies by
    c(0) - sum_t (N - |t|) c(t) / N². For white noise the ratio is R; noise slower than a run gains more than that where
    its swings within runs cancel, and less where runs share them. Runs with a pause between them are independent;
    poses at rest have no spectrum.
    """
    if recording.dt is None:
        return [None] * len(recording.channels)
    if not recording.continuous or len(noise.spectra) != len(recording.channels):
        return [float(recording.repeats)] * len(recording.channels)
    return [_gain(recording, recording.dt, spectrum) for spectrum in noise.spectra]


def _gain(recording: Recording, dt: float, spectrum: Spectrum) -> float:
    """Variance of a run over that of the average, for noise of this spectrum."""
    once, repeats, fine = recording.samples_per_repeat, recording.repeats, FINE * recording.samples
    lags = np.fft.irfft(spectrum(np.maximum(np.arange(fine // 2 + 1), 1) / (fine * dt)), n=fine)
    apart = np.arange(1 - once, once)
    shifts = np.arange(1 - repeats, repeats)
    shared = lags[np.abs(apart[:, None] + shifts * once)] @ (repeats - np.abs(shifts)) / repeats**2
    run, average = (
        covariance[once - 1] - (once - np.abs(apart)) @ covariance / once**2
        for covariance in (lags[np.abs(apart)], shared)
    )
    return float(run / average)


def by_runs(recording: Recording, series: Array) -> Array:
    """A series (n, ...) as (R, N, ...)."""
    return series.reshape(recording.repeats, recording.samples_per_repeat, *series.shape[1:])
