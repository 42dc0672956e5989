"""Student-t confidence intervals with effective degrees of freedom of the estimated noise (Satterthwaite); and the
estimate of a single run whose std these give."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct

from estimation.least_squares.estimates import PARAMETER_COLUMNS, fixed_parameters
from estimation.least_squares.problem import Solution
from estimation.least_squares.square_root_information import orthonormal_basis
from estimation.multiplicity import inverse_trigamma, student_isf
from estimation.noise.power_spectrum import MIN_ORDINATES, PowerSpectrum, smooth_power_spectra
from estimation.noise.recording_noise import RecordingNoise
from estimation.noise.whitening import AutoregressiveWhitener
from estimation.recordings.recording import Recording
from modeling.noise import NoiseModel, NoiseSource, block_means
from modeling.number_format import digits_of
from modeling.significance import LEVELS
from modeling.table import Cell, Column, Table, Tabular

Array = NDArray[np.float64]

MAX_DEGREES_OF_FREEDOM = 1e4
"""Upper limit of the degrees of freedom: from here on the t quantile is the normal one to four digits."""
MIN_DEGREES_OF_FREEDOM = 2.0
"""Lower limit: that of the power at a record's lowest line, whose scatter the extrapolated spectrum omits."""
LEAST_POWER = 1e-12
"""Of a line of the residual, relative to a stated noise."""
MIN_RESIDUAL_SHARE = 0.5
"""Share of a line's power that must remain in the residual for the line to enter the noise spectrum."""


@dataclass(frozen=True, eq=False)
class Intervals(Tabular):
    """Two-sided confidence intervals of a fit's parameters, in the order of its `theta`.

    std      (k,) standard deviation; for a single run corrected for the colour that whitening left
    freedom  (k,) effective degrees of freedom of std
    """

    fit: Solution
    level: float
    std: Array
    freedom: Array

    @property
    def half_width(self) -> Array:
        """(k,) t quantile times std; infinite for an unidentifiable parameter, zero for a fixed one."""
        quantile = student_isf(0.5 - self.level / 2, self.freedom)
        return np.where(self._fixed, 0.0, np.where(self.fit.identifiable, quantile * self.std, np.inf))

    @property
    def _fixed(self) -> NDArray[np.bool_]:
        return fixed_parameters(self.fit.unknowns)

    @property
    def low(self) -> Array:
        """Lower ends (k,)."""
        return np.asarray(self.fit.theta - self.half_width)

    @property
    def high(self) -> Array:
        """Upper ends (k,)."""
        return np.asarray(self.fit.theta + self.half_width)

    @property
    def table(self) -> Table:
        """Name, value, std, degrees of freedom, both ends and unit of every parameter."""
        name, value, std, unit = PARAMETER_COLUMNS
        ends = (Column(end, format=".6g") for end in (f"{100 * self.level:g} % from", "to"))
        numbers = np.column_stack([self.fit.theta, self.std, self.freedom, self.low, self.high])
        numbers[~(self.fit.identifiable | self._fixed)] = np.nan
        rows = []
        for parameter, (v, s, f, low, high) in zip(self.fit.unknowns, numbers.tolist(), strict=True):
            shown, first, last = (Cell(number, format=digits_of(number, s)) for number in (v, low, high))
            rows.append((parameter.name, shown, s, f, first, last, parameter.unit))
        return Table.of((name, value, std, Column("freedom", format=".3g"), *ends, unit), rows)


