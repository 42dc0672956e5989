"""A rig that is simulated: a robot, a tool and a force/torque sensor in MuJoCo, with physics hidden in it.

It is the oracle of this project and shares no equation with `modeling`. A motion is prescribed; MuJoCo's
inverse dynamics give what a force and a torque sensor at the wrist feel. Loads on the tool (drag, tether,
magnet) are computed from MuJoCo's own position and velocity of the point that they attack, and put on the
tool's body as an external wrench, because MuJoCo's forces in joint space never reach a force sensor.

World: z up, the plane is x right and z up. The tool's frame is the sensor's: in the plane e1 = x', e2 = -y',
e3 = e1 x e2, into the page, so that positive rotation is clockwise and the tip points along -e2; in six axes
the tip points along +e3. SI units throughout. MuJoCo is imported when something is simulated, not before.
"""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Protocol, Self

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from design.fourier import FourierMotion, random_motion

Array = npt.NDArray[np.float64]
Vector = tuple[float, float, float]

PLANAR_CHANNELS = ("fx", "fy", "tau")
SPATIAL_CHANNELS = ("fx", "fy", "fz", "tx", "ty", "tz")
OVERSAMPLING = 10
"""Points to a sample when an effect has memory: a lag's input is taken as straight between them."""

CONTACT_EDGE = 0.01
"""How long a push takes to rise and to fall, s."""


class PeriodicMotion(Protocol):
    """A motion of the rig's coordinates that repeats; `design.fourier.FourierMotion` is one."""

    @property
    def period(self) -> float:
        """Seconds."""

    def evaluate(self, time: Array) -> tuple[Array, Array, Array]:
        """q, dq, ddq, each (N, n), at the times (N,)."""


