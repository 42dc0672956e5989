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
from estimation.recordings.recording import QUATERNION, Recording, motion_columns
from estimation.recordings.signal_unit import signal_unit
from estimation.repeatability.error_statistics import ErrorStatistics, averaging_noise_gains, split_into_repeats
from modeling.errors import InputError
from modeling.kinematics.joint import JointKind
from modeling.space import Space
from modeling.table import Column, Table, Tabular

Array = NDArray[np.float64]

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
    >>> found = tw.RepeatTable.of(fit)
    >>> [(row.name, len(row.means), f"{row.averaging.noise:.2f} {row.unit}") for row in found.readings]
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
            own = [row for row in self.validation if row.recording == name]
            lines.append((name, *(v for row in own for v in (row.mean, row.variance))))
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
    return tuple(ErrorStatistics.of(name, units[name], own) for name, own in errors.items())


def _motion_error(recording: Recording, name: str) -> Array:
    """A column as read minus its smoothed motion averaged over the repeats, (n,)."""
    read = recording.world_columns[name]
    if name in QUATERNION:
        turns = np.stack([recording.world_columns[q] for q in QUATERNION], axis=1)
        smooth = np.stack([recording.signals[q] for q in QUATERNION], axis=1)
        return np.asarray(read * np.sign((turns * smooth).sum(axis=1)) - recording.signals[name])
    if name == "phi":
        return np.asarray((read - recording.signals[name] + np.pi) % (2 * np.pi) - np.pi)
    return np.asarray(read - recording.differentiated(read[:, None]).value[:, 0])


def validation_rows(fit: Fit, number: int, other: Recording) -> tuple[ValidationRow, ...]:
    """Mean error and variance of each channel when a fit predicts another recording, without re-estimation."""
    model = fit.layout.models[number].without_recording_specific
    values = dict(
        zip((p.name for p in fit.layout.models[number].parameters), fit.theta[fit.layout.index[number]], strict=True)
    )
    error = other.wrench - predicted_readings(model, other, np.array([values[p.name] for p in model.parameters]))
    units = Space(other.dimension).units
    return tuple(
        ValidationRow(other.name, c, unit, float(own.mean()), float(own.var()))
        for c, unit, own in zip(other.channels, units, error.T, strict=True)
    )
