"""Motion reading: what a logged orientation, its axes and its units may have been meant as.

Each is a change of the motion sample by sample, with its derivatives in closed form or by expansion about the sample:
no series is smoothed again to try it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import permutations
from math import pi
from typing import TYPE_CHECKING, Any
from warnings import catch_warnings, simplefilter

import numpy as np
from numpy.typing import NDArray

from estimation.recordings.motion import QUATERNION, MotionForm, numbered_names
from estimation.recordings.recording import Recording
from modeling.kinematics.placement import Direction, base_angle, base_placement
from modeling.rig import Rig

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

STEP = 1e-3
"""s, over which a rotation is expanded to second order about a sample: its third order is a millionth of the second's
at 1 rad/s, and rounding a billionth of it."""
ROTATIONS: dict[int, dict[int, tuple[str, ...]]] = {
    2: {0: ("phi",), 1: ("dphi",), 2: ("ddphi",)},
    3: {1: ("wx", "wy", "wz"), 2: ("alx", "aly", "alz")},
}
"""Signals of a rotation in the plane and in six axes, by their order in time; quaternions have no unit."""
TRANSLATIONS: dict[int, dict[int, tuple[str, ...]]] = {
    2: {0: ("px", "py"), 1: ("vx", "vy"), 2: ("ax", "ay")},
    3: {0: ("px", "py", "pz"), 1: ("vpx", "vpy", "vpz"), 2: ("apx", "apy", "apz")},
}
"""The same of a translation."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionReading:
    """How the motion was meant; by default as it was logged.

    mistake      id of what would be mistaken, empty for none; `detail` the unit or the convention
    meaning      what it means, as a clause; `map_line` states it in a map
    orientation  from the sensor's orientation in the base as it was read to what was meant, sample by sample
    gravity      direction of gravity in base axes; None as the model has it
    length, time, angle  factors from what was logged to m, s and, in the plane, rad clockwise
    in_base      whether the readings are along base axes
    pulled       whether forces along base axes act on the tool, constant or linear in the position: no reading, but
                 what may be beside one
    compensated  whether a weight was subtracted from the readings, but no inertial force
    shift        (3,) m, from the point whose position was logged to the sensor's origin, in sensor axes
    """

    mistake: str = ""
    detail: str = ""
    meaning: str = ""
    map_line: str = ""
    orientation: Callable[[Rotation], Rotation] | None = None
    gravity: Direction | None = None
    length: float = 1.0
    time: float = 1.0
    angle: float = 1.0
    in_base: bool = False
    pulled: bool = False
    compensated: bool = False
    shift: Array | None = None

    def applies_to(self, recording: Recording) -> bool:
        """Whether the recording has what would be mistaken."""
        if self.orientation is not None:
            return recording.form is MotionForm.POSE
        if self.angle != 1:
            return recording.form is MotionForm.PLANAR_POSE
        if self.shift is not None:
            return recording.dimension == 3 and not recording.at_rest
        if self.length != 1:
            translation = (name for names in TRANSLATIONS[recording.dimension].values() for name in names)
            moves = any(name in recording.columns for name in translation)
            return moves and recording.form is not MotionForm.JOINTS and not recording.at_rest
        return not recording.at_rest or not (self.time != 1 or self.compensated)

    def signals(self, recording: Recording, every: slice) -> Mapping[str, Array]:
        """Inputs of a model (m,) by name as they were meant, of some samples."""
        if self.gravity is not None:
            recording = recording.moved(rig=replace(recording.rig or Rig(), gravity_direction=self.gravity))
        if abs(self.angle) != 1:  # of degrees that were read as rad whole turns were left out where they jump
            return {name: series[every] for name, series in self.mended(recording).signals.items()}
        signals = {name: series[every] for name, series in recording.signals.items()}
        direction = None if recording.rig is None else recording.rig.gravity_direction
        if self.orientation is not None:
            quaternion = (0.0, 0.0, 0.0, 1.0) if direction is None else base_placement(direction).quaternion
            base = _rotations().from_quat(quaternion)
            signals |= _reoriented(signals, self.orientation, base)
        if self.shift is not None:
            signals |= _shifted(signals, self.shift)
        scaled = self._scaled(signals, recording.dimension)
        if self.angle != 1 and direction is not None:
            scaled["phi"] += (1 - self.angle) * base_angle(direction)
        return signals | scaled

    def mended(self, recording: Recording) -> Recording:
        """The recording with the motion as it was meant; its readings stay."""
        columns = dict(recording.columns)
        if self.orientation is not None:
            logged = _rotations().from_quat(np.stack([columns[name] for name in QUATERNION], axis=1))
            columns |= dict(zip(QUATERNION, self.orientation(logged).as_quat().T, strict=True))
            # Rates that were logged are along the axes of the orientation as it was read.
            for names in ROTATIONS[3].values():
                columns = {name: column for name, column in columns.items() if name not in names}
        if self.shift is not None:
            position, *derived = TRANSLATIONS[3].values()
            to_sensor = _rotations().from_quat(np.stack([recording.signals[name] for name in QUATERNION], axis=1))
            moved = {
                name: columns[name] + along for name, along in zip(position, to_sensor.apply(self.shift).T, strict=True)
            }
            columns = {name: column for name, column in (columns | moved).items() if name not in sum(derived, ())}
        columns |= self._scaled(columns, recording.dimension)
        for order, prefix in enumerate(("q", "dq", "ddq")):
            rates = {name: columns[name] for name in numbered_names(prefix, recording.joints) if name in columns}
            columns |= {name: rate * self.time**-order for name, rate in rates.items()}
        time = None if recording.time is None else recording.time * self.time
        return recording.moved(columns=columns, time=time)

    def _scaled(self, columns: Mapping[str, Array], dimension: int) -> dict[str, Array]:
        """The columns or signals of a motion that have other units, in m, s and rad."""
        units = ((ROTATIONS[dimension], self.angle), (TRANSLATIONS[dimension], self.length))
        factors = {
            name: unit * self.time**-order
            for series, unit in units
            for order, names in series.items()
            for name in names
        }
        return {name: columns[name] * factor for name, factor in factors.items() if factor != 1 and name in columns}