# ------------------------------------------------------------------------------------------ the scene


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
            f'<body pos="0 0 {length!r}"><joint type="hinge" axis="0 1 0"/>{_LINK_BODY}' for length in starts
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
            f'<inertial pos="0 0 0" mass="{mass!r}" diaginertia="1e-12 1e-12 1e-12"/></body>'
            for mass, distance in self.payloads
        )
        return (
            f'<body name="tool" pos="{_numbers(position)}" quat="{_quaternion(turn)}">'
            f'<inertial pos="{_numbers(centre)}" mass="{self.mass!r}" fullinertia="{_numbers(entries)}"/>'
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


def _mujoco_rows(
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


def _track(rows: Array, time: Array, place: int = 0) -> Track:
    """The rows of `_mujoco_rows` by name; `place` is the index of the attacked point."""
    point = 19 + 6 * place
    return Track(
        time=time,
        origin=rows[:, 6:9],
        turn=Rotation.from_quat(rows[:, 9:13], scalar_first=True),
        spin=rows[:, 13:16],
        centre=rows[:, 16:19],
        point=rows[:, point : point + 3],
        velocity=rows[:, point + 3 : point + 6],
        wrench=rows[:, :6],
    )


def felt_wrench(scene: Scene, loads: Sequence[ToolLoad], time: Array, states: tuple[Array, Array, Array]) -> Array:
    """The wrench (N, 6) that the sensor exerts on the tool, in the sensor's true axes, under the given loads.

    The first run gives the state of each attacked point, the second one feels the loads. MuJoCo wants an
    external wrench at the body's centre of mass.
    """
    points = [load.d for load in loads]
    actual = (states[0] + scene.joint_offsets, states[1], states[2])
    rows = _mujoco_rows(scene, points, actual, None)
    if not loads:
        return rows[:, :6]
    pushes = np.zeros((len(time), 6))
    for place, load in enumerate(loads):
        track = _track(rows, time, place)
        force, torque = load.push(track)
        pushes[:, :3] += force
        pushes[:, 3:] += torque + np.cross(track.point - track.centre, force)
    return _mujoco_rows(scene, points, actual, pushes)[:, :6]


# ----------------------------------------------------------------------------------- hidden effects


class HiddenEffect(ABC):
    """A piece of physics that a rig has and nobody knows of.

    `id` is the catalogue's (FORMATS.md) where `catalogued`; the fields carry the names and signs of its
    parameters there, so that a diagnosis can be compared with them.
    """

    id: ClassVar[str]
    catalogued: ClassVar[bool] = True
    planar_only: ClassVar[bool] = False
    needs_motion: ClassVar[bool] = False
    """Has nothing to act on in poses at rest."""

    def placed(self, track: Track) -> Self:
        """The effect with its open places and times filled in, to suit the record of `track`."""
        return self


class SceneChange(HiddenEffect):
    """An effect that changes what MuJoCo builds."""

    @abstractmethod
    def changed(self, scene: Scene) -> Scene:
        """The scene with the effect in it."""


class ToolLoad(HiddenEffect):
    """A force and a torque on the tool at the distance `d` (m) along the tip."""

    d: float

    @abstractmethod
    def push(self, track: Track) -> tuple[Array, Array]:
        """Force (N) at the point and torque (N m) about it, on the tool, in the world, each (N, 3)."""


class Event(HiddenEffect):
    """An effect of a part of the record only; it is a SceneChange or a ToolLoad besides."""

    needs_motion = True

    @abstractmethod
    def active(self, time: Array) -> npt.NDArray[np.bool_]:
        """When it is there."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Signal:
    """A wrench on its way through the sensor.

    record (N, p); before (M, p) one period of the motion that went on before the record; step s between
    samples.
    """

    channels: tuple[str, ...]
    record: Array
    before: Array
    step: float

    def forces(self) -> npt.NDArray[np.bool_]:
        """Which channels are forces."""
        return np.array([c.startswith("f") for c in self.channels])

    def amounts(self, force: float, torque: float) -> Array:
        """One number for each force channel (N) and one for each torque channel (N m)."""
        return np.where(self.forces(), force, torque)

    def mapped(self, memoryless: Any) -> Signal:
        """The signal after a function of the sample."""
        return replace(self, record=memoryless(self.record), before=memoryless(self.before))


class SensorEffect(HiddenEffect):
    """An effect between the wrench and the reading; `order` is its place in the chain."""

    order: ClassVar[int]
    has_memory: ClassVar[bool] = False

    @abstractmethod
    def through(self, signal: Signal) -> Signal:
        """The signal after it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Clock:
    """The time (s) and the true temperature (°C) of each sample, and the channels' names."""

    time: Array
    temperature: Array
    channels: tuple[str, ...]

    def amounts(self, force: float, torque: float) -> Array:
        """One number for each force channel (N) and one for each torque channel (N m)."""
        return np.where([c.startswith("f") for c in self.channels], force, torque)


class ZeroShift(HiddenEffect):
    """An effect that is added to the readings at the end."""

    @abstractmethod
    def shift(self, clock: Clock, rng: np.random.Generator) -> Array:
        """What is added, (N, p), N and N m."""


# joints, kinematics, tip body, mounting


@dataclass(frozen=True, kw_only=True)
class JointOffset(SceneChange):
    """Joint number `joint` (from 1) stands at its recorded angle plus `offset` (rad)."""

    id = "joint_offset"
    planar_only = True
    joint: int = 2
    offset: float = 0.02

    def changed(self, scene: Scene) -> Scene:
        """Shift one joint."""
        offsets = scene.joint_offsets.copy()
        offsets[self.joint - 1] += self.offset
        return replace(scene, joint_offsets=offsets)


@dataclass(frozen=True, kw_only=True)
class LinkLengthError(SceneChange):
    """Link number `link` (from 1) is longer than the rig's description says by `error` (m)."""

    id = "link_length_error"
    planar_only = True
    link: int = 2
    error: float = 0.03

    def changed(self, scene: Scene) -> Scene:
        """Stretch one link."""
        lengths = list(scene.links)
        lengths[self.link - 1] += self.error
        return replace(scene, links=tuple(lengths))


@dataclass(frozen=True, kw_only=True)
class CentreOfMassOffset(SceneChange):
    """The planar tool's first moment has `mlx` (kg m) along x'; its inertia about the sensor stays."""

    id = "com_offset"
    planar_only = True
    mlx: float = 0.008

    def changed(self, scene: Scene) -> Scene:
        """Move the mass aside."""
        return replace(scene, first_moment=scene.first_moment + np.array([self.mlx, 0.0, 0.0]))


@dataclass(frozen=True, kw_only=True)
class GravityTilt(SceneChange):
    """Gravity is turned about the world's x, then y (rad, right-handed).

    In the plane tilt_y is the angle, positive clockwise, and tilt_x has to be zero.
    """

    id = "gravity_tilt"
    tilt_x: float = 0.0
    tilt_y: float = 0.03

    def changed(self, scene: Scene) -> Scene:
        """Turn MuJoCo's gravity."""
        _stay_in_plane(scene, self, tilt_x=self.tilt_x)
        turn = Rotation.from_euler("xyz", [self.tilt_x, self.tilt_y, 0.0])
        return replace(scene, gravity=np.asarray(turn.apply(scene.gravity)))


@dataclass(frozen=True, kw_only=True)
class SensorRotation(SceneChange):
    """The sensor is mounted turned by Rz(yaw) Ry(pitch) Rx(roll) (rad) against the frame of the motion.

    In the plane yaw is the angle about e3, positive clockwise, and the others have to be zero. Its bias does
    not turn.
    """

    id = "sensor_rotation"
    roll: float = 0.0
    pitch: float = 0.0
    yaw: float = 0.03

    def changed(self, scene: Scene) -> Scene:
        """Turn the sensor's site."""
        _stay_in_plane(scene, self, roll=self.roll, pitch=self.pitch)
        turn = Rotation.from_euler("xyz", [self.roll, self.pitch, self.yaw])
        return replace(scene, sensor_turn=scene.sensor_turn * turn)


@dataclass(frozen=True, kw_only=True)
class PayloadChange(SceneChange, Event):
    """A point mass (kg) appears on the tool at `d` (m) at `time` (s; open: at 40 % of the record)."""

    id = "payload_change"
    mass: float = 0.05
    d: float = 0.12
    time: float | None = None

    def placed(self, track: Track) -> Self:
        """At 40 % of the record."""
        return self if self.time is not None else replace(self, time=_instant(track, 0.4))

    def changed(self, scene: Scene) -> Scene:
        """Hang the mass on the tool."""
        return replace(scene, payloads=(*scene.payloads, (self.mass, self.d)))

    def active(self, time: Array) -> npt.NDArray[np.bool_]:
        """From `time` on."""
        return np.asarray(time >= (np.inf if self.time is None else self.time))


# loads on the tool


@dataclass(frozen=True, kw_only=True)
class ViscousDrag(ToolLoad):
    """-c v at d: c in N s/m, d in m."""

    id = "viscous_drag"
    needs_motion = True
    c: float = 0.15
    d: float = 0.12

    def push(self, track: Track) -> tuple[Array, Array]:
        """Against the velocity of the point."""
        return -self.c * track.velocity, np.zeros_like(track.velocity)


@dataclass(frozen=True, kw_only=True)
class QuadraticDrag(ToolLoad):
    """-c |v| v at d: c in N s²/m², d in m."""

    id = "quadratic_drag"
    needs_motion = True
    c: float = 0.08
    d: float = 0.12

    def push(self, track: Track) -> tuple[Array, Array]:
        """Against the velocity of the point, with the square of the speed."""
        speed = np.linalg.norm(track.velocity, axis=1, keepdims=True)
        return -self.c * speed * track.velocity, np.zeros_like(track.velocity)


@dataclass(frozen=True, kw_only=True)
class CoulombFriction(ToolLoad):
    """A hose rubs at the wrist: a torque of size `level` (N m) against the tool's rotation in the world."""

    id = "coulomb_friction"
    needs_motion = True
    level: float = 0.03
    d: float = 0.0

    def push(self, track: Track) -> tuple[Array, Array]:
        """Against the spin, at rest nothing."""
        size = np.linalg.norm(track.spin, axis=1, keepdims=True)
        direction = np.divide(track.spin, size, out=np.zeros_like(track.spin), where=size > 0)
        return np.zeros_like(track.spin), -self.level * direction


@dataclass(frozen=True, kw_only=True)
class CableSpring(ToolLoad):
    """A tether pulls the point at d towards an anchor with k (distance - length), slack below `length`.

    k in N/m, the rest in m; the anchor is x, y, z of MuJoCo's world (`PlanarRig.in_world` of a point in the
    plane). Left open, the anchor lies beyond the path and the tether is taut in half of the samples.
    """

    id = "cable_spring"
    k: float = 3.0
    anchor: Vector | None = None
    length: float | None = None
    d: float = 0.12

    def placed(self, track: Track) -> Self:
        """Beyond the path's far end by half of its length."""
        middle, direction, reach = _main_direction(track.point)
        anchor = self.anchor or _vector(middle + 2 * reach * direction)
        distance = np.linalg.norm(track.point - np.array(anchor), axis=1)
        length = float(np.median(distance)) if self.length is None else self.length
        return replace(self, anchor=anchor, length=length)

    def push(self, track: Track) -> tuple[Array, Array]:
        """Towards the anchor when taut, else nothing."""
        if self.anchor is None or self.length is None:
            raise _open(self)
        way = np.array(self.anchor) - track.point
        distance = np.linalg.norm(way, axis=1, keepdims=True)
        tension = self.k * np.maximum(distance - self.length, 0.0)
        return tension * way / distance, np.zeros_like(way)


@dataclass(frozen=True, kw_only=True)
class ContactEvent(ToolLoad, Event):
    """Something pushes the tool at the sensor origin from `start` to `end` (s).

    Left open, it lasts a tenth of the record, from 55 % of it on.
    force (N) and torque (N m, about the sensor origin) are the environment's on the tool in the sensor's
    nominal axes: in the plane (fcx, -fcy, 0) and (0, 0, tauc). They rise and fall over 10 ms, half of it
    before `start`.
    """

    id = "contact_event"
    force: Vector = (4.0, -2.0, 0.0)
    torque: Vector = (0.0, 0.0, 0.3)
    start: float | None = None
    end: float | None = None
    d: float = 0.0

    def placed(self, track: Track) -> Self:
        """A tenth of the record, from 55 % of it on."""
        start = _instant(track, 0.55) if self.start is None else self.start
        end = start + _instant(track, 0.1) if self.end is None else self.end
        return replace(self, start=start, end=end)

    def push(self, track: Track) -> tuple[Array, Array]:
        """In the tool's axes, scaled by the envelope."""
        envelope = self._envelope(track.time)[:, None]
        return envelope * track.turn.apply(self.force), envelope * track.turn.apply(self.torque)

    def active(self, time: Array) -> npt.NDArray[np.bool_]:
        """Where the envelope is not zero."""
        return self._envelope(time) > 0

    def _envelope(self, time: Array) -> Array:
        if self.start is None or self.end is None:
            raise _open(self)
        inside = np.minimum(time - self.start, self.end - time) / CONTACT_EDGE + 0.5
        return np.asarray(np.sin(np.clip(inside, 0.0, 1.0) * np.pi / 2) ** 2)


# the sensor


@dataclass(frozen=True, kw_only=True)
class SensorGain(SensorEffect):
    """Each channel named reads (1 + error) times what it should; errors as (channel, error)."""

    id = "sensor_gain"
    order = 0
    errors: tuple[tuple[str, float], ...] = (("fy", 0.03),)

    def through(self, signal: Signal) -> Signal:
        """Scale channels."""
        errors = dict(self.errors)
        _known(self, errors, signal.channels)
        gains = np.array([1 + errors.get(c, 0.0) for c in signal.channels])
        return signal.mapped(lambda wrench: wrench * gains)


@dataclass(frozen=True, kw_only=True)
class SensorCrosstalk(SensorEffect):
    """Channels leak: (into, out_of, gain) adds gain times the true channel `out_of` to the reading `into`."""

    id = "sensor_crosstalk"
    order = 1
    leaks: tuple[tuple[str, str, float], ...] = (("fy", "fx", 0.04),)

    def through(self, signal: Signal) -> Signal:
        """Mix channels."""
        names = signal.channels
        _known(self, (name for leak in self.leaks for name in leak[:2]), names)
        matrix = np.eye(len(names))
        for into, out_of, gain in self.leaks:
            matrix[names.index(into), names.index(out_of)] += gain
        return signal.mapped(lambda wrench: wrench @ matrix.T)


@dataclass(frozen=True, kw_only=True)
class GainNonlinearity(SensorEffect):
    """Each force channel reads w + quadratic w² + cubic w³: 1/N and 1/N²."""

    id = "gain_nonlinearity"
    order = 2
    quadratic: float = 1.5e-3
    cubic: float = 0.0

    def through(self, signal: Signal) -> Signal:
        """Bend the forces."""
        square, cube = signal.amounts(self.quadratic, 0.0), signal.amounts(self.cubic, 0.0)
        return signal.mapped(lambda w: w + square * w**2 + cube * w**3)


@dataclass(frozen=True, kw_only=True)
class SensorHysteresis(SensorEffect):
    """Play between load and reading, of half-width `force` (N) and `torque` (N m) in the channels.

    The reading follows the load only when the load reaches an end of the play.
    """

    id = "sensor_hysteresis"
    order = 3
    has_memory = True
    force: float = 0.25
    torque: float = 0.01

    def through(self, signal: Signal) -> Signal:
        """Take the play up over the period before, then through the record."""
        width = signal.amounts(self.force, self.torque)
        settled = _play(signal.before, width, signal.before[0])
        before = _play(signal.before, width, settled[-1])
        return replace(signal, before=before, record=_play(signal.record, width, before[-1]))


@dataclass(frozen=True, kw_only=True)
class SensorLag(SensorEffect):
    """A first-order low-pass, time_constant dy/dt = wrench - y (s), in its periodic state from the beginning.

    Exact for a wrench that is straight between the points of the oversampled grid.
    """

    id = "sensor_lag"
    order = 4
    has_memory = True
    needs_motion = True
    time_constant: float = 0.02

    def through(self, signal: Signal) -> Signal:
        """Filter the period before, then the record.

        Over one step h the input goes from u to v and y becomes a y + old u + new v, with a = exp(-h / T),
        new = 1 - (1 - a) T / h, old = 1 - a - new. The periodic state repeats after the period's steps.
        """
        share = signal.step / self.time_constant
        kept = np.exp(-share)
        new = 1 - (1 - kept) / share
        old = (1 - kept) - new
        b, a = [new, old], [1.0, -kept]
        start = np.zeros((1, signal.before.shape[1]))
        rest = lfilter(b, a, signal.before, axis=0, zi=start)[0]
        ends = rest[-1] * kept + old * signal.before[-1]
        state = (ends / (1 - kept ** len(rest)))[None, :]
        before, after = lfilter(b, a, signal.before, axis=0, zi=state)
        record, _ = lfilter(b, a, signal.record, axis=0, zi=after)
        return replace(signal, before=before, record=record)


@dataclass(frozen=True, kw_only=True)
class TimeDelay(HiddenEffect):
    """The reading at time t is that of the motion at t - delay (s)."""

    id = "time_delay"
    needs_motion = True
    delay: float = 0.012


@dataclass(frozen=True, kw_only=True)
class Saturation(HiddenEffect):
    """Each force channel is clipped at `share` of its own largest |reading|, before the noise is added."""

    id = "saturation"
    share: float = 0.9

    def clipped(self, readings: Array, forces: npt.NDArray[np.bool_]) -> Array:
        """The readings (N, p), clipped."""
        level = np.where(forces, self.share * np.abs(readings).max(axis=0), np.inf)
        return np.clip(readings, -level, level)


# the zero


@dataclass(frozen=True, kw_only=True)
class BiasDrift(ZeroShift):
    """The zero wanders smoothly, by `force` (N) and `torque` (N m) from peak to peak.

    It is a random sum of 1 to 4 half-waves over the record.
    """

    id = "bias_drift"
    force: float = 0.6
    torque: float = 0.05

    def shift(self, clock: Clock, rng: np.random.Generator) -> Array:
        """Another wander for each channel, zero in the beginning."""
        progress = (clock.time - clock.time[0]) / (np.ptp(clock.time) or 1.0)
        waves = np.cos(np.pi * np.multiply.outer(progress, np.arange(1, 5)))
        wander = waves @ (rng.standard_normal((4, len(clock.channels))) / np.arange(1, 5)[:, None])
        size = np.ptp(wander, axis=0)
        return np.asarray((wander - wander[0]) / size * clock.amounts(self.force, self.torque))


@dataclass(frozen=True, kw_only=True)
class ThermalDrift(ZeroShift):
    """The zero follows the true temperature: force (N/K) and torque (N m/K) times (temperature - 20 °C)."""

    id = "thermal_drift"
    force: float = 0.2
    torque: float = 0.01

    def shift(self, clock: Clock, rng: np.random.Generator) -> Array:
        """Proportional to the temperature."""
        return np.outer(clock.temperature - 20.0, clock.amounts(self.force, self.torque))


@dataclass(frozen=True, kw_only=True)
class LineInterference(ZeroShift):
    """A tone at `frequency` (Hz), not locked to the motion, of `force` (N) and `torque` (N m)."""

    id = "line_interference"
    needs_motion = True
    frequency: float = 17.317
    force: float = 0.2
    torque: float = 0.01

    def shift(self, clock: Clock, rng: np.random.Generator) -> Array:
        """One sine per channel."""
        phase = rng.uniform(0, 2 * np.pi, len(clock.channels))
        angle = 2 * np.pi * self.frequency * clock.time[:, None] + phase
        return np.asarray(clock.amounts(self.force, self.torque) * np.sin(angle))


# in no catalogue


@dataclass(frozen=True, kw_only=True)
class Buoyancy(ToolLoad):
    """The tool dips into a bath: an upward force from 0 at the surface to `lift` (N) `depth` (m) below it.

    `level` (m, world height of the surface; open: the point's median height), at d (m).
    """

    id = "buoyancy"
    catalogued = False
    lift: float = 2.0
    level: float | None = None
    depth: float = 0.2
    d: float = 0.12

    def placed(self, track: Track) -> Self:
        """The surface at the median height."""
        return self if self.level is not None else replace(self, level=float(np.median(track.point[:, 2])))

    def push(self, track: Track) -> tuple[Array, Array]:
        """Upwards, by how deep the point is."""
        if self.level is None:
            raise _open(self)
        force = np.zeros_like(track.point)
        force[:, 2] = self.lift * np.clip((self.level - track.point[:, 2]) / self.depth, 0.0, 1.0)
        return force, np.zeros_like(force)


@dataclass(frozen=True, kw_only=True)
class Magnet(ToolLoad):
    """A magnet in the world attracts the point at d with strength / distance³ (N m³).

    `place` in m in MuJoCo's world; open: `clearance` (m) beyond the far end of the path.
    """

    id = "magnet"
    catalogued = False
    strength: float = 0.02
    place: Vector | None = None
    clearance: float = 0.15
    d: float = 0.12

    def placed(self, track: Track) -> Self:
        """Beyond the far end of the path."""
        if self.place is not None:
            return self
        middle, direction, _ = _main_direction(track.point)
        far = track.point[np.argmax((track.point - middle) @ direction)]
        return replace(self, place=_vector(far + self.clearance * direction))

    def push(self, track: Track) -> tuple[Array, Array]:
        """Towards the magnet."""
        if self.place is None:
            raise _open(self)
        way = np.array(self.place) - track.point
        distance = np.linalg.norm(way, axis=1, keepdims=True)
        return self.strength * way / distance**4, np.zeros_like(way)


@dataclass(frozen=True, kw_only=True)
class MagnusForce(ToolLoad):
    """The turning tool in its own wind: a force c (spin x velocity) at d; c in kg, d in m."""

    id = "magnus_force"
    catalogued = False
    needs_motion = True
    c: float = 0.06
    d: float = 0.12

    def push(self, track: Track) -> tuple[Array, Array]:
        """Square to the velocity: it does no work."""
        return self.c * np.cross(track.spin, track.velocity), np.zeros_like(track.velocity)


HIDDEN_EFFECTS: Mapping[str, HiddenEffect] = {
    effect.id: effect
    for effect in (
        JointOffset(),
        LinkLengthError(),
        CentreOfMassOffset(),
        GravityTilt(),
        SensorRotation(),
        PayloadChange(),
        ViscousDrag(),
        QuadraticDrag(),
        CoulombFriction(),
        CableSpring(),
        ContactEvent(),
        SensorGain(),
        SensorCrosstalk(),
        GainNonlinearity(),
        SensorHysteresis(),
        SensorLag(),
        TimeDelay(),
        BiasDrift(),
        ThermalDrift(),
        LineInterference(),
        Saturation(),
        Buoyancy(),
        Magnet(),
        MagnusForce(),
    )
}
"""Every effect that a rig can hide, by id, at a size that a record of eight repeats shows."""


def _stay_in_plane(scene: Scene, effect: HiddenEffect, **angles: float) -> None:
    for name, angle in angles.items():
        if scene.planar and angle != 0:
            raise ValueError(f"{effect.id}: {name} = {angle} leaves the plane of a planar rig; set it to 0")


def _known(effect: HiddenEffect, names: Iterable[str], channels: tuple[str, ...]) -> None:
    for name in names:
        if name not in channels:
            raise ValueError(f"{effect.id}: the rig has no channel '{name}'; it has {', '.join(channels)}")


def _open(effect: HiddenEffect) -> ValueError:
    return ValueError(f"{effect.id} has no place or time yet: call `placed` first")


def _vector(values: Array) -> Vector:
    """A place in the world to the micrometre, so that a point of the plane stays in it."""
    x, y, z = (round(float(v), 6) + 0.0 for v in values)
    return x, y, z


def _instant(track: Track, share: float) -> float:
    """A share of the record's duration, s."""
    return float(share * (track.time[-1] - track.time[0]))


def _main_direction(path: Array) -> tuple[Array, Array, float]:
    """The middle of a path (N, 3), the unit vector of its largest extent, and how far it goes that way, m."""
    middle = path.mean(axis=0)
    direction = np.linalg.svd(path - middle, full_matrices=False)[2][0]
    direction = direction * np.sign(direction[np.argmax(np.abs(direction))])
    return middle, direction, float(((path - middle) @ direction).max())


def _play(load: Array, width: Array, start: Array) -> Array:
    """The play operator, by channel: y stays within `width` of the load and moves only when pushed."""
    low, high = load - width, load + width
    followed = np.empty_like(load)
    y = start
    for i in range(len(load)):
        y = np.minimum(np.maximum(y, low[i]), high[i])
        followed[i] = y
    return followed


# -------------------------------------------------------------------------------------------- noise


class NoiseModel(ABC):
    """What a sensor adds to a reading: in each channel an independent random series of unit variance."""

    @abstractmethod
    def draw(self, rng: np.random.Generator, samples: int, channels: int) -> Array:
        """The series, (samples, channels)."""


@dataclass(frozen=True, kw_only=True)
class WhiteNoise(NoiseModel):
    """Independent normal samples."""

    def draw(self, rng: np.random.Generator, samples: int, channels: int) -> Array:
        """Normal."""
        return rng.standard_normal((samples, channels))


@dataclass(frozen=True, kw_only=True)
class AutoregressiveNoise(NoiseModel):
    """x_k = rho x_(k-1) + e_k, stationary from the first sample."""

    rho: float = 0.98

    def draw(self, rng: np.random.Generator, samples: int, channels: int) -> Array:
        """Filtered normal noise that starts in its stationary distribution."""
        shocks = rng.standard_normal((samples, channels)) * np.sqrt(1 - self.rho**2)
        start = self.rho * rng.standard_normal((1, channels))
        return np.asarray(lfilter([1.0], [1.0, -self.rho], shocks, axis=0, zi=start)[0])


@dataclass(frozen=True, kw_only=True)
class PinkNoise(NoiseModel):
    """A spectrum 1 + corner/f, and tones, frequencies as shares of the sampling rate.

    The tones carry `tone_share` of the variance, in equal parts; they are no multiple of the motion's
    frequency.
    """

    corner: float = 0.02
    tones: tuple[float, ...] = (0.1312347, 0.2871113)
    tone_share: float = 0.2

    def draw(self, rng: np.random.Generator, samples: int, channels: int) -> Array:
        """A cut from a periodic series twice as long, so that its ends do not meet."""
        frequency = np.fft.rfftfreq(2 * samples)
        power = 1 + self.corner / np.maximum(frequency, frequency[1])
        power[0] = 0.0
        white = np.fft.rfft(rng.standard_normal((2 * samples, channels)), axis=0)
        series = np.fft.irfft(white * np.sqrt(power / power.mean())[:, None], 2 * samples, axis=0)[:samples]
        phase = rng.uniform(0, 2 * np.pi, (len(self.tones), channels))
        angle = 2 * np.pi * np.multiply.outer(np.arange(samples), self.tones)[:, :, None] + phase
        share = self.tone_share if self.tones else 0.0
        tones = np.sqrt(2 / max(len(self.tones), 1)) * np.sin(angle).sum(axis=1)
        return np.asarray(np.sqrt(1 - share) * series + np.sqrt(share) * tones)


@dataclass(frozen=True, kw_only=True)
class StudentNoise(NoiseModel):
    """Independent samples of Student's t: heavy tails."""

    degrees: float = 4.0

    def draw(self, rng: np.random.Generator, samples: int, channels: int) -> Array:
        """t of variance degrees / (degrees - 2), scaled to one."""
        heavy = rng.standard_t(self.degrees, (samples, channels))
        return np.asarray(heavy * np.sqrt(1 - 2 / self.degrees))


NOISE_MODELS: Mapping[str, NoiseModel] = {
    "white": WhiteNoise(),
    "autoregressive": AutoregressiveNoise(),
    "pink_and_lines": PinkNoise(),
    "student_t": StudentNoise(),
}
"""The noise models by name."""


@dataclass(frozen=True, kw_only=True)
class WarmUp:
    """The sensor's temperature, `start` to `end` (°C) with a time constant (s), logged with noise (°C)."""

    start: float = 22.0
    end: float = 25.0
    time_constant: float = 20.0
    noise: float = 0.05

    def true(self, time: Array) -> Array:
        """The temperature itself, °C."""
        return np.asarray(self.end + (self.start - self.end) * np.exp(-time / self.time_constant))


# -------------------------------------------------------------------------------------------- rigs


@dataclass(frozen=True, kw_only=True)
class Rig(ABC):
    """A robot with a sensor and a tool: what is known of it and what a simulated one needs.

    bias and noise  one per channel, N and N m: the zero of the readings and the standard deviation of one
    sample
    gravity         m/s²
    resolver_step   rad: recorded angles are multiples of it
    convention      "on_tool", the wrench that the sensor exerts on the tool, or "on_sensor", its negative
    """

    mass: float
    bias: tuple[float, ...]
    noise: tuple[float, ...]
    gravity: float = 9.806
    resolver_step: float = 7.4e-6
    warm_up: WarmUp = field(default_factory=WarmUp)
    convention: str = "on_tool"

    channels: ClassVar[tuple[str, ...]]
    rows: ClassVar[tuple[int, ...]]

    def __post_init__(self) -> None:
        if self.convention not in ("on_tool", "on_sensor"):
            raise ValueError(f"a rig's convention is on_tool or on_sensor; got '{self.convention}'")
        for name, values in (("bias", self.bias), ("noise", self.noise)):
            if len(values) != len(self.channels):
                raise ValueError(f"{name} needs one value for each of {', '.join(self.channels)}; got {len(values)}")

    @property
    def sign(self) -> int:
        """What the wrench on the tool is multiplied by in the readings."""
        return 1 if self.convention == "on_tool" else -1

    @property
    @abstractmethod
    def coordinates(self) -> int:
        """How many coordinates a motion of this rig has."""

    @cached_property
    @abstractmethod
    def scene(self) -> Scene:
        """The rig as its description says it is."""

    @abstractmethod
    def quantised(self, q: Array) -> Array:
        """What the resolvers make of the coordinates (N, n)."""

    @abstractmethod
    def motion_columns(self, q: Array) -> dict[str, Array]:
        """The recorded columns of the motion for recorded coordinates (N, n)."""

    @abstractmethod
    def random_motion(self, *, seed: int = 0, period: float = 5.0, harmonics: int = 5) -> FourierMotion:
        """A random periodic motion that suits the rig."""

    @abstractmethod
    def random_poses(self, count: int, rng: np.random.Generator) -> Array:
        """Coordinates (count, n) of random poses."""


@dataclass(frozen=True, kw_only=True)
class PlanarRig(Rig):
    """The planar arm of the chapter: n hinges in a vertical plane, clockwise positive, q1 from upright.

    link_lengths m; mass kg, mlg kg m (along the tip) and inertia kg m² (about the sensor origin) of the tool;
    channels fx, fy, tau with the signs of 22.8; limits of `random_motion` in rad, rad/s, rad/s², one for all
    joints or one each.
    """

    link_lengths: tuple[float, ...] = (1.0, 0.97, 0.4)
    mass: float = 0.9
    mlg: float = 0.063
    inertia: float = 0.0129
    bias: tuple[float, ...] = (15.0, 0.25, -1.33)
    noise: tuple[float, ...] = (0.15, 0.25, 0.012)
    position_limit: float | tuple[float, ...] = 1.2
    velocity_limit: float | tuple[float, ...] = 2.5
    acceleration_limit: float | tuple[float, ...] = 12.0

    channels = PLANAR_CHANNELS
    rows = (0, 1, 5)

    @property
    def coordinates(self) -> int:
        """The number of joints."""
        return len(self.link_lengths)

    @cached_property
    def scene(self) -> Scene:
        """The arm; of the tool's inertia only the entry about e3 matters."""
        along = self.mlg**2 / self.mass
        return Scene(
            links=self.link_lengths,
            joint_offsets=np.zeros(self.coordinates),
            gravity=np.array([0.0, 0.0, -self.gravity]),
            mass=self.mass,
            first_moment=np.array([0.0, -self.mlg, 0.0]),
            inertia=np.diag([self.inertia, self.inertia - along, self.inertia]),
            tip_axis=np.array([0.0, -1.0, 0.0]),
        )

    def in_world(self, x: float, y: float) -> Vector:
        """A point of the plane (x right, y up, m) in MuJoCo's world."""
        return x, 0.0, y

    def quantised(self, q: Array) -> Array:
        """Every angle to the resolver's step."""
        return np.round(q / self.resolver_step) * self.resolver_step

    def motion_columns(self, q: Array) -> dict[str, Array]:
        """q1 .. qn, rad."""
        return {f"q{j + 1}": q[:, j] for j in range(self.coordinates)}

    def random_motion(self, *, seed: int = 0, period: float = 5.0, harmonics: int = 5) -> FourierMotion:
        """Within the limits of the rig."""
        return random_motion(
            joints=self.coordinates,
            position=self.position_limit,
            velocity=self.velocity_limit,
            acceleration=self.acceleration_limit,
            harmonics=harmonics,
            period=period,
            seed=seed,
        )

    def random_poses(self, count: int, rng: np.random.Generator) -> Array:
        """Uniform within the position limits."""
        limit = np.broadcast_to(self.position_limit, self.coordinates)
        return rng.uniform(-limit, limit, (count, self.coordinates))


@dataclass(frozen=True, kw_only=True)
class SpatialRig(Rig):
    """A tool that is led through space: coordinates x, y, z (m) of the sensor and three angles (rad).

    The angles turn about x, then the turned y, then the turned z: R = Rx Ry Rz. first_moment (kg m) and
    inertia (kg m²: xx, xy, xz, yy, yz, zz) of the tool about the sensor origin in its frame; channels fx ..
    tz; limits of `random_motion` for (a position, an angle); positions are recorded in steps of
    `position_step` m.
    """

    mass: float = 1.2
    first_moment: Vector = (0.010, -0.018, 0.085)
    inertia: tuple[float, ...] = (0.0125, 0.0004, -0.0009, 0.0117, 0.0011, 0.0042)
    bias: tuple[float, ...] = (1.5, -0.8, 3.0, 0.12, -0.2, 0.05)
    noise: tuple[float, ...] = (0.06, 0.06, 0.08, 0.004, 0.004, 0.003)
    position_step: float = 1e-6
    position_limit: tuple[float, float] = (0.3, 1.3)
    velocity_limit: tuple[float, float] = (0.9, 2.5)
    acceleration_limit: tuple[float, float] = (6.0, 14.0)

    channels = SPATIAL_CHANNELS
    rows = (0, 1, 2, 3, 4, 5)

    @property
    def coordinates(self) -> int:
        """Six."""
        return 6

    @cached_property
    def scene(self) -> Scene:
        """The carriage and its tool."""
        xx, xy, xz, yy, yz, zz = self.inertia
        return Scene(
            links=(),
            joint_offsets=np.zeros(6),
            gravity=np.array([0.0, 0.0, -self.gravity]),
            mass=self.mass,
            first_moment=np.array(self.first_moment),
            inertia=np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]),
            tip_axis=np.array([0.0, 0.0, 1.0]),
        )

    def quantised(self, q: Array) -> Array:
        """Positions and angles to their steps."""
        steps = np.repeat([self.position_step, self.resolver_step], 3)
        return np.asarray(np.round(q / steps) * steps)

    def motion_columns(self, q: Array) -> dict[str, Array]:
        """qx .. qw and px .. pz of the sensor in the world, by MuJoCo; the quaternion's sign is
        continuous.
        """
        track = _track(
            _mujoco_rows(self.scene, (0.0,), (q, np.zeros_like(q), np.zeros_like(q)), None), np.zeros(len(q))
        )
        quaternions = track.turn.as_quat()
        flips = np.sign((quaternions[1:] * quaternions[:-1]).sum(axis=1))
        quaternions[1:] *= np.cumprod(np.where(flips < 0, -1.0, 1.0))[:, None]
        names = ("qx", "qy", "qz", "qw", "px", "py", "pz")
        return dict(zip(names, np.hstack([quaternions, track.origin]).T, strict=True))

    def random_motion(self, *, seed: int = 0, period: float = 5.0, harmonics: int = 5) -> FourierMotion:
        """Within the limits of the rig; the angles are large enough that gravity visits three directions."""
        return random_motion(
            joints=6,
            position=np.repeat(self.position_limit, 3),
            velocity=np.repeat(self.velocity_limit, 3),
            acceleration=np.repeat(self.acceleration_limit, 3),
            harmonics=harmonics,
            period=period,
            seed=seed,
        )

    def random_poses(self, count: int, rng: np.random.Generator) -> Array:
        """Orientations uniform over the rotations, positions within the limit."""
        angles = Rotation.random(count, rng=rng).as_euler("XYZ")
        reach = self.position_limit[0]
        return np.hstack([rng.uniform(-reach, reach, (count, 3)), angles])


