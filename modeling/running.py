"""RunningModel: a model in numbers, sample by sample."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modeling.contact_gain import contact_gain_at
from modeling.errors import InputError
from modeling.memory import Memory, Transfer
from modeling.model import WrenchModel
from modeling.prediction import Emitted, compiled
from modeling.running_bend import RunningBend
from modeling.running_memory import RunningMemory, SampledMemory

Array = NDArray[np.float64]

UNBENT = np.zeros(0)


def remembers(model: WrenchModel) -> bool:
    """Whether a reading depends on samples before it."""
    return bool(model.memory != 1) or model.chain.play is not None or model.chain.bend is not None


def inputs_of(model: WrenchModel) -> tuple[str, ...]:
    """The signals that one sample of the prediction takes, sorted by name; time only where an effect is made of it."""
    parts = (model.load, model.zero, model.chain.equilibrium())
    return tuple(sorted({name for part in parts for name in model.inputs_of(part)}))


def transfer_of(model: WrenchModel, theta: Array) -> Transfer:
    """The transfer function between load and zero, in numbers.

    Raises InputError for a memory that cannot be run.
    """
    values = dict(zip((p.symbol for p in model.parameters), map(float, theta), strict=True))
    return Memory.of(model.memory).at(values)


def sampled_memory(model: WrenchModel, theta: Array, dt: float | None) -> SampledMemory | None:
    """The memory in steps of dt (s); None without one.

    Raises InputError when there is one and no dt, or when it cannot be run sample by sample.
    """
    step = require_step(model, dt)
    return SampledMemory.of(transfer_of(model, theta), step) if model.memory != 1 else None


def running_bend(model: WrenchModel, theta: Array, dt: float | None) -> RunningBend | None:
    """The bend of the model's tool in steps of dt (s), not started; None without one.

    Raises InputError when there is one and no dt, or when its inertia is not that of a body.
    """
    bent = compiled(model).bend
    if bent is None:
        return None
    return RunningBend(bent.equation, len(bent.inputs), theta, require_step(model, dt))


def require_step(model: WrenchModel, dt: float | None) -> float:
    """The time dt from sample to sample; 0 for a model that needs none.

    Raises InputError, naming the effects, when the model remembers and there is none.
    """
    if dt is None and remembers(model):
        guilty = ", ".join(e.id for e in model.effects if remembers(model.base + e))
        what = f"the model remembers ({guilty}), and the time from sample to sample is not known"
        raise InputError(what=what, where="rate", remedy="give --rate HZ, the samples per second that it will see")
    return 0.0 if dt is None else dt


class RunningModel:
    """What emitted code does, in Python: prediction and compensation of one sample after another, dt (s) apart.

    It takes signals u in the order of `inputs`, and starts as if the first sample had always been there. What comes
    out belongs to the sample of `wait` samples ago; that is 0 but for readings that lead the motion, or lag it by a
    fraction of the first sample. The two methods share one state: call one of them once for each sample.
    """

    def __init__(self, model: WrenchModel, theta: ArrayLike, *, dt: float | None = None) -> None:
        """The model with parameters theta (k,) in its order and units.

        Raises InputError when the model remembers and no dt is given, or cannot be run sample by sample.
        """
        self.model, self.theta = model, np.array(theta, dtype=float)
        self.inputs = inputs_of(model)
        self._sampled = sampled_memory(model, self.theta, dt)
        self._transfer, self._dt = transfer_of(model, self.theta), dt
        self._gain = contact_gain_at(model, self.theta)[0]
        prediction = compiled(model)
        self._bent = prediction.bend
        self._load = prediction.load if self._bent is None else self._bent.load
        self._zero = prediction.zero
        self._width, self._level = (
            None if stage is None else self._value(stage, np.zeros(len(self.inputs)))
            for stage in (prediction.play, prediction.level)
        )
        self.restart()

    @property
    def wait(self) -> int:
        """Samples by which what comes out is older than what goes in."""
        return 0 if self._sampled is None else self._sampled.wait

    def restart(self) -> None:
        """Forget all samples."""
        self._memory = None if self._sampled is None or self._dt is None else RunningMemory(self._transfer, self._dt)
        self._bend = running_bend(self.model, self.theta, self._dt)
        self._played: Array | None = None
        self._zeros: deque[Array] = deque(maxlen=self.wait + 1)
        self._readings: deque[Array] = deque(maxlen=self.wait + 1)

    def predict(self, u: ArrayLike) -> Array:
        """The reading (p,) that the tool alone gives, of `wait` samples ago; u (m,) are the signals of now."""
        values = np.asarray(u, dtype=float)
        load = self._with_play(self._load_of(values))
        self._zeros.append(self._value(self._zero, values))
        reading = (load if self._memory is None else self._memory.step(load)) + self._zeros[0]
        return reading if self._level is None else np.clip(reading, -self._level, self._level)

    def compensate(self, u: ArrayLike, reading: ArrayLike) -> Array:
        """The wrench (p,) of the environment on the tool, as in `modeling.contact`, of `wait` samples ago.

        u (m,) and the reading (p,) are those of now: contact = G^-1 (reading - predicted), G the contact gain. What the
        memory does to the contact itself is left as it is.
        """
        self._readings.append(np.asarray(reading, dtype=float))
        return np.asarray(np.linalg.solve(self._gain, self._readings[0] - self.predict(u)))

    def _load_of(self, values: Array) -> Array:
        """The load, of a tool on a spring with the bend that it has by then."""
        if self._bend is None or self._bent is None:
            return self._value(self._load, values)
        taken = np.array([values[self.inputs.index(name)] for name in self._bent.inputs])
        return self._value(self._load, values, self._bend.step(taken))

    def _value(self, part: Emitted, values: Array, bend: Array = UNBENT) -> Array:
        signals = {name: values[i : i + 1] for i, name in enumerate(self.inputs)}
        return np.asarray(part.value(signals, np.concatenate([self.theta, bend]), 1)[0], dtype=float)

    def _with_play(self, load: Array) -> Array:
        """The load after play: it stays where it is as long as it is within the half-width of the load."""
        if self._width is None:
            return load
        before = load if self._played is None else self._played
        self._played = np.clip(before, load - self._width, load + self._width)
        return self._played
