"""Problem: a model on recordings in their noise, as whitened least squares."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from estimation.least_squares.levenberg_marquardt import LeastSquaresMinimum, levenberg_marquardt
from estimation.least_squares.square_root_information import SquareRootInformation
from estimation.model_response import model_response
from estimation.noise.recording_noise import RecordingNoise
from estimation.parameter_layout import ParameterLayout, parameter_layout
from estimation.recordings.recording import Recording
from modeling.chain.model import WrenchModel
from modeling.parameter import Parameter

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LinearisedRows:
    """Whitened residual and derivative at one theta; the derivative only in rows where it does not vanish.

    residual    (rows,) measured minus predicted
    derivative  (r, k) of the prediction in the rows `reached`; in all others it vanishes
    reached     slice or (r,) index: for a prediction periodic with the motion the excited lines alone
    """

    residual: Array
    derivative: Array
    reached: slice | NDArray[np.intp]

    @property
    def reached_residual(self) -> Array:
        """The residual in the rows `reached`, (r,)."""
        return np.asarray(self.residual[self.reached])

    @property
    def cost(self) -> float:
        """Whitened chi-square."""
        return float(self.residual @ self.residual)

    @property
    def whole(self) -> Array:
        """The derivative in all rows, (rows, k)."""
        if len(self.derivative) == len(self.residual):
            return self.derivative
        derivative = np.zeros((len(self.residual), self.derivative.shape[1]))
        derivative[self.reached] = self.derivative
        return derivative

    @property
    def _unreached_power(self) -> float:
        """Sum of squares of the residual in the other rows."""
        if len(self.derivative) == len(self.residual):
            return 0.0
        others = np.delete(self.residual, self.reached)
        return float(others @ others)

    @property
    def information(self) -> SquareRootInformation:
        """Square-root information of the whitened rows on a step from theta."""
        rows = self.derivative
        nonzero = np.flatnonzero(np.einsum("ij,ij->j", rows, rows))  # columns of zeros need no factorisation
        whole = len(nonzero) == rows.shape[1]
        information = SquareRootInformation.of(rows if whole else rows[:, nonzero], self.reached_residual)
        information = replace(information, power=information.power + self._unreached_power, rows=len(self.residual))
        return information if whole else information.spread(nonzero, rows.shape[1])


@dataclass(frozen=True, eq=False)
class RecordingInNoise:
    """A recording and its noise."""

    recording: Recording
    noise: RecordingNoise

    @cached_property
    def whitened_readings(self) -> Array:
        """The readings whitened, (rows,)."""
        return self.noise.whitener.series(self.recording.wrench)


def _in_noise(recordings: Sequence[Recording], noise: Sequence[RecordingNoise]) -> tuple[RecordingInNoise, ...]:
    return tuple(RecordingInNoise(r, n) for r, n in zip(recordings, noise, strict=True))


@dataclass(frozen=True, eq=False)
class Problem:
    """Whitened least squares of one model on recordings, each in its noise.

    layout  the model's unknowns
    data    the recordings and their noise; problems of other models share it, and readings are whitened once
    """

    layout: ParameterLayout
    data: tuple[RecordingInNoise, ...]

    @classmethod
    def of(cls, model: WrenchModel, recordings: Sequence[Recording], noise: Sequence[RecordingNoise]) -> Problem:
        """The problem of a model on recordings in noise, one for each."""
        return cls(parameter_layout(model, recordings), _in_noise(recordings, noise))

    def of_model(self, model: WrenchModel) -> Problem:
        """The problem of another model on the same recordings in the same noise."""
        return replace(self, layout=parameter_layout(model, self.recordings))

    def in_noise(self, noise: Sequence[RecordingNoise]) -> Problem:
        """The same problem in other noise."""
        return replace(self, data=_in_noise(self.recordings, noise))

    def of_recordings(self, recordings: Sequence[Recording]) -> Problem:
        """The same problem with other readings of the same motions."""
        return replace(self, data=_in_noise(recordings, self.noise))

    @property
    def model(self) -> WrenchModel:
        """The model."""
        return self.layout.model

    @property
    def recordings(self) -> tuple[Recording, ...]:
        """The recordings."""
        return tuple(each.recording for each in self.data)

    @property
    def noise(self) -> tuple[RecordingNoise, ...]:
        """The noise of each recording."""
        return tuple(each.noise for each in self.data)

    @property
    def measured(self) -> tuple[Array, ...]:
        """Whitened readings of each recording, (rows,)."""
        return tuple(each.whitened_readings for each in self.data)

    @property
    def fixed(self) -> NDArray[np.bool_]:
        """The unknowns (k,) to which no derivative is taken."""
        return np.zeros(self.layout.size, dtype=bool)

    def residual(self, theta: Array) -> Array:
        """Whitened residual at theta (k,), (rows,), measured minus predicted; without a derivative."""
        parts = []
        for number, (recording, noise) in enumerate(zip(self.recordings, self.noise, strict=True)):
            model, values = self.layout.models[number], theta[self.layout.index[number]]
            whitener = noise.whitener
            response = model_response(model, recording, values, derivative=False, block=whitener.block)
            parts.append(self.measured[number] - whitener.response(response)[0])
        return _joined(parts)

    def chi_square(self, theta: Array) -> float:
        """Whitened chi-square at theta (k,)."""
        residual = self.residual(theta)
        return float(residual @ residual)

    def linearised(self, theta: Array) -> LinearisedRows:
        """The whitened rows about theta (k,); their derivative is zero in the fixed unknowns."""
        residuals, parts, reached, start = [], [], [], 0
        for number, (recording, noise) in enumerate(zip(self.recordings, self.noise, strict=True)):
            index = self.layout.index[number]
            block = noise.whitener.block
            response = model_response(self.layout.models[number], recording, theta[index], block=block)
            if self.fixed[index].any():
                free = np.flatnonzero(~self.fixed[index])
                response, index = response.in_columns(free), index[free]
            rows = noise.whitener.nonzero_rows(response)
            residual = self.measured[number].copy()
            if response.own_motion is not None:
                residual -= noise.whitener.series(response.own_motion)
            residual[: len(rows)] -= rows[:, 0]
            residuals.append(residual)
            if len(index) == self.layout.size and (index == np.arange(len(index))).all():
                derivative = rows[:, 1:]
            else:
                derivative = np.zeros((len(rows), self.layout.size))
                derivative[:, index] = rows[:, 1:]
            parts.append(derivative)
            reached.append((start, start + len(rows)))
            start += len(residual)
        return LinearisedRows(_joined(residuals), _joined(parts), _rows(reached))

    def evaluate(self, theta: Array) -> tuple[Array, Array]:
        """Whitened residual (rows,), measured minus predicted, and derivative of the prediction (rows, k)."""
        linearised = self.linearised(theta)
        return linearised.residual, linearised.whole

    def information(self, theta: Array) -> SquareRootInformation:
        """Square-root information of the whitened rows on a step from theta."""
        return self.linearised(theta).information

    def minimise(self, start: Array, far: float = np.inf) -> LeastSquaresMinimum:
        """The least-squares minimum within the parameters' bounds; `far` as `levenberg_marquardt` takes it."""
        low, high = (np.array([p.bounds[i] for p in self.layout.parameters]) for i in (0, 1))
        return levenberg_marquardt(self.information, start, (low, high), far, self.chi_square)


