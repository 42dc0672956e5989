"""Estimated noise of one recording: floor per channel, its source, and the whitening filter."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from math import inf
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from estimation.noise.power_spectrum import PowerSpectrum, bases
from estimation.noise.whitening import AutoregressiveWhitener, FourierLineWhitener, Whitener
from estimation.recordings.recording import Recording
from modeling.noise import FourierLines, NoiseModel, NoiseSource

if TYPE_CHECKING:
    from collections.abc import Callable

    from estimation.noise.transient_windows import EventShape


Array = NDArray[np.float64]

MAX_LOG_VARIANCE = np.pi**2 / 6
"""Of the logarithm of a line's power: that with two degrees of freedom, as a periodogram's has."""
DRAWN_SAMPLES = 50_000
"""Samples of all draws together."""
FEWEST_DRAWS, MOST_DRAWS = 4, 16
"""Draws of a long and of a short run: the variance of a few is averaged over `WINDOW` samples too."""
NEGLIGIBLE = 0.99
"""Of a weight: a smaller change changes no estimate."""
WINDOW = 5
"""Samples over which the variance of a few draws is averaged."""
USUAL = 4.0
"""Times its median, up to which a variance is usual: that of four draws varies by less in all but a sample in 100."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionNoise:
    """Errors of the predicted readings by what the samples of the motion leave open.

    errors              (draws, n, p), at random from the posterior of the smoothed motion
    correlation_length  samples over which an error lasts: half the sampling rate over the smoothing's cutoff
    """

    errors: Array
    correlation_length: float

    @classmethod
    def of(cls, recording: Recording, predicted: Callable[[Recording], Array]) -> MotionNoise | None:
        """Of a run whose motion is smoothed, by a prediction (n, p) of its readings; None for any other.

        The smoothed motion is a Gaussian process with known covariance. Each draw from it goes through the kinematics
        and the tool's equations as the motion itself does, so that velocity and acceleration enter with their own
        errors and their correlation, larger at the ends of the record. Each sample is predicted by itself.
        """
        splines = [d.spline for d in recording.motion.recorded.derivatives.values() if d.spline is not None]
        if recording.repeats > 1 or not splines:
            return None
        draws = int(np.clip(DRAWN_SAMPLES // recording.samples, FEWEST_DRAWS, MOST_DRAWS))
        drawn = recording.drawn_motions(np.random.default_rng(0), draws)
        errors = predicted(drawn).reshape(draws, recording.samples, -1) - predicted(recording)
        length = max(spline.half_rate / spline.cutoff * recording.samples / spline.samples for spline in splines)
        return cls(errors=errors, correlation_length=max(1.0, length))

    @property
    def variance(self) -> Array:
        """Variance (n, p) of each sample, averaged over `WINDOW` of them."""
        padded = np.pad(np.mean(self.errors**2, axis=0), ((WINDOW // 2, (WINDOW - 1) // 2), (0, 0)), mode="edge")
        weights = np.full(WINDOW, 1 / WINDOW)
        return np.stack([np.convolve(channel, weights, mode="valid") for channel in padded.T], axis=1)

    @property
    def is_usual(self) -> NDArray[np.bool_]:
        """Where (n,) no channel's variance is more than `USUAL` times its median."""
        return np.asarray(np.all(self.variance <= USUAL * np.median(self.variance, axis=0), axis=1))

    def weights(self, floor: Array, block: int) -> Array | None:
        """Factor (blocks,) of whitened rows where the motion is less certain than usual; None where it is nowhere.

        `floor` (p,) is the std of one sample of all other noise with the usual noise of the motion. An error that
        lasts for L samples counts L times its variance: as much as white noise of the same low-frequency power.
        """
        return self._weights(floor**2, np.median(self.variance, axis=0), block)

    def steady_weights(self, floor: Array, block: int) -> Array | None:
        """Those of an estimate, which must not depend on the draws: only what is more than `USUAL` counts.

        The floor is no smaller then than the usual noise of the motion: a parameter that the run does not show (an
        inertia of -6 kg m²) makes of the noise of an acceleration a hundred times the residual, and by `weights` half
        of the rows are left out by lot.
        """
        usual = np.median(self.variance, axis=0)
        return self._weights(np.maximum(floor**2, usual), USUAL * usual, block)

    def _weights(self, power: Array, usual: Array, block: int) -> Array | None:
        excess = np.maximum(self.variance - usual, 0.0) * self.correlation_length
        blocks = excess[: len(excess) // block * block].reshape(-1, block, excess.shape[1]).mean(axis=1)
        weights: Array = np.sqrt(1 / (1 + np.max(blocks / power, axis=1)))
        return weights if weights.min() < NEGLIGIBLE else None


@dataclass(frozen=True, eq=False)
class RecordingNoise:
    """Noise of one recording.

    floor     std of one sample per channel, in its unit
    whitener  linear map to rows of unit variance
    source    what the estimate rests on
    log_power_variance  per whitened row, the variance of the logarithm of the estimated noise power
    spectra   per channel the power spectral density (repeats only), per sample: white noise has S = std²
    events    intervals (s) of transient events, left out of the spectrum
    frequency Hz of each line of a line whitener, in its order
    motion    of the predicted readings by the noise of the measured motion (single runs only)
    shapes    events whose wrench is not constant, left out of the spectrum and of the rows but for a mean wrench
    tones     Hz of the sinusoids detected on non-excited lines and left out of the spectrum, the strongest first
    beside_pose  whether it is what no function of the pose explains, where a residual at rest depends on the pose
    """

    floor: Array
    whitener: Whitener
    source: NoiseSource
    log_power_variance: Array
    spectra: tuple[PowerSpectrum, ...] = ()
    events: tuple[tuple[float, float], ...] = ()
    frequency: Array = field(default_factory=lambda: np.zeros(0))
    tones: tuple[float, ...] = ()
    shapes: tuple[EventShape, ...] = ()
    motion: MotionNoise | None = None
    beside_pose: bool = False

    @property
    def filtered(self) -> bool:
        """Whether the spectra fall below their leakage, as those of a filtered sensor do: `leakage_free`."""
        return any(spectrum.nyquist < inf for spectrum in self.spectra)

    @property
    def without_events(self) -> RecordingNoise:
        """The noise of a run as it is outside its events, which stay marked."""
        if not isinstance(self.whitener, AutoregressiveWhitener) or self.whitener.event_noise is None:
            return self
        return replace(self, whitener=replace(self.whitener, events=(), event_noise=None))

    @property
    def left_out(self) -> list[int]:
        """Numbers of the channels that have weight zero."""
        return list(self.whitener.left_out) if isinstance(self.whitener, AutoregressiveWhitener) else []

    @cached_property
    def autoregression(self) -> NoiseModel:
        """The noise outside events as an autoregression, for streamed recordings; of a spectrum by Yule-Walker.

        Where the motion of a run is less certain than usual, its rows weigh less; an autoregression does not.
        """
        if isinstance(self.whitener, AutoregressiveWhitener):
            noise = self.whitener.noise
        elif self.source is NoiseSource.DWELLS:
            noise = NoiseModel.white(self.floor)
        else:
            assert isinstance(self.whitener, FourierLineWhitener)
            root = self.whitener.root
            covariance: FourierLines = np.linalg.inv(root.conj().transpose(0, 2, 1) @ root).astype(np.complex128)
            noise = NoiseModel.of_spectrum(self.frequency, covariance)
        return replace(noise, source=self.source, sample_std=self.floor)

    def log_power_variance_of(self, shares: Array, first: int = 0) -> Array:
        """Variance (g,) of the logarithm of sums of squared rows, to which each row contributes by `shares` (r, g).

        The rows are those from `first` on, a Fourier line's first; others do not contribute. To first order the
        logarithm of such a sum changes by the shares times the logarithms of the noise power. Those are correlated
        along a channel's spectrum, or its poses, and independent between channels.
        """
        p, rows = len(self.spectra), slice(first, first + len(shares))
        if self.source is NoiseSource.DWELLS:
            channels = np.arange(first, first + len(shares)) % len(self.floor)
            of_channel = [shares[channels == channel].sum(axis=0) for channel in range(len(self.floor))]
            return np.asarray(self.log_power_variance[: len(self.floor)] @ np.square(of_channel))
        if len(self.log_power_variance) != 2 * len(self.frequency) * p or not p:
            return np.asarray(self.log_power_variance[rows] @ shares)
        real, imaginary = np.moveaxis(shares.T.reshape(shares.shape[1], -1, 2, p), 2, 0)
        lines = (real + imaginary).transpose(2, 0, 1)
        within = slice(rows.start // (2 * p), rows.stop // (2 * p))
        curves = zip(self.spectra, self._bases, lines, strict=True)
        return np.asarray(sum(s.mean_log_variance(basis[within], weights.T) for s, basis, weights in curves))

    def error_of_weights(self, shares: Array, first: int = 0) -> Array:
        """Factor (g,) of variances of sums to which rows contribute by `shares` (r, g), as `log_power_variance_of`.

        Where the noise is wrong by one factor there is none. Of repeats each line's power is wrong by its own, and what
        is estimated leans on lines that seem quieter than they are: to first order the variance is larger by
        1 + 2 (sum_r q_r var(log power_r) - var(log sum)) (M. G. Kenward and J. H. Roger, Biometrics 53 (1997) 983-997).
        """
        if self.source is not NoiseSource.REPEATS:
            return np.ones(shares.shape[1])
        of_lines = np.minimum(self.log_power_variance[first : first + len(shares)], MAX_LOG_VARIANCE) @ shares
        return np.asarray(1 + 2 * np.maximum(of_lines - self.log_power_variance_of(shares, first), 0.0))

    @cached_property
    def _bases(self) -> tuple[Array, ...]:
        """Each spectrum's basis functions at the lines."""
        return tuple(bases(self.spectra, self.frequency))


def without_constant_channels(noise: RecordingNoise, recording: Recording) -> RecordingNoise:
    """The noise with weight zero for the channels that never change: they measure nothing, and without noise they would
    decide whatever acts on them."""
    constant = constant_channels(recording)
    if not constant or not isinstance(noise.whitener, AutoregressiveWhitener):
        return noise
    return replace(noise, whitener=noise.whitener.without(constant))


def constant_channels(recording: Recording) -> list[int]:
    """Numbers of the channels that never change while others do."""
    constant = np.ptp(recording.wrench, axis=0) == 0
    return [] if constant.all() else [int(number) for number in np.flatnonzero(constant)]


def sample_step(recording: Recording) -> float:
    """Sampling interval in s; 1 for static poses, which have none."""
    return recording.dt if recording.dt is not None else 1.0


def stated_noise_floor(recording: Recording) -> Array | None:
    """Std of one sample per channel (p,) as stated in the rig; None unless stated for every channel."""
    stated = recording.rig.sensor.noise if recording.rig is not None else None
    if stated is None or not all(stated.get(channel) for channel in recording.channels):
        return None
    return np.array([stated[channel] for channel in recording.channels])


def repeat_noise_floor(recording: Recording, residual: Array | None = None) -> Array:
    """Std of one sample of one repeat about the mean over repeats, (p,), with R - 1 degrees of freedom.

    Of the residual (n, p) of a prediction from each repeat's own motion where that is given, else of the readings.
    """
    series = recording.wrench if residual is None else residual
    freedom = recording.samples_per_repeat * (recording.repeats - 1)
    return np.asarray(np.sqrt(((series - recording.averaged(series)) ** 2).sum(axis=0) / freedom))
