"""Input noise: covariance of the noise of measured motion signals, stated or estimated from repeats."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from estimation.recordings.column_table import ORIENTATION_ERRORS, signal_unit
from estimation.recordings.motion import MotionForm, motion_columns
from estimation.recordings.recording import Recording
from modeling.errors import InputError

Array = NDArray[np.float64]

REPEAT_ROUNDING = 1e-12
"""Rounding, in SI, of the deviation from an average over equal repeats; no motion sensor is that accurate."""


@dataclass(frozen=True, eq=False)
class InputNoise:
    """White noise of measured motion signals.

    `stated` takes standard deviations, `measured` estimates it from the repeats of a recording.

    Parameters
    ----------
    names : tuple of str
        Signals of a recording's motion (columns of FORMATS), and `turn_x, turn_y, turn_z` for a quaternion.
    covariance : array (s, s)
        Covariance of one sample of one repeat, in products of the signals' units (SI).

    Examples
    --------
    >>> import truewrench as tw
    >>> noise = tw.InputNoise.stated({"ax": 0.2, "dphi": 0.01})
    >>> noise.names, noise.covariance.shape
    (('ax', 'dphi'), (2, 2))
    >>> print(noise)
    ax 0.2 m/s², dphi 0.01 rad/s
    """

    names: tuple[str, ...]
    covariance: Array

    @classmethod
    def stated(cls, std: Mapping[str, float]) -> InputNoise:
        """Independent noise of the given standard deviations, by signal, in its SI unit.

        Raises InputError for a name that is not a motion signal or a number that is not a standard deviation.
        """
        for name, value in std.items():
            _require(
                bool(signal_unit(name)), f"'{name}' is not a motion signal", "name columns such as ax, ay, dphi, wx"
            )
            _require(
                np.isfinite(value) and value > 0,
                f"{name} = {value:g} is not a standard deviation",
                "give a positive number",
            )
        _require(bool(std), "no signal is given", "give a std by signal, such as ax = 0.2")
        return cls(tuple(std), np.diag([float(value) ** 2 for value in std.values()]))

    @classmethod
    def measured(cls, recording: Recording) -> InputNoise:
        """Covariance of the columns about their mean over R repeats of a recording, R - 1 degrees of freedom a sample.

        Of the columns that enter the model unsmoothed: recorded rates and accelerations, and for static poses the pose.
        Differences of the true motion between repeats count as noise here, though the readings follow them.
        Raises InputError without repeats, or when no signal is used as measured.
        """
        remedy = "state the std of the signals, or record repeats"
        _require(recording.repeats > 1, "there are no repeats to estimate the motion's noise from", remedy, recording)
        spreads = {name: _spread(recording, name) for name in unsmoothed(recording)}
        spreads |= _turn_spread(recording) if _takes_quaternion(recording) else {}
        kept = {name: rows for name, rows in spreads.items() if np.abs(rows).max() > REPEAT_ROUNDING}
        _require(
            bool(kept), "every signal of its motion is smoothed: none is used as it was measured", remedy, recording
        )
        rows = np.stack(list(kept.values()), axis=1)
        freedom = recording.samples_per_repeat * (recording.repeats - 1)
        return cls(tuple(kept), np.asarray(rows.T @ rows / freedom))

    @property
    def std(self) -> dict[str, float]:
        """Standard deviation of one sample by signal."""
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    def __str__(self) -> str:
        return ", ".join(f"{name} {value:.3g} {signal_unit(name)}" for name, value in self.std.items())


def unsmoothed(recording: Recording) -> tuple[str, ...]:
    """Columns of the motion that are signals as recorded, except for the average over repeats."""
    signals = (name for name in motion_columns(recording.form, recording.joints) if signal_unit(name))
    return tuple(name for name in signals if name in recording.columns and _is_average(recording, name))


def _is_average(recording: Recording, name: str) -> bool:
    """Whether a signal is the average of its column over the repeats, and not smoothed."""
    spread = _spread(recording, name).reshape(recording.repeats, -1)
    size = np.abs(recording.motion.world_columns[name]).max()
    return bool(np.abs(spread.mean(axis=0)).max() <= 1e-12 * size)  # rounding of the average


def _spread(recording: Recording, name: str) -> Array:
    """Deviation (n,) of a column from its signal; an angle of static poses is wrapped to half a turn."""
    spread = recording.motion.world_columns[name] - recording.signals[name]
    return np.angle(np.exp(1j * spread)) if recording.at_rest and name == "phi" else spread


def _takes_quaternion(recording: Recording) -> bool:
    return recording.at_rest and recording.form is MotionForm.POSE


def _turn_spread(recording: Recording) -> dict[str, Array]:
    """The recorded orientation as rotation vectors (n,) about its average over the repeats, in the sensor frame."""
    names = ("qx", "qy", "qz", "qw")
    mean = Rotation.from_quat(np.stack([recording.signals[name] for name in names], axis=1))
    read = Rotation.from_quat(np.stack([recording.motion.world_columns[name] for name in names], axis=1))
    turns = (mean.inv() * read).as_rotvec()
    return dict(zip(ORIENTATION_ERRORS, turns.T, strict=True))


def _require(holds: bool, what: str, remedy: str, recording: Recording | None = None) -> None:
    if not holds:
        raise InputError(what=what, where=recording.name if recording else "input noise", remedy=remedy)
