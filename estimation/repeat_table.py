"""Repeatability table (Table 22.1) of a recording whose motion was repeated.

Table and equation numbers: chapter 22, "Characterization of the Dynamical Model of a Force Sensor for Robot
Manipulators" (Bassi et al.).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.fit import Fit
from estimation.model_response import predicted_readings
from estimation.multiplicity import normal_isf
from estimation.noise.power_spectrum import PowerSpectrum
from estimation.noise.recording_noise import RecordingNoise
from estimation.recordings.column_table import signal_unit
from estimation.recordings.motion import QUATERNION, motion_columns
from estimation.recordings.recording import Recording
from modeling.errors import InputError
from modeling.kinematics.placement import JointKind
from modeling.significance import LEVELS
from modeling.space import Space
from modeling.table import Column, Table, Tabular, Value

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


NOTABLE_GAIN_DIFFERENCE = 0.1
"""Relative deviation of the noise gain from that of independent runs above which the table remarks on it."""


@dataclass(frozen=True)
class ValidationRow:
    """Mean error and variance about it of one channel in another recording, predicted with the fit's zero."""

    recording: str
    channel: str
    unit: str
    mean: float
    variance: float


REPEAT_COLUMNS = (
    Column("series"),
    Column("unit"),
    *(Column(name, format=".4g") for name in ("mean error", "V run", "V average", "random std")),
    Column("systematic rms"),
    Column("95 %"),
    Column("gain", format=".3g"),
    Column("R", format="d"),
    Column("noise gain", format=".3g"),
)


@dataclass(frozen=True, eq=False)
class RepeatTable(Tabular):
    """Mean error and variance of each run, of their average and in validation; random and systematic part.

    `of` makes it from a fit and one of its recordings; InputError when that recording's motion was not repeated.

    Parameters
    ----------
    recording : str
        Name of the recording.
    readings : tuple of ErrorStatistics
        One for each channel, N and N m: measured minus predicted.
    motion : tuple of ErrorStatistics
        One for each recorded column of the motion: as read minus smoothed (`Recording.signals`). Its gain is the effect
        of 22.12 on input noise: 1 for the quantisation of a resolver, which repeats.
    validation : tuple of ValidationRow, optional
        One for each held-out recording and channel; by default none.

    Notes
    -----
    22.12 in chapter 22, "Characterization of the Dynamical Model of a Force Sensor for Robot Manipulators" (Bassi et
    al.); random and systematic part as in erratum 6 of PHYSICS.md.

    Examples
    --------
    >>> import truewrench as tw
    >>> rig = tw.Rig.read("rig.toml")
    >>> fit = tw.fit(tw.planar(rig) + tw.effects.named("viscous_drag"), tw.read("train.csv", rig=rig))
    >>> table = tw.RepeatTable.of(fit)
    >>> [(row.name, len(row.means), f"{row.averaging.noise:.2f} {row.unit}") for row in table.readings]
    [('fx', 8, '0.15 N'), ('fy', 8, '0.25 N'), ('tau', 8, '0.01 N m')]
    """

    recording: str
    readings: tuple[ErrorStatistics, ...]
    motion: tuple[ErrorStatistics, ...]
    validation: tuple[ValidationRow, ...] = ()

    @classmethod
    def of(cls, fit: Fit, number: int = 0, validation: Sequence[Recording] = ()) -> RepeatTable:
        """Of one of a fit's recordings. Raises InputError when its motion was not repeated."""
        recording = fit.recordings[number]
        if recording.repeats < 2:
            raise InputError(
                what="its motion ran once: random and systematic errors are not distinguishable",
                where=recording.name,
                remedy="record the motion several times, with a `repeat` column",
            )
        units = Space(recording.dimension).units
        gains = averaging_noise_gains(recording, fit.noise[number])
        errors = split_into_repeats(recording, fit.residuals[number])
        readings = tuple(
            ErrorStatistics.of(c, units[i], errors[:, :, i], gains[i]) for i, c in enumerate(recording.channels)
        )
        validated = tuple(row for other in validation for row in validation_rows(fit, number, other))
        return cls(recording.name, readings, motion_error_rows(recording), validated)

    @property
    def table(self) -> Table:
        """One row for each channel, and each column of the motion whose runs differ by more than rounding."""
        motion = [row for row in self.motion if not row.identical_runs]
        return Table.of(REPEAT_COLUMNS, [row.row() for row in (*self.readings, *motion)])

    @property
    def channel_table(self) -> Table:
        """One row for each channel."""
        return Table.of(REPEAT_COLUMNS, [row.row() for row in self.readings])

    @property
    def run_table(self) -> Table:
        """Mean error and variance of every channel, run by run, of the average and in validation."""
        names = [f"{kind} {row.name}" for row in self.readings for kind in ("mean", "var")]
        runs = len(self.readings[0].means)
        lines: list[tuple[str | float, ...]] = [
            (f"run {r + 1}", *(float(v) for row in self.readings for v in (row.means[r], row.variances[r])))
            for r in range(runs)
        ]
        whole = (v for row in self.readings for v in (row.average_mean, row.averaging.average))
        lines.append((f"average of {runs}", *whole))
        for name in dict.fromkeys(row.recording for row in self.validation):
            rows = [row for row in self.validation if row.recording == name]
            lines.append((name, *(v for row in rows for v in (row.mean, row.variance))))
        return Table.of(("recording", *(Column(name, format=".4g") for name in names)), lines)

    def remarks(self) -> list[str]:
        """Channels whose coloured noise makes the average's variance differ from that of independent runs."""
        remarks = []
        for row in self.readings:
            gain, runs = row.noise_gain, row.averaging.runs
            if gain is not None and abs(gain / runs - 1) > NOTABLE_GAIN_DIFFERENCE:
                shared = row.averaging.noise**2 * (1 / gain - 1 / runs)
                remarks.append(
                    f"{row.name}: its noise is coloured, averaging {runs} runs reduces its variance by {gain:.3g}, not"
                    f" {runs}: noise accounts for {shared:.2g} of the systematic mean square {row.averaging.square:.2g}"
                )
        return remarks

    def printed(self) -> list[Table | str]:
        """Runs, then series, then remarks."""
        return [self.run_table, "", *super().printed()]

    def to_data(self) -> dict[str, Any]:
        """The whole table as JSON data."""
        return {
            "recording": self.recording,
            "readings": [row.to_data() for row in self.readings],
            "motion": [row.to_data() for row in self.motion],
            "validation": [vars(row) for row in self.validation],
        }


