"""Contact evidence: samples whose force is none of a weight that turns with the sensor.

A rigid tool's force is linear in the specific force, the angular acceleration and the products of the angular velocity,
all in the sensor's axes, with a constant zero; a drag's in the velocities. With free coefficients (mass, mounting,
signs, centre of mass) it is fitted to the quieter half of the samples (least trimmed squares, by concentration steps:
Rousseeuw and van Driessen, "Computing LTS regression for large data sets", 2006), so that contact in less than half of
the time does not spoil it. Of normal residuals in three directions the quieter half has 0.4076 of the variance, and not
one in 10 million samples is beyond six std: what lies there comes and goes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.evidence.weight_fit import LEAST_EXPLAINED, weight_fit
from estimation.logs.frame_evidence import GRAVITY, sampled_rows
from estimation.logs.log_table import Array
from estimation.recordings.column_table import ColumnTable
from estimation.recordings.reading import recording_from_table
from estimation.recordings.sensor_frame import in_sensor_frame
from modeling.rig.rig import SPATIAL_CHANNELS

OUTLYING = 6
"""Usual deviations from which a sample is none of a weight and noise."""
LEAST_SHARE = 0.05
"""Of the samples, from which it is worth saying."""
STRAIGHT = 1.5
"""Ratio of residuals up to which the force is that of a weight, and the sensor's axes are those of the pose."""
FEWEST = 200
STEPS, PARTS, FEW_ROWS = 30, 10, 2000
"""Concentration steps, parts of the record for their starts, and rows from which the best start is chosen."""
QUIET_HALF = 0.4076
"""P(chi-square of 5 degrees of freedom < median of that of 3) / P(that of 3 below its median)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Deviations:
    """Samples (m,) of `sampled_rows` that deviate, and the usual deviation in one direction, N.

    mass  kg, of the other samples, where they show a weight and the sensor's axes are those of the pose; else None
    """

    outlying: NDArray[np.bool_]
    usual: float
    mass: float | None

    @property
    def share(self) -> float:
        """Share of the samples that deviate."""
        return float(self.outlying.mean())


def deviations(columns: Mapping[str, Array]) -> Deviations | None:
    """The deviations in a recording's columns (n,); None of too few samples."""
    rows = sampled_rows(columns)
    force = np.stack([columns[name][rows] for name in ("fx", "fy", "fz")], axis=1)
    if len(force) < FEWEST:
        return None
    down, moving = _motion({name: column[rows] for name, column in columns.items()})
    left, sizes, _ = np.linalg.svd(np.hstack([down, moving, np.ones((len(down), 1))]), full_matrices=False)
    squares = _trimmed_squares(left[:, sizes > 1e-10 * sizes[0]], force)
    variance = float(squares[squares <= np.median(squares)].mean()) / 3 / QUIET_HALF
    outlying = squares > OUTLYING**2 * variance
    mass = _mass(down[~outlying], force[~outlying])
    return Deviations(outlying=outlying, usual=float(np.sqrt(variance)), mass=mass)


def _trimmed_squares(basis: Array, force: Array) -> Array:
    """Squared residuals (m,) of the fit to the quieter half: the best of several starts, each without a part of them.

    One contact lies in one part or two, so that the start without them is not drawn by it.
    """
    every = slice(None, None, max(len(force) // FEW_ROWS, 1))
    few, forces = basis[every], force[every]
    parts = np.arange(len(few)) * PARTS // len(few)
    starts = [_concentrated(few, forces, (parts != i) & (parts != (i + 1) % PARTS)) for i in range(PARTS)]
    starts.append(_concentrated(few, forces, np.ones(len(few), dtype=bool)))
    best = min(starts, key=lambda squares: float(np.sort(squares)[: len(squares) // 2].sum()))
    quiet = np.repeat(best <= np.median(best), every.step)[: len(force)]
    return _concentrated(basis, force, np.pad(quiet, (0, len(force) - len(quiet)), mode="edge"))


def _concentrated(basis: Array, force: Array, quiet: NDArray[np.bool_]) -> Array:
    """Squared residuals (m,) on an orthonormal basis (m, r), after concentration steps from some samples."""
    squares = _squares(basis, force, quiet)
    for _ in range(STEPS):
        before, quiet = quiet, squares <= np.median(squares)
        if (before == quiet).all():
            break
        squares = _squares(basis, force, quiet)
    return squares


def _squares(basis: Array, force: Array, fitted: NDArray[np.bool_]) -> Array:
    """Squared residuals (m,) of the fit to some of the samples."""
    kept = basis[fitted]
    solution = np.linalg.lstsq(kept.T @ kept, kept.T @ force[fitted], rcond=1e-10)[0]
    residual = force - basis @ solution
    return np.asarray(np.einsum("nd,nd->n", residual, residual))


def _motion(columns: Mapping[str, Array]) -> tuple[Array, Array]:
    """In the sensor's axes: specific force in g (m, 3); angular acceleration and velocity, products of the latter, and
    velocity (m, k).
    """
    names = [name for name in columns if name in ("qx", "qy", "qz", "qw", "px", "py", "pz", *SPATIAL_CHANNELS)]
    step = float(columns["time"][1] - columns["time"][0])
    time: Array = np.asarray(step * np.arange(len(columns["time"])), dtype=np.float64)
    uniform = {"time": time, **{name: columns[name].copy() for name in names}}
    table = ColumnTable(columns=uniform, where="samples", first_row=1)
    signals = recording_from_table(table, name="samples", rig=None).signals
    omega, alpha = (np.stack([signals[part + axis] for axis in "xyz"], axis=1) for part in ("w", "al"))
    first, second = np.triu_indices(3)
    parts = [alpha, omega, omega[:, first] * omega[:, second]]
    if "vpx" in signals:
        parts.append(in_sensor_frame(signals, [signals["vp" + axis] for axis in "xyz"]))
    x, y, z = (signals["ap" + axis] / GRAVITY for axis in "xyz")
    return in_sensor_frame(signals, (x, y, z + 1.0)), np.hstack(parts)


def _mass(direction: Array, force: Array) -> float | None:
    """The mass in kg along the pose's axes, where it explains the force, and hardly less than a free matrix does.

    A matrix of nine coefficients bends towards a force that is no weight, as of a hand that follows the motion.
    """
    fits = [weight_fit(GRAVITY * direction, force, mounting=sign * np.eye(3)) for sign in (1.0, -1.0)]
    straight = min(fits, key=lambda fit: fit.rms)
    free = np.hstack([direction, np.ones((len(direction), 1))])
    residual = force - free @ np.linalg.lstsq(free, force, rcond=1e-10)[0]
    is_rigid = straight.rms < STRAIGHT * float(np.sqrt(np.mean(residual**2)))
    explains = straight.explained > LEAST_EXPLAINED and not straight.shows_no_weight
    return straight.mass if explains and is_rigid else None