@dataclass(frozen=True, eq=False)
class Solution:
    """A problem with its estimate.

    theta         (k,) unknowns in the order of `layout.parameters`
    covariance    (k, k) from the whitened derivative, valid for the noise it was whitened with
    identifiable  (k,) whether a parameter is identifiable
    converged     whether the iteration converged
    """

    problem: Problem
    theta: Array
    covariance: Array
    identifiable: NDArray[np.bool_]
    converged: bool = True

    @property
    def model(self) -> WrenchModel:
        """The model."""
        return self.problem.model

    @property
    def recordings(self) -> tuple[Recording, ...]:
        """The recordings."""
        return self.problem.recordings

    @property
    def noise(self) -> tuple[RecordingNoise, ...]:
        """The noise of each recording."""
        return self.problem.noise

    @property
    def layout(self) -> ParameterLayout:
        """The unknowns."""
        return self.problem.layout

    @property
    def unknowns(self) -> tuple[Parameter, ...]:
        """The model's parameters, then the biases of the further recordings."""
        return self.layout.parameters


def _joined(parts: Sequence[Array]) -> Array:
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def _rows(ranges: Sequence[tuple[int, int]]) -> slice | NDArray[np.intp]:
    """Ranges of rows as one slice where they follow each other, else as an index."""
    if all(end == start for (_, end), (start, _) in pairwise(ranges)):
        return slice(ranges[0][0], ranges[-1][1])
    return np.concatenate([np.arange(start, end) for start, end in ranges])
