"""Noise of several colours: unit series by name, and channels with correlated noise of a known model."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from modeling.noise import NoiseModel
from modeling.space import Space

Array = NDArray[np.float64]
Noise = Callable[[np.random.Generator, int], Array]
SEEDS = 200
"""Of a calibration test."""
TAIL = 1e-3
"""Probability of a calibration test to fail although the stated level holds."""


def pink(rng: np.random.Generator, n: int) -> Array:
    """1/f noise of unit variance: a quarter of a longer periodic series."""
    frequency = np.fft.rfftfreq(4 * n)[1:]
    lines = (rng.normal(size=len(frequency)) + 1j * rng.normal(size=len(frequency))) / np.sqrt(frequency)
    series = np.fft.irfft(np.concatenate([[0], lines]))
    return np.asarray(series[:n] / series.std())


def autoregressive(rng: np.random.Generator, n: int) -> Array:
    return np.asarray(lfilter([np.sqrt(1 - 0.95**2)], [1, -0.95], rng.normal(size=n + 1000))[1000:])


def with_tones(rng: np.random.Generator, n: int) -> Array:
    t = np.arange(n)
    tones = [0.5 * np.sin(2 * np.pi * f * t + rng.uniform(0, 6)) for f in (0.11, 0.31)]
    return np.asarray(pink(rng, n) + np.sum(tones, axis=0))


NOISES: dict[str, Noise] = {
    "white": lambda rng, n: np.asarray(rng.normal(size=n)),
    "autoregressive": autoregressive,
    "pink": pink,
    "pink, with tones": with_tones,
}


def noise_model(space: Space, order: int, block: int = 1) -> NoiseModel:
    """Channels that are correlated, and as coloured as `order` coefficients of 0.3, 0.15, ... make them."""
    p = len(space.channels)
    mixing = 0.1 * np.random.default_rng(p).standard_normal((p, p)) + 0.4 * np.eye(p)
    coefficients = np.outer(0.3 / 2.0 ** np.arange(order), np.linspace(1, 0.7, p))
    return NoiseModel(mixing @ mixing.T, coefficients, block)
