"""MuJoCo model of a rig, and its inverse dynamics along a motion."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Self

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

Array = npt.NDArray[np.float64]
Vector = tuple[float, float, float]
States = tuple[Array, Array, Array]
"""Coordinates (N, n), their rates and their accelerations."""
Mount = tuple[Vector, tuple[float, float, float, float]]
"""Place (m) of a frame in another, and its turn as a quaternion x, y, z, w."""
Chain = Sequence[tuple[Mount, Vector, bool]]
"""From the world on, each joint's place in the frame that the one before it moves, its axis, and whether it slides."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """Description of the MuJoCo model.

    links           lengths of the planar chain, m; empty: a carriage of three slides and three hinges
    joint_offsets   true minus recorded coordinate
    gravity         in the world, m/s²
    mass, first_moment, inertia   of the tool about the sensor origin, in its frame: kg, kg m, kg m²
    sensor_turn     rotation from the sensor's true axes to its nominal ones
    payloads        (mass, point in the tool's frame) of point masses on the tool, kg and m
    tip_axis        unit vector in the tool's frame
    flexible        whether the tool is on a ball joint at the sensor origin; the sensor is on the robot's side of it
    """

    links: tuple[float, ...]
    joint_offsets: Array
    gravity: Array
    mass: float
    first_moment: Array
    inertia: Array
    tip_axis: Array
    sensor_turn: Rotation = field(default_factory=Rotation.identity)
    payloads: tuple[tuple[float, Vector], ...] = ()
    flexible: bool = False

    @property
    def planar(self) -> bool:
        """Whether the rig moves in the plane only."""
        return bool(self.links)

    def point(self, x: float, y: float, d: float) -> Vector:
        """The point (m) at `d` along the tip and, in six axes, `x` and `y` beside it, in the tool's frame."""
        if self.planar and (x or y):
            raise ValueError(f"in the plane a point is on the tip axis; got x = {x}, y = {y}")
        along = d * self.tip_axis
        return float(along[0]) + x, float(along[1]) + y, float(along[2])

    def xml(self, points: Sequence[Vector], frames: Sequence[tuple[str, str]] = ()) -> str:
        """The MuJoCo model, with a site at each of `points`, in m in the tool's frame.

        `frames` adds sensors of position, velocity and acceleration of (kind, object).
        """
        sites = "".join(f'<site name="p{i}" pos="{_numbers(point)}"/>' for i, point in enumerate(points))
        sensors = "".join(
            f'<framepos objtype="site" objname="p{i}"/><framelinvel objtype="site" objname="p{i}"/>'
            for i in range(len(points))
        )
        frame_sensors = "".join(
            f'<{sensor} objtype="{kind}" objname="{name}"/>'
            for kind, name in frames
            for sensor in ("framepos", "framelinvel", "framelinacc")
        )
        return (
            f'<mujoco><compiler angle="radian"/><option gravity="{_numbers(self.gravity)}"/><worldbody>'
            + (self._arm(sites) if self.planar else self._carriage(sites))
            + '</worldbody><sensor><force site="sensor"/><torque site="sensor"/>'
            '<framepos objtype="xbody" objname="tool"/><framequat objtype="xbody" objname="tool"/>'
            '<frameangvel objtype="xbody" objname="tool"/><framepos objtype="body" objname="tool"/>'
            f"{sensors}{frame_sensors}</sensor></mujoco>"
        )

    def _arm(self, sites: str) -> str:
        """Hinges about +y; the tool at the end, its axes e1 = x, e2 = -z, e3 = y of the last link."""
        starts = (0.0, *self.links[:-1])
        opened = "".join(
            f'<body name="link{j}" pos="0 0 {float(length)!r}"><joint type="hinge" axis="0 1 0"/>{_LINK_BODY}'
            for j, length in enumerate(starts)
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
            f'<body name="payload{i}" pos="{_numbers(point)}">'
            f'<inertial pos="0 0 0" mass="{float(mass)!r}" diaginertia="1e-12 1e-12 1e-12"/></body>'
            for i, (mass, point) in enumerate(self.payloads)
        )
        mount = f'pos="{_numbers(position)}" quat="{_quaternion(turn)}"'
        sensor = f'<site name="sensor" quat="{_quaternion(self.sensor_turn)}"/>'
        matter = f'<inertial pos="{_numbers(centre)}" mass="{float(self.mass)!r}" fullinertia="{_numbers(entries)}"/>'
        if self.flexible:
            tool = f'<body name="tool"><joint type="ball"/>{matter}{sites}{payloads}</body>'
            return f'<body name="plate" {mount}>{sensor}{tool}</body>'
        return f'<body name="tool" {mount}>{matter}{sensor}{sites}{payloads}</body>'


@dataclass(frozen=True, kw_only=True, eq=False)
class ChainScene(Scene):
    """The tool at the end of any chain of joints, in place of the carriage.

    mount   of the tool in the frame that the last joint moves
    """

    chain: Chain
    mount: Mount

    def _carriage(self, sites: str) -> str:
        opened = "".join(
            f'<body pos="{_numbers(place)}" quat="{_quaternion(Rotation.from_quat(turn))}">'
            f'<joint type="{"slide" if slides else "hinge"}" axis="{_numbers(axis)}"/>{_LINK_BODY}'
            for (place, turn), axis, slides in self.chain
        )
        place, turn = self.mount
        return opened + self._tool(Rotation.from_quat(turn), place, sites) + "</body>" * len(self.chain)


_AXES = ("1 0 0", "0 1 0", "0 0 1")
_LINK_BODY = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'


def _numbers(values: Iterable[float]) -> str:
    return " ".join(repr(float(v)) for v in values)


def _quaternion(turn: Rotation) -> str:
    """MuJoCo's order, w x y z."""
    return _numbers(turn.as_quat(scalar_first=True))


@dataclass(frozen=True, kw_only=True, eq=False)
class Track:
    """MuJoCo's kinematics and wrench along a motion, N samples, in the world frame unless stated.

    time (N,) s; origin (N, 3) m of the sensor; turn, the rotations from the sensor's nominal axes to the
    world; spin (N, 3) rad/s; centre (N, 3) m of mass; point and velocity (N, 3), m and m/s, of the point
    of application of a load; wrench (N, 6), N and N m, that the sensor exerts on the tool, in the sensor's true
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
        """The rows of `mujoco_rows` by name; `place` is the index of the point of application."""
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
        """Time at a share of the record's duration, s."""
        return float(share * (self.time[-1] - self.time[0]))


def mujoco_rows(scene: Scene, points: Sequence[Vector], states: States, pushes: Array | None) -> Array:
    """MuJoCo's sensor data, a row per sample, for prescribed q, dq, ddq and external wrenches (N, 6) on the tool."""
    return _sensor_rows(scene.xml(points), states, pushes)


def mujoco_frames(scene: Scene, frames: Sequence[tuple[str, str]], states: States) -> Array:
    """Position, velocity and acceleration (m, m/s, m/s²; world) of (kind, object) `frames`, (N, frames, 3, 3).

    MuJoCo adds an upward acceleration for gravity: only differences of accelerations are meaningful.
    """
    rows = _sensor_rows(scene.xml((), frames), states, None)
    return rows[:, -9 * len(frames) :].reshape(len(rows), len(frames), 3, 3)


def _sensor_rows(xml: str, states: States, pushes: Array | None) -> Array:
    import mujoco

    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    tool = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, "tool")
    rows: Array = np.empty((len(states[0]), model.nsensordata))
    qpos, qvel, qacc, sensed, push = data.qpos, data.qvel, data.qacc, data.sensordata, data.xfrc_applied[tool]
    for i, (q, dq, ddq) in enumerate(zip(*states, strict=True)):
        qpos[:], qvel[:], qacc[:] = q, dq, ddq
        if pushes is not None:
            push[:] = pushes[i]
        mujoco.mj_inverse(model, data)
        rows[i] = sensed
    return rows