def intervals(fit: Solution, *, level: float = LEVELS.confidence, pull: Array | None = None) -> Intervals:
    """Confidence intervals with nominal coverage, though the noise was estimated from the same recordings.

    Parameters
    ----------
    fit : Fit or Solution
        A fit to whole recordings, with their noise.
    level : float, optional
        Two-sided confidence level, by default 0.95.
    pull : array (rows, k), optional
        Influence of the noise of each whitened row on every parameter, in the parameters' units; by default that of
        least squares, D C. One that is given holds the size of the noise that a rig states, which is taken for white.

    Returns
    -------
    Intervals
        Std, effective degrees of freedom and ends (k,) in the order of the fit's `theta`, in the parameters' units;
        infinitely wide for an unidentifiable parameter.

    Notes
    -----
    theta's error is sum_r a_rj w_r over the whitened rows' noise w, with the influence a = D C of least squares (rows,
    k), or the one given (`pull`). Its variance is sum_r a_rj² times the power of row r, which is 1 as far as whitening
    succeeded: every row was divided by an estimate. With q_r the shares of the rows in the variance and v = var(sum_r
    q_r log power_r), the variance is distributed as chi-square with f degrees of freedom, whose logarithm has variance
    trigamma(f / 2): f = 2 trigamma^-1(v) (F. E. Satterthwaite, Biometrics Bull. 2 (1946) 110-114, on the logarithm).
    Error over std is then Student's t with f degrees of freedom.

    That is all where the noise is wrong by one factor. Of repeats each line's power is wrong by its own: there the
    variance counts the error of the weights, too (`RecordingNoise.error_of_weights`).

    A single run is whitened by an autoregression of its own residual, whose low-frequency part depends on few samples
    and on the orders tried, or by the std that its rig states, which says nothing of the noise's colour. The spectrum
    of the whitened residual is therefore estimated again, as a smooth curve, and multiplied in (prewhitening:
    D. W. K. Andrews and J. C. Monahan, Econometrica 60 (1992) 953-966), together with the variance of that curve.

    Examples
    --------
    >>> import truewrench as tw
    >>> rig = tw.Rig.read("rig.toml")
    >>> model = tw.planar(rig) + tw.effects.named("viscous_drag")
    >>> ends = tw.intervals(tw.fit(model, tw.read("train.csv", rig=rig)), level=0.99)
    >>> row = [p.name for p in model.parameters].index("m")
    >>> print(f"{ends.low[row]:.4f} to {ends.high[row]:.4f} kg")
    0.8997 to 0.9005 kg
    """
    residual, derivative = fit.problem.evaluate(fit.theta)
    sources = {NoiseSource.RESIDUAL, NoiseSource.RIG} if pull is None else {NoiseSource.RESIDUAL}
    pull = derivative @ fit.covariance if pull is None else pull
    parts = list(_variance_contributions(fit, residual, derivative, pull, sources))
    variance = np.sum([contribution.variance for contribution in parts], axis=0)
    safe = np.maximum(variance, 1e-300)
    log_variance = np.sum([contribution.log_variance(safe) for contribution in parts], axis=0)
    freedom = np.array([degrees_of_freedom_of(float(v)) for v in log_variance])
    return Intervals(fit, level, np.sqrt(variance), freedom)


def degrees_of_freedom_of(log_variance: float) -> float:
    """Degrees of freedom of a power whose logarithm has the variance `log_variance`, clipped to the limits above."""
    return (
        float(np.clip(2 * inverse_trigamma(log_variance), MIN_DEGREES_OF_FREEDOM, MAX_DEGREES_OF_FREEDOM))
        if log_variance > 0
        else MAX_DEGREES_OF_FREEDOM
    )


@dataclass(frozen=True, eq=False)
class VarianceContribution:
    """Contribution of one recording to the variance of every parameter.

    variance      (k,)
    log_variance  variance (k,) of log `total`, the variance (k,) over all recordings, due to this one's noise estimate
    """

    variance: Array
    log_variance: Callable[[Array], Array]


def _variance_contributions(
    fit: Solution, residual: Array, derivative: Array, pull: Array, coloured: Collection[NoiseSource]
) -> Iterator[VarianceContribution]:
    """Of each recording; the spectrum is estimated of runs whose noise is of a `coloured` source."""
    basis = orthonormal_basis(derivative)
    ends = np.cumsum([noise.whitener.rows for noise in fit.noise])[:-1]
    blocks = zip(*(np.split(rows, ends) for rows in (residual, basis, pull)), strict=True)
    for recording, noise, (own_residual, own_basis, own_pull) in zip(fit.recordings, fit.noise, blocks, strict=True):
        if noise.source in coloured and may_be_coloured(recording, noise):
            stated = noise.source is NoiseSource.RIG
            yield _spectral_contribution(len(recording.channels), own_residual, own_basis, own_pull, stated)
        else:
            yield _row_contribution(noise, own_pull**2)


def may_be_coloured(recording: Recording, noise: RecordingNoise) -> bool:
    """Whether whitened rows are a single run's, possibly still coloured, and enough of them for a spectrum.

    A std that the rig states says nothing of the noise's colour, nor of what the model lacks.
    """
    lines = noise.whitener.rows // len(recording.channels)
    return noise.source is not NoiseSource.REPEATS and not recording.at_rest and lines > 2 * MIN_ORDINATES


def _row_contribution(noise: RecordingNoise, squares: Array) -> VarianceContribution:
    """Whitened rows as they are: squared influences (rows, k); of repeats with the error of their weights."""
    variance = squares.sum(axis=0)
    variance = variance * noise.error_of_weights(squares / np.maximum(variance, 1e-300))
    return VarianceContribution(variance, lambda total: noise.log_power_variance_of(squares / total))


