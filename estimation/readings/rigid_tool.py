"""Rigid tool: the residual that the whole rigid tool leaves of recordings, in closed form for every reading of them.

A reading says that the logged wrench is M times what the rigid tool predicts, M a matrix of signs, order and units. As
noise is as large in all axes of the force and of the torque, A = W M D, with D the derivative of the prediction and W
the inverse std, has the same A'A for every M of one unit; A' times the readings is a sum over the entries of M. The
tool is whole, with its torques and inertia: mass, first moment and inertia have to agree in a reading.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations_with_replacement
from math import comb, pi

import numpy as np
from numpy.typing import NDArray

from estimation.multiplicity import student_sf
from estimation.readings.axes_reading import AxesReading
from estimation.readings.motion_reading import AS_LOGGED, ROTATIONS, TRANSLATIONS, MotionReading, at_rest
from estimation.recordings.recording import Recording
from estimation.recordings.sign_convention import to_sensor_frame
from modeling.chain.model import ALIGNED_MOUNTING, WrenchModel
from modeling.chain.prediction import compiled_prediction
from modeling.effects.loads import ViscousDrag
from modeling.kinematics.placement import COMPONENTS
from modeling.rig import Convention

Array = NDArray[np.float64]

MOST_ROWS = 2000
"""Rows of a recording that are compared: a tool's weight needs no more, and all readings take some milliseconds."""
BLOCKS = 10
"""Contiguous blocks in which two readings are compared: each as long as the motion's correlation, enough for a std."""
MEDIAN_SQUARE = 0.4549
"""Median of the square of a normal deviate, in which jumps of a contact hardly count."""
SMALLEST_STD = 1e-9
"""N or N m, of readings without noise, so that they can be divided by it."""
SHIFT_STEPS = 5
"""Gauss-Newton steps to the shift of a point: the product of it with the first moment is all that is not linear."""
THIRD = 3
"""Order of the differences that show the white noise; its variance in them is that of noise times (6 over 3)."""
FREE_TOLERANCE = 1e-6
"""Of the largest singular value of many inputs alike: what is smaller is rounding of a motion's derivatives."""
RANK_TOLERANCE = 1e-10
"""Of the largest singular value of the normal matrix: a parameter that the motion does not excite has no column."""


@dataclass(frozen=True, eq=False)
class RigidRows:
    """Readings (n, p) of recordings, and the derivative (n, p, k) of the wrench that a rigid tool predicts.

    Both are over the noise from sample to sample, and about their means in each recording.
    """

    motion: MotionReading
    readings: Array
    derivative: Array

    @classmethod
    def of(cls, recordings: Sequence[Recording], model: WrenchModel, motion: MotionReading) -> RigidRows:
        """Of every recording no more than `MOST_ROWS`; the model is `tool_model`'s."""
        std = noise_from_sample_to_sample(recordings)
        derivatives, readings = [], []
        for recording in recordings:
            derivative = rigid_derivative(recording, model, motion) / std[:, None]
            reading = recording.wrench[compared_rows(recording)] / std
            # At rest a zero along base axes is a weight: there is none then, and the sensor's own turns with it.
            centred = not (motion.in_base and recording.at_rest)
            derivatives.append(_centred(derivative) if centred else derivative)
            readings.append(_centred(reading) if centred else reading)
        return cls(motion, np.concatenate(readings), np.concatenate(derivatives))

    @cached_property
    def power(self) -> float:
        """Sum of the squared readings."""
        return float((self.readings**2).sum())

    @cached_property
    def unstructured_mean_square(self) -> float:
        """Mean square of what is left where each reading is any linear function of what the tool's may be.

        No reading of the wrench leaves less, nor does crosstalk, a gain or a sensor that is turned. 0 where the rows
        are too few to tell.
        """
        inputs = self.derivative.reshape(len(self.derivative), -1)
        size = np.maximum(np.linalg.norm(inputs, axis=0), SMALLEST_STD)
        left, sizes, _ = np.linalg.svd(inputs / size, full_matrices=False)
        left = left[:, sizes > FREE_TOLERANCE * sizes[0]]
        freedom = len(inputs) - left.shape[1] - 1
        if freedom < len(inputs) / 2:
            return 0.0
        explained = float(((left.T @ self.readings) ** 2).sum())
        return float((self.power - explained) / freedom / self.readings.shape[1])

    @cached_property
    def _normal(self) -> tuple[Array, Array]:
        """Normal matrices (k, k) of the forces and of the torques."""
        forces = 2 if self.readings.shape[1] == 3 else 3
        halves = (self.derivative[:, :forces], self.derivative[:, forces:])
        force, torque = (flat.T @ flat for flat in (half.reshape(-1, half.shape[2]) for half in halves))
        return force, torque

    @cached_property
    def _inverses(self) -> dict[tuple[float, float], Array]:
        return {}

    def inverse(self, factors: tuple[float, float]) -> Array:
        """Pseudoinverse (k, k) of the normal matrix where forces and torques are multiplied by factors."""
        if factors not in self._inverses:
            (of_force, of_torque), (force, torque) = factors, self._normal
            self._inverses[factors] = _inverse(of_force**2 * force + of_torque**2 * torque)
        return self._inverses[factors]

    @cached_property
    def products(self) -> Array:
        """Entry (j, i, k): readings of channel j with what channel i has of parameter k."""
        count = len(self.readings)
        flat = self.readings.T @ self.derivative.reshape(count, -1)
        return flat.reshape(self.readings.shape[1], *self.derivative.shape[1:])