def _reoriented(
    signals: Mapping[str, Array], meant: Callable[[Rotation], Rotation], base: Rotation
) -> dict[str, Array]:
    """Orientation (n,) of each component, with its rates along the sensor's axes, as it was meant.

    `base` is the rotation from base axes to the world.
    """
    read = base.inv() * _rotations().from_quat(np.stack([signals[name] for name in QUATERNION], axis=1))
    now, later, before = (meant(read * turn) for turn in _turns(signals))
    forward, backward = ((now.inv() * other).as_rotvec() for other in (later, before))
    rates = ((forward - backward) / (2 * STEP), (forward + backward) / STEP**2)
    series = zip((QUATERNION, *ROTATIONS[3].values()), ((base * now).as_quat(), *rates), strict=True)
    return {name: vector[:, i] for names, vector in series for i, name in enumerate(names)}


def at_rest(signals: Mapping[str, Array], dimension: int) -> dict[str, Array]:
    """Signals of the same poses at rest."""
    tables = (ROTATIONS[dimension], TRANSLATIONS[dimension])
    moving = {name for table in tables for order, names in table.items() if order for name in names}
    return {name: np.zeros_like(series) if name in moving else series for name, series in signals.items()}


def _rotations() -> type[Rotation]:
    """SciPy's rotations, which take a tenth of a second to import: only a recording that does not fit needs them."""
    from scipy.spatial.transform import Rotation

    return Rotation


def _turns(signals: Mapping[str, Array]) -> list[Rotation]:
    """Rotations from the orientation of each sample to itself, to `STEP` later and to as much earlier."""
    omega, alpha = (np.stack([signals[name] for name in names], axis=1) for names in ROTATIONS[3].values())
    return [_rotations().from_rotvec(h * omega + h**2 / 2 * alpha) for h in (0.0, STEP, -STEP)]


def _shifted(signals: Mapping[str, Array], shift: Array) -> dict[str, Array]:
    """Translation (n,) of each component of a point at `shift` (3,) m from the one of the signals, in sensor axes."""
    read = _rotations().from_quat(np.stack([signals[name] for name in QUATERNION], axis=1))
    now, later, before = ((read * turn).apply(shift) for turn in _turns(signals))
    moved = (now, (later - before) / (2 * STEP), (later - 2 * now + before) / STEP**2)
    series = zip(TRANSLATIONS[3].values(), moved, strict=True)
    return {n: signals[n] + vector[:, i] for names, vector in series for i, n in enumerate(names) if n in signals}


# ------------------------------------------------------------------------------------------- what people mistake


def _inverse(rotation: Rotation) -> Rotation:
    return rotation.inv()


def _rolled(by: int) -> Callable[[Rotation], Rotation]:
    return lambda rotation: _rotations().from_quat(np.roll(rotation.as_quat(), by, axis=-1))


def _about_fixed_axes(rotation: Rotation) -> Array:
    """Angles (n, 3) about fixed x, y, z in this order, as roll, pitch and yaw are."""
    m = rotation.as_matrix()
    pitch = -np.arcsin(np.clip(m[:, 2, 0], -1.0, 1.0))
    return np.stack([np.arctan2(m[:, 2, 1], m[:, 2, 2]), pitch, np.arctan2(m[:, 1, 0], m[:, 0, 0])], axis=1)


def _fixed_read_as_moving(rotation: Rotation) -> Rotation:
    """The inverse of a rotation by moving axes is one by fixed axes with the negative angles."""
    return _rotations().from_euler("xyz", -_about_fixed_axes(rotation.inv()))


