"""Sensitivities of a reading to its parameters, as CasADi expressions of the joint states of a sampled trajectory."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from enum import Enum
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from modeling.chain.model import WrenchModel
from modeling.chain.prediction import Prediction, VectorFunction, compiled_prediction
from modeling.chain.stages import Bias, LinearDynamics
from modeling.errors import InputError
from modeling.kinematics.arm import Arm
from modeling.noise import NoiseModel, StationaryNoise

Array = NDArray[np.float64]
FrequencyResponse = Callable[[Array], NDArray[np.complex128]]
"""A transfer function at angular frequencies (L,) in rad/s: (L,)."""

CLOCK_SIGNALS = ("time", "progress")
"""Signals of time itself: s from the start, and -1 to 1 over the record."""


@dataclass(frozen=True, kw_only=True)
class Sampling:
    """N equally spaced samples of one trajectory over `duration` (s).

    A periodic trajectory is sampled at j T / N in its steady state, after earlier periods. Another one is sampled from
    its first instant to its last, and was at rest in its first posture before.
    """

    duration: float
    samples: int
    periodic: bool = True

    @property
    def step(self) -> float:
        """Time between samples, s."""
        return self.duration / (self.samples if self.periodic else max(self.samples - 1, 1))

    @property
    def time(self) -> Array:
        """The instants (N,), s."""
        return np.asarray(np.arange(self.samples) * self.step, dtype=float)

    @property
    def clock(self) -> Array:
        """The signals of `CLOCK_SIGNALS`, (2, N)."""
        return np.stack([self.time, np.linspace(-1.0, 1.0, self.samples)])

    def through(self, response: FrequencyResponse, series: Array) -> Array:
        """A series (N, ...) through a transfer function, by a real discrete Fourier transform.

        One period of a periodic trajectory is filtered exactly, line by line (at half the sampling rate only the real
        part). Any other series is padded by as many samples of its first value, the value before and after a
        trajectory that returns to its first posture: exact when the filter's transient has decayed after them.
        """
        padded = series if self.periodic else np.concatenate([series, np.repeat(series[:1], len(series), axis=0)])
        omega = np.asarray(2 * np.pi * np.fft.rfftfreq(len(padded), self.step), dtype=float)
        gain = response(omega).reshape(-1, *([1] * (series.ndim - 1)))
        filtered = np.fft.irfft(np.fft.rfft(padded, axis=0) * gain, n=len(padded), axis=0)
        return np.asarray(filtered[: self.samples], dtype=float)

    def matrix(self, response: FrequencyResponse) -> Array:
        """The filter as a matrix (N, N) of impulse responses."""
        return self.through(response, np.eye(self.samples))


class ReadingPart(Enum):
    """Which part of reading = H(s) load + zero."""

    LOAD = "load"
    BIAS = "bias"


@dataclass(frozen=True, kw_only=True)
class ModelTransferFunction:
    """H(j omega) of a model at theta, or its derivative by the parameter `slope`, an index of `transfer_parameters`."""

    model: WrenchModel
    theta: tuple[float, ...]
    slope: int | None = None

    def __call__(self, omega: Array) -> NDArray[np.complex128]:
        """At angular frequencies (L,) in rad/s: (L,)."""
        gain, slopes = compiled_prediction(self.model).transfer(omega, np.array(self.theta))
        return gain if self.slope is None else slopes[self.slope]


@dataclass(frozen=True, eq=False, kw_only=True)
class SensitivityTerm:
    """H(s) times a matrix (p, c) of signals, which is added to c columns of an experiment.

    part       of the model's reading at theta (k,)
    by         indices of the c parameters that it is differentiated by; None for the part itself, c = 1
    columns    of the experiment
    response   H(j omega) at angular frequencies in rad/s, None for 1
    factor     of the whole term
    """

    model: WrenchModel
    theta: Array
    part: ReadingPart
    by: tuple[int, ...] | None
    columns: tuple[int, ...]
    response: FrequencyResponse | None = None
    factor: float = 1.0

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the signals (m,) that the matrix is a function of."""
        return self._vector_function.inputs

    @cached_property
    def function(self) -> Any:
        """CasADi function (SX) from the signals (m,) to the matrix (p, c), before H."""
        inputs, parameters = self._vector_function.symbols
        value = self.factor * self._vector_function.graph
        matrix = value if self.by is None else ca.jacobian(value, parameters)[:, list(self.by)]
        general = ca.Function("term", [inputs, parameters], [ca.densify(matrix)])
        return ca.Function("term", [inputs], [general(inputs, ca.DM(self.theta))])

    def values(self, signals: Mapping[str, Array], samples: int) -> Array:
        """The matrix at every sample, (N, p, c), before H."""
        value, derivative = self._vector_function.tangent_in(
            signals, self.theta, self.by or (), samples, valued=self.by is None
        )
        return self.factor * (value[:, :, None] if self.by is None else derivative)

    @property
    def _vector_function(self) -> VectorFunction:
        prediction = compiled_prediction(self.model)
        return prediction.load if self.part is ReadingPart.LOAD else prediction.bias

    def __getstate__(self) -> dict[str, Any]:
        # Compiled functions are not pickled: workers of a pool compile their own.
        return {field.name: getattr(self, field.name) for field in fields(self)}