def _spectral_contribution(
    channels: int, residual: Array, basis: Array, pull: Array, stated: bool
) -> VarianceContribution:
    """One run in the cosine transform, each channel with the power spectrum of its residual.

    The fit absorbs the share h of a line's power, its leverage: the squares of a basis of the column space. With a
    `stated` std no line has less than white noise of that std; what is above is colour, or what the model lacks.
    """
    power, leverage, squared = (_cosine_lines(rows, channels) ** 2 for rows in (residual[:, None], basis, pull))
    share = 1 - leverage.sum(axis=2)
    ordinates = np.where(share > MIN_RESIDUAL_SHARE, power[:, :, 0] / np.maximum(share, MIN_RESIDUAL_SHARE), 0.0)
    least_power = np.where(power[:, :, 0].any(axis=0), LEAST_POWER if stated else 0.0, 1.0)  # of one that is left out
    ordinates = np.maximum(ordinates, least_power)
    # The mean is a line of its own, half a line below the first: its power is extrapolated from the spectrum.
    frequency = np.maximum(np.arange(len(power)), 0.5) / (2 * len(power))
    spectra = smooth_power_spectra(frequency[1:], ordinates[1:], shape=0.5, start=float(frequency[0]))
    least = 1.0 if stated else 0.0
    squares = [
        squared[:, c] * np.maximum(_line_power(spectrum, frequency, ordinates[:, c]), least)[:, None]
        for c, spectrum in enumerate(spectra)
    ]

    def log_variance(total: Array) -> Array:
        parts = zip(spectra, squares, strict=True)  # the channels are independent
        return np.asarray(sum(curve.mean_log_variance(curve.basis(frequency), line / total) for curve, line in parts))

    return VarianceContribution(np.sum([weighted.sum(axis=0) for weighted in squares], axis=0), log_variance)


def _cosine_lines(rows: Array, channels: int) -> Array:
    """Cosine transform (lines, channels, k) of the rows (lines channels, k) of a run."""
    return np.asarray(dct(rows.reshape(-1, channels, rows.shape[1]), axis=0, norm="ortho"))


def _line_power(spectrum: PowerSpectrum, frequency: Array, ordinates: Array) -> Array:
    """Power at the lines: the smooth spectrum, or the ordinate of a tone where that is larger."""
    level = spectrum(frequency)
    level[1:] = np.where(spectrum.tones, np.maximum(level[1:], ordinates[1:]), level[1:])
    return level


# Estimate of a single run, whose std these intervals give: ordinary least squares, each channel weighted by itself.


SMALLEST_SHARE = 1e-4
"""Of a residual's variance, that the upper half of its spectrum counts for at the least: rounded readings have none."""

SMALLEST_SIZE = 1e-12
"""N or N m, of a channel without a residual, so that it can be divided by."""


def ordinary_estimate(fitted: Solution, residuals: Sequence[Array]) -> Solution | None:
    """Parameters by least squares, in which white noise weighs each channel of a run, from a whitened solution.

    Each channel is weighted by the noise of the upper frequencies alone of its residual (n, p). None where no noise is
    taken from a residual.

    Whitening by the residual's own spectrum is efficient where the model is right, though little is gained with motions
    as smooth as a tool's. Where something is missing, the residual is large in the band of the motion, which the
    whitener then takes for noise: little of the tool's weight is left, and what is missing biases the rest, of a lag
    the mass ten times as much. Weights that depend on the channel alone keep it.
    """
    noise = tuple(_by_channel(n, residual) for n, residual in zip(fitted.noise, residuals, strict=True))
    if all(new is old for new, old in zip(noise, fitted.noise, strict=True)):
        return None
    problem = fitted.problem.in_noise(noise)
    minimum = problem.minimise(fitted.theta)
    return Solution(problem, minimum.theta, minimum.covariance, minimum.identifiable, minimum.converged)


def covariance_in_noise(fitted: Solution) -> Array:
    """Covariance (k, k) with the std that the residual's own spectrum gives."""
    std, stated = intervals(fitted).std, np.sqrt(np.maximum(np.diag(fitted.covariance), 1e-300))
    ratio = np.where(np.isfinite(stated) & (std > 0), std / stated, 1.0)
    return np.asarray(fitted.covariance * np.outer(ratio, ratio))


def _by_channel(noise: RecordingNoise, residual: Array) -> RecordingNoise:
    """The noise as white noise of each channel's own size, where it is an autoregression of the residual (n, p).

    Of poses at rest whose residual depends on the pose, that residual is the size: a channel in which something is
    missing weighs less then, and biases the rest less.
    """
    whitener = noise.whitener
    if noise.source is not NoiseSource.RESIDUAL or not isinstance(whitener, AutoregressiveWhitener):
        return noise
    if not whitener.noise.order and not noise.beside_pose:
        return noise
    means = block_means(residual, whitener.noise.block)
    size = np.sqrt((residual**2).mean(axis=0)) if noise.beside_pose else upper_noise(means)
    white = replace(NoiseModel.white(np.maximum(size, SMALLEST_SIZE)), block=whitener.noise.block)
    weights = None if noise.motion is None else noise.motion.steady_weights(noise.floor, white.block)
    plain = replace(whitener, noise=white, weights=weights)
    return replace(noise, whitener=plain, log_power_variance=np.full(plain.rows, noise.log_power_variance.mean()))


def upper_noise(residual: Array) -> Array:
    """Std (p,) of white noise as strong as the upper half of a residual's spectrum, where nothing moves."""
    power = (dct(residual, axis=0, norm="ortho")[len(residual) // 2 :] ** 2).mean(axis=0)
    return np.asarray(np.sqrt(np.maximum(power, SMALLEST_SHARE * (residual**2).mean(axis=0))))
