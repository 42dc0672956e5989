"""What MuJoCo builds, and what it says of a motion."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Self

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

Array = npt.NDArray[np.float64]
Vector = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """What MuJoCo builds.

    links           lengths of the planar chain, m; empty: a carriage of three slides and three hinges
    joint_offsets   true minus recorded coordinate
    gravity         in the world, m/s²
    mass, first_moment, inertia   of the tool about the sensor origin, in its frame: kg, kg m, kg m²
    sensor_turn     rotation from the sensor's true axes to those that it should have
    payloads        (mass, distance along the tip) of point masses on the tool
    tip_axis        unit vector in the tool's frame
    """

    links: tuple[float, ...]
    joint_offsets: Array
    gravity: Array
    mass: float
    first_moment: Array
    inertia: Array
    tip_axis: Array
    sensor_turn: Rotation = field(default_factory=Rotation.identity)
    payloads: tuple[tuple[float, float], ...] = ()

    @property
    def planar(self) -> bool:
        """Whether the rig moves in the plane only."""
        return bool(self.links)

    def xml(self, points: Sequence[float]) -> str:
        """The MuJoCo model, with a site at each of `points`, distances along the tip in m."""
        sites = "".join(f'<site name="p{i}" pos="{_numbers(d * self.tip_axis)}"/>' for i, d in enumerate(points))
        sensors = "".join(
            f'<framepos objtype="site" objname="p{i}"/><framelinvel objtype="site" objname="p{i}"/>'
            for i in range(len(points))
        )
        return (
            f'<mujoco><compiler angle="radian"/><option gravity="{_numbers(self.gravity)}"/><worldbody>'
            + (self._arm(sites) if self.planar else self._carriage(sites))
            + '</worldbody><sensor><force site="sensor"/><torque site="sensor"/>'
            '<framepos objtype="xbody" objname="tool"/><framequat objtype="xbody" objname="tool"/>'
            '<frameangvel objtype="xbody" objname="tool"/><framepos objtype="body" objname="tool"/>'
            f"{sensors}</sensor></mujoco>"
        )

    def _arm(self, sites: str) -> str:
        """Hinges about +y; at the end the tool, its axes e1 = x, e2 = -z, e3 = y of the last link."""
        starts = (0.0, *self.links[:-1])
        opened = "".join(
            f'<body pos="0 0 {float(length)!r}"><joint type="hinge" axis="0 1 0"/>{_LINK_BODY}' for length in starts
        )
        tool = self._tool(Rotation.from_euler("x", -np.pi / 2), (0.0, 0.0, self.links[-1]), sites)
        return opened + tool + "</body>" * len(self.links)

    def _carriage(self, sites: str) -> str:
        """Three slides along and three hinges about x, y, z, one after the other."""
        slides = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in _AXES)
        hinges = "".join(f'<joint type="hinge" axis="{axis}"/>' for axis in _AXES)
        tool = self._tool(Rotation.identity(), (0.0, 0.0, 0.0), sites)
        return f"<body>{slides}{hinges}{_LINK_BODY}{tool}</body>"

    def _tool(self, turn: Rotation, position: Vector, sites: str) -> str:
        centre = self.first_moment / self.mass
        about_centre = self.inertia - self.mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
        entries = about_centre[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        payloads = "".join(
            f'<body pos="{_numbers(distance * self.tip_axis)}">'
            f'<inertial pos="0 0 0" mass="{float(mass)!r}" diaginertia="1e-12 1e-12 1e-12"/></body>'
            for mass, distance in self.payloads
        )
        return (
            f'<body name="tool" pos="{_numbers(position)}" quat="{_quaternion(turn)}">'
            f'<inertial pos="{_numbers(centre)}" mass="{float(self.mass)!r}" fullinertia="{_numbers(entries)}"/>'
            f'<site name="sensor" quat="{_quaternion(self.sensor_turn)}"/>{sites}{payloads}</body>'
        )


_AXES = ("1 0 0", "0 1 0", "0 0 1")
_LINK_BODY = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'


def _numbers(values: Iterable[float]) -> str:
    return " ".join(repr(float(v)) for v in values)


def _quaternion(turn: Rotation) -> str:
    """MuJoCo's order, w x y z."""
    return _numbers(turn.as_quat(scalar_first=True))


@dataclass(frozen=True, kw_only=True, eq=False)
class Track:
    """What MuJoCo says of a motion, N samples, in the world unless stated.

    time (N,) s; origin (N, 3) m of the sensor; turn, the rotations from the sensor's nominal axes to the
    world; spin (N, 3) rad/s; centre (N, 3) m of mass; point and velocity (N, 3), m and m/s, of the point
    that a load attacks; wrench (N, 6), N and N m, that the sensor exerts on the tool, in the sensor's true
    axes.
    """

    time: Array
    origin: Array
    turn: Rotation
    spin: Array
    centre: Array
    point: Array
    velocity: Array
    wrench: Array

    @classmethod
    def of(cls, rows: Array, time: Array, place: int = 0) -> Self:
        """The rows of `mujoco_rows` by name; `place` is the index of the attacked point."""
        point = 19 + 6 * place
        return cls(
            time=time,
            origin=rows[:, 6:9],
            turn=Rotation.from_quat(rows[:, 9:13], scalar_first=True),
            spin=rows[:, 13:16],
            centre=rows[:, 16:19],
            point=rows[:, point : point + 3],
            velocity=rows[:, point + 3 : point + 6],
            wrench=rows[:, :6],
        )

    def instant(self, share: float) -> float:
        """A share of the record's duration, s."""
        return float(share * (self.time[-1] - self.time[0]))


def mujoco_rows(
    scene: Scene, points: Sequence[float], states: tuple[Array, Array, Array], pushes: Array | None
) -> Array:
    """MuJoCo's sensors, a row a sample, for prescribed q, dq, ddq and external wrenches (N, 6) on the
    tool.
    """
    import mujoco

    model = mujoco.MjModel.from_xml_string(scene.xml(points))
    data = mujoco.MjData(model)
    tool = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, "tool")
    rows: Array = np.empty((len(states[0]), model.nsensordata))
    qpos, qvel, qacc, felt, push = data.qpos, data.qvel, data.qacc, data.sensordata, data.xfrc_applied[tool]
    for i, (q, dq, ddq) in enumerate(zip(*states, strict=True)):
        qpos[:], qvel[:], qacc[:] = q, dq, ddq
        if pushes is not None:
            push[:] = pushes[i]
        mujoco.mj_inverse(model, data)
        rows[i] = felt
    return rows