def _moving_read_as_fixed(rotation: Rotation) -> Rotation:
    return _rotations().from_euler("XYZ", _about_fixed_axes(rotation))


def _reordered(rotation: Rotation, read: Any, meant: Any) -> Rotation:
    """Euler angles of a convention that were read by another one, capitals about moving axes.

    SciPy's stubs list conventions one by one.
    """
    with catch_warnings():  # where two angles turn about one axis, any of them that give the rotation will do
        simplefilter("ignore", UserWarning)
        return _rotations().from_euler(meant, rotation.as_euler(read))


AS_LOGGED = MotionReading()
"""The motion as it was read."""
PULLED = MotionReading(pulled=True)
"""As it was read, with a cable or a hose: what of a load does not turn with the sensor is no wrench in base axes."""
UNITS = (
    *(
        MotionReading(mistake="length_unit", detail=unit, length=factor, meaning=f"the position is in {unit}",
                      map_line=f'units = {{ position = "{unit}" }}')
        for unit, factor in (("mm", 1e-3), ("cm", 1e-2), ("in", 0.0254), ("ft", 0.3048))
    ),
    *(
        MotionReading(mistake="time_unit", detail=unit, time=factor, meaning=f"the time is in {unit}",
                      map_line=f'units = {{ time = "{unit}" }}')
        for unit, factor in (("ms", 1e-3), ("us", 1e-6))
    ),
)  # fmt: skip
SHIFTED = MotionReading(mistake="sensor_shifted", shift=np.zeros(3))
"""The position that is logged is a flange's, or the torques are about another point than the sensor's origin."""
COMPENSATED = MotionReading(mistake="payload_compensated", compensated=True)
"""A controller that subtracts the weight of a payload, as it was set, leaves its inertial forces."""
PLANAR = (
    MotionReading(mistake="orientation_inverse", angle=-1.0, meaning="phi is counted counterclockwise"),
    MotionReading(mistake="angle_unit", detail="deg", angle=pi / 180, map_line='units = { angle = "deg" }',
                  meaning="phi is in degrees"),
    MotionReading(mistake="wrench_axes", detail="base", in_base=True, meaning="forces are along base axes"),
)  # fmt: skip
SPATIAL = (
    MotionReading(mistake="orientation_inverse", orientation=_inverse, map_line='orientation_of = "base"',
                  meaning="the orientation is that of the base in the sensor"),
    MotionReading(mistake="orientation_order", detail="wxyz", orientation=_rolled(-1),
                  map_line='orientation = "wxyz"', meaning="the quaternion is w x y z"),
    MotionReading(mistake="orientation_order", detail="xyzw", orientation=_rolled(1),
                  map_line='orientation = "xyzw"', meaning="the quaternion is x y z w"),
    MotionReading(mistake="wrench_axes", detail="base", in_base=True, map_line='wrench_axes = "base"',
                  meaning="forces and torques are along base axes"),
    *(
        MotionReading(mistake="euler_convention", detail=meant, orientation=mended,
                      map_line=f'orientation = "euler {meant}" for "euler {read}"',
                      meaning=f"the angles are about {axes} axes, in the order {meant}, if they were read as {read}")
        for meant, axes, read, mended in (
            ("xyz", "fixed", "XYZ", _fixed_read_as_moving),
            ("XYZ", "moving", "xyz", _moving_read_as_fixed),
            ("ZYX", "moving", "XYZ", lambda rotation: _reordered(rotation, "XYZ", "ZYX")),
            ("XYZ", "moving", "ZYX", lambda rotation: _reordered(rotation, "ZYX", "XYZ")),
        )
    ),
)  # fmt: skip


def motion_readings(dimension: int, euler: str = "") -> tuple[MotionReading, ...]:
    """The mistakes with a motion in the plane or in six axes; as it was read is none.

    `euler` names the convention by which Euler angles were read, where it is known: then every other one is tried.
    """
    if dimension == 2:
        return (*UNITS, COMPENSATED, *PLANAR)
    if not euler:
        return (*UNITS, COMPENSATED, *SPATIAL)
    others = [reading for reading in SPATIAL if reading.mistake != "euler_convention"]
    orders = ["".join(order) for axes in ("xyz", "XYZ") for order in permutations(axes)] + ["ZYZ"]
    return (*UNITS, COMPENSATED, *others, *(_euler_angles(order, euler) for order in orders if order != euler))


def _euler_angles(meant: str, read: str) -> MotionReading:
    """Euler angles of a convention that were read by another one, capitals about moving axes."""
    axes = "moving" if meant.isupper() else "fixed"
    return MotionReading(
        mistake="euler_convention", detail=meant, map_line=f'orientation = "euler {meant}"',
        orientation=lambda rotation: _reordered(rotation, read, meant),
        meaning=f"the angles are about {axes} axes, in the order {meant}",
    )  # fmt: skip
