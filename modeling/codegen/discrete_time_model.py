"""Reference implementation, sample by sample, of the generated code."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modeling.chain.contact_gain import contact_gain_at
from modeling.chain.model import WrenchModel
from modeling.chain.prediction import VectorFunction, compiled_prediction
from modeling.dynamics.discrete_deflection import DeflectionIntegrator
from modeling.dynamics.discrete_transfer_function import DiscreteTransferFunction, TransferFunctionFilter
from modeling.dynamics.transfer_function import SymbolicTransferFunction, TransferFunction
from modeling.errors import InputError

Array = NDArray[np.float64]

NO_DEFLECTION = np.zeros(0)


def has_memory(model: WrenchModel) -> bool:
    """Whether a reading depends on earlier samples (linear dynamics, play or deflection)."""
    return bool(model.memory != 1) or model.chain.play is not None or model.chain.deflection is not None


def sample_inputs(model: WrenchModel) -> tuple[str, ...]:
    """The signals that the prediction of one sample needs, sorted by name; time only if an effect depends on it."""
    parts = (model.load, model.zero, model.chain.equilibrium())
    return tuple(sorted({name for part in parts for name in model.inputs_of(part)}))


def transfer_function_of(model: WrenchModel, theta: Array) -> TransferFunction:
    """The transfer function from load to reading (before the bias) at the parameters theta (k,).

    Raises InputError unless it is a stable proper rational function of s with a delay.
    """
    values = dict(zip((p.symbol for p in model.parameters), map(float, theta), strict=True))
    return SymbolicTransferFunction.of(model.memory).at(values)


def discrete_transfer_function(model: WrenchModel, theta: Array, dt: float | None) -> DiscreteTransferFunction | None:
    """The transfer function discretised at the sampling interval dt (s); None for a model without one.

    Raises InputError without a dt, or when it has no stable proper rational realisation with a delay.
    """
    step = require_sampling_interval(model, dt)
    return DiscreteTransferFunction.of(transfer_function_of(model, theta), step) if model.memory != 1 else None


def deflection_integrator(model: WrenchModel, theta: Array, dt: float | None) -> DeflectionIntegrator | None:
    """The integrator of the tool's deflection at the sampling interval dt (s), not started; None for a rigid tool.

    Raises InputError without a dt, or when the tool's inertia is not positive definite.
    """
    flexible = compiled_prediction(model).deflection
    if flexible is None:
        return None
    return DeflectionIntegrator(flexible.equation, len(flexible.inputs), theta, require_sampling_interval(model, dt))


def require_sampling_interval(model: WrenchModel, dt: float | None) -> float:
    """The sampling interval dt (s); 0 for a model without memory when it is not given.

    Raises InputError, naming the effects, when the model has memory and dt is not given.
    """
    if dt is None and has_memory(model):
        dynamic = ", ".join(e.id for e in model.effects if has_memory(model.base + e))
        what = f"the model has memory ({dynamic}), and the sampling interval is not known"
        raise InputError(what=what, where="rate", remedy="give --rate HZ, the sampling rate at which the code will run")
    return 0.0 if dt is None else dt


class DiscreteTimeModel:
    """The generated code in Python: prediction and compensation sample by sample, at the sampling interval dt (s).

    Signals u come in the order of `inputs`; the initial state is the steady state under the first sample. Outputs
    belong to the sample of `wait` samples ago: 0, unless readings lead the motion or lag it by less than one sample.
    The two methods share one state: call one of them once for each sample.
    """

    def __init__(self, model: WrenchModel, theta: ArrayLike, *, dt: float | None = None) -> None:
        """The model with parameters theta (k,) in its order and units.

        Raises InputError when the model has memory and no dt is given, or when its transfer function has no stable
        proper rational realisation with a delay.
        """
        self.model, self.theta = model, np.array(theta, dtype=float)
        self.inputs = sample_inputs(model)
        self._discrete = discrete_transfer_function(model, self.theta, dt)
        self._transfer, self._dt = transfer_function_of(model, self.theta), dt
        self._gain = contact_gain_at(model, self.theta)[0]
        prediction = compiled_prediction(model)
        self._flexible = prediction.deflection
        self._load = prediction.load if self._flexible is None else self._flexible.load
        self._bias = prediction.zero
        self._width, self._level = (
            None if stage is None else self._value(stage, np.zeros(len(self.inputs)))
            for stage in (prediction.play, prediction.level)
        )
        self.restart()

    @property
    def wait(self) -> int:
        """Samples by which the outputs lag the inputs."""
        return 0 if self._discrete is None else self._discrete.wait

    def restart(self) -> None:
        """Reset to the state before the first sample."""
        self._filter = (
            None if self._discrete is None or self._dt is None else TransferFunctionFilter(self._transfer, self._dt)
        )
        self._deflection = deflection_integrator(self.model, self.theta, self._dt)
        self._play_output: Array | None = None
        self._biases: deque[Array] = deque(maxlen=self.wait + 1)
        self._readings: deque[Array] = deque(maxlen=self.wait + 1)

    def predict(self, u: ArrayLike) -> Array:
        """The predicted reading (p,) without contact, of `wait` samples ago; u (m,) are the present signals."""
        values = np.asarray(u, dtype=float)
        load = self._with_play(self._load_of(values))
        self._biases.append(self._value(self._bias, values))
        reading = (load if self._filter is None else self._filter.step(load)) + self._biases[0]
        return reading if self._level is None else np.clip(reading, -self._level, self._level)

    def compensate(self, u: ArrayLike, reading: ArrayLike) -> Array:
        """The wrench (p,) of the environment on the tool, as in `modeling.tool.wrench_components`, of `wait` samples
        ago.

        u (m,) and the reading (p,) are the present ones: contact = G^-1 (reading - predicted), G the contact gain. The
        sensor's linear dynamics act on the contact wrench too, and are not inverted.
        """
        self._readings.append(np.asarray(reading, dtype=float))
        return np.asarray(np.linalg.solve(self._gain, self._readings[0] - self.predict(u)))

    def _load_of(self, values: Array) -> Array:
        """The load (p,), for a flexible tool at the deflection of this sample."""
        if self._deflection is None or self._flexible is None:
            return self._value(self._load, values)
        inputs = np.array([values[self.inputs.index(name)] for name in self._flexible.inputs])
        return self._value(self._load, values, self._deflection.step(inputs))

    def _value(self, part: VectorFunction, values: Array, deflection: Array = NO_DEFLECTION) -> Array:
        signals = {name: values[i : i + 1] for i, name in enumerate(self.inputs)}
        return np.asarray(part.value(signals, np.concatenate([self.theta, deflection]), 1)[0], dtype=float)

    def _with_play(self, load: Array) -> Array:
        """Output of the play operator: constant while it is within the half-width of the load."""
        if self._width is None:
            return load
        previous = load if self._play_output is None else self._play_output
        self._play_output = np.clip(previous, load - self._width, load + self._width)
        return self._play_output
