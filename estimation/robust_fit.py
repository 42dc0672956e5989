"""Robust fit: M-estimate of a model's parameters in coloured noise, by cleaned readings."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct, idct

from estimation.case import Case
from estimation.confidence_intervals import Intervals, intervals
from estimation.fit import Fit, Loads, recordings_of, require_positive_fitted_mass, unchecked_fit
from estimation.least_squares.estimates import PARAMETER_COLUMNS, Estimate
from estimation.multiplicity import normal_isf
from estimation.noise.power_spectrum import MIN_ORDINATES, power_levels, smooth_power_spectra
from estimation.noise.recording_noise import RecordingNoise, sample_step
from estimation.parameter_layout import parameter_layout, require_known_start
from estimation.recordings.recording import Recording
from estimation.robust_loss import Huber, Loss
from modeling.chain.model import WrenchModel, require_model
from modeling.significance import LEVELS
from modeling.table import Column, Table, Tabular, Value

Array = NDArray[np.float64]

MAX_ITERATIONS = 200
"""Of a fixed-point iteration: one for white noise, about 20 for first-order autoregressive noise with pole 0.98."""
OUTLIER_TOLERANCE = 1e-4
"""Change of an outlier's size, in robust std, below which the iteration has converged."""
STD_PER_MAD = float(1 / normal_isf(0.25))
"""Std of a normal variable over its median absolute value."""


@dataclass(frozen=True, eq=False)
class InverseCovarianceFilter:
    """Inverse covariance of each channel's noise as a filter, diagonal in the cosine transform.

    weights   (once, p) inverse power at the lines k / (2 N dt) of the even extension, which unlike the periodic one has
              no jump at the record's ends (leakage); zero at tones, which the neighbours predict exactly
    Channels are treated independently: correlation between channels is not used.
    """

    weights: Array

    @property
    def damping(self) -> Array:
        """Step length (p,) with which the fixed-point iteration contracts at every line."""
        return np.asarray(self.weights.mean(axis=0) / self.weights.max(axis=0))

    def prediction_error(self, series: Array) -> Array:
        """Error of the best prediction of every sample of (runs, once, p, ...) from all others.

        For noise of covariance C the best prediction of one sample from all others errs by (C^-1 e)_t / (C^-1)_tt.
        """
        weights = (self.weights / self.weights.mean(axis=0)).reshape(*self.weights.shape, *[1] * (series.ndim - 3))
        return np.asarray(idct(weights * dct(series, axis=1, norm="ortho"), axis=1, norm="ortho"))

    def whitened(self, series: Array) -> Array:
        """Series (runs, once, p) filtered to white noise of unit variance, without delay and without the tones."""
        return np.asarray(idct(np.sqrt(self.weights) * dct(series, axis=1, norm="ortho"), axis=1, norm="ortho"))


def inverse_covariance_filter(recording: Recording, residual: Array) -> InverseCovarianceFilter:
    """Inverse covariance of noise (runs, once, p) from smooth power spectra; white for static poses."""
    once = residual.shape[1]
    if recording.at_rest or once <= 2 * MIN_ORDINATES:
        return InverseCovarianceFilter(np.ones(residual.shape[1:]))
    frequency = np.arange(1, once) / (2 * once * sample_step(recording))
    power = (dct(residual, axis=1, norm="ortho") ** 2).mean(axis=0)[1:]
    # A cosine line has one degree of freedom where a Fourier line has two: half the shape.
    spectra = smooth_power_spectra(frequency, power, shape=len(residual) / 2)
    inverse = 1 / power_levels(spectra, frequency)
    tones = np.stack([spectrum.tones for spectrum in spectra], axis=1)
    weights = np.concatenate([inverse[:1], np.where(tones, 0.0, inverse)])
    return InverseCovarianceFilter(weights)


