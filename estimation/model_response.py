"""Predicted response of a model to a recording, sample by sample, with parameter derivatives."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimation.recordings.motion import Motion
from estimation.recordings.recording import Recording
from estimation.recordings.repeat_motion import is_separated, varying_channels
from modeling.chain.model import WrenchModel
from modeling.chain.prediction import compiled_prediction
from modeling.dynamics.equation_of_motion import DEFLECTION_TOLERANCE
from modeling.dynamics.motion_record import MotionRecord, ResponsePart
from modeling.rigid_body import Load, known_moments

Array = NDArray[np.float64]

NONPERIODIC_SIGNALS = ("time", "progress", "order")
"""Signals that are not periodic with the motion; auxiliary signals are not either."""


@dataclass(frozen=True, eq=False)
class ModelResponse:
    """Predicted series as the sum of a part that is periodic with the motion and one over the whole record.

    Either part is (value (samples, p), derivative (samples, p, k)); `periodic` holds one repeat, and is the whole
    series where the recording has no repeats (`whole` is None then). The derivative of `whole` is with respect to the
    parameters at the positions `columns` (None: all); in the others it vanishes. Both are of the mean motion;
    `own_motion` (samples, p) is what the motion of each repeat adds (`estimation/recordings/repeat_motion.py`), None
    where the repeats are equal.
    """

    periodic: tuple[Array, Array]
    whole: tuple[Array, Array] | None
    repeats: int
    columns: tuple[int, ...] | None = None
    own_motion: Array | None = None

    @property
    def value(self) -> Array:
        """The predicted readings over the whole record, (n, p)."""
        tiled = np.tile(self.periodic[0], (self.repeats, 1))
        mean = tiled if self.whole is None else tiled + self.whole[0]
        return mean if self.own_motion is None else mean + self.own_motion

    @property
    def derivative(self) -> Array:
        """Derivative of the predicted readings over the whole record, (n, p, k)."""
        tiled = np.tile(self.periodic[1], (self.repeats, 1, 1))
        if self.whole is not None:
            tiled[:, :, slice(None) if self.columns is None else list(self.columns)] += self.whole[1]
        return tiled

    def in_columns(self, kept: NDArray[np.intp]) -> ModelResponse:
        """The response with the derivative to the parameters at these positions (m,) alone, in their order."""
        value, derivative = self.periodic
        whole, columns = self.whole, self.columns
        if whole is not None:
            positions = list(range(derivative.shape[-1]) if columns is None else columns)
            columns = tuple(place for place, position in enumerate(kept.tolist()) if position in positions)
            whole = whole[0], whole[1][..., [positions.index(kept[place]) for place in columns]]
        return replace(self, periodic=(value, derivative[..., kept]), whole=whole, columns=columns)


def missing_inputs(model: WrenchModel, recording: Recording) -> tuple[str, ...]:
    """Signals that the model needs and the recording lacks."""
    if model.arm is None and any(effect.needs_joints for effect in model.effects):
        return ("q1",)
    available = recording.motion.model_signals
    return tuple(name for name in compiled_prediction(model).model.inputs if name not in available)


def model_response(
    model: WrenchModel,
    recording: Recording,
    theta: Array,
    *,
    derivative: bool = True,
    tolerance: float = DEFLECTION_TOLERANCE,
    block: int = 1,
) -> ModelResponse:
    """Prediction of a recording at the parameters theta (k,), in the model's order and units.

    With `derivative` False its arrays are (n, p, 0). `tolerance` is the relative size of the last correction of a
    deflection, which is solved by iteration. Where `averaged_block` allows it, its series are means over blocks of
    samples. Raises InputError when the recording lacks a signal that the model needs.
    """
    record = motion_record(model, recording.motion, theta, derivative=derivative, measured=first_readings(recording))
    mean = _response(model, replace(record, block=averaged_block(model, recording, block)), tolerance)
    own_motion = recording.own_motion
    if own_motion is None:
        return mean
    return replace(mean, own_motion=_added(model, recording.motion, own_motion, theta, mean))


def motion_response(
    model: WrenchModel,
    motion: Motion,
    theta: Array,
    *,
    derivative: bool = True,
    tolerance: float = DEFLECTION_TOLERANCE,
    steady: bool = True,
) -> ModelResponse:
    """`model_response` to the signals of a motion, if `steady` in its periodic steady state."""
    return _response(model, motion_record(model, motion, theta, derivative=derivative, steady=steady), tolerance)


def averaged_block(model: WrenchModel, recording: Recording, block: int) -> int:
    """The block of samples over which a response may be averaged as it is evaluated: 1 unless it is instantaneous."""
    return block if recording.repeats == 1 and compiled_prediction(model).instantaneous else 1


def first_readings(recording: Recording) -> Array | None:
    """The readings (n, p) of a record in motion without pauses, None of any other."""
    paused = recording.repeats > 1 and not recording.continuous
    return None if paused or recording.dt is None else recording.wrench


def _response(model: WrenchModel, record: MotionRecord, tolerance: float) -> ModelResponse:
    """The response along a record of motion."""
    k = len(record.theta) if record.derivative else 0
    deflection = compiled_prediction(model).deflection
    parts = record.evaluated("load") if deflection is None else [deflection.response(record, tolerance)]
    for stage in compiled_prediction(model).stages:
        parts = stage.response(parts, record)
    once = record.samples_per_repeat // record.block
    zero = (np.zeros((once, len(model.channels))), np.zeros((once, len(model.channels), k)))
    nonperiodic = [summand for summand in parts if not summand.periodic]
    columns = _columns_of(nonperiodic, k)
    return ModelResponse(
        periodic=_sum([summand for summand in parts if summand.periodic], tuple(range(k))) or zero,
        whole=_sum(nonperiodic, columns),
        repeats=record.repeats,
        columns=columns,
    )


def _added(model: WrenchModel, motion: Motion, of_repeats: Motion, theta: Array, mean: ModelResponse) -> Array:
    """What each repeat's own motion adds to the response (n, p) to the mean motion.

    A motion that differs from repeat to repeat is in no steady state, and what came before the record is unknown: a
    model with memory responds to both motions from the record's start, where the same is missing in both.
    """
    if not compiled_prediction(model).instantaneous:
        mean = motion_response(model, motion, theta, derivative=False, steady=False)
    return motion_response(model, of_repeats, theta, derivative=False, steady=False).value - mean.value


def readings_follow_repeats(base: WrenchModel, recording: Recording) -> bool:
    """Whether the readings show that each repeat moved as was measured, where the repeats differ beyond noise.

    The rigid tool `base`, fitted to the mean of the readings, predicts what the differences of the motion add to them.
    If it was an error of the measured motion, the readings lack it (`is_separated`). True differences that are missed
    are noise then: they are small, or the same at all phases of the motion.
    """
    motion, of_repeats = recording.motion, recording.motion.of_each_repeat
    if of_repeats is None:
        return False
    nothing = np.zeros(len(base.parameters))
    response = motion_response(base, motion, nothing)
    readings = recording.averaged(recording.wrench) - response.value
    varying, weight = varying_channels(recording.wrench), np.zeros(recording.wrench.shape[1])
    weight[varying] = 1 / recording.wrench.std(axis=0)[varying]
    rows = (response.derivative * weight[:, None]).reshape(-1, len(nothing))
    theta = np.asarray(np.linalg.lstsq(rows, (readings * weight).ravel(), rcond=None)[0], dtype=np.float64)
    mean = motion_response(base, motion, theta, derivative=False)
    return is_separated(_added(base, motion, of_repeats, theta, mean), recording.wrench, recording.repeats)


def _columns_of(parts: Sequence[ResponsePart], count: int) -> tuple[int, ...]:
    """Positions of the parameters that any of the parts depends on."""
    if any(summand.columns is None for summand in parts):
        return tuple(range(count))
    return tuple(sorted({i for summand in parts for i in summand.columns or ()}))


def _sum(parts: Sequence[ResponsePart], columns: tuple[int, ...]) -> tuple[Array, Array] | None:
    """Value of the sum and its derivative in the parameters `columns`: views of one array, value first."""
    if not parts:
        return None
    joined = np.empty((*parts[0].value.shape, 1 + len(columns)), order="F")
    value, derivative = joined[:, :, 0], joined[:, :, 1:]
    value[:] = parts[0].value
    for summand in parts[1:]:
        value += summand.value
    for place, column in enumerate(columns):
        given = [(s, range(s.derivative.shape[2]) if s.columns is None else s.columns) for s in parts]
        slopes = [s.derivative[:, :, of.index(column)] for s, of in given if column in of]
        derivative[:, :, place] = slopes[0] if slopes else 0.0
        for more in slopes[1:]:
            derivative[:, :, place] += more
    return value, derivative


def motion_record(
    model: WrenchModel,
    motion: Motion,
    theta: Array,
    *,
    derivative: bool = True,
    steady: bool = True,
    measured: Array | None = None,
) -> MotionRecord:
    """The motion as the stages of the model take it, at the parameters theta (k,)."""
    prediction = compiled_prediction(model)
    changing = () if steady else motion.signals
    recorded = motion.recorded
    theta = with_loads(model, motion.loads, theta)
    return MotionRecord(
        signals=motion.model_signals,
        dt=recorded.dt,
        repeats=recorded.repeats,
        samples_per_repeat=recorded.samples_per_repeat,
        continuous=recorded.continuous,
        nonperiodic=nonperiodic_signals(motion) | {*changing},
        theta=theta,
        vectors=prediction.vector,
        transfer=prediction.transfer,
        transfer_parameters=prediction.transfer_parameters,
        summed=not all(stage.linear for stage in prediction.stages),
        derivative=derivative,
        steady=steady,
        measured=measured,
    )


def with_loads(model: WrenchModel, loads: Sequence[Load], theta: Array) -> Array:
    """Parameters (.., k) of a model whose tool has the known loads with it: moments of rigid bodies add up.

    The derivative in a parameter of the tool is that at these.
    """
    moments = known_moments(loads, model.space)
    if moments is None:
        return theta
    carried, first = np.array(theta, dtype=float), len(model.biases)
    carried[..., first : first + len(moments)] += moments
    return carried


def nonperiodic_signals(motion: Motion) -> frozenset[str]:
    """Names of the signals that differ between repeats."""
    changing = motion.signals if motion.is_of_repeats else ()
    return frozenset({*NONPERIODIC_SIGNALS, *motion.auxiliary, *changing})


def signals_are_periodic(inputs: Iterable[str], motion: Motion) -> bool:
    """Whether these signals are the same in every repeat; true for a single run."""
    return motion.recorded.repeats == 1 or not set(inputs) & nonperiodic_signals(motion)


def predicted_readings(model: WrenchModel, recording: Recording, theta: Array) -> Array:
    """The predicted readings of a recording, (n, p), in the channels' units."""
    return model_response(model, recording, theta, derivative=False).value
