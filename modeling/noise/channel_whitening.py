"""Whitening of channels: inverse Cholesky factor of a covariance, its product with a series, and block means."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from modeling.errors import InputError

Array = NDArray[np.float64]
FourierLines = NDArray[np.complex128]
SeriesOrLines = TypeVar("SeriesOrLines", Array, FourierLines)


def inverse_cholesky_factor(covariance: SeriesOrLines) -> SeriesOrLines:
    """Inverse Cholesky factors W (..., p, p) of covariances C, lower triangular: W C W^H = 1."""
    return cast(SeriesOrLines, np.tril(np.linalg.inv(np.linalg.cholesky(covariance))))


def whitened_by_channel(root: SeriesOrLines, series: SeriesOrLines) -> Iterator[tuple[int, SeriesOrLines]]:
    """Each channel (..., n) of an inverse Cholesky factor (p, p) or (p, p, n) times a series, with its number.

    The series (..., p, n) are n samples, or n lines with a factor each.
    """
    for channel in range(len(root)):
        mixed = root[channel, 0] * series[..., 0, :]
        for other in range(1, channel + 1):
            mixed += root[channel, other] * series[..., other, :]
        yield channel, mixed


def whitened_channels(root: SeriesOrLines, series: SeriesOrLines) -> SeriesOrLines:
    """All channels (..., p, n) of `whitened_by_channel`."""
    white = np.empty_like(series)
    for channel, mixed in whitened_by_channel(root, series):
        white[..., channel, :] = mixed
    return white


def block_means(values: Array, block: int) -> Array:
    """Means (n // block, ...) of successive blocks of samples; an incomplete last block is left out."""
    if block == 1:
        return values
    count = len(values) // block
    parts = values[: count * block].T.reshape(*values.shape[:0:-1], count, block)
    return np.asarray((parts @ np.full(block, 1 / block)).T)


def require_positive_definite(covariance: NDArray[np.inexact]) -> None:
    """Raise InputError unless the covariances (..., p, p) are finite, Hermitian and positive definite."""
    scale = np.sqrt(np.abs(np.diagonal(covariance, axis1=-2, axis2=-1)))
    asymmetry = np.abs(covariance - covariance.conj().swapaxes(-1, -2))
    valid = np.isfinite(covariance).all() and (asymmetry <= 1e-9 * scale[..., None] * scale[..., None, :]).all()
    try:
        np.linalg.cholesky(covariance if valid else np.zeros((1, 1)))
    except np.linalg.LinAlgError:
        raise InputError(
            what="the covariance of the channels is not symmetric and positive definite",
            where="noise",
            remedy="give the std of every channel, above zero",
        ) from None