OUTLIER_COLUMNS = (
    Column("recording"),
    Column("channel"),
    Column("scale", format=".4g"),
    Column("downweighted", "%", format=".2g"),
    Column("if normal", "%", format=".2g"),
    Column("outliers", format="d"),
    Column("largest", "std", format=".3g"),
    Column("at", "s, row", format=".6g"),
)


@dataclass(frozen=True, eq=False)
class Outliers:
    """Separation of a recording's residual e (n, p) into noise and outliers by a robust loss.

    residual  (n, p) measured minus predicted, the readings as they are
    part      (n, p) outliers o, in the channels' units: least squares is applied to e - part
    distance  (n, p) u, prediction error of each sample from its neighbours, in units of `scale`
    scale     (p,) robust std of the prediction error

    Derivation. Let e = z + o, noise z of covariance C and outliers o, and let d = (C^-1 (e - o))_t / (C^-1)_tt be the
    error of predicting the cleaned sample from its cleaned neighbours. A sample as read is then u = (o + d) / s from
    its prediction, and the loss retains d = s psi(u) of that, o = s (u - psi(u)). For white noise u is e / s and the
    cleaned residual s psi(u): the pseudo-observations of Huber (1973). For coloured noise and Huber's psi the fixed
    point is the minimum of (e - o)' C^-1 (e - o) / 2 + k sum sqrt((C^-1)_tt) |o_t|, which is convex: the outliers are
    as few and small as shifts of single means can be (Y. She and A. B. Owen, J. Am. Stat. Assoc. 106 (2011) 626-639,
    have the equivalence for white noise). C's shape comes from `undisturbed`, s from the median of |o + d|.
    """

    recording: Recording
    loss: Loss
    precision: InverseCovarianceFilter
    residual: Array
    part: Array
    distance: Array
    scale: Array

    @property
    def limit(self) -> float:
        """Distance that Gaussian noise exceeds in a share `LEVELS.outlier` of channels of this length."""
        return float(normal_isf(LEVELS.outlier / 2 / len(self.distance)))

    @property
    def share(self) -> Array:
        """Mean of 1 - weight (p,): the share by which the loss has downweighted the readings."""
        return np.asarray(1 - self.loss.weight(self.distance).mean(axis=0))

    @property
    def found(self) -> NDArray[np.bool_]:
        """Which readings (n, p) are significant outliers."""
        return np.asarray(np.abs(self.distance) > self.limit)

    @property
    def undisturbed(self) -> Array:
        """Residual (n, p) with significant outliers replaced by the prediction from their neighbours.

        The noise spectrum is estimated from this and not from s psi(u), whose power is lower at the lines that weigh
        most in the outlier test: their weight would grow further, until the scale collapses.
        """
        predicted = self.residual - self.distance * self.scale
        return np.asarray(np.where(self.found, predicted, self.residual), dtype=np.float64)

    def times(self, channel: int) -> Array:
        """Times (s; order for static poses) of a channel's outliers, counted through all repeats."""
        return np.asarray(np.flatnonzero(self.found[:, channel]) * sample_step(self.recording))

    def linearised(self, derivative: Array) -> Array:
        """Derivative of the cleaned residual along changes (n, p, k) of the residual, at fixed scale.

        From o = s (u - psi(u)): do = (1 - psi') (do + dd), dd = prediction_error(de - do), by the same iteration.
        """
        moved = _by_runs(self.recording, derivative)
        clipped = 1 - _by_runs(self.recording, self.loss.slope(self.distance))[..., None]
        damping = self.precision.damping[:, None]
        size = np.maximum(np.abs(moved).max(axis=(0, 1), keepdims=True), 1e-300)
        outlying: Array = np.zeros_like(moved)
        for _ in range(MAX_ITERATIONS):
            step = clipped * (outlying + self.precision.prediction_error(moved - outlying)) - outlying
            outlying = outlying + damping * step
            if np.max(np.abs(step) / size, initial=0.0) < OUTLIER_TOLERANCE:
                break
        return np.asarray((moved - outlying).reshape(derivative.shape))

    def rows(self) -> list[tuple[Value, ...]]:
        """A row of `OUTLIER_COLUMNS` for each channel."""
        return [(self.recording.name, *self._row(c, channel)) for c, channel in enumerate(self.recording.channels)]

    def _row(self, number: int, channel: str) -> tuple[Value, ...]:
        size = np.abs(self.distance[:, number])
        shares = 100 * float(self.share[number]), 100 * self.loss.downweighted
        count, worst = int(self.found[:, number].sum()), int(size.argmax())
        where = worst * sample_step(self.recording)
        return (channel, float(self.scale[number]), *shares, count, float(size[worst]), where)


