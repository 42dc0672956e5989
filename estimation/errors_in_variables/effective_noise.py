"""Effective noise: noise of the readings plus that of the prediction due to input noise."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from estimation.noise.leakage import without_leakage
from estimation.noise.recording_noise import NoiseSource, RecordingNoise, sample_step
from estimation.noise.whitening import AutoregressiveWhitener, FourierLineWhitener, Whitener
from estimation.recordings.recording import Recording
from modeling.noise.whitening import FourierLines, inverse_cholesky_factor

Array = NDArray[np.float64]


def effective_noise(noise: RecordingNoise, recording: Recording, added: Array) -> RecordingNoise:
    """Noise of the residual of a recording whose prediction is noisy as well.

    `added` (p, p) is the covariance of the prediction of one sample of one repeat due to the input noise, averaged
    over the motion: white, so that it adds to the spectrum at the excited lines (the prediction has only those).
    Weights constant in time lose almost no efficiency against (S + f_u Σ f_u')^-1 sample by sample, and cannot be
    correlated with the noise of a sample. Noise estimated from a residual already includes the input noise.
    """
    if noise.source is NoiseSource.RESIDUAL:
        return noise
    if noise.source is NoiseSource.RIG:
        own = cast(AutoregressiveWhitener, noise.whitener)
        covariance = own.noise.covariance + added
        whitener: Whitener = replace(own, noise=replace(own.noise, covariance=covariance))
    else:
        whitener = _line_whitener(cast(FourierLineWhitener, noise.whitener), noise, recording, added)
    return replace(noise, floor=np.sqrt(noise.floor**2 + np.diag(added)), whitener=whitener)


def _line_whitener(
    own: FourierLineWhitener, noise: RecordingNoise, recording: Recording, added: Array
) -> FourierLineWhitener:
    excited, non_excited = np.split(own.root, [len(own.excited_lines)])
    root = np.concatenate([_with_added_covariance(excited, added), non_excited])
    plain = FourierLineWhitener(own.samples, own.repeats, own.excited_lines, own.non_excited_lines, root)
    return without_leakage(plain, noise.spectra, sample_step(recording))


def _with_added_covariance(root: FourierLines, added: Array) -> FourierLines:
    """Inverse roots (..., p, p) of C + `added`, for covariances C given by their inverse roots."""
    colouring = np.linalg.inv(root)
    covariance = colouring @ np.conj(np.swapaxes(colouring, -1, -2)) + added
    return inverse_cholesky_factor(covariance.astype(np.complex128))