def tool_model(model: WrenchModel, recordings: Sequence[Recording]) -> WrenchModel:
    """The rigid tool of a model, on the tool and not turned, with a drag where all recordings have a velocity.

    A drag is the most usual effect, and would hide a mistake that is small beside it.
    """
    base = replace(
        model.base, convention=Convention.ON_TOOL, mounting=ALIGNED_MOUNTING, gravity_direction=None, arm=None
    )
    dragged = base + ViscousDrag()
    known = not any(r.at_rest or not set(dragged.inputs) <= r.signals.keys() for r in recordings)
    return dragged if known else base


def compared_rows(recording: Recording) -> slice:
    """No more than `MOST_ROWS` rows of a recording."""
    return slice(None, None, -(-recording.samples // MOST_ROWS))


def rigid_derivative(
    recording: Recording, model: WrenchModel, motion: MotionReading, rows: slice | None = None
) -> Array:
    """Derivative (n, p, k) of the wrench in the tool's parameters, along the axes of the readings, not turned.

    Of a drag it is that in its coefficient, in its lever for a coefficient of 1, and in the products of the lever's
    components. Where a weight was subtracted, the
    second half of the parameters is that of the tool whose weight it is, negative. Along base axes a bias of the sensor
    turns with it, and the last parameters, one for each channel, are that. By default of `compared_rows`.
    """
    rows = compared_rows(recording) if rows is None else rows
    signals = motion.signals(recording, rows)
    derivative = _derivative(signals, model)
    if motion.compensated:
        return np.concatenate([derivative, _derivative(at_rest(signals, recording.dimension), model)], axis=2)
    if motion.pulled:
        derivative = np.concatenate([derivative, *_pulls(recording, signals, model)], axis=2)
    if not motion.in_base:
        return derivative
    channels = derivative.shape[1]
    zero = np.broadcast_to(np.eye(channels), (len(derivative), channels, channels))
    to_base = from_base_axes(signals, model).transpose(0, 2, 1)
    return np.asarray(to_base @ np.concatenate([derivative, zero], axis=2))


def from_base_axes(signals: Mapping[str, Array], model: WrenchModel) -> Array:
    """Rotations (n, p, p) of a wrench along base axes to the sensor's; in the plane x and y are those of a position."""
    if "phi" not in signals:
        turn = to_sensor_frame(np.stack([signals[name] for name in COMPONENTS], axis=1))
        return np.asarray(np.kron(np.eye(2), turn))
    cosine, sine, none = np.cos(signals["phi"]), np.sin(signals["phi"]), np.zeros(len(signals["phi"]))
    across = 1.0 if model.mirror_y else -1.0
    rows = [[cosine, -sine, none], [across * sine, across * cosine, none], [none, none, none + 1.0]]
    return np.array(rows).transpose(2, 0, 1)


def _pulls(recording: Recording, signals: Mapping[str, Array], model: WrenchModel) -> Iterator[Array]:
    """Derivatives (n, p, k) in forces along base axes, with their levers, and in torques that are constant there.

    In six axes also in the torque of a rotor, which forces at any lever would be like beside an exchange of torques.
    The forces are constant, or linear in the position as those of a cable that is taut. In the plane they are the
    weight of a tool at rest, turned, and the torque is a bias.
    """
    once = np.ones(len(next(iter(signals.values()))))
    positions = {} if recording.at_rest else signals  # of which orientations alone, too, may be logged
    factors = [once, *(_centred(positions.get(name, once)) for name in TRANSLATIONS[recording.dimension][0])]
    if recording.dimension == 2:
        turned = ({**signals, "phi": signals["phi"] + turn} for turn in (0.0, pi / 2))
        pushes = [_derivative(at_rest(each, 2), model)[:, :, :2] for each in turned]
    else:
        to_sensor = to_sensor_frame(np.stack([signals[name] for name in COMPONENTS], axis=1))
        none = np.zeros_like(to_sensor)
        yield np.concatenate([none, to_sensor], axis=1)
        omega = np.stack([positions.get(name, 0 * once) for name in ROTATIONS[3][1]], axis=1)
        yield np.concatenate([np.zeros((len(once), 3, 4)), _levers(omega)], axis=1)
        pushes = [
            np.concatenate([np.concatenate([along[:, :, None], none], axis=2), _levers(along)], axis=1)
            for along in to_sensor.transpose(2, 0, 1)
        ]
    yield from (factor[:, None, None] * push for push in pushes for factor in factors)


def _levers(force: Array) -> Array:
    """Torques (n, 3, 4) of a force (n, 3): none by itself, and in each component of its lever."""
    torques = [np.cross(lever, force) for lever in np.eye(3)]
    return np.stack([np.zeros_like(force), *torques], axis=2)


def _derivative(signals: Mapping[str, Array], model: WrenchModel) -> Array:
    """Derivative (n, p, k) of the load in the model's parameters but the biases."""
    about = np.zeros(len(model.parameters))
    about[model.base_size : model.base_size + 1] = 1.0
    rows = len(next(iter(signals.values())))
    excited = [i for i, p in enumerate(model.parameters) if p not in model.biases]
    derivative = np.asarray(compiled_prediction(model).load.tangent(signals, about, rows)[1][:, :, excited])
    return np.concatenate([derivative, _of_lever_squared(signals, rows)], axis=2) if model.effects else derivative


def _of_lever_squared(signals: Mapping[str, Array], rows: int) -> Array:
    """Torque (n, p, k) of a drag on a body that turns about the sensor: -c r x (omega x r), linear in products of r.

    It is far above the noise of a torque, and without it a position that is shifted would explain it.
    """
    if "dphi" in signals:
        return np.stack([np.zeros(rows), np.zeros(rows), signals["dphi"]], axis=1)[:, :, None]
    omega = np.stack([signals[name] for name in ROTATIONS[3][1]], axis=1)
    torques = np.zeros((rows, 6, 6))
    for k, (i, j) in enumerate(combinations_with_replacement(range(3), 2)):
        torques[:, 3 + i, k] = omega[:, j]
        torques[:, 3 + j, k] = omega[:, i]
    return torques


def fitted_shift(
    recordings: Sequence[Recording], model: WrenchModel, axes: AxesReading, motion: MotionReading = AS_LOGGED
) -> Array:
    """The shift (3,) m, of the sensor's origin from the point whose position was logged, in sensor axes.

    By Gauss-Newton with the tool's parameters: what the tool predicts is linear in them, and in the shift.
    """
    points = (np.zeros(3), *np.eye(3))
    unshifted, *shifted = (RigidRows.of(recordings, model, replace(motion, shift=point)) for point in points)
    first = RankedReading(axes, unshifted)
    slopes = [rows.derivative - unshifted.derivative for rows in shifted]
    parts = np.concatenate([unshifted.derivative, *slopes], axis=2).reshape(unshifted.readings.size, -1)
    normal, right_side = parts.T @ parts, parts.T @ (unshifted.readings @ axes.matrix).ravel()
    shift, parameters = np.zeros(3), first.parameters
    for _ in range(SHIFT_STEPS):
        of_tool = np.kron(np.concatenate([[1.0], shift])[:, None], np.eye(len(parameters)))
        of_shift = np.kron(np.eye(4)[:, 1:], parameters[:, None])
        slope = np.hstack([of_tool, of_shift])
        step = _inverse(slope.T @ normal @ slope) @ slope.T @ right_side
        parameters, shift = step[:-3], shift + step[-3:]
    return np.asarray(shift)


def noise_from_sample_to_sample(recordings: Sequence[Recording]) -> Array:
    """Std (p,) of the readings' noise, one for forces and one for torques, from differences of neighbouring samples.

    Of dwells that of their means, from the rows within them.
    """
    squares = []
    for recording in recordings:
        if recording.dwells is not None:
            squares.append(np.median(recording.dwells.std**2, axis=0))
            continue
        changes = np.diff(recording.wrench, axis=0) if not recording.at_rest else _centred(recording.wrench)
        squares.append(np.median(changes**2, axis=0) / MEDIAN_SQUARE / (1 if recording.at_rest else 2))
    variance = np.mean(squares, axis=0)
    forces = 2 if len(variance) == 3 else 3
    means = [max(float(group.mean()), SMALLEST_STD**2) for group in (variance[:forces], variance[forces:])]
    return np.repeat(np.sqrt(means), (forces, len(variance) - forces))


def white_noise(recordings: Sequence[Recording]) -> float:
    """Mean square of the noise that third differences of the readings show, over that from sample to sample.

    It is as large or smaller, as third differences have hardly anything of a motion. 0 of poses at rest, in any order.
    """
    if any(recording.at_rest or recording.samples <= THIRD for recording in recordings):
        return 0.0
    std = noise_from_sample_to_sample(recordings)
    squares = [np.diff(recording.wrench / std, THIRD, axis=0) ** 2 for recording in recordings]
    return float(np.mean([np.median(each, axis=0) / MEDIAN_SQUARE / comb(2 * THIRD, THIRD) for each in squares]))


def _inverse(normal: Array) -> Array:
    """Pseudoinverse (k, k) of a normal matrix, its columns scaled to unit length."""
    size = np.sqrt(np.maximum(np.diag(normal), SMALLEST_STD**2))
    scaled = np.linalg.pinv(normal / np.outer(size, size), rcond=RANK_TOLERANCE, hermitian=True)
    return np.asarray(scaled / np.outer(size, size))


def _centred(rows: Array) -> Array:
    return np.asarray(rows - rows.mean(axis=0))


@dataclass(frozen=True, eq=False)
class RankedReading:
    """A reading of rows, with the residual that it leaves."""

    axes: AxesReading
    rows: RigidRows

    @property
    def motion(self) -> MotionReading:
        """How the motion is read."""
        return self.rows.motion

    @cached_property
    def parameters(self) -> Array:
        """Parameters (k,) of the tool."""
        return self.rows.inverse(self.axes.factors) @ self._right_side

    @cached_property
    def _right_side(self) -> Array:
        return np.asarray(np.einsum("ji,jik->k", self.axes.matrix, self.rows.products))

    @property
    def mass(self) -> float:
        """Of the tool, kg."""
        return float(self.parameters[0])

    @property
    def subtracted_mass(self) -> float:
        """kg, of the weight that was subtracted from the readings; 0 where none is looked for."""
        return -float(self.parameters[len(self.parameters) // 2]) if self.motion.compensated else 0.0

    @cached_property
    def mean_square(self) -> float:
        """Of the whitened residual."""
        explained = float(self._right_side @ self.parameters)
        return max(self.rows.power - explained, SMALLEST_STD) / self.rows.readings.size

    @cached_property
    def residual(self) -> Array:
        """Whitened residual (n, p)."""
        return self.rows.readings - (self.rows.derivative @ self.parameters) @ self.axes.matrix.T

    def gain_over(self, other: RankedReading) -> float:
        """By how much it makes the mean square of the residual's forces, or of its torques, smaller than another one.

        What is mistaken may be small beside an effect that is hidden in the other ones. 0 where those become larger.
        """
        if self.mean_square > other.mean_square:
            return 0.0
        return max(b / a for b, a in zip(other.mean_squares, self.mean_squares, strict=True))

    @property
    def mean_squares(self) -> tuple[float, float]:
        """Of the whitened residual's forces and of its torques."""
        forces = 2 if self.residual.shape[1] == 3 else 3
        groups = (self.residual[:, :forces], self.residual[:, forces:])
        of_forces, of_torques = (max(float((group**2).mean()), SMALLEST_STD) for group in groups)
        return of_forces, of_torques

    def is_like(self, other: RankedReading) -> bool:
        """Whether another reading differs in a unit alone, or in nothing that the rows show."""
        same = abs(self.mean_square - other.mean_square) <= FREE_TOLERANCE * self.mean_square
        return same or self.axes.is_other_unit(other.axes)

    @cached_property
    def squares(self) -> Array:
        """Mean squared whitened residual (n,) of each row."""
        return np.asarray((self.residual**2).mean(axis=1))

    def p_value_against(self, other: RankedReading, tried: int) -> float:
        """That another reading is no nearer to the truth than this one, family-wise over so many."""
        blocks = zip(*(np.array_split(r.squares, BLOCKS) for r in (self, other)), strict=True)
        ratios = [np.log(max(a.mean(), SMALLEST_STD) / max(b.mean(), SMALLEST_STD)) for a, b in blocks if len(a)]
        deviation = max(float(np.std(ratios, ddof=1)), SMALLEST_STD) / np.sqrt(len(ratios))
        return min(1.0, tried * float(student_sf(float(np.mean(ratios)) / deviation, len(ratios) - 1)))