def separate_outliers(
    recording: Recording,
    residual: Array,
    loss: Loss,
    *,
    before: Outliers | None = None,
    held: bool = False,
    stated: Array | None = None,
) -> Outliers:
    """Separate a residual (n, p) into noise and outliers, starting at `before`, that of a similar residual.

    `held` keeps the noise spectrum of `before`. `stated` is the noise's std (p,) where the rig states it: white noise,
    nothing is estimated.
    """
    runs = _by_runs(recording, residual)
    if stated is not None:
        precision = InverseCovarianceFilter(np.ones(runs.shape[1:]))
    elif before is not None and held:
        precision = before.precision
    else:
        undisturbed = residual if before is None else residual - before.residual + before.undisturbed
        precision = inverse_covariance_filter(recording, _by_runs(recording, undisturbed))
    outlying = np.zeros_like(runs) if before is None else _by_runs(recording, before.part)
    rounds = MAX_ITERATIONS
    while True:
        distance = outlying + precision.prediction_error(runs - outlying)
        scale = stated if stated is not None else STD_PER_MAD * np.median(np.abs(distance), axis=(0, 1))
        scale = np.maximum(scale, 1e-12 * np.abs(residual).max(initial=1e-288))
        step = distance - scale * loss.psi(distance / scale) - outlying
        outlying, rounds = outlying + precision.damping * step, rounds - 1
        if not rounds or (np.abs(step) <= OUTLIER_TOLERANCE * scale).all():
            break
    outlying, distance = (series.reshape(residual.shape) for series in (outlying, distance / scale))
    return Outliers(recording, loss, precision, residual, outlying, distance, scale)


