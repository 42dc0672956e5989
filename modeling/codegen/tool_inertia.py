"""Mass, centre of mass and central inertia of an identified tool, in a frame of the robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from modeling.chain.model import WrenchModel
from modeling.chain.pseudo_inertia import pseudo_inertia
from modeling.chain.sensor_axes import Axes, is_turned, pose_to_sensor, turn_words
from modeling.chain.stages import Stage
from modeling.errors import InputError
from modeling.rig import Convention
from modeling.space import Space

Array = NDArray[np.float64]

TILT = "gravity_tilt"
"""Id of the effect that a controller can take otherwise: as gravity's direction, or as the pose of the base."""


def left_out(model: WrenchModel, theta: Array) -> str:
    """A line that names the effects that are not in the tool's inertia, at parameters theta (k,); empty without any.

    Of a tilted base it says what to state instead: gravity along the axes of the recorded motion, m/s².
    """
    ids = [effect.id for effect in model.effects if effect.stage is not Stage.MOUNTING]  # that is in the frame
    if not ids:
        return ""
    line = f"not included, effects of the model beside the rigid tool: {', '.join(ids)}"
    return f"{line}; {_tilt_advice(model, theta)}" if TILT in ids else line


def _tilt_advice(model: WrenchModel, theta: Array) -> str:
    """Where the tilt of the base is stated. UR's `set_gravity` takes the opposite of gravity: [0, 0, 9.82] if level."""
    how = "state the tilt in the pose of the robot's base in the URDF, or as gravity in the controller"
    if model.gravity_direction is not None:  # the axes of the motion are not those of the base
        return how
    vector = ", ".join(f"{v:.4g}" for v in _gravity(model, theta))
    return f"{how} (set_gravity of UR takes the negative): it is [{vector}] m/s² along the base's axes"


def _gravity(model: WrenchModel, theta: Array) -> Array:
    """Gravity (3,) along the axes of the recorded motion, m/s², as a tilted base has it."""
    values = {p.name: value for p, value in zip(model.parameters, theta, strict=True)}
    gravity = model.chain.gravity
    numbers = gravity.subs({symbol: values[symbol.name] for symbol in gravity.free_symbols})
    return np.array([float(component) for component in numbers])


@dataclass(frozen=True, kw_only=True, eq=False)
class Readings:
    """What a filter that takes the tool out of the readings must know of them.

    zero     (6,) N, N m: what the sensor reads without load, along its own axes
    gravity  (3,) m/s² along the axes of the recorded motion
    sign     +1 where a hanging weight reads m g along gravity, the wrench on the sensor; -1 where it reads -m g
    """

    zero: Array
    gravity: Array
    sign: int

    @classmethod
    def of(cls, model: WrenchModel, theta: Array) -> Readings:
        """Of a six-axis model at its parameters theta (k,)."""
        values = {p.name: float(value) for p, value in zip(model.parameters, theta, strict=True)}
        zero = np.array([values.get(f"bias_{channel}", 0.0) for channel in model.channels])
        sign = 1 if model.convention is Convention.ON_SENSOR else -1
        return cls(zero=zero, gravity=_gravity(model, theta), sign=sign)


