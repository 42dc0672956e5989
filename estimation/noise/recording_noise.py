"""Estimated noise of one recording: floor per channel, its source, and the whitening filter."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from math import inf
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from estimation.noise.motion_noise import MotionNoise
from estimation.noise.power_spectrum import PowerSpectrum, bases
from estimation.noise.whitening import AutoregressiveWhitener, FourierLineWhitener, Whitener
from estimation.recordings.recording import Recording
from modeling.noise.autoregressive_noise import NoiseModel
from modeling.noise.channel_whitening import FourierLines
from modeling.noise.stationary_noise import NoiseSource as NoiseSource

Array = NDArray[np.float64]


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
    tones     Hz of the sinusoids detected on non-excited lines and left out of the spectrum, the strongest first
    """

    floor: Array
    whitener: Whitener
    source: NoiseSource
    log_power_variance: Array
    spectra: tuple[PowerSpectrum, ...] = ()
    events: tuple[tuple[float, float], ...] = ()
    frequency: Array = field(default_factory=lambda: np.zeros(0))
    tones: tuple[float, ...] = ()
    motion: MotionNoise | None = None

    @property
    def filtered(self) -> bool:
        """Whether the spectra fall below their leakage, as those of a filtered sensor do: `leakage_free`."""
        return any(spectrum.nyquist < inf for spectrum in self.spectra)

    @cached_property
    def autoregression(self) -> NoiseModel:
        """The noise outside events as an autoregression, for streamed recordings; of a spectrum by Yule-Walker.

        Where the motion of a run is less certain than usual, its rows weigh less; an autoregression does not.
        """
        if isinstance(self.whitener, AutoregressiveWhitener):
            found = self.whitener.noise
        else:
            assert isinstance(self.whitener, FourierLineWhitener)
            root = self.whitener.root
            covariance: FourierLines = np.linalg.inv(root.conj().transpose(0, 2, 1) @ root).astype(np.complex128)
            found = NoiseModel.of_spectrum(self.frequency, covariance)
        return replace(found, source=self.source, sample_std=self.floor)

    def readings(self, recording: Recording) -> Array:
        """Whitened readings (rows,) of the recording whose noise this is, transformed once."""
        known = self._readings.get(recording)
        if known is None:
            known = self._readings[recording] = self.whitener.series(recording.wrench)
        return known

    def __getstate__(self) -> dict[str, object]:
        """The fields alone: cached values are computed again."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    @cached_property
    def _readings(self) -> WeakKeyDictionary[Recording, Array]:
        return WeakKeyDictionary()

    def log_power_variance_of(self, shares: Array, first: int = 0) -> Array:
        """Variance (g,) of the logarithm of sums of squared rows, to which each row contributes by `shares` (r, g).

        The rows are those from `first` on, a Fourier line's first; others do not contribute. To first order the
        logarithm of such a sum changes by the shares times the logarithms of the noise power. Those are correlated
        along a channel's spectrum and independent between channels.
        """
        p, rows = len(self.spectra), slice(first, first + len(shares))
        if len(self.log_power_variance) != 2 * len(self.frequency) * p or not p:
            return np.asarray(self.log_power_variance[rows] @ shares)
        real, imaginary = np.moveaxis(shares.T.reshape(shares.shape[1], -1, 2, p), 2, 0)
        lines = (real + imaginary).transpose(2, 0, 1)
        within = slice(rows.start // (2 * p), rows.stop // (2 * p))
        curves = zip(self.spectra, self._bases, lines, strict=True)
        return np.asarray(sum(s.mean_log_variance(basis[within], own.T) for s, basis, own in curves))

    @cached_property
    def _bases(self) -> tuple[Array, ...]:
        """Each spectrum's basis functions at the lines."""
        return tuple(bases(self.spectra, self.frequency))


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
