"""Generic regressors of the recorded inputs, and the cross-validated lack-of-fit test that uses them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from estimation.distributions import chi2_sf
from estimation.fit import Fit
from estimation.model_signals import model_signals
from estimation.noise.whitening import AutoregressiveWhitener
from estimation.recordings.recording import Recording
from estimation.recordings.sensor_frame import in_sensor_frame
from estimation.run_spectrum import run_spectrum

Array = NDArray[np.float64]

FOLDS = 13
"""Blocks: 2^(1 - 13) is the smallest p-value of sign flips, below the level of held-out recordings; 10 do not do."""


def generic_terms(recording: Recording, load: Array) -> dict[str, Array]:
    """Regressors (n,) by name, of direction, position, velocities, accelerations and the predicted load (n, p).

    Directions enter as sine and cosine, the load to second and third order, all else to second order; velocities also
    by their (smoothed) sign. Constant and unrecorded terms are left out.
    """
    signals = model_signals(recording)
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
    """Unit vector along the world's -z in the sensor frame: three components (n,)."""
    x, y, z = in_sensor_frame(signals, (0.0, 0.0, -1.0)).T
    return x, y, z


def standardised_columns(terms: dict[str, Array]) -> Array:
    """Regressor matrix (n, terms), columns of zero mean and unit variance."""
    matrix = np.stack(list(terms.values()), axis=1)
    matrix = matrix - matrix.mean(axis=0)
    return np.asarray(matrix / matrix.std(axis=0))


def smallest_gain_p_value(whitener: AutoregressiveWhitener) -> float:
    """The smallest p-value that the sign flips of `cross_validated_gain` can give: one pattern of all."""
    return 2.0 ** (1 - min(FOLDS, whitener.rows // len(whitener.noise.covariance)))


@dataclass(frozen=True)
class CrossValidatedGain:
    """Cross-validated prediction of the residual by generic terms.

    gain     drop of the whitened chi-square on held-out blocks; zero mean under noise, so that it may be negative
    p_value  by a sign-flip permutation test over the blocks, in rows without the colour that whitening leaves
    """

    gain: float
    p_value: float


def cross_validated_gain(fit: Fit, number: int, residual: Array) -> CrossValidatedGain:
    """Cross-validated gain of generic terms on the residual (n, p) of a single run: each block by all others.

    The whitened residual of each channel is regressed (ridge) on a constant and the whitened terms; the gain of a
    held-out block is its residual times its prediction. The sum of the gains is a quadratic form in the blocks'
    residuals without its diagonal; under noise the blocks' signs are exchangeable, and all 2^(blocks - 1) sign
    patterns give the null distribution. They are not where 1/f noise goes on from block to block, which an
    autoregression does not whiten: for the p-value the rows are flattened by their own spectrum. Less powerful than
    repeats: the autoregression absorbs part of the residual.
    """
    recording, whitener = fit.recordings[number], fit.noise[number].whitener
    assert isinstance(whitener, AutoregressiveWhitener), "the test is for a single run"
    load = recording.wrench - residual
    p = len(recording.channels)
    terms = generic_terms(recording, load)
    constant = np.ones((recording.samples, 1))
    columns = np.column_stack([constant, standardised_columns(terms)]) if terms else constant
    whitened = whitener.series(residual).reshape(-1, p)
    blocks = np.array_split(np.arange(len(whitened)), min(FOLDS, len(whitened)))
    spectrum = run_spectrum(fit, number)
    pairs = np.zeros((len(blocks), len(blocks)))
    flat_pairs = pairs.copy()
    for channel in range(p):
        white, rows = whitener.of_channel(channel).series(columns[:, None]), whitened[:, channel]
        pairs += _gain_of_pairs(white, rows, blocks)
        if spectrum is not None:
            flat_pairs += _gain_of_pairs(spectrum.flattened(white, channel), spectrum.flattened(rows, channel), blocks)
    flat_pairs = pairs if spectrum is None else flat_pairs
    signs = np.array(list(product((1.0, -1.0), repeat=len(blocks) - 1)))
    signs = np.column_stack([np.ones(len(signs)), signs])
    gains = np.einsum("sb,bc,sc->s", signs, flat_pairs, signs)
    return CrossValidatedGain(float(pairs.sum()), float(np.mean(gains >= gains[0] * (1 - 1e-12))))


def _gain_of_pairs(white: Array, residual: Array, blocks: list[NDArray[np.intp]]) -> Array:
    """Matrix (blocks, blocks): element (b, c) is the contribution of block c to the gain of held-out block b."""
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


def event_mean_p_value(fit: Fit, number: int, residual: Array) -> float:
    """P-value that the residual (n, p) within a run's events has zero mean, 1 without events.

    Each event's whitened rows, whitened with the residual's variance about its mean there, are summed per channel.
    """
    whitener = fit.noise[number].whitener
    if not isinstance(whitener, AutoregressiveWhitener) or not whitener.events:
        return 1.0
    rows = whitener.series(residual).reshape(-1, len(whitener.noise.covariance))
    order = whitener.noise.order
    sums = [
        rows[max(0, s - order) : e - 2 * order].sum(axis=0) / np.sqrt(max(1, e - s - order)) for s, e in whitener.events
    ]
    statistic = float(np.sum(np.square(sums)))
    return float(chi2_sf(statistic, len(sums) * rows.shape[1]))