def motion_error_rows(recording: Recording) -> tuple[ErrorStatistics, ...]:
    """A row for each recorded column of a motion, in the column's unit; none for static poses."""
    if recording.at_rest:
        return ()
    recorded = [name for name in motion_columns(recording.form, recording.joints) if name in recording.columns]
    errors = {name: split_into_repeats(recording, _motion_error(recording, name)) for name in recorded}
    kinds = () if recording.arm is None else recording.arm.kinds
    prismatic = [joint for joint, kind in enumerate(kinds, start=1) if kind is JointKind.PRISMATIC]
    linear = {f"{prefix}{joint}" for prefix in ("q", "dq", "ddq") for joint in prismatic}
    units = {name: signal_unit(name) or "1" for name in errors}  # 1 of a quaternion
    units |= {name: units[name].replace("rad", "m") for name in linear & set(errors)}
    return tuple(ErrorStatistics.of(name, units[name], series) for name, series in errors.items())


def _motion_error(recording: Recording, name: str) -> Array:
    """A column as read minus its smoothed motion averaged over the repeats, (n,)."""
    read = recording.motion.world_columns[name]
    if name in QUATERNION:
        turns = np.stack([recording.motion.world_columns[q] for q in QUATERNION], axis=1)
        smooth = np.stack([recording.signals[q] for q in QUATERNION], axis=1)
        return np.asarray(read * np.sign((turns * smooth).sum(axis=1)) - recording.signals[name])
    if name == "phi":
        return np.asarray((read - recording.signals[name] + np.pi) % (2 * np.pi) - np.pi)
    return np.asarray(read - recording.motion.recorded.differentiated(read[:, None]).value[:, 0])


def validation_rows(fit: Fit, number: int, other: Recording) -> tuple[ValidationRow, ...]:
    """Mean error and variance of each channel when a fit predicts another recording, without re-estimation."""
    model = fit.layout.models[number].without_recording_specific
    values = dict(
        zip((p.name for p in fit.layout.models[number].parameters), fit.theta[fit.layout.index[number]], strict=True)
    )
    error = other.wrench - predicted_readings(model, other, np.array([values[p.name] for p in model.parameters]))
    units = Space(other.dimension).units
    return tuple(
        ValidationRow(other.name, c, unit, float(errors.mean()), float(errors.var()))
        for c, unit, errors in zip(other.channels, units, error.T, strict=True)
    )
