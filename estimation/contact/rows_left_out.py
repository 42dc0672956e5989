"""Rows of a log outside the repeats that were cut: which, and where they deviate from what a fit predicts of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from estimation.contact.contact_wrench import ContactMean, compensate
from estimation.fit import Fit
from estimation.multiplicity import bonferroni_p_value, chi2_sf
from estimation.recordings.recording import Recording, WholeLog
from modeling.significance import LEVELS

FEWEST_ROWS = 20
"""Of a part that is tested: fewer do not determine a motion and its acceleration."""


@dataclass(frozen=True, eq=False)
class RowsLeftOut:
    """What of a log the fit of a recording is not about.

    used, rows  of the whole repeats, and of the log
    left_out    from, to: s from the log's first row
    deviations  from, to, s, and N: the size of the mean force by which the readings differ from the model there
    tested      whether any part was long enough to be compared with the model
    """

    name: str
    used: int
    rows: int
    left_out: tuple[tuple[float, float], ...]
    deviations: tuple[tuple[float, float, float], ...]
    tested: bool

    @property
    def sentence(self) -> str:
        """The share of rows that the fit is about, and what the others show."""
        parts = " and ".join(f"{begin:.4g} to {end:.4g} s" for begin, end in self.left_out)
        text = f"{self.name}: {self.used} of {self.rows} rows ({100 * self.used / self.rows:.2g} %) are whole repeats,"
        text += f" which all of this is about; outside them, from {parts}, "
        if self.deviations:
            return f"{text}{self.deviation}."
        return text + (
            "the readings agree with the model." if self.tested else "too few to be compared with the model."
        )

    @property
    def deviation(self) -> str:
        """Where and by how much the readings outside the repeats differ from the model."""
        begin, end, force = max(self.deviations, key=lambda one: one[2])
        others = len(self.deviations) - 1
        more = f", and {others} more time{'s' * (others > 1)}" if others else ""
        return (
            f"the readings differ from the model: by {force:.3g} N from {begin:.4g} to {end:.4g} s{more}; contact,"
            " another load, or physics that the repeats do not show"
        )

    def to_data(self) -> dict[str, Any]:
        """Rows, s and N."""
        return {
            "recording": self.name,
            "used": self.used,
            "of": self.rows,
            "left_out": [list(rows) for rows in self.left_out],
            "tested": self.tested,
            "deviations": [{"from": begin, "to": end, "force": force} for begin, end, force in self.deviations],
        }


def rows_left_out(fit: Fit) -> tuple[RowsLeftOut, ...]:
    """The rows outside the repeats of each recording of a fit that has such, compared with what the fit predicts.

    As in a recording with contact, whose zero and noise are those of the whole log: where the mean over some time
    differs by more than noise, systematic residual and the parameters' covariance. Within the repeats the fit's own
    tests hold.
    """
    return tuple(_compared(fit, r, r.whole) for r in fit.recordings if r.whole is not None)


def _compared(fit: Fit, recording: Recording, whole: WholeLog) -> RowsLeftOut:
    log = whole.recording
    step = log.dt or 1.0
    parts = [rows for rows in whole.left_out if rows[1] - rows[0] >= FEWEST_ROWS]
    means = compensate(fit, log, false_alarms=LEVELS.held_out).means if parts else ()
    outside = [
        (mean, first, last)
        for mean in means
        for begin, end in parts
        if (first := max(mean.interval.first, begin)) < (last := min(mean.interval.last, end)) and _is_significant(mean)
    ]
    return RowsLeftOut(
        name=recording.name,
        used=whole.last - whole.first,
        rows=log.samples,
        left_out=tuple((_at(begin, step), _at(end, step)) for begin, end in whole.left_out),
        deviations=tuple((_at(first, step), _at(last, step), mean.force) for mean, first, last in outside),
        tested=bool(parts),
    )


def _at(row: int, step: float) -> float:
    """Seconds from the first row, to the nanosecond."""
    return round(row * step, 9)


def _is_significant(mean: ContactMean) -> bool:
    """Whether a mean wrench is more than noise, systematic residual, zero and parameters make likely."""
    p_values = chi2_sf((mean.wrench / mean.std) ** 2, 1.0)
    return bonferroni_p_value(p_values.tolist()) < LEVELS.held_out
