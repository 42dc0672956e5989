"""Frame check: what the weight in a recording shows of its orientation, and when the force is none of a weight."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.reading.column_map import ColumnMap, name_and_unit
from estimation.reading.column_recognition import ColumnGroup, ColumnMapping
from estimation.reading.frame_evidence import (
    GRAVITY,
    W_FIRST,
    FrameEvidence,
    frame_evidence,
    quaternion_orders,
    sampled_rows,
)
from estimation.reading.log_reader import Array
from estimation.reading.motion_evidence import impossible_speed
from estimation.reading.orientation_form import OrientationForm
from estimation.reading.step_log import StepLog
from estimation.recordings.column_table import ColumnTable
from estimation.recordings.reading import recording_from_table
from estimation.recordings.reading_report import Assumption, spans
from estimation.recordings.sign_convention import in_sensor_frame
from estimation.recordings.weight_fit import LEAST_EXPLAINED, RANK_TOLERANCE, weight_fit
from modeling.errors import InputError
from modeling.kinematics.placement import COMPONENTS, Direction, motion_in_world
from modeling.rig import SPATIAL_CHANNELS

OUTLYING = 6
"""Usual deviations from which a sample is none of a weight and noise: not one in 10 million normal ones is beyond."""
LEAST_SHARE = 0.05
"""Of the samples, from which it is worth saying."""
STRAIGHT = 1.5
"""Ratio of residuals up to which the force is that of a weight, and the sensor's axes are those of the pose."""
FEWEST = 200
"""Samples: ten times the 19 coefficients that are fitted to them."""
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
    """The deviations in a recording's columns (n,); None of too few samples.

    A rigid tool's force is linear in the specific force, the angular acceleration and the products of the angular
    velocity, all in the sensor's axes, with a constant zero; a drag's in the velocities. With free coefficients (mass,
    mounting, signs, centre of mass) it is fitted to the quieter half of the samples (least trimmed squares, by
    concentration steps: Rousseeuw and van Driessen, "Computing LTS regression for large data sets", 2006), so that
    contact in less than half of the time does not spoil it.
    """
    rows = sampled_rows(columns)
    force = np.stack([columns[name][rows] for name in ("fx", "fy", "fz")], axis=1)
    if len(force) < FEWEST:
        return None
    down, moving = _motion({name: column[rows] for name, column in columns.items()})
    left, sizes, _ = np.linalg.svd(np.hstack([down, moving, np.ones((len(down), 1))]), full_matrices=False)
    squares = _trimmed_squares(left[:, sizes > RANK_TOLERANCE * sizes[0]], force)
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
    solution = np.linalg.lstsq(kept.T @ kept, kept.T @ force[fitted], rcond=RANK_TOLERANCE)[0]
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
    omega, alpha = (np.stack([signals[prefix + axis] for axis in "xyz"], axis=1) for prefix in ("w", "al"))
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
    residual = force - free @ np.linalg.lstsq(free, force, rcond=RANK_TOLERANCE)[0]
    is_rigid = straight.rms < STRAIGHT * float(np.sqrt(np.mean(residual**2)))
    explains = straight.explained > LEAST_EXPLAINED and not straight.shows_no_weight
    return straight.mass if explains and is_rigid else None


# Ambiguity: columns that could be either of two things are asked for, with what each would mean.


def require_plausible_speed(columns: Mapping[str, Array], rate: float, group: ColumnGroup) -> None:
    """Ask for the unit of joint angles that no name states, where they turn as fast as no robot. Raises InputError."""
    if any(name_and_unit(name)[1] for name in group.columns):
        return
    angles = {name: columns[name] for name in columns if re.fullmatch(r"q\d+", name)}
    fastest = impossible_speed(angles, 1 / rate)
    if fastest is not None:
        fast = fastest[1]
        turn = float(max(np.ptp(column) for column in angles.values()))
        what = f"joint angles {group.columns[0]} .. {group.columns[-1]} could be radians ({turn:.3g} rad at speeds of"
        what += f" {fast:.3g} rad/s) or degrees ({np.radians(turn):.3g} rad at {np.radians(fast):.2g} rad/s)"
        remedy = 'state it in a map: units = { angle = "deg" }, or "rad"'
        raise InputError(what=what, where=group.table.name, remedy=remedy)


def require_decided_order(columns: Mapping[str, Array], group: ColumnGroup, direction: Direction | None = None) -> None:
    """Ask for the order of a quaternion that neither names nor the weight decide. Raises InputError."""
    as_read, w_first = quaternion_orders(columns, direction)
    if as_read.fit.is_shown_against(w_first.fit):
        return
    means = [f"{order} (mass {one.mass:.3g} kg, residual of the weight {one.rms:.3g} N)"
             for order, one in (("x y z w", as_read), ("w x y z", w_first))]  # fmt: skip
    raise InputError(
        what=f"the quaternion {group.columns[0]} .. {group.columns[-1]} could be {means[0]} or {means[1]}",
        where=group.table.name,
        remedy='state it in a map: orientation = "xyzw", or "wxyz"',
    )


