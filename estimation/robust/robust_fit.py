"""RobustFit: parameters that a few wild readings do not move, in coloured noise too."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimation.convention import decided
from estimation.fit import Estimate, Fit, Problem, check_channels, refit, require_weight, table
from estimation.interval import Intervals, intervals
from estimation.noise import Noise, NoiseSource
from estimation.recording import Recording
from estimation.robust.loss import Huber, Loss
from estimation.robust.outliers import Outliers, outliers_of
from estimation.robust.rereading import reread
from modeling.model import WrenchModel

Array = NDArray[np.float64]

MOST_ROUNDS = 40
NOISE_ROUNDS = 4
"""Rounds in which noise is estimated again: one finds wild readings, one its colour, two settle. Then it is held."""
STILL = 0.01
"""Move in standard deviations below which the unknowns have come to rest: their intervals do not show it."""


@dataclass(frozen=True, eq=False)
class RobustFit:
    """An M-estimate of a model's parameters, with what it took out of the recordings.

    fit        of the cleaned recordings (readings less `outliers.part`); its covariance is the M-estimate's
    plain      least squares of the recordings as they are
    outliers   per recording
    pull       (rows, k) what each whitened row of noise moves every unknown by
    converged  whether unknowns and outliers came to rest together
    """

    fit: Fit
    plain: Fit
    outliers: tuple[Outliers, ...]
    loss: Loss
    pull: Array
    converged: bool

    @property
    def parameters(self) -> Mapping[str, Estimate]:
        """Every unknown by name, with std and unit."""
        return self.fit.parameters

    @property
    def values(self) -> dict[str, float]:
        """The value of every unknown by name."""
        return self.fit.values

    def intervals(self, level: float = 0.95) -> Intervals:
        """Intervals of every unknown, with the degrees of freedom of the noise that was estimated."""
        return intervals(self.fit, level=level, pull=self.pull)

    def rows(self) -> list[tuple[str, ...]]:
        """Name, value, std, unit, and value and std of plain least squares, as text."""
        plain = [row[1:3] for row in self.plain.rows()]
        return [(*row, *other) for row, other in zip(self.fit.rows(), plain, strict=True)]

    def outlier_rows(self) -> list[tuple[str, ...]]:
        """The rows of every recording's outliers under its name."""
        names = [r.name for r in self.plain.recordings]
        return [(name, *row) for name, own in zip(names, self.outliers, strict=True) for row in own.rows()]

    def __str__(self) -> str:
        found = table(("parameter", "value", "std", "unit", "least squares", "std"), self.rows())
        head = ("recording", "channel", "scale", "taken", "if normal", "outliers", "largest (std)", "at (s, row)")
        text = f"{found}\n{self.loss}\n{table(head, self.outlier_rows())}"
        return text if self.converged else f"{text}\nnot converged after {MOST_ROUNDS} rounds: the values may move on"


def robust_fit(
    model: WrenchModel,
    recordings: Recording | Iterable[Recording],
    *,
    loss: Loss | None = None,
    start: Mapping[str, float] | None = None,
) -> RobustFit:
    """Estimate a model's parameters with a loss (default Huber(1.345)) in the place of squares.

    Outliers live in time; whitened rows are Fourier lines or innovations, in which one wild reading is everywhere or
    in many. So no rows are weighted. Instead the readings are cleaned by as much as the loss says (`Outliers`), least
    squares and their noise are computed from what is left, and both are repeated until they agree. The
    estimating equation is then X' W' W (e - o(e)) = 0, W the whitening of the cleaned noise: for white noise Huber's
    sum psi(e_t / s) x_t = 0 (his H-algorithm, "Robust regression", Ann. Statist. 1 (1973) 799-821).

    Covariance. With J = d(e - o)/de the linearised cleaning, theta's error moves the equation by H = X' W' W J X, and
    its noise has the covariance M = X' W' W X, as W whitens what is left: H^-1 M H^-T = pull' pull with the pull
    W X H^-T. For white noise J = diag(psi'), and this is the known s² E psi² / (E psi')² (X'X)^-1.

    Missing physics counts as noise only as far as it surprises its neighbours in time: what is smooth stays.
    Raises InputError as `fit` does.
    """
    several = (recordings,) if isinstance(recordings, Recording) else tuple(recordings)
    check_channels(model, several)
    plain = refit(decided(model, several), several, start=start)
    found = _settled(plain, loss or Huber())
    require_weight(found.fit)
    return found


