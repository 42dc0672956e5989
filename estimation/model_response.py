"""Predicted response of a model to a recording, sample by sample, with parameter derivatives."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from estimation.recordings.derivatives.differentiation import spline_derivatives
from estimation.recordings.recording import OwnMotion, Recording
from estimation.recordings.repeat_motion import difference_of
from modeling.chain.model import WrenchModel
from modeling.chain.prediction import compiled_prediction
from modeling.dynamics.deflection.equation_of_motion import DEFLECTION_TOLERANCE
from modeling.dynamics.motion_record import MotionRecord, ResponsePart
from modeling.significance import LEVELS

Array = NDArray[np.float64]

NONPERIODIC_SIGNALS = ("time", "progress", "order")
"""Signals that are not periodic with the motion; auxiliary signals are not either."""

SPECTRUM_BANDS = 40
"""Of a spectrum that weighs what differs between repeats, equally wide in the logarithm of the frequency."""


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


@lru_cache(maxsize=32)
def model_signals(recording: Recording) -> Mapping[str, Array]:
    """The recording's signals, auxiliary ones smoothed, and `progress`, -1 to 1 over the record."""
    signals = dict(recording.signals)
    if recording.dt is not None:
        for name in (name for name in recording.auxiliary if np.ptp(signals[name]) > 0):
            signals[name] = spline_derivatives(signals[name][:, None], recording.dt).value[:, 0]
    return signals | {"progress": np.linspace(-1.0, 1.0, recording.samples)}


def missing_inputs(model: WrenchModel, recording: Recording) -> tuple[str, ...]:
    """Signals that the model needs and the recording lacks."""
    if model.arm is None and any(effect.needs_joints for effect in model.effects):
        return ("q1",)
    available = model_signals(recording)
    return tuple(name for name in compiled_prediction(model).model.inputs if name not in available)


def model_response(
    model: WrenchModel,
    recording: Recording,
    theta: Array,
    *,
    derivative: bool = True,
    tolerance: float = DEFLECTION_TOLERANCE,
) -> ModelResponse:
    """Prediction of a recording at the parameters theta (k,), in the model's order and units.

    With `derivative` False its arrays are (n, p, 0). `tolerance` is the relative size of the last correction of a
    deflection, which is solved by iteration. Raises InputError when the recording lacks a signal that the model needs.
    """
    mean = _mean_motion_response(model, recording, theta, derivative=derivative, tolerance=tolerance)
    own = decided_own_motion(model.base, recording)
    return mean if own is None else replace(mean, own_motion=_added(model, own, theta, mean))


def _mean_motion_response(
    model: WrenchModel,
    recording: Recording,
    theta: Array,
    *,
    derivative: bool,
    tolerance: float = DEFLECTION_TOLERANCE,
) -> ModelResponse:
    """`model_response` to the motion in the recording's signals."""
    k = len(theta) if derivative else 0
    record = motion_record(model, recording, theta, derivative=derivative)
    deflection = compiled_prediction(model).deflection
    parts = record.evaluated("load") if deflection is None else [deflection.response(record, tolerance)]
    for stage in compiled_prediction(model).stages:
        parts = stage.response(parts, record)
    once = recording.samples_per_repeat
    zero = (np.zeros((once, len(model.channels))), np.zeros((once, len(model.channels), k)))
    nonperiodic = [part for part in parts if not part.periodic]
    columns = _columns_of(nonperiodic, k)
    return ModelResponse(
        periodic=_sum([part for part in parts if part.periodic], tuple(range(k))) or zero,
        whole=_sum(nonperiodic, columns),
        repeats=recording.repeats,
        columns=columns,
    )


def _added(model: WrenchModel, own: OwnMotion, theta: Array, mean: ModelResponse) -> Array:
    """What each repeat's own motion adds to the response (n, p) to the mean motion."""
    return _mean_motion_response(model, own, theta, derivative=False).value - mean.value


