"""Error statistics of one series over the repeats, and the noise gain of averaging."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.noise.power_spectrum import PowerSpectrum
from estimation.noise.recording_noise import RecordingNoise
from estimation.recordings.recording import Recording
from estimation.repeatability.variance_components import VarianceComponents
from modeling.table import Value

Array = NDArray[np.float64]

FREQUENCY_OVERSAMPLING = 4
"""Frequency grid over the record's lines when a spectrum is transformed to autocovariances, against wrap-around."""

ROUNDING = 1e-12
"""Of a variance relative to that of a run, which is rounded to about 1e-16 of a motion a hundred times its error."""


@dataclass(frozen=True, eq=False)
class ErrorStatistics:
    """Errors of one series (measured minus predicted) in its `unit`.

    means, variances   (R,) of every run, the variance about the run's own mean
    average_mean       mean of the runs' average
    averaging          variance reduction by averaging, random and systematic part
    noise_gain         variance reduction expected for the noise alone from its spectrum; None without a spectrum
    """

    name: str
    unit: str
    means: Array
    variances: Array
    average_mean: float
    averaging: VarianceComponents
    noise_gain: float | None

    @classmethod
    def of(cls, name: str, unit: str, errors: Array, noise_gain: float | None = None) -> ErrorStatistics:
        """From errors (R, N)."""
        averaging = VarianceComponents.of(errors)
        return cls(
            name, unit, errors.mean(axis=1), errors.var(axis=1), float(errors.mean()), averaging, noise_gain
        )  # fmt: skip

    @property
    def identical_runs(self) -> bool:
        """Whether the runs are equal to rounding, so that nothing of the error is random."""
        return self.averaging.noise**2 <= ROUNDING * self.averaging.single

    def row(self) -> tuple[Value, ...]:
        """Name, unit, mean error, variance of a run and of the average, random and systematic part, gains."""
        a = self.averaging
        low, high = a.interval()
        systematic = (f"{a.remainder:.3g} ± {a.remainder_std:.2g}", f"{low:.3g} to {high:.3g}")
        numbers = (float(self.means.mean()), a.single, a.average, a.noise)
        return (self.name, self.unit, *numbers, *systematic, a.gain, a.runs, self.noise_gain)

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


def averaging_noise_gains(recording: Recording, noise: RecordingNoise) -> list[float | None]:
    """Variance of a run over that of the runs' average, from the noise spectrum S, per channel.

    With the autocovariance r of S, noise of R runs of N samples without a pause has in their average the covariance
    c(t) = sum_m (R - |m|) r(t + m N) / R² of samples t apart. About its own mean a series of covariance c varies by
    c(0) - sum_t (N - |t|) c(t) / N². For white noise the ratio is R; noise slower than a run gains more where its
    variations within runs cancel, and less where runs share them. Runs with a pause between them are independent;
    static poses have no spectrum.
    """
    if recording.dt is None:
        return [None] * len(recording.channels)
    if not recording.continuous or len(noise.spectra) != len(recording.channels):
        return [float(recording.repeats)] * len(recording.channels)
    return [_averaging_noise_gain(recording, recording.dt, spectrum) for spectrum in noise.spectra]


def _averaging_noise_gain(recording: Recording, dt: float, spectrum: PowerSpectrum) -> float:
    """Variance of a run over that of the average, for noise of this spectrum."""
    period, repeats, grid = recording.samples_per_repeat, recording.repeats, FREQUENCY_OVERSAMPLING * recording.samples
    autocovariance = np.fft.irfft(spectrum(np.maximum(np.arange(grid // 2 + 1), 1) / (grid * dt)), n=grid)
    lag = np.arange(1 - period, period)
    shifts = np.arange(1 - repeats, repeats)
    averaged = autocovariance[np.abs(lag[:, None] + shifts * period)] @ (repeats - np.abs(shifts)) / repeats**2
    run, average = (
        covariance[period - 1] - (period - np.abs(lag)) @ covariance / period**2
        for covariance in (autocovariance[np.abs(lag)], averaged)
    )
    return float(run / average)


def split_into_repeats(recording: Recording, series: Array) -> Array:
    """A series (n, ...) as (R, N, ...)."""
    return series.reshape(recording.repeats, recording.samples_per_repeat, *series.shape[1:])
