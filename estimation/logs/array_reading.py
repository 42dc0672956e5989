"""Recordings from data frames and arrays, cut into repeats as those from files."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimation.logs.log_reading import recording_with_repeats
from estimation.recordings.column_table import table_from_columns, table_from_frame
from estimation.recordings.recording import Recording
from modeling.errors import InputError
from modeling.rig.rig import PLANAR_CHANNELS, SPATIAL_CHANNELS, Rig

if TYPE_CHECKING:
    import pandas as pd


def from_dataframe(
    frame: pd.DataFrame,
    *,
    name: str = "recording",
    rig: Rig | None = None,
    period: float | None = None,
    strict: bool = False,
    one_run: bool = False,
) -> Recording:
    """The recording in a data frame with the columns of a recording file, cut into repeats as `read` cuts them.

    Parameters
    ----------
    frame : pandas.DataFrame
        One row a sample, SI: wrench, motion and, unless the rows are poses at rest, `time` in s. A time as the index
        counts as the column `time`.
    name : str, optional
        Its name in messages.
    rig : Rig, optional
        The kinematics that joint angles need.
    period : float, optional
        Period of the motion, s, to cut repeats; by default as a column `repeat` counts them, or as the motion has one.
    strict : bool, optional
        Refuse what has to be interpolated or cut; by default False.
    one_run : bool, optional
        Take everything as one run, whatever repeats; by default False.

    Returns
    -------
    Recording
        Wrench (n, p), N and N m, motion and auxiliary columns.

    Raises
    ------
    InputError
        For missing columns, values that are not numbers, and whatever cannot be a recording.

    Examples
    --------
    >>> import pandas as pd
    >>> import truewrench as tw
    >>> frame = pd.read_csv("train.csv")
    >>> tw.from_dataframe(frame, rig=tw.Rig.read("rig.toml")).repeats
    8
    """
    timed = frame.reset_index() if frame.index.name == "time" and "time" not in frame.columns else frame
    table = table_from_frame(timed.reset_index(drop=True), name)
    return recording_with_repeats(table, name=name, rig=rig, period=period, strict=strict, one_run=one_run)


ARRAY_COLUMNS = {
    "orientation": ("qx", "qy", "qz", "qw"),
    "position": ("px", "py", "pz"),
    "angular_velocity": ("wx", "wy", "wz"),
    "angular_acceleration": ("alx", "aly", "alz"),
    "acceleration": ("apx", "apy", "apz"),
}
"""Columns of a recording that an array of `from_arrays` holds."""


def from_arrays(
    wrench: ArrayLike,
    *,
    name: str = "recording",
    rig: Rig | None = None,
    period: float | None = None,
    strict: bool = False,
    one_run: bool = False,
    **arrays: ArrayLike,
) -> Recording:
    """The recording in arrays, cut into repeats as `read` cuts them.

    Parameters
    ----------
    wrench : array (n, 3) or (n, 6)
        Readings: fx, fy, tau, or fx, fy, fz, tx, ty, tz; N and N m.
    name : str, optional
        Its name in messages.
    rig : Rig, optional
        The kinematics that joint angles need.
    period : float, optional
        Period of the motion, s, to cut repeats; by default as a column `repeat` counts them, or as the motion has one.
    strict : bool, optional
        Refuse what has to be interpolated or cut; by default False.
    one_run : bool, optional
        Take everything as one run, whatever repeats; by default False.
    **arrays : array
        `time` (n,) in s; `q` (n, joints), `dq`, `ddq` in rad; `orientation` (n, 4), a quaternion x, y, z, w of the
        sensor in the world; `position` (n, 3) in m; `angular_velocity` (n, 3) and `angular_acceleration` in the sensor
        frame; `acceleration` (n, 3) in the world; `repeat` (n,); and any column (n,) of a recording by its name, such
        as `phi`, `ax` or a temperature.

    Returns
    -------
    Recording
        Wrench (n, p), N and N m, motion and auxiliary columns.

    Raises
    ------
    InputError
        For arrays of other shapes, and whatever cannot be a recording.

    Examples
    --------
    >>> import truewrench as tw
    >>> rig = tw.Rig.read("rig.toml")
    >>> known = tw.read("train.csv", rig=rig)
    >>> time = [i * known.dt for i in range(known.samples)]
    >>> angles = [known.signals[f"q{j}"] for j in (1, 2, 3)]
    >>> tw.from_arrays(known.wrench, time=time, q=list(zip(*angles)), rig=rig).samples
    4000
    """
    readings = np.asarray(wrench)
    channels = {3: PLANAR_CHANNELS, 6: SPATIAL_CHANNELS}.get(readings.shape[1] if readings.ndim == 2 else 0)
    if channels is None:
        remedy = "give (n, 3) for a planar sensor, (n, 6) for six axes"
        raise InputError(what=f"wrench has the shape {readings.shape}", where=name, remedy=remedy)
    columns = dict(zip(channels, readings.T, strict=True))
    for key, values in arrays.items():
        columns |= _columns_of(key, np.asarray(values), name)
    table = table_from_columns(columns, name)
    return recording_with_repeats(table, name=name, rig=rig, period=period, strict=strict, one_run=one_run)


def _columns_of(key: str, values: NDArray[Any], where: str) -> dict[str, NDArray[Any]]:
    """The columns of one array by name."""
    if values.ndim == 1:
        return {key: values}
    joints = [f"{key}{j}" for j in range(1, values.shape[-1] + 1)] if key in ("q", "dq", "ddq") else None
    names = joints or ARRAY_COLUMNS.get(key)
    if names is None or values.ndim != 2 or values.shape[1] != len(names):
        expected = f"(n, {len(names)})" if names else "(n,)"
        raise InputError(what=f"{key} has the shape {values.shape}", where=where, remedy=f"give {expected}")
    return dict(zip(names, values.T, strict=True))