def _settled(plain: Fit, loss: Loss) -> RobustFit:
    """Cleaning and least squares in turn, until the unknowns stand still."""
    fitted, moved = plain, np.inf
    outliers = _outliers(plain, plain, loss)
    for number in range(MOST_ROUNDS):
        cleaned = tuple(reread(r, r.wrench - o.part) for r, o in zip(plain.recordings, outliers, strict=True))
        noise = fitted.noise if number >= NOISE_ROUNDS else None
        before, fitted = fitted, refit(plain.model, cleaned, noise=noise, start=fitted.values)
        outliers = _outliers(plain, fitted, loss, outliers, noise is not None)
        std = np.sqrt(np.diag(fitted.covariance))
        moved = float(np.max(np.abs(fitted.theta - before.theta)[fitted.shown] / std[fitted.shown], initial=0.0))
        if moved < STILL:
            break
    pull = _pull(fitted, outliers)
    robust = replace(fitted, covariance=pull.T @ pull)
    return RobustFit(robust, plain, outliers, loss, pull, moved < STILL and fitted.converged)


def _outliers(
    plain: Fit, fitted: Fit, loss: Loss, before: Sequence[Outliers] | None = None, held: bool = False
) -> tuple[Outliers, ...]:
    """What every recording as it is holds beyond a fit and its noise, whose colour may be `held` from before."""
    found = []
    for number, (recording, noise) in enumerate(zip(plain.recordings, plain.noise, strict=True)):
        residual = recording.wrench - fitted.response(number).value
        earlier = None if before is None else before[number]
        known = noise.floor if noise.source is NoiseSource.RIG else None
        found.append(outliers_of(recording, residual, loss, before=earlier, held=held, known=known))
    return tuple(found)


def _pull(fitted: Fit, outliers: Sequence[Outliers]) -> Array:
    """D H^-T, as D C G^-T with C the least-squares covariance and G = C H, on columns of unit length."""
    derivative = Problem(fitted.layout, fitted.recordings, fitted.noise).evaluate(fitted.theta)[1]
    scale = np.linalg.norm(derivative, axis=0)
    scale[scale == 0] = 1.0
    unit, inverse = derivative / scale, fitted.covariance * np.outer(scale, scale)
    moved = np.concatenate([_moved(fitted, number, own) for number, own in enumerate(outliers)]) / scale
    loud = np.concatenate([_loudness(noise, own) for noise, own in zip(fitted.noise, outliers, strict=True)])
    return np.asarray(loud * unit @ (np.linalg.pinv(inverse @ unit.T @ moved) @ inverse).T / scale)


def _moved(fitted: Fit, number: int, own: Outliers) -> Array:
    """W J X of one recording: what reaches the cleaned, whitened rows (rows, k) of each unknown."""
    moved = fitted.noise[number].whitener.series(own.linearised(fitted.response(number).derivative))
    rows = np.zeros((len(moved), fitted.layout.size))
    rows[:, fitted.layout.index[number]] = moved
    return rows


def _loudness(noise: Noise, own: Outliers) -> Array:
    """Std (rows, 1) of whitened cleaned noise: 1 but for noise that the rig states, of which cleaning leaves less."""
    if noise.source is not NoiseSource.RIG:
        return np.ones((noise.whitener.rows, 1))
    left = np.sqrt((own.loss.psi(own.distance) ** 2).mean(axis=0))
    return np.tile(left, noise.whitener.rows // len(left))[:, None]
