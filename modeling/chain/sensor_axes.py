"""Axes that a vector is given along, the turns between them, and the gain from a contact wrench to the reading.

A model computes the tool's wrench along the axes of the pose that was logged, or that the joints lead to: its first
moment and inertia, and the points and wrenches of its effects, are along these. A robot's flange has them where it is
the flange whose pose was logged. The sensor reads the wrench along its own axes, as R times it: R is the model's
mounting, and what `sensor_rotation` turns beside it. Readings, biases and noise are along the sensor's axes. All
vectors are about the sensor's origin.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import Enum
from functools import lru_cache
from math import atan2, degrees
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modeling import symbolic as sp
from modeling.chain.model import ALIGNED_MOUNTING, WrenchModel
from modeling.chain.stages import Mounting, Stage
from modeling.compiled.symbolic_vector import numpy_function
from modeling.errors import InputError
from modeling.kinematics.placement import (
    COMPONENTS,
    Direction,
    base_angle,
    base_placement,
    quaternion_conjugate,
    quaternion_product,
    rotated_vector,
)
from modeling.rigid_body import contact_components, contact_force_torque
from modeling.space import Space

Array = NDArray[np.float64]

ALONG = 0.02
"""Sine of the angle, 1°, to a coordinate axis up to which an axis of rotation is called by its name: mountings are not
more exact."""
HALF_TURN = 0.02
"""Sine of a turn below which, near 180°, one about an axis is as well one about its negative: the positive is said."""


class Axes(Enum):
    """Axes that a vector is given along."""

    SENSOR = "sensor"
    POSE = "pose"
    BASE = "base"

    @classmethod
    def of_tool(cls, model: WrenchModel) -> Axes:
        """Those of the tool's parameters: the sensor's, unless it is turned against the logged pose."""
        return cls.POSE if is_turned(model) or model.space is Space.PLANE else cls.SENSOR

    @classmethod
    def of_contact(cls, space: Space) -> Axes:
        """Those of a contact wrench by default: the sensor's; in the plane x' and y' of the tip."""
        return cls.POSE if space is Space.PLANE else cls.SENSOR

    def words(self, space: Space) -> str:
        """What texts call them: sensor axes, the axes of the logged pose, base axes; in the plane those of the tip."""
        if self is Axes.POSE:
            return "tip axes" if space is Space.PLANE else "the axes of the logged pose"
        return f"{self.value} axes"


def axes_named(name: Axes | str) -> Axes:
    """The axes of that name; InputError for another."""
    names = [axes.value for axes in Axes]
    if not isinstance(name, Axes) and name not in names:
        raise InputError(what=f"{str(name)[:40]!r} are no axes", where="axes", remedy=f"give one of {', '.join(names)}")
    return Axes(name)


def is_turned(model: WrenchModel) -> bool:
    """Whether a model's sensor is turned against the logged pose, by its mounting or by an effect."""
    return model.mounting != ALIGNED_MOUNTING or any(effect.stage is Stage.MOUNTING for effect in model.effects)


def pose_to_sensor(model: WrenchModel, theta: Array) -> tuple[Array, Array]:
    """R (3, 3) from the axes of the logged pose to the sensor's at parameters theta (k,), its derivative (3, 3, k).

    v_sensor = R v_pose; theta may go on after those of the model. In the plane the axes are e1 = x', e2 = -y' and e3,
    clockwise.
    """
    theta = theta[: len(model.parameters)]
    slopes = np.zeros((3, 3, len(theta)))
    if all(effect.stage is not Stage.MOUNTING for effect in model.effects):
        return np.array(model.mounting, dtype=np.float64), slopes
    rotation, symbols = model.chain[Mounting].rotation, [p.symbol for p in model.parameters]
    if model.inputs_of(rotation):  # of a user's effect, which turns the sensor as it moves: no constant axes
        return np.array(model.mounting, dtype=np.float64), slopes
    used = [i for i, symbol in enumerate(symbols) if symbol in rotation.free_symbols]
    expressions = [*rotation, *(entry for i in used for entry in rotation.diff(symbols[i]))]
    values = numpy_function([symbols[i] for i in used], expressions)(*(theta[i] for i in used))
    matrices = np.array(values, dtype=np.float64).reshape(-1, 3, 3)
    slopes[:, :, used] = np.moveaxis(matrices[1:], 0, 2)
    return matrices[0], slopes


