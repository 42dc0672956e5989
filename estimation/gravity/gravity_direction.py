"""Gravity's direction in a model and its recordings: as the rig states it, or decided where the base does not stand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, reduce
from operator import add

import numpy as np
from numpy.typing import NDArray

from estimation.gravity.gravity_estimate import (
    FEWEST_POSES,
    GravityEstimate,
    WeightMoments,
    estimated_gravity,
    independent_samples,
    rotation_terms,
    upright_direction,
    without_terms,
)
from estimation.least_squares.square_root_information import orthonormal_basis
from estimation.multiplicity import f_sf
from estimation.recordings.recording import Recording
from estimation.recordings.sign_convention import to_sensor_frame
from estimation.recordings.weight_fit import (
    LEAST_EXPLAINED,
    SMALLEST_SQUARE,
    PulledTool,
    WeightFit,
    cable_instead,
    joined,
    weight_fit,
)
from modeling.chain.model import WrenchModel
from modeling.effects.geometry import GravityTilt
from modeling.kinematics.placement import COMPONENTS, Direction, in_base_axes, unit_direction
from modeling.rig import Convention
from modeling.significance import LEVELS

Array = NDArray[np.float64]

STEP, LONGEST = 0.01, 20_000
"""Seconds between rows that are fitted, and the first rows of a recording among which they are."""
LEAST_UNEXPLAINED = 0.01
"""Share of the readings' power that an upright base has to leave before another one is sought."""


def gravity_evidence(
    recordings: Sequence[Recording], *, gravity: float, convention: Convention, mirror_y: bool = False
) -> GravityEstimate | None:
    """The direction where the base is shown not to stand upright, and no other mistake explains as much; else None.

    Where an upright base with a cable on its tool explains the forces as well, the estimate has that cable; where one
    with a force that is constant in base axes explains the readings better, it says so.

    The recordings, of one sensor, are in base axes; gravity in m/s². The signs are those of planar readings, and decide
    of six axes between directions that poses at rest do not distinguish. Shown is by `WeightFit.is_shown_against`: of
    the direction against an upright base, the best of the directions unlike it, and every mistake.
    """
    if recordings[0].dimension == 2:
        signs = np.array([1.0, -1.0 if mirror_y else 1.0]) * (-1.0 if convention is Convention.ON_SENSOR else 1.0)
        return _in_plane(recordings, gravity, signs)
    if any("qw" not in r.signals for r in recordings) or sum(r.samples for r in recordings) < FEWEST_POSES:
        return None
    samples, moments = _in_space(tuple(recordings), gravity)
    if not _leaves_enough(moments):
        return None
    estimate = estimated_gravity(moments, _independent(recordings), convention)
    if not _explains_enough(estimate):
        return None
    mistaken = [[mistake(series) for series in samples] for mistake in MISTAKES]
    others = [_weight(series, upright_direction(3), gravity) for series in (samples, *mistaken)]
    return _with_rivals(estimate, samples, gravity) if _is_shown(estimate, samples, others, gravity) else None


@lru_cache(maxsize=1)
def _in_space(recordings: tuple[Recording, ...], gravity: float) -> tuple[tuple[SensorSamples, ...], WeightMoments]:
    """Samples and moments, cached for the last recordings: their reading asks for them, and their diagnosis again."""
    samples = tuple(SensorSamples.in_space(recording) for recording in recordings)
    return samples, _moments(samples, gravity)


def _in_plane(recordings: Sequence[Recording], gravity: float, signs: Array) -> GravityEstimate | None:
    """From runs alone: in poses at rest a turned base is indistinguishable from a sensor that is mounted turned."""
    if any(recording.at_rest or "phi" not in recording.signals for recording in recordings):
        return None
    samples = [SensorSamples.in_plane(recording, signs) for recording in recordings]
    if not _leaves_enough(_moments(samples, gravity)):
        return None
    estimate = estimated_gravity(_moments(samples, gravity), _independent(recordings))
    if not estimate.decided or np.trace(estimate.fit.matrix) <= 0 or not _explains_enough(estimate):
        return None
    others = [_weight(samples, upright_direction(2), gravity)]
    return _with_rivals(estimate, samples, gravity) if _is_shown(estimate, samples, others, gravity) else None


