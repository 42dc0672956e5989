"""Bootstrap over repeats: what the scatter from repeat to repeat says of a fit's uncertainty, beside the analytic."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from enum import Enum
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray
from scipy.stats import f, norm, pearsonr, t

from estimation.fit import Fit, Problem, table
from estimation.interval import intervals
from estimation.recording import Recording
from estimation.robust.rereading import reread
from modeling.errors import InputError

Array = NDArray[np.float64]

DRAWS = 2000
"""Resamples: the std of their scatter errs by 1.6 %, far less than any number of repeats lets it be known."""
FEW = 5
"""Repeats below which the t quantile is above 2.7 and there are fewer than 130 different resamples."""
ALPHA = 0.01
"""Chance that the whole table calls out a difference when both stds are right."""
PARTS = 16
"""Tasks that refits are cut into for an executor: enough for its workers to end together."""


class Agreement(Enum):
    """How the bootstrap's std stands to the analytic one; the value says why, and which to believe."""

    AGREES = "agrees"
    DRIFTS = "larger, and moves steadily over the repeats: drift or warming; add it to the model, believe the bootstrap"
    SCATTERS = "larger: something differs from repeat to repeat that is no stationary noise; believe the bootstrap"
    SHARED = "smaller: neighbouring repeats share noise slower than a repeat, unseen between them; believe the analytic"
    NOT_SHOWN = "not shown by the recordings"