# -------------------------------------------------------------------------------------- experiments


@dataclass(frozen=True, kw_only=True, eq=False)
class _Experiment:
    """A rig with its hidden effects, sorted by where they act."""

    rig: Rig
    hidden: tuple[HiddenEffect, ...]

    def of(self, kind: type[Any]) -> list[Any]:
        """The effects of a kind, in the order given."""
        return [effect for effect in self.hidden if isinstance(effect, kind)]

    @property
    def delay(self) -> float:
        """The sum of all delays, s."""
        return float(sum(effect.delay for effect in self.of(TimeDelay)))

    @property
    def oversampling(self) -> int:
        """Points to a sample."""
        return OVERSAMPLING if any(effect.has_memory for effect in self.of(SensorEffect)) else 1

    def wrench(self, time: Array, states: tuple[Array, Array, Array], events: Sequence[Event] = ()) -> Array:
        """The true wrench (N, p) in the signs of the readings, under lasting effects and the given events."""
        present = [e for e in self.hidden if not isinstance(e, Event)] + list(events)
        scene = self.rig.scene
        for effect in present:
            if isinstance(effect, SceneChange):
                scene = effect.changed(scene)
        loads = [effect for effect in present if isinstance(effect, ToolLoad)]
        return self.rig.sign * felt_wrench(scene, loads, time, states)[:, self.rig.rows]

    def with_events(self, wrench: Array, time: Array, motion: PeriodicMotion) -> Array:
        """The wrench of the whole record, computed anew where an event is active."""
        events: list[Event] = self.of(Event)
        if not events:
            return wrench
        wrench = wrench.copy()
        active = np.stack([event.active(time) for event in events], axis=1)
        for pattern in np.unique(active, axis=0):
            if pattern.any():
                here = (active == pattern).all(axis=1)
                present = [event for event, on in zip(events, pattern, strict=True) if on]
                wrench[here] = self.wrench(time[here], motion.evaluate(time[here]), present)
        return wrench

    def through_sensor(self, signal: Signal) -> Array:
        """The wrench (N, p) after gains, crosstalk, nonlinearity, play and lag, in this order."""
        for effect in sorted(self.of(SensorEffect), key=lambda e: int(e.order)):
            signal = effect.through(signal)
        return signal.record

    def readings(self, wrench: Array, clock: Clock, noise: NoiseModel, seed: int) -> Array:
        """The readings: bias, drifts, clipping and noise added; each has a random stream of its own."""
        noisy, *streams = np.random.default_rng(seed).spawn(1 + len(self.of(ZeroShift)))
        readings = wrench + np.array(self.rig.bias)
        for effect, stream in zip(self.of(ZeroShift), streams, strict=True):
            readings = readings + effect.shift(clock, stream)
        for effect in self.of(Saturation):
            readings = effect.clipped(readings, np.array([c.startswith("f") for c in clock.channels]))
        return np.asarray(readings + noise.draw(noisy, *readings.shape) * np.array(self.rig.noise))


