"""Readings: whether six-axis recordings are read as they were meant, tested before any physics is looked for.

A reading is a hypothesis like an effect: the sign of the torques, an axis that is mirrored, the sense of gravity. Each
says that the readings are M times what the rigid tool predicts, M a signed permutation of the axes of force and torque.
As M is orthogonal, and noise is as large in all axes of the force and of the torque, A = W M D, with D the derivative
of the prediction and W the inverse std, has the same A'A for every M; A' times the readings is a sum over its entries.
The tool is whole, with its torques and inertia: mass, first moment and inertia have to agree in a reading.

A reading is shown where the residual that it leaves is smaller by `LEAST_GAIN` and by a test that holds though neither
reading is true (Vuong, "Likelihood ratio tests for model selection and non-nested hypotheses", 1989), in contiguous
blocks, against the recording as read and against every other reading. The scale of the noise is that of the readings'
differences from sample to sample: a residual would have the mistake in it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.multiplicity import student_sf
from estimation.reading.column_map import TORQUE
from estimation.recordings.recording import Recording
from modeling.chain.model import ALIGNED_MOUNTING, QUARTER_TURNS, QuarterTurnRotation, WrenchModel
from modeling.chain.prediction import compiled_prediction
from modeling.kinematics.placement import Direction
from modeling.rig import Convention, Rig
from modeling.significance import LEVELS

Array = NDArray[np.float64]

MOST_ROWS = 2000
"""Rows of a recording that are compared: a tool's weight needs no more, and all readings take some milliseconds."""
LEAST_GAIN = 2.0
"""Ratio of the mean squares of the two residuals: a mistake of the whole recording is most of what the rigid tool
leaves as read, and what removes less than half of it is left to physics."""
BLOCKS = 10
"""Contiguous blocks in which two readings are compared: each as long as the motion's correlation, enough for a std."""
MEDIAN_SQUARE = 0.4549
"""Median of the square of a normal deviate, in which jumps of a contact hardly count."""
SMALLEST_STD = 1e-9
"""N or N m, of readings without noise, so that they can be divided by it."""
RANK_TOLERANCE = 1e-10
"""Of the largest singular value of the normal matrix: a parameter that the motion does not excite has no column."""
FEW = 40
"""Readings with the smallest residuals that are compared sample by sample, the others are too far off to be alike."""
LARGEST_MASS = 5000.0
"""kg: twice what the strongest industrial robots carry; a wrist sensor that reads more reads no newtons."""
TORQUE_UNITS = {unit: 1 / TORQUE[unit] for unit in ("N mm", "N cm", "lbf in", "lbf ft")}
"""Logged torques for each N m, beside forces in N."""
UP: Direction = (0.0, 0.0, 1.0)
SIGN_OF = {Convention.ON_TOOL: 1.0, Convention.ON_SENSOR: -1.0}


@dataclass(frozen=True, eq=False)
class AxesReading:
    """What the logged wrench is of the sensor's: `factors` times the wrench of a sensor that is mounted turned.

    mistake  id of what would be mistaken, empty for none; `detail` the axis that is mirrored, or the unit
    factors  (6,) of the logged forces and torques
    turn     quarter turns (3, 3) of the mounting; `gravity` the direction in base axes, None as the model has it
    """

    mistake: str
    detail: str
    factors: Array
    convention: Convention
    turn: QuarterTurnRotation
    gravity: Direction | None = None

    @property
    def cost(self) -> tuple[bool, bool, bool]:
        """A mistake, a mounting that is turned, gravity that points up: the simplest reading has the least."""
        return (bool(self.mistake), self.turn != ALIGNED_MOUNTING, self.gravity is not None)

    @cached_property
    def matrix(self) -> Array:
        """From the wrench that the tool predicts, on it and not turned, to the logged one, (6, 6)."""
        turn = SIGN_OF[self.convention] * np.array(self.turn, dtype=np.float64)
        return self.factors[:, None] * np.kron(np.eye(2), turn)