def _independent(recordings: Sequence[Recording]) -> int:
    return sum(independent_samples(r.samples, at_rest=r.at_rest) for r in recordings)


def _explains_enough(estimate: GravityEstimate) -> bool:
    """Whether the base stands otherwise than upright, and most of what an upright one leaves is explained so.

    An effect that pulls one way, as a tether does, is a small part of a turned weight.
    """
    return not estimate.is_upright and estimate.fit.rms**2 <= (1 - LEAST_EXPLAINED) * estimate.upright.rms**2


def _is_shown(
    estimate: GravityEstimate, samples: Sequence[SensorSamples], others: Sequence[WeightFit], gravity: float
) -> bool:
    """Whether the base is shown to stand as found, against `others` and the best of the directions unlike it."""
    turned, rivals = _weight(samples, estimate.direction, gravity), [*others, _weight(samples, estimate.rival, gravity)]
    return all(turned.is_shown_against(rival, len(rivals)) for rival in rivals)


def _with_rivals(estimate: GravityEstimate, samples: Sequence[SensorSamples], gravity: float) -> GravityEstimate:
    """The estimate with what explains the readings on a level base: a force that is constant there, or a cable.

    A force is no rival of an axis: a base on a wall or a ceiling is none's accident. A cable is one where the positions
    are known.
    """
    if not estimate.along_axis and _constant_force_instead(estimate, samples, gravity):
        return replace(estimate, base_force=True)
    if any(recorded.position is None for recorded in samples):
        return estimate
    upright, turned = (
        joined([recorded.pulled(direction, gravity) for recorded in samples])
        for direction in (upright_direction(len(estimate.direction)), estimate.direction)
    )
    return replace(estimate, cable=cable_instead(upright, turned))


ROUNDS = 20
"""In which the mounting, and the size and direction of the pull, are fitted in turn: a fifth of them is enough."""
LEAST_REMOVED = 0.5
"""Share of what a turned gravity leaves that a force which is constant in base axes has to remove: it has more
parameters, and some hidden effect would favour it."""


def _constant_force_instead(estimate: GravityEstimate, samples: Sequence[SensorSamples], gravity: float) -> bool:
    """Whether a force that is constant in base axes explains the readings better than a turned gravity.

    Both pull one way in base axes, at rest alike. In motion gravity has the size that it has; at rest its torque is
    that of the forces at the centre of mass, while that of the weight and of another force have two directions.
    """
    turned = _weight(samples, estimate.direction, gravity)
    if any(recorded.rotation is None for recorded in samples):
        return _torque_of_two_directions(samples, np.array(estimate.direction), turned.mounting)
    axes = len(estimate.direction)
    rows = [recorded.without_rotation((0.0,) * axes, gravity) for recorded in samples]
    moved, force = (np.concatenate(each) for each in zip(*rows, strict=True))
    along = [
        np.concatenate([recorded.without_rotation(tuple(unit), gravity)[0] for recorded in samples]) - moved
        for unit in np.eye(axes)
    ]
    return _pull_instead(moved, along, force, turned, mounting=np.eye(2) if axes == 2 else None)


def _pull_instead(
    moved: Array, along: Sequence[Array], force: Array, turned: WeightFit, *, mounting: Array | None = None
) -> bool:
    """Whether a force that is constant in base axes explains the forces of a run better than gravity `turned`.

    It makes another size of gravity, beside its direction: `moved` (n, k) is the acceleration in sensor axes, `along`
    each base axis the weight per mass (n, k). Its squares are taken larger by what the size costs by the Bayesian
    information criterion.
    """
    columns, fit = np.column_stack([moved.ravel(), *(column.ravel() for column in along)]), turned
    for _ in range(ROUNDS):
        mass, *pull = np.linalg.lstsq(columns, (force @ fit.mounting).ravel())[0]
        if mass <= 0:
            return False
        pulled = sum((share / mass * column for share, column in zip(pull, along, strict=True)), start=moved)
        fit = weight_fit(pulled, force, mounting=mounting)
    fit = replace(fit, squares=fit.squares * force.size ** (1 / force.size))
    return fit.rms**2 < LEAST_REMOVED * turned.rms**2 and fit.is_nearer_than(turned)