def placed(
    rig: Rig, motion: PeriodicMotion, hidden: Sequence[HiddenEffect], *, repeats: int = 8
) -> tuple[HiddenEffect, ...]:
    """The effects as `simulate` uses them: open places and times filled in to suit path and record.

    Raises ValueError when an effect needs joints and the rig has none.
    """
    time = np.linspace(0.0, motion.period, 201)
    states = motion.evaluate(time)
    return tuple(
        _checked(rig, effect).placed(_stretched(_path(rig, effect, time, states), repeats)) for effect in hidden
    )


def simulate(
    rig: Rig,
    motion: PeriodicMotion,
    *,
    hidden: Sequence[HiddenEffect] = (),
    repeats: int = 8,
    samples_per_period: int = 1000,
    noise: NoiseModel | str = "white",
    seed: int = 0,
) -> pd.DataFrame:
    """A recording of a periodic motion, repeated without pause, in the columns of FORMATS.md.

    Columns: time (s, running on), repeat, the rig's motion, its wrench channels, temperature (°C). The tool
    moved before the record in the same way, so that lag and play are in their periodic state. The same seed
    gives the same noise whatever is hidden.

    Raises ValueError when motion, effects or counts do not suit the rig.
    """
    _check_counts(rig, motion, repeats, samples_per_period)
    experiment = _Experiment(rig=rig, hidden=placed(rig, motion, hidden, repeats=repeats))
    fine = experiment.oversampling
    step = motion.period / (samples_per_period * fine)
    seen = _ticks(repeats * samples_per_period * fine, step) - experiment.delay
    period = seen[: samples_per_period * fine]
    before = experiment.wrench(period, motion.evaluate(period))
    record = experiment.with_events(np.tile(before, (repeats, 1)), seen, motion)
    signal = Signal(channels=rig.channels, record=record, before=before, step=step)
    wrench = experiment.through_sensor(signal)[::fine]

    time = _ticks(repeats * samples_per_period, motion.period / samples_per_period)
    q = rig.quantised(motion.evaluate(time[:samples_per_period])[0])
    columns = {name: np.tile(column, repeats) for name, column in rig.motion_columns(q).items()}
    head = {"time": time, "repeat": np.repeat(np.arange(repeats), samples_per_period)}
    return _frame(experiment, head | columns, wrench, time, _noise(noise), seed)