def axes_readings(gravity: Direction | None) -> Iterator[AxesReading]:
    """Every reading of the axes: signs and quarter turns as a mounting has them, each alone and with one mistake."""
    torques = np.arange(6) >= 3
    mistakes = [("", "", np.ones(6)), ("torque_sign", "", np.where(torques, -1.0, 1.0))]
    for number, axis in enumerate("xyz"):
        for mistake, place in (("force_axis_mirrored", number), ("torque_axis_mirrored", 3 + number)):
            mistakes.append((mistake, axis, np.where(np.arange(6) == place, -1.0, 1.0)))
    mistakes += [("torque_unit", unit, np.where(torques, factor, 1.0)) for unit, factor in TORQUE_UNITS.items()]
    for convention, turn, (mistake, detail, factors) in product(SIGN_OF, QUARTER_TURNS, mistakes):
        yield AxesReading(mistake, detail, factors, convention, turn, gravity)


@dataclass(frozen=True, eq=False)
class RigidRows:
    """Readings (n, 6) of recordings, and the derivative (n, 6, k) of the wrench that a rigid tool predicts.

    Both are over the noise from sample to sample, and about their means in each recording.
    """

    readings: Array
    derivative: Array

    @classmethod
    def of(cls, recordings: Sequence[Recording], model: WrenchModel) -> RigidRows:
        """Of every recording no more than `MOST_ROWS`; the model is a rigid tool's, on the tool, not turned."""
        readings, derivatives = [], []
        prediction, count = compiled_prediction(model), model.base_size
        std = _scale(recordings)
        for recording in recordings:
            every = slice(None, None, -(-recording.samples // MOST_ROWS))
            rows = len(range(*every.indices(recording.samples)))
            inputs = {name: series[every] for name, series in recording.signals.items()}
            derivative = prediction.load.tangent(inputs, np.zeros(count), rows)[1]
            excited = [i for i, p in enumerate(model.parameters) if p not in model.biases]
            derivatives.append(_centred(derivative[:, :, excited] / std[:, None]))
            readings.append(_centred(recording.wrench[every] / std))
        return cls(np.concatenate(readings), np.concatenate(derivatives))

    @cached_property
    def power(self) -> float:
        """Sum of the squared readings."""
        return float((self.readings**2).sum())

    @cached_property
    def inverses(self) -> Mapping[float, Array]:
        """Pseudoinverse (k, k) of the normal matrix for each factor of the torques."""
        force, torque = (
            np.einsum("nik,nil->kl", half, half) for half in (self.derivative[:, :3], self.derivative[:, 3:])
        )
        return {factor: _inverse(force + factor**2 * torque) for factor in (1.0, *TORQUE_UNITS.values())}

    @cached_property
    def products(self) -> Array:
        """Entry (j, i, k): readings of channel j with what channel i has of parameter k."""
        return np.asarray(np.einsum("nik,nj->jik", self.derivative, self.readings))


def _scale(recordings: Sequence[Recording]) -> Array:
    """Std (6,) of the readings' noise, one for forces and one for torques, from differences of neighbouring samples."""
    squares = []
    for recording in recordings:
        changes = np.diff(recording.wrench, axis=0) if not recording.at_rest else _centred(recording.wrench)
        squares.append(np.median(changes**2, axis=0) / MEDIAN_SQUARE / (1 if recording.at_rest else 2))
    variance = np.mean(squares, axis=0)
    return np.repeat(np.sqrt([max(float(group.mean()), SMALLEST_STD**2) for group in (variance[:3], variance[3:])]), 3)


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

    reading: AxesReading
    rows: RigidRows

    @cached_property
    def parameters(self) -> Array:
        """Parameters (k,) of the tool."""
        return self.rows.inverses[abs(self.reading.factors[-1])] @ self._right_side

    @cached_property
    def _right_side(self) -> Array:
        return np.asarray(np.einsum("ji,jik->k", self.reading.matrix, self.rows.products))

    @property
    def mass(self) -> float:
        """Of the tool, kg."""
        return float(self.parameters[0])

    @cached_property
    def mean_square(self) -> float:
        """Of the whitened residual."""
        explained = float(self._right_side @ self.parameters)
        return max(self.rows.power - explained, SMALLEST_STD) / self.rows.readings.size

    @cached_property
    def squares(self) -> Array:
        """Squared whitened residual (n,) of each row."""
        predicted = (self.rows.derivative @ self.parameters) @ self.reading.matrix.T
        return np.asarray(((self.rows.readings - predicted) ** 2).mean(axis=1))

    def p_value_against(self, other: RankedReading, tried: int) -> float:
        """That another reading is no nearer to the truth than this one, family-wise over so many."""
        blocks = zip(*(np.array_split(r.squares, BLOCKS) for r in (self, other)), strict=True)
        ratios = [np.log(max(a.mean(), SMALLEST_STD) / max(b.mean(), SMALLEST_STD)) for a, b in blocks if len(a)]
        deviation = max(float(np.std(ratios, ddof=1)), SMALLEST_STD) / np.sqrt(len(ratios))
        return min(1.0, tried * float(student_sf(float(np.mean(ratios)) / deviation, len(ratios) - 1)))

    def is_of(self, model: WrenchModel) -> bool:
        """Whether a model reads the recordings so."""
        own = self.reading
        if own.mistake or own.gravity is not None:
            return False
        return own.convention is model.convention and own.turn == model.mounting


@dataclass(frozen=True, eq=False)
class DoubtedReading:
    """A reading of recordings that is shown, other than the one that they were read by.

    before, after  root mean square of the rigid tool's residual over the noise from sample to sample, as read and in
                   this reading
    p_value        that the recording as read is as near to the truth, family-wise over all readings; None where nothing
                   but the weight is doubted
    mass           kg, of the tool in this reading
    adopted        whether the recordings are read so
    """

    reading: AxesReading
    before: float
    after: float
    p_value: float | None
    mass: float
    adopted: bool = False

    @property
    def id(self) -> str:
        """What is read otherwise."""
        if self.reading.mistake:
            return self.reading.mistake
        if self.reading.gravity is not None:
            return "gravity_direction"
        return "sensor_turned" if self.reading.turn != ALIGNED_MOUNTING else "wrench_sign"

    @property
    def value(self) -> Any:
        """Direction, rotation, convention or axis; None of a sign."""
        of_mistake = self.reading.detail or None
        values = {
            "gravity_direction": [int(component) for component in self.reading.gravity or ()],
            "sensor_turned": [list(row) for row in self.reading.turn],
            "wrench_sign": self.reading.convention.value,
        }
        return values.get(self.id, of_mistake)

    @property
    def statement(self) -> str:
        """The line of the rig, or the option, that states it."""
        convention = f'convention = "{self.reading.convention.value}" under [sensor]'
        statements = {
            "gravity_direction": f"gravity_direction = {self.value} under [robot] and {convention} of the rig",
            "sensor_turned": "turn the wrench into the axes of the pose",
            "wrench_sign": f"{convention} of the rig",
            "torque_unit": f'units = {{ torque = "{self.reading.detail}" }} in a map, or --read torque_unit',
            "force_unit": 'units = { force = "..", torque = ".." } in a map',
        }
        return statements.get(self.id, f"--read {self.id}")

    @property
    def meaning(self) -> str:
        """What it means, as a clause."""
        meanings = {
            "gravity_direction": f"gravity points along {self.value} of the base, the readings being"
            f" {self.reading.convention.value}",
            "sensor_turned": "the sensor is turned by quarter turns against the axes of the pose",
            "wrench_sign": f"the readings are {self.reading.convention.value}",
            "torque_unit": f"the torques are in {self.reading.detail}, the forces in N",
            "force_unit": "the forces are in other units than N, such as counts",
            "torque_sign": "the torques have the other sign than the forces",
            "force_axis_mirrored": f"the force along {self.reading.detail} has the other sign",
            "torque_axis_mirrored": f"the torque about {self.reading.detail} has the other sign",
        }
        return meanings[self.id]

    @property
    def sentence(self) -> str:
        """What is doubted, the evidence, and how it is stated."""
        if self.p_value is None:
            return (
                f"The recording seems to be read wrongly: {self.meaning}; the tool would"
                f" weigh {self.mass:.2g} kg. State them, {self.statement}; if they are N, --as-read takes the recording"
                " as it is."
            )
        evidence = (
            f"the residual of the rigid tool is {self.after:.2g} times the noise from sample to sample then, and"
            f" {self.before:.2g} times as read (p = {self.p_value:.1g}), with a mass of {self.mass:.4g} kg"
        )
        if self.adopted and self.reading.mistake:
            return (
                f"Read so that {self.meaning}: {evidence}. `compensate` and `compare` take a log as it stands: mend it"
                " for them."
            )
        if self.adopted:
            return f"Read so that {self.meaning}: {evidence}. To state it: {self.statement}; --as-read prevents it."
        return (
            f"The recording seems to be read wrongly: {self.meaning}; {evidence}."
            f" If it is so, apply it with {self.statement}; if not, --as-read takes the recording as it is."
        )

    def to_data(self) -> dict[str, Any]:
        """As plain data."""
        return {
            "id": self.id,
            "adopted": self.adopted,
            "value": self.value,
            "statement": self.statement,
            "p_value": self.p_value,
            "misfit": [self.before**2, self.after**2],
            "applies_to": "rig",
            "sentence": self.sentence,
        }


def doubted_reading(recordings: Sequence[Recording], model: WrenchModel) -> DoubtedReading | None:
    """The reading that is shown against how the recordings are read by a model, whose frames are decided; else None.

    Gravity may point up where the model has it down and nobody stated it.
    """
    base = replace(model.base, convention=Convention.ON_TOOL, mounting=ALIGNED_MOUNTING)
    rows: dict[Direction | None, RigidRows] = {None: RigidRows.of(recordings, base)}
    if model.gravity_direction is None:
        upward = [r.moved(rig=replace(r.rig or Rig(), gravity_direction=UP)) for r in recordings]
        arm = None if base.arm is None else base.arm.mounted(UP)
        rows[UP] = RigidRows.of(upward, replace(base, gravity_direction=UP, arm=None).with_arm(arm))
    every = [RankedReading(reading, own) for gravity, own in rows.items() for reading in axes_readings(gravity)]
    as_read = next(r for r in every if r.is_of(model))
    ranked = sorted((r for r in every if r.mass > 0), key=lambda r: (r.mean_square, r.reading.cost))[:FEW]
    if not ranked or ranked[0].mean_square * LEAST_GAIN > as_read.mean_square:
        return _too_heavy(as_read)
    of_cost = Counter(r.reading.cost for r in every)

    def tried(shown: RankedReading) -> int:
        """Each cost has its share of the level, and shares it among its readings: a simple one is no surprise."""
        return len(of_cost) * of_cost[shown.reading.cost]

    alike = [r for r in ranked if r.p_value_against(ranked[0], tried(ranked[0])) > LEVELS.misread]
    simplest = min(alike, key=lambda r: r.reading.cost)
    p_value = as_read.p_value_against(simplest, tried(simplest))
    if sum(r.reading.cost == simplest.reading.cost for r in alike) > 1 or p_value > LEVELS.misread:
        return None
    before, after = (float(np.sqrt(r.mean_square)) for r in (as_read, simplest))
    return DoubtedReading(simplest.reading, before, after, p_value, simplest.mass)


def _too_heavy(as_read: RankedReading) -> DoubtedReading | None:
    """The doubt in the unit of forces whose weight no wrist carries; None of one that is possible."""
    if abs(as_read.mass) < LARGEST_MASS:
        return None
    size = float(np.sqrt(as_read.mean_square))
    unknown = replace(as_read.reading, mistake="force_unit")
    return DoubtedReading(unknown, size, size, None, as_read.mass)
