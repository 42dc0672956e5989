"""Comparison: where a fitted model and its measurements part, in the channels' units and against the noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from diagnosis.generic import predictability, push_evidence
from diagnosis.validation import transferred
from estimation.directions import spanned
from estimation.distributions import chi2_sf, f_sf
from estimation.fit import Fit, table
from estimation.interval import inverse_trigamma
from estimation.noise import Noise, NoiseSource, step_of
from estimation.recording import Recording
from estimation.whitening import LineWhitener
from modeling.space import Space

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Comparison:
    """One recording against its prediction.

    noise_floor      std of one sample per channel
    rms              of measured minus predicted over all raw samples
    explainable_rms  root of the residual's power that repeats or is slower than the repeats; None without repeats
    explainable_std  standard error of the explainable power (its square), from the noise alone
    misfit           whitened chi-square over its degrees of freedom; None where the residual judges itself
    lack_of_fit      p-value of "nothing is left but noise"
    """

    recording: Recording
    residual: Array
    noise: Noise
    noise_floor: Mapping[str, float]
    rms: Mapping[str, float]
    explainable_rms: Mapping[str, float] | None
    explainable_std: Mapping[str, float] | None
    misfit: float | None
    lack_of_fit: float

    @property
    def space(self) -> Space:
        """Planar or six axes."""
        return Space(self.recording.dimension)

    @cached_property
    def explainable_limit(self) -> Mapping[str, float] | None:
        """Two standard errors above the explainable power, as an RMS: what may be left at the most."""
        if self.explainable_rms is None or self.explainable_std is None:
            return None
        return {c: float(np.sqrt(rms**2 + 2 * self.explainable_std[c])) for c, rms in self.explainable_rms.items()}

    def rows(self) -> list[tuple[str, ...]]:
        """Channel, unit, noise floor, RMS and explainable RMS, as text."""
        explainable = self.explainable_rms or {}
        return [
            (c, unit, f"{self.noise_floor[c]:.4g}", f"{self.rms[c]:.4g}", _number(explainable.get(c)))
            for c, unit in zip(self.recording.channels, self.space.units, strict=True)
        ]

    def __str__(self) -> str:
        head = table(("channel", "unit", "noise floor", "rms", "explainable rms"), self.rows())
        return f"{head}\nmisfit {_number(self.misfit)}, lack of fit p = {self.lack_of_fit:.3g}"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def compare(fit: Fit, recording: Recording | None = None) -> Comparison:
    """Compare a fit with one of the recordings it was made from, or with another whose biases are estimated anew."""
    if recording is None or recording in fit.recordings:
        number = 0 if recording is None else fit.recordings.index(recording)
        return comparison_of(fit, number)
    return comparison_of(transferred(fit, recording), 0)


def comparison_of(fit: Fit, number: int) -> Comparison:
    """The comparison of a fit's recording of that number."""
    recording, noise, residual = fit.recordings[number], fit.noise[number], fit.residuals[number]
    channels = recording.channels
    power = (residual**2).mean(axis=0)
    explainable = explainable_power(recording, residual, noise) if noise.source is NoiseSource.REPEATS else None
    misfit, p_value = judged(fit, number)
    return Comparison(
        recording=recording,
        residual=residual,
        noise=noise,
        noise_floor=_by_channel(channels, noise.floor),
        rms=_by_channel(channels, np.sqrt(power)),
        explainable_rms=None if explainable is None else _by_channel(channels, np.sqrt(explainable[0])),
        explainable_std=None if explainable is None else _by_channel(channels, explainable[1]),
        misfit=misfit,
        lack_of_fit=p_value,
    )


def _by_channel(channels: tuple[str, ...], values: Array) -> dict[str, float]:
    return {c: float(v) for c, v in zip(channels, values, strict=True)}