@dataclass(frozen=True, eq=False)
class Bootstrap:
    """Uncertainty of a fit from its repeats.

    pushes   per recording (R, k): what each repeat adds to the estimate's error, in the unknowns' units
    draws    (B, k) deviations of resampled estimates, widened by sqrt(R / (R - 1)) for the R that they were drawn from
    refits   whether the draws are full nonlinear refits; else one Gauss-Newton step, exact for linear unknowns
    level    of the intervals
    """

    fit: Fit
    pushes: tuple[Array, ...]
    draws: Array
    refits: bool
    level: float

    @cached_property
    def parts(self) -> Array:
        """Variance (recordings, k) that each recording's scatter gives: R/(R-1) sum_r (a_r - mean a)²."""
        return np.stack([len(a) * a.var(axis=0, ddof=1) for a in self.pushes])

    @property
    def std(self) -> Array:
        """Bootstrap std (k,): that of one step in closed form, without Monte Carlo; that of the draws of refits."""
        return np.asarray(self.draws.std(axis=0) if self.refits else np.sqrt(self.parts.sum(axis=0)))

    @cached_property
    def freedom(self) -> Array:
        """Degrees of freedom (k,) of that std: R - 1 of one recording, Satterthwaite's sum of several."""
        repeats = np.array([len(a) for a in self.pushes])[:, None]
        weights = np.maximum(self.parts, 1e-300)
        return np.asarray(weights.sum(axis=0) ** 2 / (weights**2 / (repeats - 1)).sum(axis=0))

    @property
    def relative_error(self) -> Array:
        """Standard error (k,) of std over std: 1/(2 f) for the few repeats, 1/(2 B) for the draws of refits."""
        return np.asarray(np.sqrt(1 / (2 * self.freedom) + (1 / (2 * len(self.draws)) if self.refits else 0.0)))

    @cached_property
    def per_repeat(self) -> Array:
        """The estimate (R, k) from each repeat alone, of a fit to one recording."""
        (pushes,) = self.pushes
        return np.asarray(self.fit.theta + len(pushes) * pushes)

    def t_interval(self) -> tuple[Array, Array]:
        """Lower and upper ends (k,): theta ± t std."""
        half = t.ppf(0.5 + self.level / 2, self.freedom) * self.std
        return self.fit.theta - half, self.fit.theta + half

    def percentile_interval(self) -> tuple[Array, Array]:
        """Lower and upper ends (k,): the draws' percentiles, taken further out for the few repeats.

        The levels Phi(±t), t Student's quantile, give normal estimates the t interval (T. C. Hesterberg, Am. Stat. 69
        (2015) 371-386, expanded percentiles). With R of 2 or 3 they are the outermost draws and mean nothing.
        """
        reach = np.asarray(norm.cdf(t.ppf(0.5 + self.level / 2, self.freedom)))
        columns = zip(self.draws.T, reach, strict=True)
        low, high = np.array([np.quantile(draws, [1 - edge, edge]) for draws, edge in columns]).T
        return self.fit.theta + low, self.fit.theta + high

    @cached_property
    def p_values(self) -> Array:
        """Two-sided p-values (k,) of equal variances, F with the freedom of both; 1 where nothing is shown."""
        analytic = intervals(self.fit)
        ratio = (self.std / np.maximum(analytic.std, 1e-300)) ** 2
        above = f.sf(ratio, self.freedom, analytic.freedom)
        return np.where(self.fit.shown, np.minimum(1.0, 2 * np.minimum(above, 1 - above)), 1.0)

    @cached_property
    def agreement(self) -> tuple[Agreement, ...]:
        """What is said of every unknown; differences by Holm's procedure at ALPHA together."""
        return tuple(map(self._judged, range(len(self.std)), _holm(self.p_values)))

    def _judged(self, number: int, p_value: float) -> Agreement:
        if not self.fit.shown[number]:
            return Agreement.NOT_SHOWN
        if p_value >= ALPHA:
            return Agreement.AGREES
        if self.std[number] ** 2 < self.fit.covariance[number, number]:
            return Agreement.SHARED
        return Agreement.DRIFTS if self._trend(number) < ALPHA else Agreement.SCATTERS

    def _trend(self, number: int) -> float:
        """Least p-value over recordings of a correlation between a repeat's push and its turn, times their number."""
        long = [a[:, number] for a in self.pushes if len(a) > 2]
        p_values = [float(pearsonr(np.arange(len(a)), a).pvalue) for a in long]
        return min(p_values, default=1.0) * max(len(long), 1)

    def rows(self) -> list[tuple[str, ...]]:
        """Name, value, analytic and bootstrap std with its own error, t and percentile interval, agreement, as text."""
        return [self._row(number) for number in range(len(self.std))]

    def _row(self, i: int) -> tuple[str, ...]:
        unknown, says = self.fit.unknowns[i], self.agreement[i]
        if says is Agreement.NOT_SHOWN:
            return (unknown.name, "-", "not shown", *["-"] * 4, unknown.unit, says.name.lower())
        analytic = float(np.sqrt(self.fit.covariance[i, i]))
        ends = [f"{low[i]:.6g} to {high[i]:.6g}" for low, high in (self.t_interval(), self.percentile_interval())]
        std = f"{self.std[i]:.2g} ± {self.std[i] * self.relative_error[i]:.1g}"
        numbers = f"{self.fit.theta[i]:.6g}", f"{analytic:.2g}", std, f"{self.freedom[i]:.3g}"
        return (unknown.name, *numbers, *ends, unknown.unit, says.name.lower())

    def remarks(self) -> list[str]:
        """Why stds differ, and what few repeats are worth."""
        said = [f"{a.name.lower()}: {a.value}" for a in Agreement if a in self.agreement and a is not Agreement.AGREES]
        fewest = min(map(len, self.pushes))
        if fewest < FEW:
            said.append(
                f"{fewest} repeats: a std from their scatter errs by {100 / np.sqrt(2 * (fewest - 1)):.0f} %, intervals"
                f" take {t.ppf(0.5 + self.level / 2, fewest - 1):.3g} of it, and percentiles of so few different"
                " resamples are worth nothing; believe the analytic std, the bootstrap only where it is far larger"
            )
        return said

    def __str__(self) -> str:
        ends = (f"t {100 * self.level:g} %", "percentile")
        head = ("parameter", "value", "analytic std", "bootstrap std", "freedom", *ends, "unit", "")
        return "\n".join([table(head, self.rows()), *self.remarks()])


