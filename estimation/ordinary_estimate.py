"""Ordinary weighted least squares for single runs, with intervals that hold in coloured noise.

Whitening by the residual's own spectrum is efficient where the model is right, though little is gained with motions as
smooth as a tool's. Where something is missing, the residual is large in the band of the motion, which the whitener then
takes for noise: little of the tool's weight is left, and what is missing biases the rest, of a lag the mass ten times
as much. Weights that depend on the channel alone keep it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct

from estimation.confidence_intervals import intervals
from estimation.least_squares.whitened_problem import WhitenedProblem
from estimation.noise.recording_noise import RecordingNoise
from estimation.noise.whitening import AutoregressiveWhitener
from estimation.parameter_layout import ParameterLayout
from estimation.recordings.recording import Recording
from modeling.noise import NoiseModel, NoiseSource, block_means
from modeling.parameter import Parameter

Array = NDArray[np.float64]

SMALLEST_SHARE = 1e-4
"""Of a residual's variance, that the upper half of its spectrum counts for at the least: rounded readings have none."""


@dataclass(frozen=True, eq=False)
class OrdinaryEstimate:
    """Parameters (k,) by least squares, in which white noise weighs each channel of a run.

    noise       per recording, white where it comes from the residual of a run, else as it was
    covariance  (k, k) in that noise, as `intervals` needs it
    """

    layout: ParameterLayout
    recordings: tuple[Recording, ...]
    noise: tuple[RecordingNoise, ...]
    theta: Array
    covariance: Array
    identifiable: NDArray[np.bool_]
    converged: bool

    @classmethod
    def of(cls, problem: WhitenedProblem, theta: Array, residuals: Sequence[Array]) -> OrdinaryEstimate | None:
        """From a whitened problem, its solution and the residuals (n, p) there; None without noise from a residual.

        Each channel is weighted by the noise of its upper frequencies alone.
        """
        noise = tuple(_by_channel(n, residual) for n, residual in zip(problem.noise, residuals, strict=True))
        if all(new is old for new, old in zip(noise, problem.noise, strict=True)):
            return None
        found = replace(problem, noise=noise).minimise(theta)
        return cls(
            layout=problem.layout,
            recordings=problem.recordings,
            noise=noise,
            theta=found.theta,
            covariance=found.covariance,
            identifiable=found.identifiable,
            converged=found.converged,
        )

    @property
    def unknowns(self) -> tuple[Parameter, ...]:
        """The model's parameters, then the biases of the further recordings."""
        return self.layout.parameters

    @cached_property
    def covariance_in_noise(self) -> Array:
        """Covariance (k, k) with the std that the residual's own spectrum gives."""
        std, own = intervals(self).std, np.sqrt(np.maximum(np.diag(self.covariance), 1e-300))
        ratio = np.where(np.isfinite(own) & (std > 0), std / own, 1.0)
        return np.asarray(self.covariance * np.outer(ratio, ratio))


def _by_channel(noise: RecordingNoise, residual: Array) -> RecordingNoise:
    """The noise as white noise of each channel's own size, where it is an autoregression of the residual (n, p)."""
    whitener = noise.whitener
    if noise.source is not NoiseSource.RESIDUAL or not isinstance(whitener, AutoregressiveWhitener):
        return noise
    if not whitener.noise.order:
        return noise
    means = block_means(residual, whitener.noise.block)
    white = replace(NoiseModel.white(_upper_noise(means)), block=whitener.noise.block)
    plain = replace(whitener, noise=white)
    return replace(noise, whitener=plain, log_power_variance=np.full(plain.rows, noise.log_power_variance.mean()))


def _upper_noise(residual: Array) -> Array:
    """Std (p,) of white noise as strong as the upper half of a residual's spectrum, where nothing moves."""
    power = (dct(residual, axis=0, norm="ortho")[len(residual) // 2 :] ** 2).mean(axis=0)
    return np.asarray(np.sqrt(np.maximum(power, SMALLEST_SHARE * (residual**2).mean(axis=0))))