def rest_poses(
    rig: Rig,
    poses: int | Array = 24,
    *,
    hidden: Sequence[HiddenEffect] = (),
    noise: NoiseModel | str = "white",
    seed: int = 0,
    seconds_per_pose: float = 10.0,
) -> pd.DataFrame:
    """Readings in poses at rest, one row each and no time column, in the order taken.

    poses is how many random ones, or the coordinates (N, n) themselves; drift and warm-up go on between them.

    Raises ValueError when an effect needs motion or time (drag, lag, delay, friction, events, a tone).
    """
    for effect in hidden:
        if effect.needs_motion:
            raise ValueError(f"{effect.id} does not exist in poses at rest; simulate a motion")
    generator = np.random.default_rng([seed, 1])
    q = rig.random_poses(poses, generator) if isinstance(poses, int) else np.asarray(poses, dtype=float)
    if q.ndim != 2 or q.shape[1] != rig.coordinates:
        raise ValueError(f"poses of this rig have {rig.coordinates} coordinates; got an array of shape {q.shape}")
    time = _ticks(len(q), seconds_per_pose)
    states = (q, np.zeros_like(q), np.zeros_like(q))
    known = tuple(_checked(rig, e).placed(_path(rig, e, time, states)) for e in hidden)
    experiment = _Experiment(rig=rig, hidden=known)
    record = experiment.wrench(time, states)
    signal = Signal(channels=rig.channels, record=record, before=record[:1], step=seconds_per_pose)
    wrench = experiment.through_sensor(signal)
    return _frame(experiment, rig.motion_columns(rig.quantised(q)), wrench, time, _noise(noise), seed)


