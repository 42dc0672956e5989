"""Decision on readings: whether recordings are read as they were meant, tested before any physics is looked for.

A reading is a hypothesis like an effect: the sign of the torques, an axis that is mirrored, the sense of gravity, the
convention of an orientation, a unit. It is shown where the residual of the rigid tool is smaller by `LEAST_GAIN` and by
a test that holds though neither reading is true (Vuong, "Likelihood ratio tests for model selection and non-nested
hypotheses", 1989), in contiguous blocks, against the recording as read and against every other reading. The scale of
the noise is that of the readings' differences from sample to sample: a residual would have the mistake in it. Where a
force along base axes explains most of what the nearest reading leaves, all readings are compared beside such a force.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from estimation.readings.axes_reading import SIGN_OF, AxesReading, axes_readings
from estimation.readings.doubted_reading import DoubtedReading
from estimation.readings.motion_reading import AS_LOGGED, PULLED, SHIFTED, MotionReading, motion_readings
from estimation.readings.rigid_tool import (
    MOST_ROWS,
    RankedReading,
    RigidRows,
    compared_rows,
    fitted_shift,
    from_base_axes,
    rigid_derivative,
    tool_model,
    white_noise,
)
from estimation.recordings.motion import MotionForm
from estimation.recordings.recording import Recording
from modeling.chain.model import QuarterTurnRotation, WrenchModel
from modeling.rig import Convention
from modeling.significance import LEVELS
from modeling.space import Space

Array = NDArray[np.float64]

LEAST_GAIN = 2.0
"""Ratio of the mean squares of the two residuals, of forces or of torques: a mistake of the whole recording is most of
what the rigid tool leaves as read, and what removes less than half of it is left to physics."""
FEW = 40
"""Readings with the smallest residuals that are compared sample by sample, the others are too far off to be alike."""
LARGEST_MASS = 5000.0
"""kg: twice what the strongest industrial robots carry; a wrist sensor that reads more reads no newtons."""
SMALLEST_MASS = 1e-3
"""kg: a gram, below which nothing is a tool, and a reading that finds one explains nothing by it."""
LARGEST_SHIFT = 0.5
"""m: no flange is farther from its sensor, and torques are taken about no other point than a tip; more is a unit."""
MOST_CARRIED = 2.0
"""Ratio of the masses beside a pull and without one: beside it the weight tells nothing, and inertia alone weighs the
tool; a pull that carries more than half of it stands in for another unit of the position."""
BESIDE_PULL = ", beside a force along base axes as a cable's,"
MOMENT_POINT = "moment_point"
UP = {2: (0.0, 1.0), 3: (0.0, 0.0, 1.0)}
"""Gravity in base axes of a base that hangs, in the plane and in six axes."""
INERTIA_SIGN = "the inertial forces have the other sign against the weight than they should"
"""What gravity that points up is where it was stated to point down: m (g + a) is -m (a - g) with gravity turned."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ShownReading:
    """A reading of recordings that is shown, by the ranked one.

    stated  sign convention as it was given, AUTO if it was not
    model   a rigid tool's, on the tool, not turned
    as_read the reading by which they were read
    p_value that it is as near to the truth; None where nothing but the weight is doubted
    or_units readings in other units of the same quantity that the data cannot tell from it
    or_else mistakes of another name that the data cannot tell from it
    """

    ranked: RankedReading
    model: WrenchModel
    stated: Convention
    as_read: RankedReading
    p_value: float | None
    or_units: tuple[AxesReading, ...] = ()
    or_else: tuple[ShownReading, ...] = ()

    def read_as(self, identity: str) -> ShownReading:
        """The one of those that are alike with this id, by default this."""
        return next((shown for shown in self.or_else if shown.doubted.id == identity), self)

    @property
    def axes(self) -> AxesReading:
        """How the wrench is read."""
        return self.ranked.axes

    @property
    def motion(self) -> MotionReading:
        """How the motion is read."""
        return self.ranked.motion

    @property
    def contradicts(self) -> bool:
        """Whether another sign convention was stated."""
        return self.stated not in (Convention.AUTO, self.axes.convention)

    @property
    def is_net(self) -> bool:
        """Whether nothing is shown but a mass that is negative with the sign convention that was stated."""
        return self.p_value is None and self.as_read.mass < 0

    @property
    def is_mistake(self) -> bool:
        """Whether the log would be mistaken, not only understood otherwise."""
        return bool(self.axes.mistake or self.motion.mistake)

    @property
    def turn(self) -> QuarterTurnRotation:
        """Of the mounting in six axes."""
        rows = [tuple(int(number) for number in row) for row in self.axes.turn]
        return cast(QuarterTurnRotation, tuple(rows))

    def is_simpler_than(self, other: ShownReading | None, recordings: Sequence[Recording], model: WrenchModel) -> bool:
        """Whether a base that stands upright with this reading is likelier than one that a model has turned.

        `other` is what is shown of it. What is left of a weight may point up, where more was subtracted; and angles
        about other axes may be like a base, a sensor and a sign that are all others than the usual ones.
        """
        if self.motion.compensated:
            return other is not None and other.motion.compensated
        if self.motion.mistake != "euler_convention" or self.axes.is_turned or self.axes.mistake:
            return False
        rows = RigidRows.of(recordings, self.model, replace(AS_LOGGED, pulled=self.motion.pulled))
        turned = RankedReading(_axes_as_read(model), rows)
        # Of a recording in quaternions nothing says that there were angles: the model that is turned may not fit then.
        most = LEAST_GAIN if _euler(recordings) else 1 / LEAST_GAIN
        return self.ranked.mean_square < most * turned.mean_square

    def mended(self, recording: Recording, read: Collection[str] = ()) -> Recording:
        """A recording as it was meant to be logged; gravity and the mounting of a six-axis sensor are the model's.

        `read` holds the ids of what it is read as, of two that are alike.
        """
        if self.motion.shift is not None and (MOMENT_POINT in read or recording.form is MotionForm.JOINTS):
            return recording.with_readings(_about_point(recording.wrench, self.axes.turn @ self.motion.shift))
        mended = self.motion.mended(recording)
        wrench = recording.wrench
        if self.motion.in_base:
            wrench = self._in_sensor_axes(recording)
        elif self.motion.compensated:
            wrench = wrench - self._subtracted(recording)
        else:
            in_plane = recording.dimension == 2
            inverse = np.linalg.inv(
                self.axes.matrix * SIGN_OF[self.axes.convention] if in_plane else self.axes.mistaken
            )
            wrench, dwells = wrench @ inverse.T, recording.dwells
            if dwells is not None:  # whose rows show the noise
                mended = replace(mended, dwells=replace(dwells, wrench=dwells.wrench @ inverse.T))
        return mended.with_readings(wrench)

    def _in_sensor_axes(self, recording: Recording) -> Array:
        """Readings (n, p) along base axes without their zero there, along the sensor's axes."""
        matrix = SIGN_OF[self.axes.convention] * self.axes.matrix
        along_base = recording.wrench @ np.linalg.inv(matrix).T
        predicted = rigid_derivative(recording, self.model, self.motion) @ self.ranked.parameters
        predicted = SIGN_OF[self.axes.convention] * predicted
        zero = 0.0 if recording.at_rest else (along_base[compared_rows(recording)] - predicted).mean(axis=0)
        return np.asarray(np.einsum("nij,nj->ni", from_base_axes(recording.signals, self.model), along_base - zero))

    def _subtracted(self, recording: Recording) -> Array:
        """What was subtracted of the readings (n, p), as far as it is no zero."""
        of_weight = self.ranked.parameters.copy()
        of_weight[: len(of_weight) // 2] = 0.0
        blocks = (slice(first, first + MOST_ROWS) for first in range(0, recording.samples, MOST_ROWS))
        derivatives = (rigid_derivative(recording, self.model, self.motion, rows) for rows in blocks)
        return np.concatenate([derivative @ of_weight for derivative in derivatives]) @ self.axes.matrix.T

    @property
    def readings(self) -> tuple[DoubtedReading, ...]:
        """The reading, with others that the data cannot tell from it."""
        if self.or_else:
            alike = [replace(shown, or_else=()).doubted for shown in (self, *self.or_else)]
            *first, last = (doubted.id for doubted in alike)
            which = f"the readings show {', '.join(first)} or {last}, and not which"
            return tuple(replace(doubted, shown_by=f"{doubted.evidence}; {which}") for doubted in alike)
        if self.motion.shift is None:
            return (self.doubted,)
        at = np.round(self.axes.turn @ self.motion.shift, 5).tolist()
        meaning = f"the torques are about a point at {at} m, in sensor axes, from the one whose position was logged"
        of_moment = replace(
            self.doubted, id=MOMENT_POINT, value=at, meaning=meaning, statement=f"--read {MOMENT_POINT}",
            shown_by=f"the readings show this or {self.doubted.id}, and not which",
        )  # fmt: skip
        return (self.doubted, of_moment)

    @cached_property
    def doubted(self) -> DoubtedReading:
        """What is said of it."""
        if self.is_net:
            return DoubtedReading(
                id="payload_compensated", value=self.as_read.mass, before=self._before, after=self._before, mends=False,
                meaning="the controller subtracts more than the tool weighs", statement="--read payload_compensated",
                mass=self.as_read.mass, shown_by=f"the mass comes out as {self.as_read.mass:.3g} kg",
            )  # fmt: skip
        if self.p_value is None:
            return DoubtedReading(
                id="force_unit", meaning="the forces are in other units than N, such as counts", value=None,
                statement='units = { force = "..", torque = ".." } in a map', mass=self.as_read.mass,
                before=self._before, after=self._before, applies_to="map",
                shown_by=f"the tool would weigh {self.as_read.mass:.2g} kg",
            )  # fmt: skip
        identity, value, meaning, statement = self._named()
        return DoubtedReading(
            id=identity, value=value, meaning=meaning, statement=statement, p_value=self.p_value, mass=self.ranked.mass,
            before=self._before, after=float(np.sqrt(self.ranked.mean_square)), mends=self.is_mistake,
            applies_to="map" if "map" in statement else "rig", beside=BESIDE_PULL if self.motion.pulled else "",
        )  # fmt: skip

    @property
    def _before(self) -> float:
        return float(np.sqrt(self.as_read.mean_square))

    def _named(self) -> tuple[str, Any, str, str]:
        """Id, value, meaning and the line that states it."""
        axes, motion = self.axes, self.motion
        if motion.compensated:
            mass = self.ranked.subtracted_mass
            meaning = (
                f"the weight of {mass:.4g} kg was subtracted from the readings, as of a payload that a controller has"
                " (a constant force upwards on the tool, base_force, reads the same)"
            )
            return motion.mistake, mass, meaning, f"--read {motion.mistake}"
        if motion.shift is not None:
            at = np.round(motion.shift, 5).tolist()
            meaning = f"the sensor's origin is at {at} m from the point whose position was logged, in sensor axes"
            return motion.mistake, at, meaning, f"--read {motion.mistake}"
        of_rig = f'convention = "{axes.convention.value}" under [sensor]'
        if motion.mistake:
            line = f"{motion.map_line} in a map, or --read {motion.mistake}" if motion.map_line else ""
            return motion.mistake, motion.detail or None, motion.meaning, line or f"--read {motion.mistake}"
        if axes.mistake:
            kind = axes.mistake.removesuffix("_unit")
            unit = f'units = {{ {kind} = "{axes.detail}" }} in a map, or ' if kind != axes.mistake else ""
            return (
                axes.mistake,
                axes.detail or None,
                ", or ".join(map(_meaning, (axes, *self.or_units))),
                f"{unit}--read {axes.mistake}",
            )
        if motion.gravity is not None:
            direction = [int(component) for component in motion.gravity]
            meaning = f"gravity points along {direction} of the base, the readings being {axes.convention.value}"
            line = f"gravity_direction = {direction} under [robot] and {of_rig} of the rig"
            return "gravity_direction", direction, meaning, line
        if not axes.is_turned:
            return (
                "wrench_sign",
                axes.convention.value,
                f"the readings are {axes.convention.value}",
                f"{of_rig} of the rig",
            )
        turn = [[int(number) for number in row] for row in axes.turn]
        if self.contradicts and (exchanged := _exchanged(-axes.turn)):
            return *exchanged, f"--read {exchanged[0]}"
        meaning = "the sensor is turned by quarter turns against the axes of the pose"
        return "sensor_turned", turn, meaning, "turn the wrench into the axes of the pose"


def _about_point(wrench: Array, arm: Array) -> Array:
    """Readings (n, 6) with torques about the point whose position was logged, by the arm (3,) to where they are now."""
    force, torque = wrench[:, :3], wrench[:, 3:]
    return np.hstack([force, torque + np.cross(arm, force)])


def _meaning(axes: AxesReading) -> str:
    """What a mistake with the columns means, as a clause."""
    columns = "fx, fy, fz" if axes.detail.startswith("f") else "tx, ty, tz"
    return {
        "torque_unit": f"the torques are in {axes.detail}, the forces in N",
        "force_unit": f"the forces are in {axes.detail}, the torques in N m",
        "torque_sign": "the torques have the other sign than the forces",
        "force_axis_mirrored": f"the force along {axes.detail} has the other sign",
        "torque_axis_mirrored": f"the torque about {axes.detail} has the other sign",
        "axes_permuted": f"the columns {columns if len(axes.turn) == 3 else 'fx, fy'} hold {axes.detail}",
    }[axes.mistake]


def _exchanged(matrix: Array) -> tuple[str, str | None, str] | None:
    """Id, value and meaning of columns of forces and torques alike that are exchanged or mirrored; else None.

    That is what a sensor mounted turned is like, with readings of the other sign: in the plane half a turn leaves a
    torque of the other sign, a quarter turn no exchange.
    """
    axes = "xyz"[: len(matrix)]
    if len(matrix) == 2:
        alone = np.array_equal(matrix, np.eye(2))
        return ("torque_sign", None, "the torque has the other sign than the forces") if alone else None
    if np.array_equal(np.abs(matrix), np.eye(len(matrix))) and (matrix < 0).sum() == 1:
        axis = axes[int(np.argmin(np.diag(matrix)))]
        return "force_axis_mirrored", axis, f"force and torque along {axis} have the other sign"
    if (matrix >= 0).all():
        order = ", ".join(axes[int(place)] for place in matrix.argmax(axis=1))
        return "axes_permuted", order, f"the columns of forces and of torques are in the order {order}"
    return None


def shown_reading(recordings: Sequence[Recording], model: WrenchModel, stated: Convention) -> ShownReading | None:
    """The reading that is shown against how the recordings are read by a model, whose frames are decided; else None.

    `stated` is the sign convention as it was given, AUTO if it was not.
    """
    tool = tool_model(model, recordings)
    as_logged = RigidRows.of(recordings, tool, AS_LOGGED)
    axes_as_read = _axes_as_read(model)
    as_read = RankedReading(axes_as_read, as_logged)
    shown = partial(ShownReading, model=tool, stated=stated, as_read=as_read)
    # Of counts every ratio is right, and the weight is no tool's; with the other sign it is none either.
    is_none = abs(as_read.mass) > LARGEST_MASS or (as_read.mass < 0 and stated is not Convention.AUTO)
    no_tool = shown(ranked=as_read, p_value=None) if is_none else None
    if max(as_read.mean_squares) < LEAST_GAIN * white_noise(recordings):
        return no_tool
    up = UP[model.space.value]
    stood = model.gravity_direction is not None
    hangs = MotionReading(gravity=up, mistake="inertia_sign" if stood else "", meaning=INERTIA_SIGN if stood else "")
    others = [hangs] if model.gravity_direction in (None, tuple(-c + 0.0 for c in up)) else []
    possible = motion_readings(model.space.value, _euler(recordings))
    others += [m for m in possible if all(m.applies_to(r) for r in recordings)]
    every = _ranked(recordings, tool, axes_as_read, [AS_LOGGED, *others])
    ranked = _nearest(every, stated)
    if _is_pulled(recordings, tool, ranked):
        weighed = {_name(r): r.mass for r in every if r.motion.gravity is None}
        motions = [replace(m, pulled=True) for m in (AS_LOGGED, *others) if not (m.compensated or m.gravity)]
        every = _ranked(recordings, tool, axes_as_read, motions)
        as_read = next(r for r in every if r.axes is axes_as_read and r.motion.pulled and not r.motion.mistake)
        carried = [r for r in every if r.mass / MOST_CARRIED < weighed.get(_name(r), 0.0) < r.mass * MOST_CARRIED]
        ranked = _nearest(carried, stated)
        shown = partial(shown, as_read=as_read)
    gain = ranked[0].gain_over(as_read) if ranked else 0.0
    if gain < LEAST_GAIN or ranked[0].mean_square > gain * as_read.rows.unstructured_mean_square > 0:
        return no_tool
    of_cost = Counter(_cost(r, stated) for r in every)

    def tried(reading: RankedReading) -> int:
        """Each cost has its share of the level, and shares it among its readings: a simple one is no surprise."""
        return len(of_cost) * of_cost[_cost(reading, stated)]

    alike = [r for r in ranked if r.p_value_against(ranked[0], tried(ranked[0])) > LEVELS.misread]
    simplest = min(alike, key=lambda r: _cost(r, stated))
    if simplest.motion.in_base or simplest.motion.compensated:
        pulled = RankedReading(axes_as_read, RigidRows.of(recordings, tool, PULLED))
        # A load that does not turn with the sensor has to explain as much; of a weight that was subtracted, which is
        # one itself, more.
        least = LEAST_GAIN if simplest.motion.compensated else 1 / LEAST_GAIN
        if simplest.mean_square > least * pulled.mean_square:
            return no_tool
    p_value = as_read.p_value_against(simplest, tried(simplest))
    # No controller adds a weight, but a constant force in base axes does; beside one no scale is told.
    if simplest.subtracted_mass < 0 or (simplest.motion.pulled and _is_scale(simplest)):
        return no_tool
    of_name: dict[str, list[RankedReading]] = {}
    for reading in alike:
        if _cost(reading, stated) == _cost(simplest, stated):
            of_name.setdefault(reading.axes.mistake or reading.motion.mistake, []).append(reading)
    named = [(one, tuple(other.axes for other in others)) for one, *others in of_name.values()]
    units_alone = all(one.axes.is_other_unit(axes) for one, others in named for axes in others)
    if p_value > LEVELS.misread or not (units_alone and all(simplest.is_like(one) for one, _ in named)):
        return no_tool
    first, *or_else = (shown(ranked=one, p_value=p_value, or_units=units) for one, units in named)
    return replace(first, or_else=tuple(or_else))


def _ranked(
    recordings: Sequence[Recording], tool: WrenchModel, axes_as_read: AxesReading, motions: Sequence[MotionReading]
) -> list[RankedReading]:
    """Readings of the axes with these of the motion, and with a shift that is fitted; one mistake each."""
    shifted = replace(SHIFTED, pulled=motions[0].pulled)
    if all(shifted.applies_to(recording) for recording in recordings):
        shift = fitted_shift(recordings, tool, axes_as_read, shifted)
        motions = [*motions, *([replace(shifted, shift=shift)] if np.linalg.norm(shift) < LARGEST_SHIFT else [])]
    return [
        RankedReading(axes, rows)
        for rows in (RigidRows.of(recordings, tool, motion) for motion in motions)
        for axes in axes_readings(recordings[0].channels)
        if not (axes.mistake and rows.motion.mistake)
    ]


def _is_pulled(recordings: Sequence[Recording], tool: WrenchModel, ranked: Sequence[RankedReading]) -> bool:
    """Whether a force along base axes explains most of what the nearest reading leaves of a tool that moves."""
    if not ranked or any(recording.at_rest for recording in recordings):
        return False
    pulled = replace(ranked[0].motion, pulled=True, compensated=False)
    return RankedReading(ranked[0].axes, RigidRows.of(recordings, tool, pulled)).gain_over(ranked[0]) >= LEAST_GAIN


def _is_scale(ranked: RankedReading) -> bool:
    """Whether it changes a unit or a length, which a weight tells: beside a pull it is a rival, and never shown."""
    return ranked.motion.shift is not None or "_unit" in ranked.motion.mistake + ranked.axes.mistake


def _name(ranked: RankedReading) -> tuple[str, str, AxesReading]:
    """What is read otherwise, beside a pull or not."""
    return ranked.motion.mistake, ranked.motion.detail, ranked.axes


def _nearest(every: Sequence[RankedReading], stated: Convention) -> list[RankedReading]:
    """Readings that leave the smallest residuals of a plausible tool."""
    plausible = (r for r in every if r.mass > SMALLEST_MASS)
    return sorted(plausible, key=lambda r: (r.mean_square, _cost(r, stated)))[:FEW]


def _cost(ranked: RankedReading, stated: Convention) -> tuple[bool, ...]:
    """Numbers that are fitted, a mistake, a mounting that is turned, gravity that points up, another sign than stated.

    The simplest reading has the least: a shift of twice the centre of mass is like torques of the other sign.
    """
    axes, motion = ranked.axes, ranked.motion
    is_fitted = motion.shift is not None or motion.compensated
    is_mistake = bool(axes.mistake or motion.mistake)
    contradicts = stated not in (Convention.AUTO, axes.convention)
    return (is_fitted, is_mistake, axes.is_turned, motion.gravity is not None, contradicts)


def _axes_as_read(model: WrenchModel) -> AxesReading:
    """How a model reads the axes of a wrench."""
    planar = model.space is Space.PLANE
    mounting = np.eye(2) if planar else np.array(model.mounting)
    return next(
        axes
        for axes in axes_readings(model.channels)
        if not axes.mistake and axes.convention is model.convention and np.array_equal(axes.turn, mounting)
    )


def _euler(recordings: Sequence[Recording]) -> str:
    """The convention by which the Euler angles of all recordings were read; empty where it is not known."""
    conventions = {"" if recording.reading is None else recording.reading.euler for recording in recordings}
    return conventions.pop() if len(conventions) == 1 else ""
