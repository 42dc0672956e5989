"""The noise of a recording without repeats, from what a fit leaves: weaker, for it cannot judge that fit's size."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimation.noise import Noise, NoiseSource, step_of
from estimation.recording import Recording
from estimation.whitening import RegressionWhitener, block_means, inverse_root

Array = NDArray[np.float64]

ORDERS = (0, 1, 2, 4, 8, 15, 30)
MOST_BLOCKS = 1000
"""Blocks that a run is averaged into: enough for what a tool does, few enough to be fitted again and again."""


def from_residual(recording: Recording, residual: Array, fitted: int, events: tuple[tuple[float, float], ...]) -> Noise:
    """Poses: the spread of each channel's residual. A run: an autoregression per channel, joint innovations.

    What is left of poses is more the model's error than noise; taking its correlations between the channels for
    noise would let one channel's error move what another has measured, so that they are left out. Within events
    (s) a run has a noise of its own: how the residual varies there about its mean, and how slowly.
    """
    block = 1 if recording.at_rest else max(1, len(residual) // MOST_BLOCKS)
    floor = _floor(recording, residual, fitted, events)
    residual = block_means(residual, block)
    n, p = residual.shape
    parts = [_indices(event, step_of(recording) * block, n) for event in events]
    quiet = np.ones(n, dtype=bool)
    for start, end in parts:
        quiet[start:end] = False
    if recording.at_rest:
        coefficients, covariance = np.zeros((0, p)), np.diag(floor**2)
    else:
        coefficients, covariance = best_autoregression(residual, quiet)
    loud = np.concatenate(
        [residual[start:end] - residual[start:end].mean(axis=0) for start, end in parts] or [residual]
    )
    whitener = RegressionWhitener(
        samples=recording.samples,
        block=block,
        coefficients=coefficients,
        root=np.real(inverse_root(covariance)),
        events=tuple(parts),
        event_root=np.diag(1 / _slow_spread(loud, floor)),
    )
    parameters = coefficients.size + p * (p + 1) / 2
    doubt = np.full(whitener.rows, 2 * parameters / (n * p))
    return Noise(floor, whitener, NoiseSource.RESIDUAL, doubt, events=events)


def _floor(recording: Recording, residual: Array, fitted: int, events: tuple[tuple[float, float], ...]) -> Array:
    """Std of one sample (p,) outside events."""
    quiet = np.ones(len(residual), dtype=bool)
    for event in events:
        start, end = _indices(event, step_of(recording), len(residual))
        quiet[start:end] = False
    floor = np.sqrt((residual[quiet] ** 2).sum(axis=0) / max(1.0, quiet.sum() - fitted / residual.shape[1]))
    return np.asarray(np.maximum(floor, 1e-12 * max(floor.max(), 1e-300)))


def _indices(event: tuple[float, float], step: float, count: int) -> tuple[int, int]:
    start, end = (int(np.clip(round(edge / step), 0, count)) for edge in event)
    return start, max(end, start + 2)


def _slow_spread(loud: Array, floor: Array) -> Array:
    """Std of a sample of slow noise, as white noise with the same std of its mean would have it."""
    spread = np.maximum(loud.std(axis=0), floor)
    correlation = (loud[1:] * loud[:-1]).mean(axis=0) / np.maximum(loud.var(axis=0), 1e-300)
    correlation = np.clip(correlation, 0.0, 1 - 4 / len(loud))
    return np.asarray(spread * np.sqrt((1 + correlation) / (1 - correlation)))


def best_autoregression(residual: Array, quiet: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Coefficients (order, p) and innovations' covariance (p, p), the order chosen by Akaike's criterion."""
    n, p = residual.shape
    best: tuple[float, Array, Array] | None = None
    for order in (order for order in ORDERS if order <= n // 20):
        kept = _undisturbed(quiet, order)
        if kept.sum() < 10 * (order + p):
            continue
        coefficients, innovation = _autoregression(residual, kept, order)
        covariance = innovation.T @ innovation / max(1, len(innovation) - order)
        covariance += 1e-12 * np.eye(p) * max(np.trace(covariance) / p, 1e-300)
        criterion = kept.sum() * np.linalg.slogdet(covariance)[1] + 2 * order * p
        if best is None or criterion < best[0]:
            best = (float(criterion), coefficients, covariance)
    if best is None:
        return np.zeros((0, p)), np.diag(residual.var(axis=0))
    return best[1:]


def _undisturbed(quiet: NDArray[np.bool_], order: int) -> NDArray[np.bool_]:
    """Samples (n,) that are quiet and whose `order` predecessors are."""
    kept = quiet.copy()
    for lag in range(1, order + 1):
        kept[lag:] &= quiet[:-lag]
    kept[:order] = False
    return kept


def _autoregression(residual: Array, kept: NDArray[np.bool_], order: int) -> tuple[Array, Array]:
    """Least-squares coefficients (order, p) of each channel by itself, and its innovations where `kept`."""
    index = np.flatnonzero(kept)
    coefficients = np.zeros((order, residual.shape[1]))
    innovation = residual[index].copy()
    for channel in range(residual.shape[1]):
        if order:
            past = np.stack([residual[index - lag, channel] for lag in range(1, order + 1)], axis=1)
            coefficients[:, channel] = np.linalg.lstsq(past, residual[index, channel], rcond=None)[0]
            innovation[:, channel] -= past @ coefficients[:, channel]
    return coefficients, innovation
