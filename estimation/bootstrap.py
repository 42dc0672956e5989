"""Bootstrap over repeats: a fit's covariance from the scatter between repeats, compared with the analytic one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray
from scipy.stats import f, norm, pearsonr, t

from estimation.confidence_intervals import intervals
from estimation.fit import Fit
from estimation.least_squares.estimates import PARAMETER_COLUMNS
from estimation.multiplicity import bonferroni_p_value, holm_adjusted
from estimation.recordings.recording import Recording
from modeling.errors import InputError
from modeling.significance import LEVELS
from modeling.table import Column, Table, Tabular, Value

Array = NDArray[np.float64]

RESAMPLES = 2000
"""Resamples: their std has a relative error of 1.6 %, far below that from the finite number of repeats."""
FEW_REPEATS = 5
"""Repeats below which the t quantile is above 2.7 and there are fewer than 130 different resamples."""
EXECUTOR_TASKS = 16
"""Tasks that refits are split into for an executor: enough to balance its workers."""


class Agreement(Enum):
    """Comparison of the bootstrap's std with the analytic one; the value says why they differ, and which to use."""

    AGREES = "agrees"
    DRIFTS = "larger, with a trend over the repeats: drift or warm-up; add it to the model, use the bootstrap std"
    SCATTERS = "larger: the repeats differ by more than stationary noise; use the bootstrap std"
    SHARED = "smaller: neighbouring repeats share noise slower than a repeat; use the analytic std"
    NOT_IDENTIFIABLE = "not identifiable from the recordings"