FORCES = ("fx", "fy", "fz")
XYZW = OrientationForm("xyzw")
ROLLED = (("qx", "qy"), ("qy", "qz"), ("qz", "qw"), ("qw", "qx"))
"""Columns of a quaternion x y z w, and those that hold them where it was w x y z and read as x y z w."""
FLATTEST = 0.05
"""Std of the directions of gravity in the sensor, in any direction, below which it hardly turns: 3 degrees."""


@dataclass(frozen=True)
class FrameCheck:
    """The check of one reading's columns; what it finds goes into the log.

    `direction` is gravity's in base axes, where the rig states it.
    """

    mapping: ColumnMapping
    stated: ColumnMap
    log: StepLog
    direction: Direction | None = None

    def checked(self, columns: dict[str, Array], stamps: Array | None, *, is_moved: bool) -> dict[str, Array]:
        """The columns (n,) at stamps (n,), s, None of static poses, in the reading that the weight shows.

        A clearly better order of the quaternion is taken where no name stated it, and no clock was moved (`is_moved`)
        by the orientation as it was read. Raises InputError for an order that nothing decides.
        """
        group = self.mapping.orientation
        if group is None:
            return columns
        evidence = frame_evidence(columns, self.direction)
        if evidence is not None and evidence.is_better:
            if not self._is_better_taken(evidence, group, is_moved=is_moved):
                return columns
            columns = columns | {new: columns[old] for new, old in ROLLED}
        elif self._is_unstated(group):
            self._require_order(columns, group)
        in_world = columns if self.direction is None else motion_in_world(columns, self.direction)
        deviating = None if stamps is None else self._deviations(in_world, stamps)
        self._note_missing_weight(in_world, evidence, deviating)
        return columns

    def _note_missing_weight(
        self, columns: dict[str, Array], evidence: FrameEvidence | None, deviating: Deviations | None
    ) -> None:
        """Say that the readings show no weight, unless those without contact do."""
        if _spread_of_gravity(columns) < FLATTEST:
            what = "the sensor hardly turns: these readings cannot tell a tool's weight from the zero"
            self.log.suspicious(what, self.mapping.wrench.table.name)
        elif evidence is not None and evidence.shows_no_weight and (deviating is None or deviating.mass is None):
            self.log.suspicious(evidence.weight_sentence, self.mapping.wrench.table.name)

    def _is_better_taken(self, evidence: FrameEvidence, group: ColumnGroup, *, is_moved: bool) -> bool:
        """Whether the better reading is taken; where it is stated otherwise, the case of the recording says what is."""
        if evidence.best.meaning != W_FIRST or not self._is_unstated(group) or is_moved:
            return False
        self.log.mended(f"no name states the quaternion's order, and {evidence.sentence}; taken so", group.table.name)
        residuals = f"the residual of the weight is {evidence.best.rms:.3g} N then, else {evidence.as_read.rms:.3g} N"
        self.log.assumptions.append(Assumption("orientation", "wxyz", residuals))
        return True

    def _is_unstated(self, group: ColumnGroup) -> bool:
        """Whether neither a map nor a name says in which order the parts of the quaternion are."""
        numbered = all(name[-1:].isdigit() or name.endswith("]") for name in group.columns)
        return self.stated.form is None and numbered and (group.form or XYZW) == XYZW and len(group.columns) in (4, 7)

    def _require_order(self, columns: dict[str, Array], group: ColumnGroup) -> None:
        """Ask for an order that the weight does not decide; after a position x y z w is usual, and is assumed."""
        if len(group.columns) == 4:
            require_decided_order(columns, group, self.direction)
            return
        as_read, w_first = quaternion_orders(columns, self.direction)
        if not as_read.fit.is_shown_against(w_first.fit):
            what = "nothing states the order of the quaternion, x y z w is assumed, and the weight does not confirm it:"
            self.log.suspicious(f'{what} state orientation = "xyzw" or "wxyz" in a map', group.table.name)

    def _deviations(self, columns: dict[str, Array], stamps: Array) -> Deviations | None:
        """The times at which the force is none of a weight, which are named if they are more than a few."""
        deviating = deviations(columns)
        if deviating is None or deviating.share < LEAST_SHARE:
            return None
        what = f"the force deviates from a weight by more than {OUTLYING} times its usual {deviating.usual:.2g} N:"
        what += " contact, or another effect that is strongest then"
        what += f"; the rest shows a tool of about {deviating.mass:.2g} kg" if deviating.mass is not None else ""
        at = spans(stamps[sampled_rows(columns)], deviating.outlying)
        count = round(deviating.share * len(stamps))
        self.log.suspicious(what, self.mapping.wrench.table.name, count, len(stamps), at, FORCES)
        return deviating


def _spread_of_gravity(columns: Mapping[str, Array]) -> float:
    """The largest std of the directions of gravity in the sensor."""
    every = sampled_rows(columns)
    down = in_sensor_frame({name: columns[name][every] for name in COMPONENTS}, (0.0, 0.0, 1.0))
    return float(np.linalg.svd(down - down.mean(axis=0), compute_uv=False)[0] / np.sqrt(len(down)))