def sensitivity_terms(model: WrenchModel, theta: Array, first: int = 0) -> tuple[SensitivityTerm, ...]:
    """The terms of d reading / d theta (p, k) at theta (k,), in the columns first, first + 1, ..

    reading = H(s) load + bias, so d reading = H d load + dH load + d bias, the second for each parameter of H.
    Raises InputError for a model with another stage after its load: its sensitivities have no such terms.
    """
    prediction = compiled_prediction(model)
    _require_load_and_filter(prediction)
    pairs = zip(prediction_terms(model, theta, first), (prediction.load, prediction.bias), strict=True)
    terms = [replace(t, by=vector.active, columns=tuple(first + i for i in vector.active)) for t, vector in pairs]
    for number, index in enumerate(prediction.transfer_parameters):
        slope = ModelTransferFunction(model=model, theta=tuple(theta), slope=number)
        column = (first + index,)
        terms.append(
            SensitivityTerm(model=model, theta=theta, part=ReadingPart.LOAD, by=None, columns=column, response=slope)
        )
    return tuple(term for term in terms if term.columns)


def _require_load_and_filter(prediction: Prediction) -> None:
    others = [stage.__name__ for stage in prediction.stages if stage not in (LinearDynamics, Bias)]
    if others:
        what = f"a design knows a static load, a linear filter and a bias, not the stage {', '.join(others)}"
        raise InputError(what=what, where="model", remedy="leave the effect that puts it there out")


def prediction_terms(model: WrenchModel, theta: Array, column: int, factor: float = 1.0) -> tuple[SensitivityTerm, ...]:
    """The terms of `factor` times the predicted reading at theta (k,), in one column of an experiment."""
    response = (
        ModelTransferFunction(model=model, theta=tuple(theta))
        if compiled_prediction(model).has_transfer_function
        else None
    )
    load = SensitivityTerm(
        model=model, theta=theta, part=ReadingPart.LOAD, by=None, columns=(column,), response=response, factor=factor
    )
    return load, replace(load, part=ReadingPart.BIAS, response=None)


STATE_PREFIXES = ("q", "dq", "ddq")


def signal_names(arm: Arm) -> tuple[str, ...]:
    """Names of the signals that follow from a state of the arm: q1.., dq1.., ddq1.. and the sensor's kinematics."""
    return (*(f"{order}{j}" for order in STATE_PREFIXES for j in range(1, arm.joints + 1)), *arm.names)


def signals_along(arm: Arm, q: Array, dq: Array, ddq: Array) -> dict[str, Array]:
    """Every signal (N,) along joint states (N, n)."""
    return dict(zip(signal_names(arm), np.hstack([q, dq, ddq]).T, strict=False)) | arm.pose(q, dq, ddq)


@lru_cache(maxsize=16)
def signals_of_state(arm: Arm) -> Any:
    """CasADi function (SX) from a state (q, dq, ddq), (3n,), to the signals in the order of `signal_names`."""
    state = ca.SX.sym("x", len(STATE_PREFIXES) * arm.joints)
    motion = arm.function(*ca.vertsplit(state, arm.joints))
    return ca.Function("signals", [state], [ca.densify(ca.vertcat(state, motion))])


SensitivityShape = tuple[int, int]


@lru_cache(maxsize=64)
def sensitivity_function(arm: Arm, terms: tuple[SensitivityTerm, ...], shape: SensitivityShape) -> Any:
    """CasADi function (SX) from a state (3n,) and the clock's signals (2,) to the columns (p, k), before filters."""
    state, clock = ca.SX.sym("x", 3 * arm.joints), ca.SX.sym("clock", len(CLOCK_SIGNALS))
    given, names = ca.vertcat(signals_of_state(arm)(state), clock), (*signal_names(arm), *CLOCK_SIGNALS)
    total = ca.SX.zeros(*shape)
    for term in terms:
        total[:, list(term.columns)] += term.function(given[[names.index(name) for name in term.inputs]])
    return ca.Function("columns", [state, clock], [ca.cse(total)])


def sensitivity_graph(
    arm: Arm, terms: Sequence[SensitivityTerm], shape: SensitivityShape, states: Any, sampling: Sampling
) -> Any:
    """The unweighted columns along the states (3n, N), as one (k, N) for each channel.

    Terms with a common transfer function are one map over the samples; each filter is a constant matrix (N, N) on its
    result, so that derivatives of every order follow.
    """
    channels, size = shape
    rows: list[Any] = [ca.MX.zeros(size, sampling.samples) for _ in range(channels)]
    for response, group in _by_response(terms).items():
        function = sensitivity_function(arm, tuple(group), shape)
        flat = function.map(sampling.samples)(states, sampling.clock)
        used = sorted({column for term in group for column in term.columns})
        filtered = None if response is None else ca.DM(sampling.matrix(response)).T
        for channel in range(channels):
            series = ca.reshape(flat[channel, :], size, sampling.samples)[used, :]
            rows[channel][used, :] += series if filtered is None else series @ filtered
    return rows


def whitened_graph(rows: list[Any], noise: StationaryNoise | None, sampling: Sampling) -> list[Any]:
    """The whitened columns (k, N) of each channel: by constant weights, or by filters where the noise is coloured."""
    if noise is None:
        return rows
    channels = range(len(rows))
    if isinstance(noise, NoiseModel) and noise.is_white:
        return [sum(float(noise.root[c, d]) * rows[d] for d in channels if noise.root[c, d]) for c in channels]
    result: list[Any] = [ca.MX.zeros(*rows[0].shape) for _ in channels]
    for d in channels:
        impulses = np.zeros((sampling.samples, len(rows), sampling.samples))
        impulses[:, d] = np.eye(sampling.samples)
        filters = noise.whitened(impulses, sampling.step)
        for c in channels:
            if filters[:, c].any():
                result[c] += rows[d] @ ca.DM(filters[:, c]).T
    return result


def _by_response(terms: Sequence[SensitivityTerm]) -> dict[Any, list[SensitivityTerm]]:
    groups: dict[Any, list[SensitivityTerm]] = {}
    for term in terms:
        groups.setdefault(term.response, []).append(term)
    return groups
