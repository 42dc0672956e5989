"""Errors-in-variables fit: a model whose motion signals are measured with noise, by the corrected score."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from estimation.errors_in_variables.corrected_score import CorrectedScoreProblem
from estimation.errors_in_variables.input_noise import InputNoise
from estimation.fit import Fit, fit, refit
from estimation.least_squares.estimates import PARAMETER_COLUMNS
from estimation.noise.recording_noise import RecordingNoise
from estimation.recordings.recording import Recording
from modeling.chain.model import WrenchModel
from modeling.chain.prediction import compiled_prediction
from modeling.errors import InputError
from modeling.table import Column, Table, Tabular, Value

REWEIGHTING_ROUNDS = 2
"""Of weights: at ordinary least squares, then at the corrected values; more change no value by 0.01 std."""


@dataclass(frozen=True, eq=False)
class ErrorsInVariables(Tabular):
    """Two fits of one model to the same recordings: `plain` least squares, and `corrected` for the input noise.

    Both have the same weights, so that they differ by the bias alone.

    noise        of the inputs, of one sample
    reliability  smallest share of true motion in the information of any direction of the parameters
    """

    plain: Fit
    corrected: Fit
    noise: InputNoise
    reliability: float

    @cached_property
    def bias(self) -> Mapping[str, float]:
        """Estimated bias of ordinary least squares, plain minus corrected, of each identifiable parameter."""
        found = self.corrected.parameters.items()
        return {name: self.plain.values[name] - e.value for name, e in found if np.isfinite(e.std)}

    @property
    def table(self) -> Table:
        """Name, plain value, corrected value with std, bias of the plain one, and that in std."""
        name, value, std, unit = PARAMETER_COLUMNS
        bias = (Column("bias of plain", format=".2g"), Column("in std", format=".1f"))
        columns = (name, replace(value, name="plain"), replace(value, name="corrected"), std, *bias, unit)
        return Table.of(columns, [self._row(name) for name in self.corrected.parameters])

    def _row(self, name: str) -> tuple[Value, ...]:
        found, bias = self.corrected.parameters[name], self.bias.get(name)
        ratio = bias / found.std if bias is not None and found.std else None
        return name, self.plain.values[name], found.known, found.std, bias, ratio, found.unit

    def remarks(self) -> list[str]:
        """The noise of the inputs."""
        return [f"noise of one sample of the motion: {self.noise}"]


def errors_in_variables_fit(
    model: WrenchModel,
    recordings: Recording | Iterable[Recording],
    *,
    input_noise: InputNoise | None = None,
    noise: Sequence[RecordingNoise] | None = None,
    start: Mapping[str, float] | None = None,
) -> ErrorsInVariables:
    """Estimate a model's parameters from recordings with noisy motion, and the bias of ordinary least squares.

    Parameters
    ----------
    model : WrenchModel
        Model without dynamics, in which the noise of one sample would affect many.
    recordings : Recording or iterable of Recording
        Recordings of one rig and tool.
    input_noise : InputNoise, optional
        Noise of one sample of one repeat of the motion, the same in all recordings; by default it is measured from the
        first recording that has repeats.
    noise : sequence of RecordingNoise, optional
        Noise of the readings per recording; by default it is estimated as in `fit`.
    start : mapping of str to float, optional
        Initial values of parameters by name, in their units; by default the parameters' own.

    Returns
    -------
    ErrorsInVariables
        The ordinary and the corrected fit with the same weights, the bias of the ordinary one by parameter, and the
        smallest share of true motion in the information of any direction of the parameters (`reliability`).

    Raises
    ------
    InputError
        As `fit` does; when no input noise can be measured, or it belongs to no signal of the recordings; and for models
        with dynamics.

    Notes
    -----
    Averaging over R repeats (22.12 in chapter 22, "Characterization of the Dynamical Model of a Force Sensor for Robot
    Manipulators", Bassi et al.) leaves 1/R of the input noise's covariance. The weights are those of the effective
    noise of readings and inputs; nothing is then lost against orthogonal regression (`CorrectedScoreProblem` has the
    comparison). The covariance is the sandwich N^-1 V N^-1: the inverse information N of the true signals is not the
    variance, since the gradient has the variance V, which includes the noise of the regressor.

    Examples
    --------
    >>> import truewrench as tw
    >>> rig = tw.Rig.read("rig.toml")
    >>> noise = tw.InputNoise.stated({"ddphi": 2.0})
    >>> found = tw.errors_in_variables_fit(tw.planar(rig), tw.read("train.csv", rig=rig), input_noise=noise)
    >>> found.bias["I"] < 0 < found.reliability < 1  # noise attenuates the inertia
    True
    """
    first = fit(model, recordings, noise=noise, start=start)
    _require_no_dynamics(first)
    inputs = input_noise if input_noise is not None else InputNoise.measured(_first_repeated(first.recordings))
    problem = CorrectedScoreProblem.of(first, inputs).weighted(first.theta, first.noise)
    theta, found, converged = problem.minimise(first.theta)
    for _ in range(REWEIGHTING_ROUNDS - 1):
        problem = problem.weighted(theta, first.noise)
        theta, found, converged = problem.minimise(theta)
    plain = refit(first.model, first.recordings, noise=problem.problem.noise, start=first.values)
    corrected = replace(
        plain,
        theta=theta,
        covariance=found.covariance,
        identifiable=found.identifiable,
        converged=converged and plain.converged,
    )
    return ErrorsInVariables(plain, corrected, inputs, found.reliability)


def _first_repeated(recordings: Sequence[Recording]) -> Recording:
    return next((r for r in recordings if r.repeats > 1), recordings[0])


def _require_no_dynamics(fitted: Fit) -> None:
    for own in fitted.layout.models:
        own.require_direct("errors_in_variables_fit")
    if any(compiled_prediction(own).has_transfer_function for own in fitted.layout.models):
        raise InputError(
            what="input noise cannot be propagated through a lag or a delay",
            where="errors_in_variables_fit",
            remedy="leave sensor_lag and time_delay out, or average over more repeats and use fit",
        )