def bootstrap(
    fit: Fit,
    *,
    draws: int = DRAWS,
    seed: int = 0,
    level: float = 0.95,
    refits: bool = False,
    executor: Executor | None = None,
) -> Bootstrap:
    """Resample the repeats of every recording, each within itself, and estimate again.

    One step (the default). At the minimum D'w = 0, with whitened residual w = W e and derivative D; W is linear, so
    that the equation is a sum over repeats, and repeat r, alone in e_r, adds a_r = C D' W e_r to the estimate, C the
    covariance. Repeats drawn m_r times give theta + sum_r (m_r - 1) a_r: for a linear model the whole refit with the
    same noise. R repeats drawn out of R scatter by (R - 1)/R too little in variance; deviations are widened by that.

    `refits` solves the nonlinear problem for each draw of whole residuals instead, with the same noise; `executor`
    takes these, in PARTS tasks. Raises InputError when a recording ran once: it has nothing to resample.
    """
    for recording in fit.recordings:
        _require_repeats(recording)
    pushes = _pushes(fit)
    if refits:
        return Bootstrap(fit, pushes, _refitted(fit, draws, seed, executor), True, level)
    rng = np.random.default_rng(seed)
    found = np.zeros((draws, len(fit.theta)))
    for a in pushes:
        times = rng.multinomial(len(a), np.full(len(a), 1 / len(a)), size=draws)
        found += np.sqrt(len(a) / (len(a) - 1)) * times @ (a - a.mean(axis=0))
    return Bootstrap(fit, pushes, found, False, level)


def _require_repeats(recording: Recording) -> None:
    if recording.repeats < 2:
        raise InputError(
            what="its motion ran once: there are no repeats to resample",
            where=recording.name,
            remedy="use intervals(fit), or record the motion at least 5 times with a `repeat` column",
        )


def _pushes(fit: Fit) -> tuple[Array, ...]:
    """C D' W e_r of every repeat, (R, k) for each recording."""
    derivative = Problem(fit.layout, fit.recordings, fit.noise).evaluate(fit.theta)[1]
    ends = np.cumsum([noise.whitener.rows for noise in fit.noise])[:-1]
    found = []
    columns = zip(fit.recordings, fit.noise, fit.residuals, np.split(derivative @ fit.covariance, ends), strict=True)
    for recording, noise, residual, pull in columns:
        alone = np.kron(np.eye(recording.repeats), np.ones((recording.samples_per_repeat, 1)))
        found.append(noise.whitener.series(residual[:, :, None] * alone[:, None, :]).T @ pull)
    return tuple(found)


def _refitted(fit: Fit, draws: int, seed: int, executor: Executor | None) -> Array:
    """Deviations (draws, k) of refits; every draw has a random stream of its own, whoever runs it."""
    streams = np.random.SeedSequence(seed).spawn(draws)
    chunks = [streams[i::PARTS] for i in range(min(PARTS, draws))]
    run: Callable[[Sequence[np.random.SeedSequence]], Array] = partial(_refits, fit)
    done: Iterable[Array] = map(run, chunks) if executor is None else executor.map(run, chunks)
    return np.concatenate(list(done))


def _refits(fit: Fit, streams: Sequence[np.random.SeedSequence]) -> Array:
    """theta* - theta (draws, k) of recordings whose residuals were drawn anew, repeat by repeat."""
    found = []
    for stream in streams:
        rng = np.random.default_rng(stream)
        several = tuple(_redrawn(fit, number, rng) for number in range(len(fit.recordings)))
        found.append(Problem(fit.layout, several, fit.noise).minimise(fit.theta).theta - fit.theta)
    return np.array(found)


def _redrawn(fit: Fit, number: int, rng: np.random.Generator) -> Recording:
    """Prediction plus residuals of drawn repeats, their deviations from the repeats' mean widened."""
    recording, repeats = fit.recordings[number], fit.recordings[number].repeats
    runs = fit.residuals[number].reshape(repeats, recording.samples_per_repeat, -1)
    mean, drawn = runs.mean(axis=0), rng.integers(repeats, size=repeats)
    wide = mean + np.sqrt(repeats / (repeats - 1)) * (runs[drawn] - mean)
    return reread(recording, recording.wrench - fit.residuals[number] + wide.reshape(recording.wrench.shape))


def _holm(p_values: Array) -> list[float]:
    """Holm-adjusted p-values."""
    order = np.argsort(p_values)
    raised = np.maximum.accumulate(p_values[order] * np.arange(len(order), 0, -1))
    adjusted = np.empty_like(raised)
    adjusted[order] = np.minimum(raised, 1.0)
    return [float(p) for p in adjusted]
