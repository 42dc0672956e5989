"""RepeatTable: Table 22.1 of the chapter for any recording whose motion was repeated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.fit import Fit, table
from estimation.recording import QUATERNION, Recording, motion_columns
from estimation.repeats.error_row import ErrorRow, by_runs, noise_gains
from estimation.response import predicted
from modeling.errors import InputError
from modeling.space import Space

Array = NDArray[np.float64]

STANDS_OUT = 0.1
"""Share by which an average's noise may differ from that of independent runs before the table says so."""


@dataclass(frozen=True)
class ValidationRow:
    """Mean error and variance about it of one channel in another recording, predicted with the fit's own zero."""

    recording: str
    channel: str
    unit: str
    mean: float
    variance: float


HEADER = ("", "unit", "mean error", "V run", "V average", "noise", "remainder", "95 %", "gain", "R", "noise gain")


@dataclass(frozen=True, eq=False)
class RepeatTable:
    """Mean error and variance of each run, of their average and in validation, and what they imply (erratum 6).

    readings    one row per channel: measured minus predicted
    motion      one row per column that the motion was taken from: as read, minus what the recording's signals make of
                it. Its gain is what 22.12 does for the noise of the input: 1 for a resolver's steps, which repeat
    validation  per recording and channel
    """

    recording: str
    readings: tuple[ErrorRow, ...]
    motion: tuple[ErrorRow, ...]
    validation: tuple[ValidationRow, ...] = ()

    @classmethod
    def of(cls, fit: Fit, number: int = 0, validation: Sequence[Recording] = ()) -> RepeatTable:
        """Of one of a fit's recordings. Raises InputError when its motion was not repeated."""
        recording = fit.recordings[number]
        if recording.repeats < 2:
            raise InputError(
                what="its motion ran once, and noise cannot be told from what repeats",
                where=recording.name,
                remedy="record the motion several times, with a `repeat` column",
            )
        units = Space(recording.dimension).units
        gains = noise_gains(recording, fit.noise[number])
        errors = by_runs(recording, fit.residuals[number])
        readings = tuple(ErrorRow.of(c, units[i], errors[:, :, i], gains[i]) for i, c in enumerate(recording.channels))
        checked = tuple(row for other in validation for row in validated(fit, number, other))
        return cls(recording.name, readings, motion_rows(recording), checked)

    def rows(self) -> list[tuple[str, ...]]:
        """One row for each channel and each column of the motion, as text under `HEADER`."""
        return [row.row() for row in (*self.readings, *self.motion)]

    def run_rows(self) -> list[tuple[str, ...]]:
        """Mean error and variance of every channel, run by run, of the average and in validation, as text."""
        runs = len(self.readings[0].means)
        lines = [
            (f"run {r + 1}", *(f"{v:.4g}" for row in self.readings for v in (row.means[r], row.variances[r])))
            for r in range(runs)
        ]
        whole = (f"{v:.4g}" for row in self.readings for v in (row.average_mean, row.averaging.average))
        lines.append((f"average of {runs}", *whole))
        for name in dict.fromkeys(row.recording for row in self.validation):
            own = [row for row in self.validation if row.recording == name]
            lines.append((name, *(f"{v:.4g}" for row in own for v in (row.mean, row.variance))))
        return lines

    def remarks(self) -> list[str]:
        """Where the noise's colour makes the average noisier or quieter than independent runs would."""
        said = []
        for row in self.readings:
            gain, runs = row.noise_gain, row.averaging.runs
            if gain is not None and abs(gain / runs - 1) > STANDS_OUT:
                shared = row.averaging.noise**2 * (1 / gain - 1 / runs)
                said.append(
                    f"{row.name}: its noise is coloured, averaging {runs} runs brings {gain:.3g} and not {runs}: of the"
                    f" remainder's square ({row.averaging.square:.2g}) noise accounts for {shared:.2g}"
                )
        return said

    def __str__(self) -> str:
        heads = ("", *(f"{kind} {row.name}" for row in self.readings for kind in ("mean", "var")))
        return "\n".join([table(heads, self.run_rows()), "", table(HEADER, self.rows()), *self.remarks()])

    def to_data(self) -> dict[str, Any]:
        """The whole table as JSON takes it."""
        return {
            "recording": self.recording,
            "readings": [row.to_data() for row in self.readings],
            "motion": [row.to_data() for row in self.motion],
            "validation": [vars(row) for row in self.validation],
        }


def motion_rows(recording: Recording) -> tuple[ErrorRow, ...]:
    """A row for each recorded column of a motion, in the column's unit; none at rest."""
    if recording.at_rest:
        return ()
    named = [name for name in motion_columns(recording.form, recording.joints) if name in recording.columns]
    errors = {name: by_runs(recording, _motion_error(recording, name)) for name in named}
    slides = () if recording.arm is None else np.flatnonzero(np.array(recording.arm.units) == "m") + 1
    sliding = {f"{prefix}{joint}" for prefix in ("q", "dq", "ddq") for joint in slides}
    units = {name: unit_of(name).replace("rad", "m") if name in sliding else unit_of(name) for name in errors}
    return tuple(ErrorRow.of(name, units[name], own) for name, own in errors.items())


def unit_of(column: str) -> str:
    """SI unit of a column of the motion."""
    if column in QUATERNION:
        return "1"
    order = next((order for prefix, order in RATES if column.startswith(prefix)), 0)
    turning = column.lstrip("d").startswith(("q", "phi")) or column.startswith(("w", "al"))
    return ("rad" if turning else "m") + ("", "/s", "/s²")[order]


RATES = (("ddq", 2), ("ddphi", 2), ("al", 2), ("ap", 2), ("a", 2), ("dq", 1), ("dphi", 1), ("w", 1), ("v", 1))
"""How often columns with these beginnings are differentiated; the first that fits counts."""


def _motion_error(recording: Recording, name: str) -> Array:
    """A column as read minus the smooth motion (n,) that the recording's repeats make of it."""
    read = recording.columns[name]
    if name in QUATERNION:
        turns = recording.stack(QUATERNION)
        smooth = np.stack([recording.signals[q] for q in QUATERNION], axis=1)
        return np.asarray(read * np.sign((turns * smooth).sum(axis=1)) - recording.signals[name])
    if name == "phi":
        return np.asarray((read - recording.signals[name] + np.pi) % (2 * np.pi) - np.pi)
    return np.asarray(read - recording.differentiated(read[:, None]).value[:, 0])


def validated(fit: Fit, number: int, other: Recording) -> tuple[ValidationRow, ...]:
    """Mean error and variance of each channel when a fit predicts another recording, nothing estimated there."""
    model = fit.layout.models[number].lasting
    values = dict(
        zip((p.name for p in fit.layout.models[number].parameters), fit.theta[fit.layout.index[number]], strict=True)
    )
    error = other.wrench - predicted(model, other, np.array([values[p.name] for p in model.parameters]))
    units = Space(other.dimension).units
    return tuple(
        ValidationRow(other.name, c, unit, float(own.mean()), float(own.var()))
        for c, unit, own in zip(other.channels, units, error.T, strict=True)
    )