@dataclass(frozen=True, eq=False)
class Bootstrap(Tabular):
    """Uncertainty of a fit from its repeats.

    pushes      per recording (R, k): influence of each repeat on the estimate, in the unknowns' units
    draws       (B, k) deviations of resampled estimates, scaled by sqrt(R / (R - 1)) for resampling of R repeats
    refits      whether the draws are full nonlinear refits; else one Gauss-Newton step, exact for linear unknowns
    level       of the intervals
    """

    fit: Fit
    pushes: tuple[Array, ...]
    draws: Array
    refits: bool
    level: float

    @cached_property
    def parts(self) -> Array:
        """Variance (recordings, k) from each recording's scatter: R/(R-1) sum_r (a_r - mean a)²."""
        return np.stack([len(a) * a.var(axis=0, ddof=1) for a in self.pushes])

    @property
    def std(self) -> Array:
        """Bootstrap std (k,): of one Gauss-Newton step in closed form; of refits from the draws."""
        return np.asarray(self.draws.std(axis=0) if self.refits else np.sqrt(self.parts.sum(axis=0)))

    @cached_property
    def freedom(self) -> Array:
        """Degrees of freedom (k,) of that std: R - 1 for one recording, Satterthwaite's formula for several."""
        repeats = np.array([len(a) for a in self.pushes])[:, None]
        weights = np.maximum(self.parts, 1e-300)
        return np.asarray(weights.sum(axis=0) ** 2 / (weights**2 / (repeats - 1)).sum(axis=0))

    @property
    def relative_error(self) -> Array:
        """Relative standard error (k,) of std: variance 1/(2 f) for f degrees of freedom, and 1/(2 B) for B refits."""
        return np.asarray(np.sqrt(1 / (2 * self.freedom) + (1 / (2 * len(self.draws)) if self.refits else 0.0)))

    def t_interval(self) -> tuple[Array, Array]:
        """Lower and upper ends (k,): theta ± t std."""
        half = t.ppf(0.5 + self.level / 2, self.freedom) * self.std
        return self.fit.theta - half, self.fit.theta + half

    def percentile_interval(self) -> tuple[Array, Array]:
        """Lower and upper ends (k,): the draws' percentiles, expanded for the few repeats.

        The levels Phi(±t), t Student's quantile, give normal estimates the t interval (T. C. Hesterberg, Am. Stat. 69
        (2015) 371-386, expanded percentiles). For R of 2 or 3 they are the extreme draws and carry no information.
        """
        probability = np.asarray(norm.cdf(t.ppf(0.5 + self.level / 2, self.freedom)))
        columns = zip(self.draws.T, probability, strict=True)
        low, high = np.array([np.quantile(draws, [1 - edge, edge]) for draws, edge in columns]).T
        return self.fit.theta + low, self.fit.theta + high

    @cached_property
    def p_values(self) -> Array:
        """Two-sided p-values (k,) of equal variances, F with the degrees of freedom of both; 1 if not identifiable."""
        analytic = intervals(self.fit)
        ratio = (self.std / np.maximum(analytic.std, 1e-300)) ** 2
        above = f.sf(ratio, self.freedom, analytic.freedom)
        return np.where(self.fit.identifiable, np.minimum(1.0, 2 * np.minimum(above, 1 - above)), 1.0)

    @cached_property
    def agreement(self) -> tuple[Agreement, ...]:
        """Agreement of every unknown; differences by Holm's procedure at `LEVELS.agreement`."""
        return tuple(map(self._classified, range(len(self.std)), holm_adjusted(list(self.p_values))))

    def _classified(self, number: int, p_value: float) -> Agreement:
        if not self.fit.identifiable[number]:
            return Agreement.NOT_IDENTIFIABLE
        if p_value >= LEVELS.agreement:
            return Agreement.AGREES
        if self.std[number] ** 2 < self.fit.covariance[number, number]:
            return Agreement.SHARED
        return Agreement.DRIFTS if self._trend(number) < LEVELS.agreement else Agreement.SCATTERS

    def _trend(self, number: int) -> float:
        """Bonferroni-corrected p-value over recordings of a correlation between influence and repeat number."""
        testable = [a[:, number] for a in self.pushes if len(a) > 2]
        p_values = [float(pearsonr(np.arange(len(a)), a).pvalue) for a in testable]
        return bonferroni_p_value(p_values)

    @property
    def table(self) -> Table:
        """Name, value, analytic and bootstrap std with its own error, t and percentile interval, agreement."""
        name, value, std, unit = PARAMETER_COLUMNS
        texts = (f"t {100 * self.level:g} %", "percentile", unit, "agreement")
        columns = (name, value, replace(std, name="analytic std"), "bootstrap std", Column("freedom", format=".3g"))
        return Table.of((*columns, *texts), [self._row(number) for number in range(len(self.std))])

    def _row(self, i: int) -> tuple[Value, ...]:
        unknown, agreement = self.fit.unknowns[i], self.agreement[i]
        if agreement is Agreement.NOT_IDENTIFIABLE:
            return (unknown.name, *[None] * 6, unknown.unit, agreement.name.lower())
        ends = [f"{low[i]:.6g} to {high[i]:.6g}" for low, high in (self.t_interval(), self.percentile_interval())]
        std = f"{self.std[i]:.2g} ± {self.std[i] * self.relative_error[i]:.1g}"
        analytic, freedom = float(np.sqrt(self.fit.covariance[i, i])), float(self.freedom[i])
        return (
            unknown.name,
            float(self.fit.theta[i]),
            analytic,
            std,
            freedom,
            *ends,
            unknown.unit,
            agreement.name.lower(),
        )

    def remarks(self) -> list[str]:
        """Why stds differ, and how uncertain a bootstrap from few repeats is."""
        remarks = [
            f"{a.name.lower()}: {a.value}" for a in Agreement if a in self.agreement and a is not Agreement.AGREES
        ]
        fewest = min(map(len, self.pushes))
        if fewest < FEW_REPEATS:
            remarks.append(
                f"{fewest} repeats: a std from their scatter errs by {100 / np.sqrt(2 * (fewest - 1)):.0f} %, the t"
                f" quantile is {t.ppf(0.5 + self.level / 2, fewest - 1):.3g}, and percentiles of so few different"
                " resamples carry no information; use the analytic std unless the bootstrap's is far larger"
            )
        return remarks