def sensor_to_pose(model: WrenchModel, theta: Array) -> Array:
    """The rotation (3, 3) from the sensor's axes to those of the logged pose: v_pose = R' v_sensor."""
    return pose_to_sensor(model, theta)[0].T


def axes_data(model: WrenchModel, theta: Array) -> dict[str, Any]:
    """Which axes are those of the readings, with biases and noise, and of the tool, with points of effects.

    The rotation turns a vector in sensor axes into those of the logged pose.
    """
    turn = sensor_to_pose(model, theta)
    return {"readings": Axes.SENSOR.value, "tool": Axes.of_tool(model).value, "sensor_to_pose": turn.tolist()}


def contact_turn(model: WrenchModel, theta: Array, axes: Axes) -> tuple[Array, Array]:
    """Rotation (p, p) of a contact wrench from its own axes to `axes`, to BASE that to POSE; its derivative (p, p, k).

    Its own axes are those of `Axes.of_contact`; the components are as `contact_components` has them.
    """
    rotation, slopes = pose_to_sensor(model, theta)
    if model.space is Space.PLANE:
        if axes is not Axes.SENSOR:
            return np.eye(3), np.zeros((3, 3, len(theta)))
        flips = np.outer(PLANAR_SIGNS, PLANAR_SIGNS)  # components along -e2 = y'
        return flips * rotation, flips[:, :, None] * slopes
    if axes is Axes.SENSOR:
        return np.eye(6), np.zeros((6, 6, len(theta)))
    both = np.zeros((6, 6, len(theta)))
    both[:3, :3] = both[3:, 3:] = np.swapaxes(slopes, 0, 1)
    return np.asarray(np.kron(np.eye(2), rotation.T)), both


PLANAR_SIGNS = np.array([1.0, -1.0, 1.0])
"""Of fcx, fcy, tauc along e1, e2 and e3."""


def pose_to_base(space: Space, signals: Mapping[str, Array], direction: Direction | None) -> Array:
    """Rotations (n, p, p) of contact wrenches from the axes of the logged pose to those of the base.

    The signals are in the world, in which the base is placed by gravity's `direction` in its axes; None where these are
    the world's.
    """
    if space is Space.PLANE:
        phi = np.asarray(signals["phi"]) - (0.0 if direction is None else base_angle(direction))
        turn = np.zeros((len(phi), 3, 3))
        turn[:, 0, 0] = turn[:, 1, 1] = np.cos(phi)
        turn[:, 0, 1], turn[:, 1, 0], turn[:, 2, 2] = np.sin(phi), -np.sin(phi), 1.0
        return turn
    quaternions = np.stack([signals[name] for name in COMPONENTS])
    unit: Sequence[Array] = tuple(quaternions / np.linalg.norm(quaternions, axis=0))
    if direction is not None:
        unit = quaternion_product(quaternion_conjugate(base_placement(direction).quaternion), unit)
    rotation = np.stack([np.stack(rotated_vector(unit, axis), axis=1) for axis in np.eye(3).tolist()], axis=2)
    turn = np.zeros((len(rotation), 6, 6))
    turn[:, :3, :3] = turn[:, 3:, 3:] = rotation
    return turn