def _torque_of_two_directions(samples: Sequence[SensorSamples], direction: Array, mounting: Array) -> bool:
    """Whether the torques at rest are not those of one pull along `direction`, but of it and of another.

    One pull gives torques that are linear in it, whatever its point, its leaks and its mounting; beside them the torque
    of a vertical weight and one that is constant in base axes are tested.
    """
    at_rest = [recorded for recorded in samples if recorded.rotation is None and recorded.torque is not None]
    left, columns, count = [], [], 0
    for recorded in at_rest:
        assert recorded.torque is not None
        turn = recorded.to_sensor
        basis = orthonormal_basis(np.column_stack([np.ones(len(turn)), turn @ direction]))
        up = turn[:, :, -1]
        weight = np.stack([np.cross(unit, up) for unit in np.eye(3)], axis=2)
        extra = np.concatenate([weight, turn], axis=2)
        torque = recorded.torque @ mounting
        left.append((torque - basis @ (basis.T @ torque)).ravel())
        columns.append((extra - np.tensordot(basis, np.tensordot(basis.T, extra, 1), 1)).reshape(-1, extra.shape[2]))
        count += 3 * (len(turn) - basis.shape[1])
    if not at_rest:
        return False
    rows, design = np.concatenate(left), np.concatenate(columns)
    power, more = float(rows @ rows), design.shape[1]
    remains = float(np.sum((rows - design @ np.linalg.lstsq(design, rows)[0]) ** 2))
    if count <= more or remains > LEAST_REMOVED * power or not power:
        return False
    ratio = (power - remains) / more / (max(remains, SMALLEST_SQUARE) / (count - more))
    return bool(f_sf(ratio, more, count - more) < LEVELS.misread)


def _weight(samples: Sequence[SensorSamples], direction: Direction, gravity: float) -> WeightFit:
    """The weight of a tool whose mounting is unknown in space, and known in the plane."""
    parts = [recorded.without_rotation(direction, gravity) for recorded in samples]
    along, force = (np.concatenate(each) for each in zip(*parts, strict=True))
    return weight_fit(along, force, mounting=np.eye(2) if len(direction) == 2 else None)


def _leaves_enough(moments: WeightMoments) -> bool:
    """Whether an upright base leaves so much of the readings that another one may explain it."""
    upright = moments.fit(upright_direction(moments.axes))
    return upright.rms**2 > LEAST_UNEXPLAINED * moments.force**2