def bootstrap(
    fit: Fit,
    *,
    draws: int = RESAMPLES,
    seed: int = 0,
    level: float = LEVELS.confidence,
    refits: bool = False,
    executor: Executor | None = None,
) -> Bootstrap:
    """Resample the repeats of every recording, each within itself, and estimate again.

    Parameters
    ----------
    fit : Fit
        A fit to recordings with repeats.
    draws : int, optional
        Number B of resamples, by default 2000.
    seed : int, optional
        Seed of the random resamples, by default 0.
    level : float, optional
        Two-sided confidence level of the intervals, by default 0.95.
    refits : bool, optional
        Whether each draw is a full nonlinear refit; by default one Gauss-Newton step.
    executor : Executor, optional
        Runs the refits in `EXECUTOR_TASKS` tasks; by default this process does.

    Returns
    -------
    Bootstrap
        Std, t and percentile intervals (k,) in the parameters' units, and whether they agree with the analytic ones.

    Raises
    ------
    InputError
        When a recording ran once: it has nothing to resample.

    Notes
    -----
    One step (the default). At the minimum D'w = 0, with whitened residual w = W e and derivative D; W is linear, so
    that the equation is a sum over repeats, and repeat r, alone in e_r, adds a_r = C D' W e_r to the estimate, C the
    covariance. Repeats drawn m_r times give theta + sum_r (m_r - 1) a_r: for a linear model the whole refit with the
    same noise. Resampling R of R repeats gives (R - 1)/R of the variance; deviations are scaled up accordingly.

    `refits` solves the nonlinear problem for each draw of whole residuals instead, with the same noise.

    Examples
    --------
    >>> import truewrench as tw
    >>> rig = tw.Rig.read("rig.toml")
    >>> fit = tw.fit(tw.planar(rig) + tw.effects.named("viscous_drag"), tw.read("train.csv", rig=rig))
    >>> bootstrap = tw.bootstrap(fit, draws=500)
    >>> bootstrap.draws.shape, bootstrap.freedom.round(6).tolist()[0]
    ((500, 8), 7.0)
    >>> {agreement.name for agreement in bootstrap.agreement}
    {'AGREES'}
    """
    for recording in fit.recordings:
        _require_repeats(recording)
    influences = _repeat_influences(fit)
    if refits:
        return Bootstrap(fit, influences, _refitted(fit, draws, seed, executor), True, level)
    rng = np.random.default_rng(seed)
    deviations = np.zeros((draws, len(fit.theta)))
    for a in influences:
        times = rng.multinomial(len(a), np.full(len(a), 1 / len(a)), size=draws)
        deviations += np.sqrt(len(a) / (len(a) - 1)) * times @ (a - a.mean(axis=0))
    return Bootstrap(fit, influences, deviations, False, level)


def _require_repeats(recording: Recording) -> None:
    if recording.repeats < 2:
        raise InputError(
            what="its motion ran once: there are no repeats to resample",
            where=recording.name,
            remedy="use intervals(fit), or record the motion at least 5 times with a `repeat` column",
        )


def _repeat_influences(fit: Fit) -> tuple[Array, ...]:
    """C D' W e_r of every repeat, (R, k) for each recording."""
    derivative = fit.problem.evaluate(fit.theta)[1]
    ends = np.cumsum([noise.whitener.rows for noise in fit.noise])[:-1]
    influences = []
    per_recording = zip(
        fit.recordings,
        fit.noise,
        fit.residuals,
        np.split(derivative @ (fit.ordinary or fit).covariance, ends),
        strict=True,
    )
    for recording, noise, residual, gain in per_recording:
        selection = np.kron(np.eye(recording.repeats), np.ones((recording.samples_per_repeat, 1)))
        influences.append(noise.whitener.series(residual[:, :, None] * selection[:, None, :]).T @ gain)
    return tuple(influences)


def _refitted(fit: Fit, draws: int, seed: int, executor: Executor | None) -> Array:
    """Deviations (draws, k) of refits; every draw has a random stream of its own, independent of the executor."""
    streams = np.random.SeedSequence(seed).spawn(draws)
    chunks = [streams[i::EXECUTOR_TASKS] for i in range(min(EXECUTOR_TASKS, draws))]
    run: Callable[[Sequence[np.random.SeedSequence]], Array] = partial(_refit_resamples, fit)
    done: Iterable[Array] = map(run, chunks) if executor is None else executor.map(run, chunks)
    return np.concatenate(list(done))


def _refit_resamples(fit: Fit, streams: Sequence[np.random.SeedSequence]) -> Array:
    """theta* - theta (draws, k) of recordings with resampled residuals, repeat by repeat."""
    deviations = []
    for stream in streams:
        rng = np.random.default_rng(stream)
        several = tuple(_resampled(fit, number, rng) for number in range(len(fit.recordings)))
        deviations.append(fit.problem.of_recordings(several).minimise(fit.theta).theta - fit.theta)
    return np.array(deviations)


def _resampled(fit: Fit, number: int, rng: np.random.Generator) -> Recording:
    """Prediction plus residuals of resampled repeats, their deviations from the repeats' mean scaled up."""
    recording, repeats = fit.recordings[number], fit.recordings[number].repeats
    runs = fit.residuals[number].reshape(repeats, recording.samples_per_repeat, -1)
    mean, drawn = runs.mean(axis=0), rng.integers(repeats, size=repeats)
    wide = mean + np.sqrt(repeats / (repeats - 1)) * (runs[drawn] - mean)
    return recording.with_readings(recording.wrench - fit.residuals[number] + wide.reshape(recording.wrench.shape))