def turn_words(sensor_to_pose: Array) -> str:
    """By how many degrees, and about which axis, the sensor is turned against the logged pose."""
    skew = sensor_to_pose - sensor_to_pose.T
    twice = np.array([skew[2, 1], skew[0, 2], skew[1, 0]])  # 2 sin(angle) of the axis
    angle = degrees(atan2(float(np.linalg.norm(twice)), float(np.trace(sensor_to_pose)) - 1))
    if round(angle, 1) == 0:
        return "0°"
    axis = np.linalg.svd(sensor_to_pose - np.eye(3))[2][-1]  # v with R v = v
    along = axis @ twice if angle < 90 or abs(axis @ twice) > 2 * HALF_TURN else axis[np.argmax(np.abs(axis))]
    axis = axis * np.copysign(1.0, along)
    largest = int(np.argmax(np.abs(axis)))
    across = float(np.linalg.norm(np.delete(axis, largest)))
    about = f"({', '.join(f'{c + 0.0:.3g}' for c in axis)})"
    if across < ALONG:
        about = f"{'-' if axis[largest] < 0 else ''}{'xyz'[largest]}"
    return f"{angle:.1f}° about {about}".replace(".0° ", "° ")


# From a contact wrench to the reading.


@lru_cache(maxsize=64)
def contact_gain(model: WrenchModel, *, warm: bool = False) -> sp.Matrix:
    """Symbolic derivative (p, p) of the reading, before transfer function and bias, in the contact components.

    The sensor exerts the tool's inertial wrench minus the environment's (22.1, Bassi et al.): reading = G (wrench -
    contact), so that the matrix is -G, in terms of the parameters of mounting and gain. For 22.8 it is diag(-1, 1, -1).
    The contact is along the sensor's axes, whatever they are turned against; in the plane along x' and y' of the tip.
    A gain that depends on the load is linearised at zero load. Raises InputError when it depends on a signal, but for
    the temperature where it is known (`warm`).
    """
    chain = model.chain
    if model.space is Space.SPACE:
        chain = chain.with_stage(Mounting(sp.eye(3), chain[Mounting].rows))
    symbols = [sp.Symbol(name, real=True) for name in contact_components(model.space)]
    force, torque = contact_force_torque(model.space, symbols)
    gain = sp.Matrix(chain.reading(-force, -torque).jacobian(symbols)).xreplace(dict.fromkeys(symbols, sp.S.Zero))
    if changing := [name for name in model.inputs_of(gain) if not (warm and name == "temperature")]:
        raise InputError(
            what=f"the gain from contact wrench to reading depends on '{changing[0]}', and a constant one is needed",
            where="contact",
            remedy="leave out the effect by which the gain depends on a signal",
        )
    return gain


def contact_gain_at(model: WrenchModel, theta: Array, temperature: float | None = None) -> tuple[Array, Array]:
    """The contact gain (p, p) at the parameters theta (k,), and its derivative (p, p, k) in each of them.

    At a temperature, °C, where a gain that depends on it is to be taken there.
    """
    gain = contact_gain(model, warm=temperature is not None)
    if temperature is not None:
        gain = gain.xreplace({sp.Symbol("temperature", real=True): sp.Float(temperature)})
    symbols = [p.symbol for p in model.parameters]
    used = [i for i, symbol in enumerate(symbols) if symbol in gain.free_symbols]
    expressions = [*gain, *(entry for i in used for entry in gain.diff(symbols[i]))]
    values = numpy_function([symbols[i] for i in used], expressions)(*(theta[i] for i in used))
    size = len(model.channels)
    matrices = np.array(values, dtype=float).reshape(-1, size, size)
    slopes = np.zeros((size, size, len(symbols)))
    for place, i in enumerate(used):
        slopes[:, :, i] = matrices[1 + place]
    return matrices[0], slopes


def group_delay(model: WrenchModel, theta: Array) -> float:
    """Group delay (s) of the transfer function at zero frequency: -dH/ds at s = 0."""
    from modeling.compiled.straight_line_program import laplace

    if model.transfer_function == 1:
        return 0.0
    slope = -sp.diff(model.transfer_function, laplace()).subs(laplace(), 0)
    symbols = [p.symbol for p in model.parameters]
    return float(numpy_function(symbols, [slope])(*theta)[0])
