"""Validation fit: parameters kept from training, biases and recording-specific disturbances re-estimated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from diagnosis.comparison.data_split import non_excited_noise
from estimation.fit import Fit, initial_noise, initial_values
from estimation.gravity.gravity_direction import mounted_recording
from estimation.least_squares.estimates import Estimate
from estimation.least_squares.levenberg_marquardt import LeastSquaresMinimum
from estimation.least_squares.whitened_problem import WhitenedProblem
from estimation.noise.recording_noise import RecordingNoise
from estimation.parameter_layout import ParameterLayout, parameter_layout
from estimation.recordings.recording import Recording
from modeling.chain.effect import Effect
from modeling.chain.model import WrenchModel
from modeling.parameter import Parameter

Array = NDArray[np.float64]


@runtime_checkable
class EstimatedModel(Protocol):
    """A model with estimated parameters: a fit, or one from a model file."""

    @property
    def model(self) -> WrenchModel:
        """The model."""

    @property
    def parameters(self) -> Mapping[str, Estimate]:
        """Every parameter of the model by name, with std and unit."""


@dataclass(frozen=True, eq=False)
class PartiallyFixedProblem(WhitenedProblem):
    """A least-squares problem in the unknowns marked `free` (k,); the others are fixed at their initial values."""

    free: NDArray[np.bool_]

    @property
    def fixed(self) -> NDArray[np.bool_]:
        """All unknowns but those that are free."""
        return ~self.free

    def minimise(self, start: Array, far: float = np.inf) -> LeastSquaresMinimum:
        """The least-squares minimum in the free unknowns; the fixed ones are returned unchanged, bit by bit."""
        found = super().minimise(start, far)
        return replace(found, theta=np.where(self.free, found.theta, start))


def validation_fit(
    fit: EstimatedModel,
    recording: Recording,
    noise: RecordingNoise | None = None,
    own: Sequence[Effect] = (),
    start: Mapping[str, float] | None = None,
) -> Fit:
    """The fit's parameters on another recording; only its biases and its disturbances `own` are estimated there.

    Recording-specific effects of the fit's own recordings are dropped. The disturbances are estimated from the initial
    values `start` on the non-excited lines, where there are any: on the excited lines they would absorb systematic
    error of the fit.
    """
    recording = mounted_recording(recording, fit.model.gravity_direction)
    shared = fit.model.without_recording_specific
    model = shared + own
    known = noise if noise is not None else initial_noise(shared, (recording,))[0]
    unknowns = parameter_layout(model, (recording,))
    values = {p.name: fit.parameters[p.name].value for p in shared.parameters}
    theta = initial_values(unknowns, {**values, **(start or {})})
    biases = _mask_of(unknowns, model.biases)
    added = _mask_of(unknowns, [p for e in own for p in e.qualified(model.space)])
    covariance, estimable = np.zeros((len(theta), len(theta))), np.zeros(len(theta), dtype=bool)
    if own:
        rest = (non_excited_noise(known) or known,)
        disturbed = PartiallyFixedProblem(unknowns, (recording,), rest, biases | added).minimise(theta)
        theta, estimable = disturbed.theta, disturbed.identifiable & added
        covariance = disturbed.covariance * np.outer(added, added)
    biased = PartiallyFixedProblem(unknowns, (recording,), (known,), biases).minimise(theta)
    covariance, estimable = covariance + biased.covariance, estimable | biased.identifiable
    return Fit(model, (recording,), (known,), unknowns, biased.theta, covariance, estimable)


def _mask_of(unknowns: ParameterLayout, parameters: Sequence[Parameter]) -> NDArray[np.bool_]:
    names = {p.name for p in parameters}
    return np.array([p.name in names for p in unknowns.parameters])


def zero_shift(fit: Fit, carried: Fit) -> Mapping[str, float]:
    """Change of each channel's bias from the fit's first recording to the validation recording."""
    return {c: carried.values[f"bias_{c}"] - fit.values[f"bias_{c}"] for c in fit.recordings[0].channels}