WHERE = "tool"
ROUNDING = 1e-9
"""Size of a negative second moment about the centre of mass that is rounding, over the sum of those about the sensor
origin, of which it is a difference: a tool that is flat, a line or a point has zeros."""
THINNEST = 1e-12
"""Least second moment about the centre of mass over the sum of those about the origin, of a tool for a simulator: of a
flat one rounding, some 1e-15, decides there about A + B >= C of its principal moments."""
SMALLEST_MOMENT = 1e-13
"""kg m²: MuJoCo takes principal moments from 1e-14 (mjEPS), this is ten times as much, and a grain of sand's."""
STATED_FRAME = "frame in which"
"""What a frame begins with in which the pose of the sensor was stated."""
LARGEST_OFFSET = 2.0
"""Metres between the sensor and the frame in which its pose is stated, from which millimetres were meant."""
SENSOR_FRAME = "sensor frame"
"""The frame of the readings, which is the one whose pose was logged unless the sensor is turned against it."""
ALONG_POSE = "frame at the sensor's origin along the axes of the logged pose"
"""The frame of the tool's parameters where the sensor is turned against the logged pose."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ToolInertia:
    """Mass and mass distribution of a rigid tool.

    mass            kg, and its std
    centre_of_mass  (3,) m, from the frame's origin along its axes
    inertia         (3, 3) kg m² about the centre of mass, along the frame's axes; None where it was not identifiable
    centre_modes    (k, 3) m and
    inertia_modes   (k, 3, 3) kg m²: changes of these by one std of each of k uncorrelated combinations of parameters
    frame           what the axes are
    link            name of the link whose frame it is, where the rig names it; else empty
    turn            what is said of a sensor that is turned against the logged pose; empty of one that is not
    left_out        the effects of its model that these numbers do not express, as a line; empty without any
    readings        of the sensor that weighed it; None of a tool that none did
    """

    mass: float
    mass_std: float
    centre_of_mass: Array
    inertia: Array | None
    centre_modes: Array
    inertia_modes: Array
    frame: str = SENSOR_FRAME
    link: str = ""
    turn: str = ""
    left_out: str = ""
    readings: Readings | None = None

    @property
    def centre_std(self) -> Array:
        """Std (3,) of the centre of mass, m, to first order."""
        return np.asarray(np.sqrt(np.square(self.centre_modes).sum(axis=0)))

    @property
    def inertia_std(self) -> Array:
        """Std (3, 3) of the inertia's elements, kg m², to first order."""
        return np.asarray(np.sqrt(np.square(self.inertia_modes).sum(axis=0)))

    @classmethod
    def of(
        cls, model: WrenchModel, theta: Array, covariance: Array, link: str = "", along: Axes = Axes.POSE
    ) -> ToolInertia:
        """The tool of a six-axis model at its parameters theta (k,) with covariance (k, k), from the sensor's origin.

        It is `along` the axes of the logged pose, which are a flange's where its pose was logged, or the sensor's;
        `link` names the frame to which joints lead, where the rig does.

        With the pseudo-inertia [[Sigma, c], [c', m]] about the sensor origin (Wensing et al. 2018) the second moments
        about the centre of mass c/m are its Schur complement Sigma - c c'/m, and the inertia is tr(.) 1 minus them.
        Raises InputError for a planar model, for a mass or first moment that is not identifiable, and for a tool that
        no distribution of mass has.
        """
        if model.space is Space.PLANE:
            what = "a planar model has one moment of inertia and no centre of mass across its plane"
            raise InputError(what=what, where=WHERE, remedy="identify the tool with a six-axis sensor")
        identifiable = dict(zip((p.name for p in model.parameters), np.isfinite(np.diag(covariance)), strict=True))
        _require_identifiable([n for n in ("m", "mx", "my", "mz") if not identifiable[n]])
        place = [p.name for p in model.parameters].index("m")
        pseudo = pseudo_inertia(model.base).over([p.name for p in model.parameters])
        matrix = pseudo.at(theta)
        first, mass = matrix[:3, 3], float(matrix[3, 3])
        if mass <= 0:
            raise InputError(
                what=f"the mass is {mass:.4g} kg", where=WHERE, remedy="see what the model lacks: diagnose"
            )
        second = matrix[:3, :3] - np.outer(first, first) / mass
        central = (
            None
            if any(not identifiable[n] for n in identifiable if n[0] == "I" and len(n) == 3)
            else _consistent(second, float(np.trace(matrix[:3, :3])))
        )
        changes = _one_std_changes(covariance)
        centre_modes, inertia_modes = _modes(matrix, np.tensordot(changes, pseudo.slopes, axes=1))
        rotation, slopes = pose_to_sensor(model, theta)
        turned = is_turned(model)
        link = "" if turned and along is Axes.SENSOR else link
        tool = cls(
            mass=mass,
            mass_std=float(np.sqrt(covariance[place, place])),
            centre_of_mass=first / mass,
            inertia=central,
            centre_modes=centre_modes,
            inertia_modes=inertia_modes,
            frame=f"{ALONG_POSE if turned and along is Axes.POSE else SENSOR_FRAME}{f', link {link}' if link else ''}",
            link=link,
            turn=f"the sensor is turned by {turn_words(rotation.T)} against the axes of the logged pose"
            if turned
            else "",
            left_out=left_out(model, theta),
            readings=Readings.of(model, theta),
        )
        return tool._turned(rotation, np.tensordot(changes, slopes, axes=(1, 2))) if along is Axes.SENSOR else tool

    def _turned(self, rotation: Array, changes: Array) -> ToolInertia:
        """Along axes R v with this rotation R (3, 3), which has changes (k, 3, 3) by one std of each combination."""
        moments = np.zeros((3, 3)) if self.inertia is None else self.inertia
        of_rotation = changes @ moments @ rotation.T
        return replace(
            self,
            centre_of_mass=rotation @ self.centre_of_mass,
            inertia=None if self.inertia is None else rotation @ self.inertia @ rotation.T,
            centre_modes=self.centre_modes @ rotation.T + changes @ self.centre_of_mass,
            inertia_modes=rotation @ self.inertia_modes @ rotation.T + of_rotation + np.swapaxes(of_rotation, 1, 2),
        )

    def seen_from(self, pose: Sequence[float]) -> ToolInertia:
        """The same tool in a frame in which the sensor has this pose: x, y, z (m), roll, pitch, yaw (rad).

        The angles turn about the fixed axes x, y, z in that order, as URDF has them. Raises InputError for an angle of
        more than a turn, and an offset of more than LARGEST_OFFSET.
        """
        if (offset := max(abs(length) for length in pose[:3])) > LARGEST_OFFSET:
            what = f"an offset of {offset:g} m is longer than any flange: millimetres?"
            raise InputError(what=what, where="sensor pose", remedy="give metres, and roll, pitch and yaw in rad")
        if max(abs(angle) for angle in pose[3:]) > 2 * np.pi:
            what = f"an angle of {max(map(abs, pose[3:])):g} rad is more than a turn: degrees?"
            raise InputError(what=what, where="sensor pose", remedy="give m, and roll, pitch and yaw in rad")
        turn, place = Rotation.from_euler("xyz", pose[3:]).as_matrix(), np.asarray(pose[:3], dtype=np.float64)
        sensor = f"sensor (link {self.link})" if self.link else f"sensor{' (its own axes)' * bool(self.turn)}"
        where = f"{STATED_FRAME} the {sensor} is at {' '.join(f'{v:g}' for v in pose)}"
        turned = self._turned(turn, np.zeros((len(self.centre_modes), 3, 3)))
        return replace(
            turned,
            centre_of_mass=turned.centre_of_mass + place,
            frame=f"{where} (m, rad: x y z roll pitch yaw)",
            link="",
        )

    def required_inertia(self, name: str) -> Array:
        """The inertia (3, 3); InputError where it was not identifiable and the format `name` needs it."""
        if self.inertia is None:
            what = f"the inertia is not identifiable from the recordings of this model, and {name} needs it"
            remedy = "record a motion that turns quickly about three axes; ur needs mass and centre of mass alone"
            raise InputError(what=what, where=WHERE, remedy=remedy)
        return self.inertia

    def solid_inertia(self, name: str) -> Array:
        """The inertia (3, 3) for a simulator, whose format is `name`.

        InputError as `required_inertia`, and for a tool that is flat, a line, a point or too small.
        """
        inertia = self.required_inertia(name)
        moments = np.linalg.eigvalsh(inertia)
        second = moments.sum() / 2 - moments[::-1]
        size = second.sum() + self.mass * np.sum(self.centre_of_mass**2)
        shape = ("", "flat", "a line", "a point")[int((second <= THINNEST * size).sum())]
        if shape or moments[0] < SMALLEST_MOMENT:
            shape = shape or f"below {SMALLEST_MOMENT:g} kg m²"
            what = f"{name} is for simulators, which refuse a tool that is {shape}: principal moments"
            what = f"{what} {', '.join(f'{max(v, 0.0):.3g}' for v in moments)} kg m²"
            raise InputError(what=what, where=WHERE, remedy="fit with --physical, which keeps it thicker; ur takes it")
        return inertia


