"""Planar and spatial models in one description: measured channels, axes and motion signals."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from functools import cached_property

from modeling import symbolic as sp

FORCE_UNIT = "N"
TORQUE_UNIT = "N m"


def signals(*names: str) -> tuple[sp.Symbol, ...]:
    """SymPy symbols of recorded or derived signals.

    Parameters
    ----------
    *names : str
        As in a recording's columns, or those derived from them.

    Returns
    -------
    tuple of Symbol
        Real symbols of these names.

    Examples
    --------
    >>> import truewrench as tw
    >>> tw.signals("phi", "dphi")
    (phi, dphi)
    """
    return tuple(sp.Symbol(name, real=True) for name in names)


def vector(*components: sp.Expr) -> sp.Matrix:
    """Column vector of three expressions."""
    return sp.Matrix(3, 1, list(components))


@dataclass(frozen=True)
class SensorMotion:
    """Symbolic motion of the sensor: rotation matrix and 3-vectors.

    `rotation` maps sensor axes to world axes; `omega`, `alpha` (rad/s, rad/s²) in the sensor frame; `position`,
    `velocity`, `acceleration` (m, m/s, m/s², kinematic) of the sensor origin in the world.
    """

    rotation: sp.Matrix
    omega: sp.Matrix
    alpha: sp.Matrix
    position: sp.Matrix
    velocity: sp.Matrix
    acceleration: sp.Matrix


class Space(Enum):
    """Planar or three-dimensional motion of the sensor.

    In the plane the sensor axes are e1 = x', e2 = -y', e3 = e1 x e2 (away from the viewer, so that positive
    rotation is clockwise): the right-handed axes in which 22.8 is the wrench on the tool. Its three channels are
    the first two forces and the third torque of the Newton-Euler wrench that a six-axis sensor measures.
    Equation numbers are those of chapter 22, "Characterization of the Dynamical Model of a Force Sensor for Robot
    Manipulators" (Bassi et al.).
    """

    PLANE = 2
    SPACE = 3

    @property
    def channels(self) -> tuple[str, ...]:
        """The names of the wrench's channels, forces first."""
        return ("fx", "fy", "tau") if self is Space.PLANE else ("fx", "fy", "fz", "tx", "ty", "tz")

    @property
    def units(self) -> tuple[str, ...]:
        """The unit of each channel."""
        forces = self.value
        return (FORCE_UNIT,) * forces + (TORQUE_UNIT,) * (len(self.channels) - forces)

    @property
    def channel_units(self) -> dict[str, str]:
        """The unit of each channel, by its name."""
        return dict(zip(self.channels, self.units, strict=True))

    @property
    def rows(self) -> tuple[int, ...]:
        """Indices of the measured components among the six (force, torque)."""
        return (0, 1, 5) if self is Space.PLANE else (0, 1, 2, 3, 4, 5)

    @property
    def turns(self) -> tuple[int, ...]:
        """Indices of the sensor axes about which the sensor can rotate."""
        return (2,) if self is Space.PLANE else (0, 1, 2)

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the world axes."""
        return ("x", "y") if self is Space.PLANE else ("x", "y", "z")

    @cached_property
    def tip_axis(self) -> sp.Matrix:
        """Unit vector along the tip in the sensor frame: y' in the plane, the sensor's z axis in six axes."""
        return vector(0, -1, 0) if self is Space.PLANE else vector(0, 0, 1)

    @cached_property
    def up(self) -> sp.Matrix:
        """Unit vector opposite to gravity in the world: y in the plane, z in six axes."""
        return vector(0, 1, 0) if self is Space.PLANE else vector(0, 0, 1)

    @cached_property
    def motion(self) -> SensorMotion:
        """The sensor's motion in terms of this space's signals."""
        return _planar_motion() if self is Space.PLANE else _spatial_motion()


def _planar_motion() -> SensorMotion:
    phi, dphi, ddphi, px, py, vx, vy, ax, ay = signals("phi", "dphi", "ddphi", "px", "py", "vx", "vy", "ax", "ay")
    x_axis = vector(sp.cos(phi), -sp.sin(phi), 0)
    y_axis = vector(-sp.sin(phi), -sp.cos(phi), 0)
    return SensorMotion(
        rotation=sp.Matrix.hstack(x_axis, y_axis, vector(0, 0, -1)),
        omega=vector(0, 0, dphi),
        alpha=vector(0, 0, ddphi),
        position=vector(px, py, 0),
        velocity=vector(vx, vy, 0),
        acceleration=vector(ax, ay, 0),
    )


def _spatial_motion() -> SensorMotion:
    x, y, z, w = signals("qx", "qy", "qz", "qw")
    rotation = sp.Matrix(
        [
            [1 - 2 * (y**2 + z**2), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x**2 + z**2), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x**2 + y**2)],
        ]
    )
    return SensorMotion(
        rotation=rotation,
        omega=vector(*signals("wx", "wy", "wz")),
        alpha=vector(*signals("alx", "aly", "alz")),
        position=vector(*signals("px", "py", "pz")),
        velocity=vector(*signals("vpx", "vpy", "vpz")),
        acceleration=vector(*signals("apx", "apy", "apz")),
    )


def rotation_matrix(space: Space, angles: tuple[sp.Expr, ...]) -> sp.Matrix:
    """Rotation by the space's angles (rad): one about e3 in the plane, roll, pitch and yaw about x, y, z in six axes.

    In six axes R = Rz(yaw) Ry(pitch) Rx(roll).
    """
    rotation = sp.eye(3)
    for axis, angle in zip(space.turns, angles, strict=True):
        rotation = _about(axis, angle) * rotation
    return rotation


def _about(axis: int, angle: sp.Expr) -> sp.Matrix:
    first, second = (axis + 1) % 3, (axis + 2) % 3
    rotation = sp.eye(3)
    rotation[first, first] = rotation[second, second] = sp.cos(angle)
    rotation[second, first], rotation[first, second] = sp.sin(angle), -sp.sin(angle)
    return rotation
