"""Parameters before and after: the estimates of two fits, with interval, change and correlation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from diagnosis.comparison.compared_step import systematic_error
from diagnosis.diagnosis import Diagnosis
from diagnosis.verdict_rule import RecordVerdict
from estimation.fit import Fit
from estimation.least_squares.estimates import HELD, Estimate, correlation_matrix
from modeling.noise import NoiseSource
from modeling.number_format import NO_VALUE, format_number, format_unit, format_with_std
from modeling.table import Column, Table
from truewrench.plots.style import ADEQUATE_COLOUR, MISFIT_COLOUR
from truewrench.plots.time_series_plot import MIN_SIGNAL_TO_NOISE, LabelledComparison
from truewrench.text.diagnosis_text import base_name
from truewrench.text.tool_text import NOT_KNOWN

# Rigid tool and final model, compared on one recording.


def compared_models(diagnosis: Diagnosis, number: int, *, held_out: bool = False) -> list[LabelledComparison]:
    """The rigid tool and, if effects were added, the final model, on one recording."""
    steps = [diagnosis.steps[0], diagnosis.steps[-1]][: len(diagnosis.added) + 1]
    comparisons = [(s.validation if held_out else s.training)[number] for s in steps]
    adequate = diagnosis.verdict is not RecordVerdict.UNEXPLAINED
    nothing_missing = diagnosis.verdict is RecordVerdict.NOTHING_MISSING
    colours = [ADEQUATE_COLOUR if nothing_missing else MISFIT_COLOUR, ADEQUATE_COLOUR if adequate else MISFIT_COLOUR]
    labels = [base_name(diagnosis), "with " + " + ".join(diagnosis.added)]
    return [LabelledComparison(*parts) for parts in zip(labels, colours, comparisons, strict=False)]


def worst_recording(diagnosis: Diagnosis) -> int:
    """The training recording with the largest error-to-noise ratio of a channel with the rigid tool."""
    first = diagnosis.steps[0].training
    ratios = [max(systematic_error(c)[k] / max(c.noise_floor[k], 1e-300) for k in c.noise_floor) for c in first]
    if max(ratios) < MIN_SIGNAL_TO_NOISE and all(c.noise.source is NoiseSource.RESIDUAL for c in first):
        # The noise was estimated from the residual itself, so that the ratio carries no information.
        return int(np.argmin([c.lack_of_fit for c in first]))
    return int(np.argmax(ratios))


MOST_CORRELATED = 14
"""Parameters in the matrix of correlations: those most correlated with another one."""
NOTABLE = 0.5
"""A correlation from which a table names the other parameter."""


@dataclass(frozen=True, eq=False)
class ParameterChanges:
    """Estimates of a fit, with those of an earlier model, None without; `known`: whether the readings show the tool."""

    before: Fit | None
    after: Fit
    known: bool = True

    @property
    def table(self) -> Table:
        """Value ± std in each model, 95 % interval, and the parameter that each is most correlated with.

        Where the tool is not known, no parameter has a std or an interval.
        """
        intervals = self.after.intervals()
        ends = dict(zip(self.after.parameters, zip(intervals.low, intervals.high, strict=True), strict=True))
        earlier = {} if self.before is None else self.before.parameters
        partners = self.partners
        rows = []
        for name in dict.fromkeys((*self.after.parameters, *earlier)):
            first, last = earlier.get(name), self.after.parameters.get(name)
            unit = format_unit(next(e.unit for e in (last, first) if e is not None))
            measured = self.known and last is not None and name not in self.after.held
            interval = _interval(*ends[name]) if measured else NO_VALUE if self.known else NOT_KNOWN
            cells = [self._text(last, self.after), interval, partners.get(name, "")]
            if self.before is not None:
                cells = [self._text(first, self.before), cells[0], _change(first, last), *cells[1:]]
            rows.append((name, unit, *cells))
        shown = ("estimate",) if self.before is None else ("before", "after", "change / std")
        level = f"{intervals.level:.0%} interval".replace("%", " %")
        return Table.of((Column("parameter"), Column("unit"), *shown, level, "most correlated with"), rows)

    @property
    def partners(self) -> Mapping[str, str]:
        """The parameter that each one is most correlated with, where that is notable."""
        names, correlation = self._correlation()
        partners = {}
        for row, name in enumerate(names):
            other = int(np.argmax(np.abs(correlation[row])))
            if abs(correlation[row, other]) >= NOTABLE:
                partners[name] = f"{names[other]} ({_signed(correlation[row, other])})"
        return partners

    @property
    def correlation_table(self) -> Table:
        """Correlation coefficients of the estimates of the later fit, the most correlated ones alone where many."""
        names, correlation = self._correlation()
        largest = np.abs(correlation).max(axis=0, initial=0.0)
        chosen = np.sort(np.argsort(-largest, kind="stable")[:MOST_CORRELATED])
        columns = (Column("parameter"), *(Column(names[i]) for i in chosen))
        rows = [(names[i], *("1" if i == j else _signed(correlation[i, j]) for j in chosen)) for i in chosen]
        return Table.of(columns, rows)

    def _text(self, estimate: Estimate | None, fit: Fit) -> str:
        if estimate is None:
            return NO_VALUE
        return _text(estimate, fit) if self.known else format_number(estimate.value, 2)

    def _correlation(self) -> tuple[list[str], NDArray[np.float64]]:
        """Names and coefficients of the parameters that are estimated; the diagonal is zero."""
        every = correlation_matrix(self.after.covariance, self.after.identifiable)
        estimated = np.flatnonzero(np.isfinite(np.diag(every)))
        names = [list(self.after.parameters)[place] for place in estimated]
        matrix = np.nan_to_num(every[np.ix_(estimated, estimated)])
        np.fill_diagonal(matrix, 0.0)
        return names, matrix


def _text(estimate: Estimate, fit: Fit) -> str:
    if estimate.std > 0 and estimate.name in fit.held:
        return f"{format_number(estimate.value, 4)} ({HELD})"
    return format_with_std(estimate.value, estimate.shown_std) + (" (fixed)" if estimate.std == 0 else "")


def _interval(low: float, high: float) -> str:
    if not isfinite(low) or low == high:
        return NO_VALUE
    digits = max(3, int(np.ceil(np.log10(max(abs(low), abs(high)) / (high - low)))) + 2)
    return f"{format_number(low, digits)} to {format_number(high, digits)}"


def _change(first: Estimate | None, last: Estimate | None) -> str:
    """In stds of the earlier model."""
    if first is None or last is None or not isfinite(first.std) or first.std == 0:
        return NO_VALUE
    return f"{(last.value - first.value) / first.std:+.1f}".replace("-", "−")


def _signed(value: float) -> str:
    return f"{value:.2f}".replace("-", "−")