def _require_identifiable(unknown: Sequence[str]) -> None:
    if unknown:
        what = f"not identifiable from the recordings of this model: {', '.join(unknown)}"
        raise InputError(what=what, where=WHERE, remedy="record poses or a motion that turn the tool about two axes")


def _consistent(second: Array, size: float) -> Array:
    """The inertia of second moments (3, 3) about the centre of mass; InputError if one of them is negative.

    What is negative by rounding of `size`, the sum of those about the sensor origin, is zero.
    """
    moments, axes = np.linalg.eigh(second)
    if moments[0] < -ROUNDING * size:
        largest = (moments.sum() - moments)[::-1]
        what = (
            "no distribution of mass has this inertia: principal moments about the centre of mass"
            f" {', '.join(f'{v:.3g}' for v in largest)} kg m², of which one exceeds the sum of the others"
        )
        raise InputError(what=what, where=WHERE, remedy="fit again with --physical, or record a faster motion")
    if moments[0] < 0:
        second = (axes * np.maximum(moments, 0.0)) @ axes.T
    return np.asarray(np.trace(second) * np.eye(3) - second)


def _one_std_changes(covariance: Array) -> Array:
    """Uncorrelated changes (k, k) of k parameters, by one std each; zero of what is not identifiable."""
    identifiable = np.isfinite(np.diag(covariance))
    variances, directions = np.linalg.eigh(np.where(np.outer(identifiable, identifiable), covariance, 0.0))
    return np.asarray((directions * np.sqrt(np.maximum(variances, 0.0))).T)


def _modes(matrix: Array, changes: Array) -> tuple[Array, Array]:
    """Changes (k, 3) of the centre of mass c/m and (k, 3, 3) of the inertia about it, by `changes` (k, 4, 4) of J.

    With the second moments S = Sigma - c c'/m: d(c/m) = (dc - c/m dm)/m and
    dS = dSigma - (dc c' + c dc')/m + c c'/m² dm; the inertia is tr(S) 1 - S.
    """
    mass, centre = matrix[3, 3], matrix[:3, 3] / matrix[3, 3]
    first, weight = changes[:, :3, 3], changes[:, 3, 3]
    crossed = first[:, :, None] * centre
    second = changes[:, :3, :3] - crossed - np.swapaxes(crossed, 1, 2)
    second = second + weight[:, None, None] * np.outer(centre, centre)
    inertia = np.trace(second, axis1=1, axis2=2)[:, None, None] * np.eye(3) - second
    return (first - weight[:, None] * centre) / mass, inertia
