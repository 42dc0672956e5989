"""The seam: where a Fourier transform joins a record's end to its start, and coloured noise jumps on all lines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.spectrum import Spectrum
from estimation.whitening import LineWhitener

Array = NDArray[np.float64]

SEAM = 4
"""Samples after the record's end is joined to its start at which coloured noise may start anew."""


AT_ONCE = 16
"""Columns that are freed of the seam together: the seam is read once for all of them."""


@dataclass(frozen=True, eq=False)
class SeamlessWhitener(LineWhitener):
    """A line whitener that does not believe the seam, where the transform joins the record's end to its start.

    Coloured noise does not close on itself. Filtered to whiteness round the seam, the first few samples after it are
    wrong, by the same amount in all lines: to a drift, which jumps there too, they look like proof. The noise is
    therefore free to start anew, as in an autoregression that is given its first samples. Orthonormal directions
    (k, rows), of the motion's lines and of those between, are taken out of every column, and the rest scaled so that
    the squares of noise still add up to the number of rows.
    """

    steady_seam: Array
    rest_seam: Array

    def finish(self, steady: Array, rest: Array) -> None:
        """Take the seam out of the rows."""
        _leave_out(self.steady_seam, steady)
        _leave_out(self.rest_seam, rest)


def _leave_out(directions: Array, rows: Array) -> None:
    """Take the directions (k, r) out of rows (c, r), in place, and scale what is left."""
    if not (rows.size and directions.size):
        return
    scale = np.sqrt(directions.shape[1] / (directions.shape[1] - len(directions)))
    for first in range(0, len(rows), AT_ONCE):
        own = rows[first : first + AT_ONCE]
        own -= (own @ directions.T) @ directions
        own *= scale


def seamless(
    plain: LineWhitener, spectra: tuple[Spectrum, ...], dt: float, tones: Array | None = None, judged: int = 0
) -> LineWhitener:
    """The whitener less the noise that begins at the seam: its answer to each of the first shocks.

    Less the series `tones` (n, p, k) too, whatever their amount; the first `judged` of them only on the motion's lines,
    so that between those they can be seen.
    """
    once = plain.samples // plain.repeats
    steady = plain.steady(shocks_of(spectra, once, dt))
    rest = np.zeros((0, 1))
    if len(plain.between):
        rest = plain.rest(shocks_of(spectra, plain.samples, dt))
    if tones is not None and tones.size:
        rows = plain.series(tones)
        steady = np.hstack([steady, rows[: plain.steady_rows]])
        rest = np.hstack([rest, rows[plain.steady_rows :, judged:]])
    fields = (plain.samples, plain.repeats, plain.motion, plain.between, plain.root)
    return SeamlessWhitener(*fields, *(np.ascontiguousarray(np.linalg.qr(seam)[0].T) for seam in (steady, rest)))


def shocks_of(spectra: tuple[Spectrum, ...], n: int, dt: float) -> Array:
    """Noise (n, p, p SEAM) that a unit shock in one channel at one of the first samples sets going.

    The causal series whose transform has the modulus sqrt(S): the minimum-phase one, by folding the cepstrum.
    """
    p = len(spectra)
    series = np.zeros((n, p, p * SEAM))
    frequency = np.maximum(np.arange(n // 2 + 1), 1) / (n * dt)
    for channel, spectrum in enumerate(spectra):
        cepstrum = np.fft.irfft(np.log(spectrum(frequency)) / 2, n=n)
        cepstrum[1 : (n + 1) // 2] *= 2
        cepstrum[n // 2 + 1 :] = 0
        answer = np.fft.irfft(np.exp(np.fft.rfft(cepstrum)), n=n)
        for late in range(SEAM):
            series[:, channel, channel * SEAM + late] = np.roll(answer, late)
    return series


# ------------------------------------------------------------------------------------------- events