def write_recording(frame: pd.DataFrame, path: str | os.PathLike[str]) -> Path:
    """Write a recording as CSV, ten significant digits, beside its place first and then renamed into it."""
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    beside = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        frame.to_csv(beside, index=False, float_format="%.10g")
        beside.replace(target)
    finally:
        beside.unlink(missing_ok=True)
    return target


def _frame(
    experiment: _Experiment,
    columns: Mapping[str, npt.NDArray[Any]],
    wrench: Array,
    time: Array,
    noise: NoiseModel,
    seed: int,
) -> pd.DataFrame:
    rig = experiment.rig
    warm_up = rig.warm_up
    clock = Clock(time=time, temperature=warm_up.true(time), channels=rig.channels)
    readings = experiment.readings(wrench, clock, noise, seed)
    thermometer = np.random.default_rng([seed, 2])
    logged = clock.temperature + warm_up.noise * thermometer.standard_normal(len(time))
    named = dict(zip(rig.channels, readings.T, strict=True))
    return pd.DataFrame({**columns, **named, "temperature": logged})


def _ticks(count: int, step: float) -> Array:
    """`count` times from zero on, s."""
    return np.arange(count, dtype=np.float64) * np.float64(step)


def _checked(rig: Rig, effect: HiddenEffect) -> HiddenEffect:
    if effect.planar_only and not rig.scene.planar:
        raise ValueError(f"{effect.id} needs a planar rig with joints")
    return effect


