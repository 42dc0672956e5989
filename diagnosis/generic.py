"""Generic terms of a recording's inputs: what a remainder looks like when no effect has a name for it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from estimation.distributions import chi2_sf
from estimation.fit import Fit
from estimation.recording import Recording
from estimation.response import signals_of
from estimation.whitening import RegressionWhitener

Array = NDArray[np.float64]

BLOCKS = 10


def generic_terms(recording: Recording, load: Array) -> dict[str, Array]:
    """Named series (n,) of the inputs: direction, position, speeds, accelerations and the predicted load (n, p).

    Directions enter as sine and cosine, everything else to second order and by its sign, as far as recorded.
    """
    signals = signals_of(recording)
    terms: dict[str, Array] = {}
    if recording.dimension == 2:
        phi = signals["phi"]
        for k in (1, 2, 3):
            terms |= {f"sin {k} phi": np.sin(k * phi), f"cos {k} phi": np.cos(k * phi)}
        plain: tuple[str, ...] = ("px", "py", "dphi", "ddphi", "vx", "vy", "ax", "ay")
    else:
        down = gravity_direction(signals)
        for i, a in enumerate("xyz"):
            terms |= {
                f"down_{a}²" if i == j else f"down_{a} down_{b}": down[i] * down[j]
                for j, b in enumerate("xyz")
                if j >= i
            }
            terms[f"down_{a}"] = down[i]
        plain = tuple(p + a for p in ("p", "w", "al", "vp", "ap") for a in "xyz")
    for name in plain:
        if name in signals and signals[name].std() > 1e-9:
            terms |= {name: signals[name], f"{name}²": signals[name] ** 2}
    for name in ("dphi", "vx", "vy", "wx", "wy", "wz"):
        if name in signals and signals[name].std() > 1e-6:
            terms[f"sign {name}"] = np.tanh(signals[name] / (0.05 * signals[name].std()))
    for channel, series in zip(recording.channels, load.T, strict=True):
        terms |= {f"{channel}²": series**2, f"{channel}³": series**3}
    return {name: series for name, series in terms.items() if np.ptp(series) > 0}


def gravity_direction(signals: Mapping[str, Array]) -> tuple[Array, Array, Array]:
    """The world's -z in the sensor frame, three series (n,) of unit vectors' components."""
    from scipy.spatial.transform import Rotation  # which takes long to load

    orientation = Rotation.from_quat(np.stack([signals[name] for name in ("qx", "qy", "qz", "qw")], axis=1))
    x, y, z = orientation.apply([0.0, 0.0, -1.0], inverse=True).T
    return x, y, z


def standardised(terms: dict[str, Array]) -> Array:
    """Columns (n, terms) of zero mean and unit variance."""
    matrix = np.stack(list(terms.values()), axis=1)
    matrix = matrix - matrix.mean(axis=0)
    return np.asarray(matrix / matrix.std(axis=0))


@dataclass(frozen=True)
class Predictability:
    """What generic terms predict of the residual of parts that they were not fitted to.

    gain     whitened chi-square that the prediction explains there; no noise in its mean, so that it may be negative
    p_value  chance of such a gain if the sign of each part's residual were open
    """

    gain: float
    p_value: float


def predictability(fit: Fit, number: int) -> Predictability:
    """How well the residual of each block of a run is predicted from all other blocks.

    The whitened residual of each channel is regressed (ridge) on a constant and the whitened terms, and the gain of
    a held-out block is its residual times its prediction. The sum of the gains is a quadratic form in the blocks'
    residuals without its diagonal; were they noise, the sign of each block would be open, and all 2^(blocks - 1)
    patterns of signs give the sum's distribution. Weaker than repeats: what the autoregression took for noise
    cannot be seen.
    """
    recording, whitener = fit.recordings[number], fit.noise[number].whitener
    assert isinstance(whitener, RegressionWhitener), "of a single run"
    load = recording.wrench - fit.residuals[number]
    p = len(recording.channels)
    terms = generic_terms(recording, load)
    constant = np.ones((recording.samples, 1))
    columns = np.column_stack([constant, standardised(terms)]) if terms else constant
    residual = whitener.series(fit.residuals[number]).reshape(-1, p)
    blocks = np.array_split(np.arange(len(residual)), min(BLOCKS, len(residual)))
    pairs = np.zeros((len(blocks), len(blocks)))
    for channel in range(p):
        white = whitener.alone(channel).series(columns[:, None])
        pairs += _gain_of_pairs(white, residual[:, channel], blocks)
    signs = np.array(list(product((1.0, -1.0), repeat=len(blocks) - 1)))
    signs = np.column_stack([np.ones(len(signs)), signs])
    gains = np.einsum("sb,bc,sc->s", signs, pairs, signs)
    return Predictability(float(gains[0]), float(np.mean(gains >= gains[0] * (1 - 1e-12))))


def _gain_of_pairs(white: Array, residual: Array, blocks: list[NDArray[np.intp]]) -> Array:
    """Element (b, c): what block c contributes to the gain of block b, when b is predicted from all others."""
    gram = white.T @ white
    ridge = np.eye(len(gram)) * max(1e-3 * np.trace(gram) / len(gram), 1.0)
    moments = np.stack([white[block].T @ residual[block] for block in blocks], axis=1)
    pairs = np.stack(
        [
            moments[:, b] @ np.linalg.solve(gram - white[block].T @ white[block] + ridge, moments)
            for b, block in enumerate(blocks)
        ]
    )
    np.fill_diagonal(pairs, 0.0)
    return pairs


def push_evidence(fit: Fit, number: int) -> float:
    """P-value that the wrench left within a run's events has no mean, 1 without events.

    Each event's whitened rows, white with the spread that the event has about its mean, are summed per channel.
    """
    whitener = fit.noise[number].whitener
    if not isinstance(whitener, RegressionWhitener) or not whitener.events:
        return 1.0
    rows = whitener.series(fit.residuals[number]).reshape(-1, len(whitener.root))
    order = len(whitener.coefficients)
    sums = [
        rows[max(0, s - order) : e - 2 * order].sum(axis=0) / np.sqrt(max(1, e - s - order)) for s, e in whitener.events
    ]
    statistic = float(np.sum(np.square(sums)))
    return float(chi2_sf(statistic, len(sums) * rows.shape[1]))
