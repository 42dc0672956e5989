"""Outliers: the part of a residual that the noise's own colour cannot account for, sample by sample."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct, idct
from scipy.stats import norm

from estimation.noise import step_of
from estimation.recording import Recording
from estimation.robust.loss import Loss
from estimation.spectrum import FEWEST, smooth_spectrum

Array = NDArray[np.float64]

MOST_PASSES = 200
"""Of a fixed point that white noise reaches in one pass and noise of an autoregression at 0.98 in about 20."""
STILL = 1e-4
"""Change in robust std below which an outlier's size stands still: a hundredth of what one sample's noise hides."""
ALARM = 0.01
"""Chance that a channel of Gaussian noise shows one reading that is called an outlier."""
MAD = float(1 / norm.ppf(0.75))
"""Std of a normal variable over its median absolute value."""


@dataclass(frozen=True, eq=False)
class Precision:
    """The inverse covariance of each channel's noise, as a filter: diagonal in cosine lines.

    weights   (once, p) inverse power at the lines k / (2 N dt) of the even continuation, which unlike Fourier's has no
              seam where a slow noise would jump; zero at tones, of which a sample's neighbours know all
    A channel is judged by itself: what others read at the same time is not used.
    """

    weights: Array

    @property
    def damping(self) -> Array:
        """Part of a step (p,) with which the fixed point contracts in every line."""
        return np.asarray(self.weights.mean(axis=0) / self.weights.max(axis=0))

    def surprise(self, series: Array) -> Array:
        """What is left of every sample of (runs, once, p, ...) when its neighbours have predicted it.

        For noise of covariance C the best prediction of one sample from all others errs by (C^-1 e)_t / (C^-1)_tt.
        """
        weights = (self.weights / self.weights.mean(axis=0)).reshape(*self.weights.shape, *[1] * (series.ndim - 3))
        return np.asarray(idct(weights * dct(series, axis=1, norm="ortho"), axis=1, norm="ortho"))


def precision_of(recording: Recording, residual: Array) -> Precision:
    """The precision of noise (runs, once, p), from smooth spectra through its cosine lines; white at rest."""
    once = residual.shape[1]
    if recording.at_rest or once <= 2 * FEWEST:
        return Precision(np.ones(residual.shape[1:]))
    frequency = np.arange(1, once) / (2 * once * step_of(recording))
    power = (dct(residual, axis=1, norm="ortho") ** 2).mean(axis=0)[1:]
    weights = np.zeros(residual.shape[1:])
    for channel, ordinates in enumerate(power.T):
        # A cosine line has one part where Fourier's has two: half the shape.
        spectrum = smooth_spectrum(frequency, ordinates, shape=len(residual) / 2)
        weights[1:, channel] = np.where(spectrum.tones, 0.0, 1 / spectrum(frequency))
        weights[0, channel] = 1 / spectrum(frequency[:1])[0]
    return Precision(weights)


@dataclass(frozen=True, eq=False)
class Outliers:
    """What a loss takes out of a recording's residual e (n, p), and by what.

    residual  (n, p) measured minus predicted, the readings as they are
    part      (n, p) what is taken away, in the channels' units: e - part is what least squares still see
    distance  (n, p) u, each sample's distance from what its neighbours predict, in units of `scale`
    scale     (p,) robust std of that distance

    Derivation. Let e = z + o, noise z of covariance C and outliers o, and let d = (C^-1 (e - o))_t / (C^-1)_tt be what
    the cleaned neighbours do not predict of the cleaned sample. A sample as read is then u = (o + d) / s away from its
    prediction, and the loss leaves d = s psi(u) of that, o = s (u - psi(u)). For white noise u is e / s and the cleaned
    residual s psi(u): the pseudo-observations of Huber (1973). For coloured noise and Huber's psi the fixed point is
    the minimum of (e - o)' C^-1 (e - o) / 2 + k sum sqrt((C^-1)_tt) |o_t|, which is convex: the outliers are as few
    and small as shifts of single means can be (Y. She and A. B. Owen, J. Am. Stat. Assoc. 106 (2011) 626-639, have
    the equivalence for white noise). C's shape comes from `undisturbed`, s from the median of |o + d|.
    """

    recording: Recording
    loss: Loss
    precision: Precision
    residual: Array
    part: Array
    distance: Array
    scale: Array

    @property
    def limit(self) -> float:
        """Distance that Gaussian noise passes once in 1 / ALARM channels of this length."""
        return float(norm.isf(ALARM / 2 / len(self.distance)))

    @property
    def share(self) -> Array:
        """Mean of 1 - weight (p,): the share of the readings that the loss has taken out of the count."""
        return np.asarray(1 - self.loss.weight(self.distance).mean(axis=0))

    @property
    def found(self) -> NDArray[np.bool_]:
        """Which readings (n, p) are outliers beyond doubt."""
        return np.asarray(np.abs(self.distance) > self.limit)

    @property
    def undisturbed(self) -> Array:
        """Residual (n, p) whose outliers beyond doubt read what their neighbours predict, all others as they are.

        The noise's colour is taken from this and not from what psi leaves: that is quieter at the lines which decide
        most on outliers, which would then decide still more, until the scale collapses.
        """
        predicted = self.residual - self.distance * self.scale
        return np.asarray(np.where(self.found, predicted, self.residual), dtype=np.float64)

    def times(self, channel: int) -> Array:
        """When (s; order at rest) a channel's outliers were read, counted through all repeats."""
        return np.asarray(np.flatnonzero(self.found[:, channel]) * step_of(self.recording))

    def linearised(self, derivative: Array) -> Array:
        """Derivative of the cleaned residual along changes (n, p, k) of the residual itself, the scale held.

        From o = s (u - psi(u)): do = (1 - psi') (do + dd), dd = surprise(de - do), by the same iteration.
        """
        moved = _by_runs(self.recording, derivative)
        stiff = 1 - _by_runs(self.recording, self.loss.slope(self.distance))[..., None]
        damping = self.precision.damping[:, None]
        size = np.maximum(np.abs(moved).max(axis=(0, 1), keepdims=True), 1e-300)
        taken: Array = np.zeros_like(moved)
        for _ in range(MOST_PASSES):
            step = stiff * (taken + self.precision.surprise(moved - taken)) - taken
            taken = taken + damping * step
            if np.max(np.abs(step) / size, initial=0.0) < STILL:
                break
        return np.asarray((moved - taken).reshape(derivative.shape))

    def rows(self) -> list[tuple[str, ...]]:
        """Channel, scale, share taken and what normal noise would give, outliers, the largest and when, as text."""
        return [self._row(c, channel) for c, channel in enumerate(self.recording.channels)]

    def _row(self, number: int, channel: str) -> tuple[str, ...]:
        size = np.abs(self.distance[:, number])
        shares = f"{100 * self.share[number]:.2g} %", f"{100 * self.loss.taken:.2g} %"
        count, worst = str(int(self.found[:, number].sum())), int(size.argmax())
        where = f"{worst * step_of(self.recording):.6g}"
        return (channel, f"{self.scale[number]:.4g}", *shares, count, f"{size[worst]:.3g}", where)