def _path(rig: Rig, effect: HiddenEffect, time: Array, states: tuple[Array, Array, Array]) -> Track:
    """The path of the point that the effect attacks, or of the sensor origin."""
    point = effect.d if isinstance(effect, ToolLoad) else 0.0
    return _track(_mujoco_rows(rig.scene, (point,), states, None), time)


def _stretched(track: Track, repeats: int) -> Track:
    """The same path with times over all repeats: places come from one period, instants from the record."""
    return replace(track, time=track.time * repeats)


def _noise(noise: NoiseModel | str) -> NoiseModel:
    if isinstance(noise, NoiseModel):
        return noise
    if noise not in NOISE_MODELS:
        raise ValueError(f"no noise model is called '{noise}'; use one of {', '.join(NOISE_MODELS)}")
    return NOISE_MODELS[noise]


def _check_counts(rig: Rig, motion: PeriodicMotion, repeats: int, samples_per_period: int) -> None:
    if repeats < 1 or samples_per_period < 2:
        raise ValueError(f"needs 1 repeat and 2 samples at least; got {repeats} and {samples_per_period}")
    coordinates = motion.evaluate(np.zeros(1))[0].shape[1]
    if coordinates != rig.coordinates:
        raise ValueError(f"the rig has {rig.coordinates} coordinates, the motion {coordinates}")
