"""A recorded motion as the stages take it, and the summands of a response to it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from modeling.compiled.vector_function import VectorFunction


@dataclass(frozen=True)
class TimeBase:
    """Sampling interval `dt` (s), None for static poses; `periodic` for a record of whole periods in steady state.

    A record that is not periodic starts at zero velocity, in the static equilibrium of its first sample.
    """

    dt: float | None
    periodic: bool


Array = NDArray[np.float64]
FrequencyResponse = Callable[[Array, Array], tuple[NDArray[np.complex128], list[NDArray[np.complex128]]]]


@dataclass(frozen=True, eq=False)
class ResponsePart:
    """A summand of the response: value (n, p), derivative (n, p, k), of one repeat (`periodic`) or the whole record.

    The derivative is with respect to the parameters at the positions `columns` (None: all).
    """

    value: Array
    derivative: Array
    periodic: bool
    columns: tuple[int, ...] | None = None

    @classmethod
    def at_start(cls, value: Array, derivative: Array, samples: int) -> ResponsePart:
        """A summand of a record of so many samples that is zero after its first ones."""
        after = ((0, samples - len(value)), (0, 0))
        return cls(np.pad(value, after), np.pad(derivative, (*after, (0, 0))), periodic=False)

    def over(self, repeats: int) -> ResponsePart:
        """The same over the whole record."""
        if not self.periodic:
            return self
        value, derivative = np.tile(self.value, (repeats, 1)), np.tile(self.derivative, (repeats, 1, 1))
        return replace(self, value=value, derivative=derivative, periodic=False)


@dataclass(frozen=True, eq=False, kw_only=True)
class MotionRecord:
    """Signals of a recording and the model that is evaluated along it, at the parameters theta (k,).

    nonperiodic   names of the signals that differ between repeats
    continuous    whether repeats follow each other without pause
    steady        whether they then find the model in its periodic steady state; not where each moves in its own way
    vectors       the compiled vectors of the model's stages by name (`ChainStage.vectors`)
    transfer      H(j omega) and its derivatives in the parameters `transfer_parameters`, at omega (rad/s)
    summed        whether a stage acts on the sum of all summands: play, saturation
    derivative    whether parameter derivatives are wanted
    measured      readings (n, p) of a record without pauses, whose start tells the state that it finds the sensor in;
                  None without
    block         samples of a single run whose means are evaluated, if no stage has a memory or an edge
    """

    signals: Mapping[str, Array]
    dt: float | None
    repeats: int
    samples_per_repeat: int
    continuous: bool
    nonperiodic: frozenset[str]
    theta: Array
    vectors: Callable[[str], VectorFunction]
    transfer: FrequencyResponse
    transfer_parameters: tuple[int, ...]
    summed: bool
    derivative: bool = True
    steady: bool = True
    measured: Array | None = None
    block: int = 1

    @property
    def clock(self) -> TimeBase:
        """Sampling interval, and whether the motion is in its periodic steady state."""
        return TimeBase(self.dt, periodic=self.repeats > 1 and self.continuous and self.steady)

    def repeating(self, inputs: Iterable[str]) -> bool:
        """Whether these signals are the same in every repeat; true for a single run."""
        return self.repeats == 1 or not set(inputs) & self.nonperiodic

    def samples(self, *, periodic: bool) -> int:
        """Samples of one repeat, or of the whole record."""
        return self.samples_per_repeat * (1 if periodic else self.repeats)

    def runs(self, series: Array) -> list[Array]:
        """A series (n, ...) split into its separate runs, or whole where the repeats are continuous."""
        if self.continuous or len(series) <= self.samples_per_repeat:
            return [series]
        return np.split(series, self.repeats)

    def constant(self, name: str) -> tuple[Array, Array]:
        """Value (p,) and derivative (p, k) of a vector of the parameters alone."""
        value, slopes = self.vectors(name).tangent({}, self.theta, 1)
        return value[0], slopes[0]

    def evaluated(self, name: str) -> list[ResponsePart]:
        """A vector of the signals along the record, split into non-periodic and periodic summands.

        A derivative that is the same in every repeat is evaluated over one: with a transient event or a drift all but
        its own are. Where a stage acts on the sum nothing is split.
        """
        vector, theta = self.vectors(name), self.theta
        periodic = self.repeating(vector.inputs)
        samples = self.samples(periodic=periodic)
        if not self.derivative:
            response = vector.tangent_in(self.signals, theta, (), samples, block=self.block)
            return [ResponsePart(*response, periodic=periodic)]
        if self.summed:
            return [ResponsePart(*vector.tangent(self.signals, theta, samples), periodic=periodic)]
        if periodic:
            columns = tuple(sorted({*vector.active, *self.transfer_parameters}))
            response = vector.tangent_in(self.signals, theta, columns, samples, block=self.block)
            return [ResponsePart(*response, periodic=True, columns=columns)]
        return self._split(vector)

    def _split(self, vector: VectorFunction) -> list[ResponsePart]:
        changing = set(vector.depending_on(frozenset(vector.inputs) & self.nonperiodic))
        columns = tuple(sorted({i for i in vector.active if i in changing} | set(self.transfer_parameters)))
        repeating = tuple(i for i in vector.active if i not in changing)
        value, derivative = vector.tangent_in(self.signals, self.theta, columns, self.samples(periodic=False))
        once = self.samples_per_repeat
        _, repeated = vector.tangent_in(self.signals, self.theta, repeating, once, valued=False)
        whole = np.zeros((once, vector.rows, vector.count), order="F")
        whole[:, :, list(repeating)] = repeated
        return [
            ResponsePart(value, derivative, periodic=False, columns=columns),
            ResponsePart(np.zeros((once, vector.rows)), whole, periodic=True),
        ]

    def sum(self, parts: Sequence[ResponsePart]) -> ResponsePart:
        """The parts as one, over the whole record unless all are periodic; derivatives in all parameters."""
        if len(parts) == 1:
            return parts[0]
        if not all(part.periodic for part in parts):
            parts = [part.over(self.repeats) for part in parts]
        first, *others = parts
        value, derivative = first.value, first.derivative
        for part in others:
            value, derivative = value + part.value, derivative + part.derivative
        return ResponsePart(value, derivative, periodic=first.periodic)