def outliers_of(
    recording: Recording,
    residual: Array,
    loss: Loss,
    *,
    before: Outliers | None = None,
    held: bool = False,
    known: Array | None = None,
) -> Outliers:
    """Separate a residual (n, p) into noise and outliers, starting `before`, an earlier separation of nearly the same.

    `held` keeps the noise's colour from before. `known` is the noise's std (p,) where the rig states it: white, and
    nothing is estimated.
    """
    runs = _by_runs(recording, residual)
    if known is not None:
        precision = Precision(np.ones(runs.shape[1:]))
    elif before is not None and held:
        precision = before.precision
    else:
        calm = residual if before is None else residual - before.residual + before.undisturbed
        precision = precision_of(recording, _by_runs(recording, calm))
    part = np.zeros_like(runs) if before is None else _by_runs(recording, before.part)
    for _ in range(MOST_PASSES):
        distance = part + precision.surprise(runs - part)
        scale = known if known is not None else MAD * np.median(np.abs(distance), axis=(0, 1))
        scale = np.maximum(scale, 1e-12 * np.abs(residual).max(initial=1e-288))
        step = distance - scale * loss.psi(distance / scale) - part
        part = part + precision.damping * step
        if (np.abs(step) <= STILL * scale).all():
            break
    part, distance = (series.reshape(residual.shape) for series in (part, distance / scale))
    return Outliers(recording, loss, precision, residual, part, distance, scale)


def _by_runs(recording: Recording, series: Array) -> Array:
    """A series (n, ...) as (runs, once, ...): stretches without a pause."""
    runs = 1 if recording.continuous else recording.repeats
    return series.reshape(runs, len(series) // runs, *series.shape[1:])