def explainable_power(recording: Recording, residual: Array, noise: Noise) -> tuple[Array, Array]:
    """Power of the residual that repeats or is slow, per channel, and the standard error of that, both (p,).

    Within the repeats, each less its own mean e_r, the power is the mean of e_r e_s over all pairs of different
    repeats, in which noise has no mean. The repeats' means add what they vary more than the noise's spectrum lets
    them. With white noise of spectrum S the standard error is sqrt(2 mean(S²) / (N R (R - 1))).
    """
    repeats, once = recording.repeats, recording.samples_per_repeat
    blocks = residual.reshape(repeats, once, -1)
    means = blocks.mean(axis=1)
    inner = blocks - means[:, None]
    pairs = repeats * (repeats - 1)
    repeating = ((inner.sum(axis=0) ** 2).sum(axis=0) - (inner**2).sum(axis=(0, 1))) / (once * pairs)
    frequency = np.asarray(np.fft.rfftfreq(recording.samples, step_of(recording))[1:], dtype=np.float64)
    levels = np.stack([s(frequency) for s in noise.spectra], axis=1)
    spread = np.sqrt(2 * (levels**2).mean(axis=0) / (once * pairs))
    slow = means.var(axis=0, ddof=1) - _variance_of_means(levels, recording)
    return np.maximum(repeating, 0.0) + np.maximum(slow, 0.0), spread


def _variance_of_means(levels: Array, recording: Recording) -> Array:
    """Expected variance over repeats of the mean of a repeat, from the noise's spectrum (lines, p)."""
    n, repeats, once = recording.samples, recording.repeats, recording.samples_per_repeat
    box = np.zeros(n)
    box[:once] = 1 / once
    gain = np.abs(np.fft.rfft(box)[1:]) ** 2
    return np.asarray(2 * (gain[:, None] * levels).sum(axis=0) / n * repeats / (repeats - 1))


def judged(fit: Fit, number: int) -> tuple[float | None, float]:
    """Misfit of one recording of a fit, and the p-value of its lack of fit.

    With a noise of its own the whitened rows are tested in bands of frequency (each against F, as the spectrum is
    itself estimated), and the smallest p-value is paid for by their number. Where the residual had to give the
    noise, lack of fit is what generic terms of the inputs predict in parts of the residual held out.
    """
    noise = fit.noise[number]
    if noise.source is NoiseSource.RESIDUAL:
        return None, min(1.0, 2 * min(predictability(fit, number).p_value, push_evidence(fit, number)))
    rows, leverage = _judged_rows(fit, number)
    steady = noise.whitener.steady_rows
    total = (rows[:steady] ** 2).sum() / max(1.0, steady - leverage[:steady].sum())
    p_values = []
    for band in frequency_bands(noise):
        freedom = band.sum() - leverage[band].sum()
        if freedom > 0.5:
            power = float((rows[band] ** 2).sum())
            shares = (rows * band)[:, None] ** 2 / max(power, 1e-300)
            p_values.append(tail(power, freedom, float(noise.doubt_of(shares)[0])))
    return float(total), float(min(1.0, len(p_values) * min(p_values, default=1.0)))


def residual_judges_itself(fit: Fit) -> bool:
    """Whether any recording's noise had to come from the residual."""
    return any(n.source is NoiseSource.RESIDUAL for n in fit.noise)


def _judged_rows(fit: Fit, number: int) -> tuple[Array, Array]:
    """Whitened residual rows of one recording, and how much of each the fit has soaked up."""
    whole = spanned(fit)
    start = sum(n.whitener.rows for n in fit.noise[:number])
    part = slice(start, start + fit.noise[number].whitener.rows)
    return whole.residual[part], whole.leverage[part]


def frequency_bands(noise: Noise) -> list[NDArray[np.bool_]]:
    """Masks of the rows to be judged together: the motion's lines by octaves, and what is slower than the motion.

    One band where rows are no lines.
    """
    whitener = noise.whitener
    everything = np.arange(whitener.rows)
    if not isinstance(whitener, LineWhitener):
        return [everything >= 0]
    per_line = whitener.rows // (len(whitener.motion) + len(whitener.between))
    harmonic = whitener.motion // whitener.repeats
    octave = np.maximum(0, np.ceil(np.log2(np.maximum(harmonic, 1) / 8))).astype(int)
    slow = np.where(whitener.between < whitener.repeats, -1, -2)
    label = np.repeat(np.concatenate([octave, slow]), per_line)
    return [label == o for o in np.unique(label) if o != -2]


def tail(statistic: float, freedom: float, doubt: float) -> float:
    """Chance of a chi-square this large under the noise; F where the noise's power is known with some doubt.

    A power estimated with d degrees of freedom has a logarithm of variance trigamma(d / 2), which is the doubt.
    """
    if doubt <= 0:
        return float(chi2_sf(statistic, freedom))
    return float(f_sf(statistic / freedom, freedom, 2 * inverse_trigamma(doubt)))
