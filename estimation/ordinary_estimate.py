"""Ordinary weighted least squares for single runs, with intervals that hold in coloured noise.

Whitening by the residual's own spectrum is efficient where the model is right, though little is gained with motions as
smooth as a tool's. Where something is missing, the residual is large in the band of the motion, which the whitener then
takes for noise: little of the tool's weight is left, and what is missing biases the rest, of a lag the mass ten times
as much. Weights that depend on the channel alone keep it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct

from estimation.confidence_intervals import intervals
from estimation.least_squares.problem import Solution
from estimation.noise.recording_noise import RecordingNoise
from estimation.noise.whitening import AutoregressiveWhitener
from modeling.noise import NoiseModel, NoiseSource, block_means

Array = NDArray[np.float64]

SMALLEST_SHARE = 1e-4
"""Of a residual's variance, that the upper half of its spectrum counts for at the least: rounded readings have none."""

SMALLEST_SIZE = 1e-12
"""N or N m, of a channel without a residual, so that it can be divided by."""


def ordinary_estimate(fitted: Solution, residuals: Sequence[Array]) -> Solution | None:
    """Parameters by least squares, in which white noise weighs each channel of a run, from a whitened solution.

    Each channel is weighted by the noise of the upper frequencies alone of its residual (n, p). None where no noise is
    taken from a residual.
    """
    noise = tuple(_by_channel(n, residual) for n, residual in zip(fitted.noise, residuals, strict=True))
    if all(new is old for new, old in zip(noise, fitted.noise, strict=True)):
        return None
    problem = fitted.problem.in_noise(noise)
    minimum = problem.minimise(fitted.theta)
    return Solution(problem, minimum.theta, minimum.covariance, minimum.identifiable, minimum.converged)


def covariance_in_noise(fitted: Solution) -> Array:
    """Covariance (k, k) with the std that the residual's own spectrum gives."""
    std, stated = intervals(fitted).std, np.sqrt(np.maximum(np.diag(fitted.covariance), 1e-300))
    ratio = np.where(np.isfinite(stated) & (std > 0), std / stated, 1.0)
    return np.asarray(fitted.covariance * np.outer(ratio, ratio))


def _by_channel(noise: RecordingNoise, residual: Array) -> RecordingNoise:
    """The noise as white noise of each channel's own size, where it is an autoregression of the residual (n, p).

    Of poses at rest whose residual depends on the pose, that residual is the size: a channel in which something is
    missing weighs less then, and biases the rest less.
    """
    whitener = noise.whitener
    if noise.source is not NoiseSource.RESIDUAL or not isinstance(whitener, AutoregressiveWhitener):
        return noise
    if not whitener.noise.order and not noise.beside_pose:
        return noise
    means = block_means(residual, whitener.noise.block)
    size = np.sqrt((residual**2).mean(axis=0)) if noise.beside_pose else upper_noise(means)
    white = replace(NoiseModel.white(np.maximum(size, SMALLEST_SIZE)), block=whitener.noise.block)
    weights = None if noise.motion is None else noise.motion.steady_weights(noise.floor, white.block)
    plain = replace(whitener, noise=white, weights=weights)
    return replace(noise, whitener=plain, log_power_variance=np.full(plain.rows, noise.log_power_variance.mean()))


def upper_noise(residual: Array) -> Array:
    """Std (p,) of white noise as strong as the upper half of a residual's spectrum, where nothing moves."""
    power = (dct(residual, axis=0, norm="ortho")[len(residual) // 2 :] ** 2).mean(axis=0)
    return np.asarray(np.sqrt(np.maximum(power, SMALLEST_SHARE * (residual**2).mean(axis=0))))