def _by_runs(recording: Recording, series: Array) -> Array:
    """A series (n, ...) as (runs, once, ...), split at pauses."""
    runs = 1 if recording.continuous else recording.repeats
    return series.reshape(runs, len(series) // runs, *series.shape[1:])


MAX_ROUNDS = 40
"""Of outliers and parameters in turn, at most; a fit that takes more says so."""
NOISE_REESTIMATION_ROUNDS = 4
"""Rounds with noise re-estimation: one for outliers, one for the spectrum, two to settle. Then it is fixed."""
PARAMETER_TOLERANCE = 0.01
"""Change of the parameters, in std, below which they have converged: negligible in their intervals."""


@dataclass(frozen=True, eq=False)
class RobustFit(Tabular):
    """An M-estimate of a model's parameters, with the outliers of the recordings.

    fit        of the cleaned recordings (readings less `outliers.part`); its covariance is the M-estimate's
    plain      least squares of the recordings as they are
    outliers   per recording
    pull       (rows, k) influence of each whitened row's noise on every parameter
    converged  whether parameters and outliers converged
    """

    fit: Fit
    plain: Fit
    outliers: tuple[Outliers, ...]
    loss: Loss
    pull: Array
    converged: bool

    @property
    def parameters(self) -> Mapping[str, Estimate]:
        """Every parameter by name, with std and unit."""
        return self.fit.parameters

    @property
    def values(self) -> dict[str, float]:
        """The value of every parameter by name."""
        return self.fit.values

    def intervals(self, level: float = LEVELS.confidence) -> Intervals:
        """Confidence intervals of every parameter, with the effective degrees of freedom of the estimated noise."""
        return intervals(self.fit, level=level, pull=self.pull)

    @property
    def table(self) -> Table:
        """Name, value, std, unit, and value and std of ordinary least squares."""
        _, value, std, _ = PARAMETER_COLUMNS
        plain = (replace(value, name="least squares"), replace(std, name="its std"))
        rows = zip(self.fit.table.rows, self.plain.table.rows, strict=True)
        return Table.of((*PARAMETER_COLUMNS, *plain), [(*row, *other[1:3]) for row, other in rows])

    @property
    def outlier_table(self) -> Table:
        """Share downweighted, and the significant outliers, of each channel of each recording."""
        return Table.of(OUTLIER_COLUMNS, [row for outliers in self.outliers for row in outliers.rows()])

    def printed(self) -> list[Table | str]:
        """Parameters, then outliers."""
        unfinished = f"not converged after {MAX_ROUNDS} rounds: the estimates are not final"
        return [self.table, str(self.loss), self.outlier_table, *([] if self.converged else [unfinished])]


def robust_fit(
    model: WrenchModel,
    recordings: Recording | Iterable[Recording] | Mapping[str, Recording],
    *,
    loads: Loads | None = None,
    loss: Loss | None = None,
    start: Mapping[str, float] | None = None,
) -> RobustFit:
    """Estimate a model's parameters with a robust loss in place of squares.

    Parameters
    ----------
    model : WrenchModel
        The model, with its effects.
    recordings : Recording, iterable of Recording, or mapping of str to Recording
        Recordings of one rig and sensor, perhaps by name.
    loads : mapping of str to Load or str, or to several, optional
        What the sensor carried beside the tool in a recording, by its name, as for `fit`; by default nothing.
    loss : Loss, optional
        `Huber` or `StudentT`; by default Huber(1.345).
    start : mapping of str to float, optional
        Initial values of parameters by name, in their units; by default the parameters' own.

    Returns
    -------
    RobustFit
        The M-estimate, the least-squares fit beside it, and the outliers of each recording.

    Raises
    ------
    InputError
        As `fit` does.

    Notes
    -----
    Outliers are local in time; whitened rows are Fourier lines or innovations, over which one outlier is spread. So
    rows are not weighted. Instead the readings are cleaned by the amount that the loss gives (`Outliers`), least
    squares and noise re-estimation use the cleaned readings, and both are iterated to convergence. The estimating
    equation is then X' W' W (e - o(e)) = 0, W the whitening of the cleaned noise: for white noise Huber's sum psi(e_t /
    s) x_t = 0 (his H-algorithm, "Robust regression", Ann. Statist. 1 (1973) 799-821).

    Covariance. With J = d(e - o)/de the linearised cleaning, the estimating equation has the derivative H = X' W' W J X
    in theta and noise of covariance M = X' W' W X, as W whitens the cleaned noise: H^-1 M H^-T = pull' pull with the
    influence pull = W X H^-T. For white noise J = diag(psi'), and this is the known s² E psi² / (E psi')² (X'X)^-1.

    Unmodelled effects are downweighted only where neighbouring samples do not predict them: a smooth residual stays.

    Examples
    --------
    >>> import truewrench as tw
    >>> rig = tw.Rig.read("rig.toml")
    >>> model = tw.planar(rig) + tw.effects.named("viscous_drag")
    >>> robust = tw.robust_fit(model, tw.read("train.csv", rig=rig))
    >>> robust.converged, round(robust.values["m"], 2), round(robust.plain.values["m"], 2)
    (True, 0.9, 0.9)
    """
    require_model(model, "robust_fit")
    return robust_fit_case(Case.of(model, recordings_of(recordings, "robust_fit", loads)), loss=loss, start=start)


def robust_fit_case(case: Case, *, loss: Loss | None = None, start: Mapping[str, float] | None = None) -> RobustFit:
    """`robust_fit` of a case."""
    require_known_start(start or (), case.model, parameter_layout(case.model, case.recordings).parameters)
    robust = _iterated(unchecked_fit(case, start=start), loss or Huber())
    if case.is_of_tool:
        require_positive_fitted_mass(robust.fit)
    return robust


def _iterated(plain: Fit, loss: Loss) -> RobustFit:
    """Cleaning and least squares in turn, until the parameters converge."""
    fitted, change = plain, np.inf
    outliers = _outliers(plain, plain, loss)
    for number in range(MAX_ROUNDS):
        cleaned = tuple(r.with_readings(r.wrench - o.part) for r, o in zip(plain.recordings, outliers, strict=True))
        noise = fitted.noise if number >= NOISE_REESTIMATION_ROUNDS else None
        before, fitted = fitted, unchecked_fit(Case(plain.model, cleaned), noise=noise, start=fitted.values)
        outliers = _outliers(plain, fitted, loss, outliers, noise is not None)
        std = np.sqrt(np.diag(fitted.covariance))
        change = float(
            np.max(np.abs(fitted.theta - before.theta)[fitted.identifiable] / std[fitted.identifiable], initial=0.0)
        )
        if change < PARAMETER_TOLERANCE:
            break
    pull = _influence(fitted, outliers)
    robust = replace(fitted, covariance=pull.T @ pull)
    return RobustFit(robust, plain, outliers, loss, pull, change < PARAMETER_TOLERANCE and fitted.converged)


def _outliers(
    plain: Fit, fitted: Fit, loss: Loss, before: Sequence[Outliers] | None = None, held: bool = False
) -> tuple[Outliers, ...]:
    """Outliers of every recording about a fit, the noise spectrum `held` from `before` where asked."""
    outliers = []
    for number, (recording, noise) in enumerate(zip(plain.recordings, plain.noise, strict=True)):
        residual = recording.wrench - fitted.predicted_readings(number)
        earlier = None if before is None else before[number]
        stated = noise.floor if noise.source.is_of_samples else None
        outliers.append(separate_outliers(recording, residual, loss, before=earlier, held=held, stated=stated))
    return tuple(outliers)


def _influence(fitted: Fit, outliers: Sequence[Outliers]) -> Array:
    """D H^-T, as D C G^-T with C the least-squares covariance and G = C H, on columns of unit length."""
    derivative = fitted.problem.evaluate(fitted.theta)[1]
    scale = np.linalg.norm(derivative, axis=0)
    scale[scale == 0] = 1.0
    unit, inverse = derivative / scale, fitted.covariance * np.outer(scale, scale)
    cleaned = np.concatenate([_cleaned_sensitivity(fitted, number, o) for number, o in enumerate(outliers)]) / scale
    std = np.concatenate([_cleaned_noise_std(noise, o) for noise, o in zip(fitted.noise, outliers, strict=True)])
    return np.asarray(std * unit @ (np.linalg.pinv(inverse @ unit.T @ cleaned) @ inverse).T / scale)


def _cleaned_sensitivity(fitted: Fit, number: int, outliers: Outliers) -> Array:
    """W J X of one recording: sensitivity (rows, k) of its cleaned, whitened rows."""
    cleaned = fitted.noise[number].whitener.series(outliers.linearised(fitted.response(number).derivative))
    rows = np.zeros((len(cleaned), fitted.layout.size))
    rows[:, fitted.layout.index[number]] = cleaned
    return rows


def _cleaned_noise_std(noise: RecordingNoise, outliers: Outliers) -> Array:
    """Std (rows, 1) of whitened cleaned noise: 1, or less for noise that the rig states, which cleaning reduces."""
    if not noise.source.is_of_samples:
        return np.ones((noise.whitener.rows, 1))
    std = np.sqrt((outliers.loss.psi(outliers.distance) ** 2).mean(axis=0))
    return np.tile(std, noise.whitener.rows // len(std))[:, None]