@lru_cache(maxsize=32)
def decided_own_motion(base: WrenchModel, recording: Recording) -> OwnMotion | None:
    """The motion of each repeat, where it differs and the readings show that it did; None for the mean motion.

    The rigid tool, fitted to the mean of the readings, predicts what the differences of the motion add to them, d. Of
    what the readings e differ between the repeats, that is true (e = d + noise) or an error of the measured motion
    (e = noise). In noise of the spectrum S of e the chi-square of the second is higher by

        4 sum Re(conj(D) E) / S - 2 sum |D|² / S,

    and above `LEVELS.separated_by_readings` the first is taken: an error of the motion is taken for motion at 0.12 % at
    the most, whatever its size, and differences that are missed raise the chi-square of the whole record by less.
    """
    own = recording.own_motion
    if own is None:
        return None
    nothing = np.zeros(len(base.parameters))
    response = _mean_motion_response(base, recording, nothing, derivative=True)
    readings = recording.averaged(recording.wrench) - response.value
    spread = np.maximum(recording.wrench.std(axis=0), np.finfo(float).tiny)
    rows = (response.derivative / spread[:, None]).reshape(-1, len(nothing))
    theta = np.linalg.lstsq(rows, (readings / spread).ravel(), rcond=None)[0]
    added = _added(base, own, theta, _mean_motion_response(base, recording, theta, derivative=False))
    added, readings = (difference_of(series, own.repeats) for series in (added, recording.wrench))
    return own if _is_separated(added, readings) else None


def _is_separated(added: Array, differences: Array) -> bool:
    """Whether differences (n, p) of the readings surely contain what the motion adds to them (n, p)."""
    expected, found = np.fft.rfft(added, axis=0)[1:], np.fft.rfft(differences, axis=0)[1:]
    edges = np.unique(np.geomspace(1, len(found) + 1, SPECTRUM_BANDS + 1).astype(int)) - 1
    bands = [slice(a, b) for a, b in pairwise(edges)]
    power = np.concatenate([np.broadcast_to((np.abs(found[b]) ** 2).mean(axis=0), found[b].shape) for b in bands])
    weight = 1 / np.maximum(power, np.finfo(float).tiny)
    agreement = float((np.real(expected.conj() * found) * weight).sum())
    return 4 * agreement - 2 * float((np.abs(expected) ** 2 * weight).sum()) > LEVELS.separated_by_readings


def _columns_of(parts: Sequence[ResponsePart], count: int) -> tuple[int, ...]:
    """Positions of the parameters that any of the parts depends on."""
    if any(part.columns is None for part in parts):
        return tuple(range(count))
    return tuple(sorted({i for part in parts for i in part.columns or ()}))


def _sum(parts: Sequence[ResponsePart], columns: tuple[int, ...]) -> tuple[Array, Array] | None:
    """Value of the sum and its derivative in the parameters `columns`: views of one array, value first."""
    if not parts:
        return None
    joined = np.zeros((*parts[0].value.shape, 1 + len(columns)), order="F")
    value, derivative = joined[:, :, 0], joined[:, :, 1:]
    for part in parts:
        value += part.value
        if part.columns is None or part.columns == columns:
            derivative += part.derivative
        else:
            for place, i in enumerate(part.columns):
                derivative[:, :, columns.index(i)] += part.derivative[:, :, place]
    return value, derivative


def motion_record(model: WrenchModel, recording: Recording, theta: Array, *, derivative: bool = True) -> MotionRecord:
    """The recording as the stages of the model take it, at the parameters theta (k,)."""
    prediction = compiled_prediction(model)
    return MotionRecord(
        signals=model_signals(recording),
        dt=recording.dt,
        repeats=recording.repeats,
        samples_per_repeat=recording.samples_per_repeat,
        continuous=recording.continuous,
        nonperiodic=nonperiodic_signals(recording),
        theta=theta,
        vectors=prediction.vector,
        transfer=prediction.transfer,
        transfer_parameters=prediction.transfer_parameters,
        summed=not all(stage.linear for stage in prediction.stages),
        derivative=derivative,
    )


def nonperiodic_signals(recording: Recording) -> frozenset[str]:
    """Names of the signals that differ between repeats."""
    motion = recording.signals if isinstance(recording, OwnMotion) else ()
    return frozenset({*NONPERIODIC_SIGNALS, *recording.auxiliary, *motion})


def signals_are_periodic(inputs: Iterable[str], recording: Recording) -> bool:
    """Whether these signals are the same in every repeat; true for a single run."""
    return recording.repeats == 1 or not set(inputs) & nonperiodic_signals(recording)


def predicted_readings(model: WrenchModel, recording: Recording, theta: Array) -> Array:
    """The predicted readings of a recording, (n, p), in the channels' units."""
    return model_response(model, recording, theta, derivative=False).value
