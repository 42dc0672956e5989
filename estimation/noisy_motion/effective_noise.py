"""Effective noise: that of the readings and what the noise of the motion adds to their prediction, together."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from estimation.noise import Noise, NoiseSource, step_of
from estimation.recording import Recording
from estimation.seam import seamless
from estimation.whitening import LineWhitener, RegressionWhitener, Whitener

Array = NDArray[np.float64]


def effective(noise: Noise, recording: Recording, added: Array) -> Noise:
    """The noise of a recording's readings about a prediction that is noisy itself.

    `added` (p, p) is the covariance that the inputs' noise gives the prediction of one sample of one repeat, averaged
    over the motion: white, so that it adds to the spectrum at the motion's lines (the prediction has only those).
    Weights constant in time lose next to nothing against (S + f_u Σ f_u')^-1 sample by sample, and cannot be
    correlated with the noise of a sample. Noise estimated from a residual has the inputs' part in it already.
    """
    if noise.source is NoiseSource.RESIDUAL:
        return noise
    if noise.source is NoiseSource.RIG:
        own = cast(RegressionWhitener, noise.whitener)
        whitener: Whitener = replace(own, root=np.real(_widened(own.root, added)))
    else:
        whitener = _line_whitener(cast(LineWhitener, noise.whitener), noise, recording, added)
    return replace(noise, floor=np.sqrt(noise.floor**2 + np.diag(added)), whitener=whitener)


def _line_whitener(own: LineWhitener, noise: Noise, recording: Recording, added: Array) -> LineWhitener:
    steady, between = np.split(own.root, [len(own.motion)])
    root = np.concatenate([_widened(steady, added), between])
    plain = LineWhitener(own.samples, own.repeats, own.motion, own.between, root)
    return seamless(plain, noise.spectra, step_of(recording))


def _widened(root: NDArray[np.complex128] | Array, added: Array) -> NDArray[np.complex128]:
    """Inverse roots (..., p, p) of the covariances whose inverse roots these are, and `added` to each."""
    colouring = np.linalg.inv(root)
    covariance = colouring @ np.conj(np.swapaxes(colouring, -1, -2)) + added
    return np.asarray(np.tril(np.linalg.inv(np.linalg.cholesky(covariance))), dtype=np.complex128)
