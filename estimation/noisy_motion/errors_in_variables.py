"""Errors in variables: the fit of a model whose signals of motion are themselves measured with noise."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from estimation.fit import Fit, fit, refit
from estimation.linear.estimate import table
from estimation.noise import Noise
from estimation.noisy_motion.corrected_problem import CorrectedProblem
from estimation.noisy_motion.input_noise import InputNoise
from estimation.recording import Recording
from modeling.errors import InputError
from modeling.model import WrenchModel
from modeling.prediction import compiled

ROUNDS = 2
"""Of weights: at plain least squares, then at the corrected values; more move no value by a hundredth of its std."""


@dataclass(frozen=True, eq=False)
class ErrorsInVariables:
    """Two fits of one model to the same recordings: `plain` least squares, and `corrected` for the noise of the inputs.

    Both have the same weights, so that they differ by the bias alone.

    noise        of the inputs, of one sample
    reliability  the least share of true motion in what a direction of the unknowns is seen by
    """

    plain: Fit
    corrected: Fit
    noise: InputNoise
    reliability: float

    @cached_property
    def bias(self) -> Mapping[str, float]:
        """Estimated bias of plain least squares of each unknown that is shown: plain minus corrected."""
        found = self.corrected.parameters.items()
        return {name: self.plain.values[name] - e.value for name, e in found if np.isfinite(e.std)}

    def rows(self) -> list[tuple[str, ...]]:
        """Name, plain value, corrected value with std, bias of the plain one, and that in std, as text."""
        return [self._row(name) for name in self.corrected.parameters]

    def _row(self, name: str) -> tuple[str, ...]:
        plain, found = self.plain.parameters[name], self.corrected.parameters[name]
        if name not in self.bias:
            return name, f"{plain.value:.6g}", "-", "not shown", "-", "-", found.unit
        bias = self.bias[name]
        ratio = f"{bias / found.std:.1f}" if found.std else "-"
        return name, f"{plain.value:.6g}", f"{found.value:.6g}", f"{found.std:.2g}", f"{bias:.2g}", ratio, found.unit

    def __str__(self) -> str:
        header = ("parameter", "plain", "corrected", "std", "bias of plain", "in std", "unit")
        return f"{table(header, self.rows())}\nnoise of one sample of the motion: {self.noise}"


def errors_in_variables_fit(
    model: WrenchModel,
    recordings: Recording | Iterable[Recording],
    *,
    input_noise: InputNoise | None = None,
    noise: Sequence[Noise] | None = None,
    start: Mapping[str, float] | None = None,
) -> ErrorsInVariables:
    """Estimate a model's parameters from recordings whose motion is noisy, and the bias of plain least squares.

    `input_noise` is that of one sample of one repeat, the same in all recordings; unless given, it is measured from
    the first recording that has repeats. Averages over repeats are taken first (22.12), which leaves 1/R of it. Weights
    are those of the effective noise, of readings and inputs together; then nothing is lost against orthogonal
    regression (`corrected_problem` says why it is not that). The covariance is the sandwich N^-1 V N^-1: the inverse
    information N of the true signals alone is not the variance, since the gradient varies by V, which has the noise of
    the regressor in it too.
    Raises InputError as `fit` does; when no input noise can be measured, or it is that of no signal of the recordings;
    and for models that remember, in which the noise of one sample moves many.
    """
    first = fit(model, recordings, noise=noise, start=start)
    _refuse_memory(first)
    inputs = input_noise if input_noise is not None else InputNoise.measured(_repeated(first.recordings))
    problem, theta = CorrectedProblem.of(first, inputs), first.theta
    for _ in range(ROUNDS):
        problem = problem.weighted(theta, first.noise)
        theta, found, converged = problem.minimise(theta)
    plain = refit(first.model, first.recordings, noise=problem.problem.noise, start=first.values)
    corrected = replace(
        plain, theta=theta, covariance=found.covariance, shown=found.shown, converged=converged and plain.converged
    )
    return ErrorsInVariables(plain, corrected, inputs, found.reliability)


def _repeated(recordings: Sequence[Recording]) -> Recording:
    return next((r for r in recordings if r.repeats > 1), recordings[0])


def _refuse_memory(fitted: Fit) -> None:
    for own in fitted.layout.models:
        own.require_direct("errors_in_variables_fit")
    if any(compiled(own).remembers for own in fitted.layout.models):
        raise InputError(
            what="noise of the motion is not followed through a lag or a delay",
            where="errors_in_variables_fit",
            remedy="leave sensor_lag and time_delay out, or average over more repeats and use fit",
        )