@dataclass(frozen=True, eq=False)
class SensorSamples:
    """Rows of one recording that are fitted: R' (n, d, d) to the sensor's axes, accelerations in base axes and forces
    (n, d), what turns with the tool (n, k), None at rest, and positions (n, d) in base axes, None where not known.

    torque  (n, 3) in six axes
    """

    to_sensor: Array
    acceleration: Array
    force: Array
    rotation: Array | None
    position: Array | None
    torque: Array | None = None

    @classmethod
    def in_space(cls, recording: Recording) -> SensorSamples:
        """From the recording's signals, in base axes."""
        every, signals = _every(recording), recording.signals
        return cls(
            to_sensor_frame(np.stack([signals[name][every] for name in COMPONENTS], axis=1)),
            np.stack([signals[name][every] for name in ("apx", "apy", "apz")], axis=1),
            recording.wrench[every, :3],
            None if recording.at_rest else rotation_terms(recording, every),
            _positions(recording, every),
            recording.wrench[every, 3:],
        )

    @classmethod
    def in_plane(cls, recording: Recording, signs: Array) -> SensorSamples:
        """Forces with the signs of the sensor's on the tool, in the axes x' and -y' of the sensor."""
        every, signals = _every(recording), recording.signals
        s, c = np.sin(signals["phi"][every]), np.cos(signals["phi"][every])
        return cls(
            np.stack([np.stack([c, -s], axis=1), np.stack([-s, -c], axis=1)], axis=1),
            np.stack([signals["ax"][every], signals["ay"][every]], axis=1),
            recording.wrench[every, :2] * signs,
            rotation_terms(recording, every),
            _positions(recording, every),
        )

    def moments(self, gravity: float) -> WeightMoments:
        """Their moments, for any direction of gravity."""
        return WeightMoments.of(self.to_sensor, self.acceleration, self.force, gravity, self.rotation)

    def pulled(self, direction: Direction, gravity: float) -> PulledTool:
        """The same rows for the fit of a cable, with gravity along a direction; their positions are known."""
        assert self.position is not None
        specific = self.acceleration - gravity * np.array(direction)
        tool = PulledTool.of(self.to_sensor, self.position, specific, self.force, self.rotation)
        return replace(tool, mounting=np.eye(2)) if len(direction) == 2 else tool

    def without_rotation(self, direction: Direction, gravity: float) -> tuple[Array, Array]:
        """Specific force (n, d) in the sensor with gravity along a direction, and force, less what turns with the
        tool."""
        along = np.einsum("nij,nj->ni", self.to_sensor, self.acceleration - gravity * np.array(direction))
        rows = np.hstack([along, self.force])
        rows = rows - rows.mean(axis=0) if self.rotation is None else without_terms(rows, self.rotation)
        return rows[:, : len(direction)], rows[:, len(direction) :]


def _w_first(samples: SensorSamples) -> SensorSamples:
    """The quaternion, as it was read, w first."""
    from scipy.spatial.transform import Rotation  # slow to import

    quaternion = Rotation.from_matrix(np.swapaxes(samples.to_sensor, 1, 2)).as_quat()
    return replace(samples, to_sensor=to_sensor_frame(np.roll(quaternion, -1, axis=1)))


def _inverse(samples: SensorSamples) -> SensorSamples:
    return replace(samples, to_sensor=np.swapaxes(samples.to_sensor, 1, 2))


def _in_base_axes(samples: SensorSamples) -> SensorSamples:
    return replace(samples, force=np.einsum("nij,nj->ni", samples.to_sensor, samples.force))


MISTAKES = (_w_first, _inverse, _in_base_axes)
"""Other readings of orientation and axes, of which each may seem to turn gravity."""


def _moments(samples: Sequence[SensorSamples], gravity: float) -> WeightMoments:
    return reduce(add, (recorded.moments(gravity) for recorded in samples))


def _positions(recording: Recording, every: slice) -> Array | None:
    """Positions (n, d) of the sensor in base axes in these rows, m; None where they are not recorded."""
    names = ("px", "py", "pz")[: recording.dimension]
    if any(name not in recording.signals for name in names):
        return None
    return np.stack([recording.signals[name][every] for name in names], axis=1)


def _every(recording: Recording) -> slice:
    """The rows that are fitted: no more than a hundred a second, among the first of a long recording."""
    stride = 1 if recording.dt is None else max(int(STEP / recording.dt), 1)
    return slice(0, LONGEST, stride)


def with_fitted_tilt(estimate: GravityEstimate, model: WrenchModel, estimates: Mapping[str, float]) -> GravityEstimate:
    """The estimate turned by the `gravity_tilt` that a fit of the model, on that base, found beside the tool.

    The first estimate knows nothing of the other effects of the model; `estimates` are its parameters by name.
    """
    tilt = next((effect for effect in model.effects if effect.id == GravityTilt.id), None)
    if tilt is None:
        return estimate
    parameters = tilt.qualified(model.space)
    angles = {p.name.removeprefix(f"{tilt.id}."): estimates[p.name] for p in parameters}
    turned = tilt.perturb(replace(model, effects=()).chain, angles).gravity
    components = [float(component) for component in turned][: model.space.value]
    direction = in_base_axes(unit_direction(components), estimate.direction)
    return replace(estimate, direction=direction, mounted=estimate.direction)
