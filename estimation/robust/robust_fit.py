"""Robust fit: M-estimate of a model's parameters in coloured noise, by cleaned readings."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimation.confidence_intervals import Intervals, intervals
from estimation.fit import Estimate, Fit, WhitenedProblem, check_channels, refit, require_positive_fitted_mass
from estimation.gravity.gravity_direction import with_gravity_direction
from estimation.initial_value_names import require_known_start
from estimation.least_squares.estimates import PARAMETER_COLUMNS
from estimation.noise.recording_noise import NoiseSource, RecordingNoise
from estimation.parameter_layout import parameter_layout
from estimation.recordings.recording import Recording, with_readings
from estimation.recordings.sign_convention import with_decided_convention
from estimation.robust.outliers import OUTLIER_COLUMNS, Outliers, separate_outliers
from estimation.robust.robust_loss import Huber, Loss
from modeling.chain.model import WrenchModel
from modeling.significance import LEVELS
from modeling.table import Table, Tabular

Array = NDArray[np.float64]

MAX_ROUNDS = 40
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
        return Table.of(OUTLIER_COLUMNS, [row for own in self.outliers for row in own.rows()])

    def printed(self) -> list[Table | str]:
        """Parameters, then outliers."""
        unfinished = f"not converged after {MAX_ROUNDS} rounds: the estimates are not final"
        return [self.table, str(self.loss), self.outlier_table, *([] if self.converged else [unfinished])]


def robust_fit(
    model: WrenchModel,
    recordings: Recording | Iterable[Recording],
    *,
    loss: Loss | None = None,
    start: Mapping[str, float] | None = None,
) -> RobustFit:
    """Estimate a model's parameters with a robust loss in place of squares.

    Parameters
    ----------
    model : WrenchModel
        The model, with its effects.
    recordings : Recording or iterable of Recording
        Recordings of one rig and tool.
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
    >>> found = tw.robust_fit(model, tw.read("train.csv", rig=rig))
    >>> found.converged, round(found.values["m"], 2), round(found.plain.values["m"], 2)
    (True, 0.9, 0.9)
    """
    several = (recordings,) if isinstance(recordings, Recording) else tuple(recordings)
    check_channels(model, several)
    case = with_gravity_direction(model, several)
    decided, several = with_decided_convention(case.model, case.recordings), case.recordings
    require_known_start(start or (), decided, parameter_layout(decided, several).parameters)
    plain = refit(decided, several, start=start)
    found = _iterated(plain, loss or Huber())
    require_positive_fitted_mass(found.fit)
    return found


def _iterated(plain: Fit, loss: Loss) -> RobustFit:
    """Cleaning and least squares in turn, until the parameters converge."""
    fitted, change = plain, np.inf
    outliers = _outliers(plain, plain, loss)
    for number in range(MAX_ROUNDS):
        cleaned = tuple(with_readings(r, r.wrench - o.part) for r, o in zip(plain.recordings, outliers, strict=True))
        noise = fitted.noise if number >= NOISE_REESTIMATION_ROUNDS else None
        before, fitted = fitted, refit(plain.model, cleaned, noise=noise, start=fitted.values)
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
    found = []
    for number, (recording, noise) in enumerate(zip(plain.recordings, plain.noise, strict=True)):
        residual = recording.wrench - fitted.predicted_readings(number)
        earlier = None if before is None else before[number]
        known = noise.floor if noise.source is NoiseSource.RIG else None
        found.append(separate_outliers(recording, residual, loss, before=earlier, held=held, known=known))
    return tuple(found)


def _influence(fitted: Fit, outliers: Sequence[Outliers]) -> Array:
    """D H^-T, as D C G^-T with C the least-squares covariance and G = C H, on columns of unit length."""
    derivative = WhitenedProblem(fitted.layout, fitted.recordings, fitted.noise).evaluate(fitted.theta)[1]
    scale = np.linalg.norm(derivative, axis=0)
    scale[scale == 0] = 1.0
    unit, inverse = derivative / scale, fitted.covariance * np.outer(scale, scale)
    cleaned = np.concatenate([_cleaned_sensitivity(fitted, number, own) for number, own in enumerate(outliers)]) / scale
    std = np.concatenate([_cleaned_noise_std(noise, own) for noise, own in zip(fitted.noise, outliers, strict=True)])
    return np.asarray(std * unit @ (np.linalg.pinv(inverse @ unit.T @ cleaned) @ inverse).T / scale)


def _cleaned_sensitivity(fitted: Fit, number: int, own: Outliers) -> Array:
    """W J X of one recording: sensitivity (rows, k) of its cleaned, whitened rows."""
    cleaned = fitted.noise[number].whitener.series(own.linearised(fitted.response(number).derivative))
    rows = np.zeros((len(cleaned), fitted.layout.size))
    rows[:, fitted.layout.index[number]] = cleaned
    return rows


def _cleaned_noise_std(noise: RecordingNoise, own: Outliers) -> Array:
    """Std (rows, 1) of whitened cleaned noise: 1, or less for noise that the rig states, which cleaning reduces."""
    if noise.source is not NoiseSource.RIG:
        return np.ones((noise.whitener.rows, 1))
    std = np.sqrt((own.loss.psi(own.distance) ** 2).mean(axis=0))
    return np.tile(std, noise.whitener.rows // len(std))[:, None]
