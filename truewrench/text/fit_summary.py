"""Text and JSON summary of a fit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import isfinite
from typing import Any

from diagnosis.comparison.compared_step import misfitting_names
from diagnosis.comparison.comparison import Comparison, comparisons_of
from diagnosis.comparison.slow_residual import SlowResidual, slow_residuals
from diagnosis.verdict.aliasing import channel_tolerance
from diagnosis.verdict.unexplained_residual import describe_residual, motion_notes, unknown_tool_reason
from estimation.case import Case
from estimation.centre_of_mass import centres_of_mass
from estimation.confidence_intervals import MAX_DEGREES_OF_FREEDOM, Intervals
from estimation.contact.rows_left_out import RowsLeftOut, rows_left_out
from estimation.fit import Fit
from estimation.least_squares.constrained_minimum import ConstrainedMinimum
from estimation.least_squares.estimates import HELD, NOT_CONVERGED, Estimate
from estimation.pose_advice import PoseAdvice
from estimation.repeat_table import RepeatTable
from estimation.robust_fit import RobustFit
from modeling.chain.sensor_axes import is_turned
from modeling.noise import NoiseSource
from modeling.number_format import as_sentence, estimate_text, interval_text
from modeling.significance import LEVELS
from modeling.table import Table
from truewrench.effect_description.effect_size import size_sentence
from truewrench.files.case_files import frame_sentences, frames_data
from truewrench.text.diagnosis_text import WEAKER
from truewrench.text.tool_text import (
    LEGEND,
    NOT_KNOWN,
    left_out_channels,
    tool_lines,
)

ADVICE = (
    "`truewrench diagnose` with the same recordings tests every effect that could explain it; by hand, in Python,"
    " tw.study(...).suspects() does."
)
"""After where a model fails: what to do about it."""


@dataclass(frozen=True, eq=False)
class FitSummary:
    """A fit with confidence intervals, the robust fit where one was made, and held-out recordings compared with it."""

    fit: Fit
    intervals: Intervals
    robust: RobustFit | None = None
    validation: tuple[Comparison, ...] = ()

    @cached_property
    def comparisons(self) -> tuple[Comparison, ...]:
        """Residual statistics of each recording."""
        return comparisons_of(self.fit)

    @cached_property
    def repeat_tables(self) -> tuple[RepeatTable, ...]:
        """Repeatability table of each recording whose motion was repeated."""
        return tuple(RepeatTable.of(self.fit, i) for i, r in enumerate(self.fit.recordings) if r.repeats > 1)

    # ------------------------------------------------------------------------------------------ text

    def text(self, case: Case | None, *, runs: bool = False, verbose: bool = True) -> str:
        """Summary; the repeatability tables only if `verbose`, and the rows of every run in it only with `runs`."""
        frames = [] if case is None else frame_sentences(case, detailed=verbose)
        parts = [*frames, self.headline()] if case is not None and case.misread else [self.headline(), *frames]
        parts += [self.parameters(), *self._constraints(), *self._outliers(), *self._poses()]
        parts += [f"{c.recording.name}:\n{c}" for c in self.comparisons]
        parts += [f"{c.recording.name} (held out, its biases estimated there):\n{c}" for c in self.validation]
        parts += [repeatability_text(t, runs=runs) for t in (self.repeat_tables if verbose or runs else ())]
        return "\n\n".join([*parts, *self._failures()])

    def _failures(self) -> Iterator[str]:
        """Where the model fails, of each recording with a significant lack of fit, and what searches for the cause."""
        failing = [c for c in self.comparisons if c.lack_of_fit < LEVELS.effect]
        failing += [c for c in self.validation if c.lack_of_fit < LEVELS.held_out]
        if failing:
            tolerance, _ = channel_tolerance(self.fit)
            lines = [f"  {c.recording.name}: {_failure(c, tolerance)}" for c in failing]
            yield "\n".join(["Where the model fails:", *lines, f"  {ADVICE}"])

    @property
    def misfitting(self) -> tuple[str, ...]:
        """Names of the recordings that the model does not fit, the held-out ones named as such."""
        return misfitting_names(self.comparisons, self.validation, self.fit.model)

    @cached_property
    def rows_left_out(self) -> tuple[RowsLeftOut, ...]:
        """Rows outside the whole repeats that were cut from the logs, as they were read."""
        read = (
            self.fit
            if self.robust is None
            else replace(self.fit, problem=self.fit.problem.of_recordings(self.robust.plain.recordings))
        )
        return rows_left_out(read)

    @property
    def deviating(self) -> list[str]:
        """Names of the recordings whose logs the model does not fit outside the whole repeats."""
        return [rows.name for rows in self.rows_left_out if rows.deviations]

    def headline(self) -> str:
        """Whether the model fits, before any number of it: the std of a model that does not fit means nothing."""
        unfinished = [] if self.fit.converged else [as_sentence(NOT_CONVERGED)]
        return "\n".join([*unfinished, self._agreement(), *self.notes])

    def _agreement(self) -> str:
        """Whether the residual is that of a model that fits."""
        if self.misfitting:
            said = agreement_text(self.misfitting)
            return (
                f"{said} Stds and intervals hold for noise alone, and are too small here; `truewrench diagnose` or"
                " `tw.diagnose` searches for what is missing."
            )
        if self.deviating:
            names = " and ".join(self.deviating)
            return f"The model fits the whole repeats of {names}, but not the readings outside them."
        from_residual = any(c.noise.source is NoiseSource.RESIDUAL for c in self.comparisons)
        return agreement_text((), from_residual=from_residual)

    @cached_property
    def unknown_tool(self) -> str:
        """Why the readings do not say what the tool weighs, empty where they do: parameters have no std then."""
        return unknown_tool_reason(self.comparisons, self.fit.model)

    @cached_property
    def slow(self) -> tuple[SlowResidual, ...]:
        """The significant slow parts of the residuals of single runs."""
        return slow_residuals(self.comparisons)

    @cached_property
    def notes(self) -> list[str]:
        """What the motion leaves unknown, what remains slowly, and the rows that the fit is not about."""
        slow = [as_sentence(remainder.sentence) for remainder in self.slow]
        rows = [left_out.sentence for left_out in self.rows_left_out]
        outliers = [note for c in self.comparisons for note in c.outlier_notes]
        return [*motion_notes(self.comparisons, self.fit.model), *outliers, *slow, *rows]

    def parameters(self) -> str:
        """Every estimate with std, 95 % interval and its degrees of freedom, and remarks on identifiability."""
        names = ("parameter", "value", f"{self.intervals.level:.0%} interval", "degrees of freedom")
        table = Table.of(names, self._parameter_rows())
        legend = f"({LEGEND[self.fit.model.space]}{'' if is_turned(self.fit.model) else '; sensor axes'})"
        tool = tool_lines(self.fit, misfitting=bool(self.misfitting), unknown=self.unknown_tool)
        return "\n".join([str(table), legend, *tool, *self._effect_sizes(), *self.fit.remarks()])

    def _parameter_rows(self) -> Iterator[tuple[str, ...]]:
        intervals = self.intervals
        ends = zip(intervals.low, intervals.high, intervals.freedom, strict=True)
        constant = left_out_channels(self.fit)
        for estimate, (low, high, freedom) in zip(self.fit.parameters.values(), ends, strict=True):
            row = (estimate.name, self._estimate(estimate))
            if self.unknown_tool:
                yield (*row, NOT_KNOWN, "")
            elif (
                estimate.name.removeprefix("bias_") in constant
                or estimate.std == 0
                or not isfinite(low)
                or estimate.name in self.fit.held
            ):
                yield (*row, "", "")
            else:
                count = f"{freedom:.3g}" if freedom < MAX_DEGREES_OF_FREEDOM else "many"
                yield (*row, interval_text(low, high, estimate.shown_std), count)

    def _estimate(self, estimate: Estimate) -> str:
        """Value and std; of one that a bound holds, or of a tool that is not known, the value alone."""
        unit = "" if estimate.unit == "1" else f" {estimate.unit}"
        if estimate.std > 0 and estimate.name in self.fit.held:
            return f"{estimate.value:.6g}{unit}, {HELD}"
        if self.unknown_tool:
            return f"{estimate.value:.2g}{unit}"
        if (channel := estimate.name.removeprefix("bias_")) in left_out_channels(self.fit):
            return f"not known, as {channel} never changes"
        return estimate_text(estimate.value, estimate.shown_std, estimate.unit)

    def _effect_sizes(self) -> Iterator[str]:
        """How large each effect of the model is in these recordings."""
        for effect in self.fit.model.effects:
            if size := size_sentence(self.fit, effect.id):
                yield f"{effect.id}: {size}"

    def _constraints(self) -> Iterator[str]:
        if self.fit.constrained is not None:
            minimum = self.fit.constrained
            yield "\n".join(["Constraints:", str(minimum), *(f"  {active.sentence}." for active in minimum.active)])

    def _outliers(self) -> Iterator[str]:
        if self.robust is not None:
            yield f"Outliers, by {self.robust.loss}:\n{self.robust.outlier_table}"

    def _poses(self) -> Iterator[str]:
        if any(r.at_rest for r in self.fit.recordings):
            yield "\n".join(str(centre) for centre in centres_of_mass(self.fit))
            yield str(PoseAdvice.of(self.fit))

    # ------------------------------------------------------------------------------------------- data

    def to_data(self, case: Case) -> dict[str, Any]:
        """JSON data in addition to the model: numbers are finite or None."""
        ends = zip(self.fit.parameters, self.intervals.low, self.intervals.high, strict=True)
        data: dict[str, Any] = {
            "intervals": {
                n: [float(a), float(b)] if isfinite(a) and not self.unknown_tool else None for n, a, b in ends
            },
            "tool_unknown": self.unknown_tool or None,
            "converged": self.fit.converged,
            "condition": self.fit.condition if isfinite(self.fit.condition) else None,
            "unseen": [direction.whole for direction in self.fit.unidentifiable],
            "fits": not self.misfitting and not self.deviating,
            "recordings": [comparison_data(c) for c in self.comparisons],
            "validation": [comparison_data(c) for c in self.validation],
            "repeats": [t.to_data() for t in self.repeat_tables],
        }
        data |= {} if self.fit.constrained is None else {"constraints": constraints_data(self.fit.constrained)}
        data |= {"rows": [rows.to_data() for rows in self.rows_left_out]} if self.rows_left_out else {}
        return data | frames_data(case)


def agreement_text(misfitting: Sequence[str], *, from_residual: bool = False) -> str:
    """Whether a model fits, by the names of the recordings that it does not fit and where the noise comes from."""
    if misfitting:
        return f"The model does not fit {' and '.join(misfitting)}: something is missing in it."
    if from_residual:
        return (
            f"No lack of fit was found, but {WEAKER[NoiseSource.RESIDUAL]}: record repeats, or state the noise in the"
            " rig file."
        )
    return "The model fits: the residual is consistent with the noise."


def _failure(comparison: Comparison, tolerance: Mapping[str, float]) -> str:
    """The largest of a recording's residual in words."""
    return f"{describe_residual(comparison, tolerance).text}."


def repeatability_text(table: RepeatTable, *, runs: bool) -> str:
    """Noise, systematic residual and gain of averaging per channel; with `runs` the whole repeatability table."""
    title = f"{table.recording}, over its repeats:"
    if runs:
        return f"{title}\n{table}"
    return "\n".join([title, str(table.channel_table), *table.remarks()])


def constraints_data(minimum: ConstrainedMinimum) -> dict[str, Any]:
    """Constraints and their active set: numbers finite or None."""
    return {
        "chi_square": minimum.cost,
        "chi_square_free": minimum.free.cost,
        "p_value": minimum.p_value,
        "prior_cost": None if minimum.region.prior is None else minimum.pulled,
        "converged": minimum.converged,
        "active": [
            vars(active) | {"pressure": active.pressure.name.lower(), "sentence": active.sentence}
            for active in minimum.active
        ],
    }


def comparison_data(comparison: Comparison) -> dict[str, Any]:
    """Residual statistics of a recording, as in `result.json`: numbers finite or None."""
    explainable = comparison.explainable_rms
    return {
        "name": comparison.recording.name,
        "noise_floor": dict(comparison.noise_floor),
        "noise_source": comparison.noise.source.value,
        "misfit": comparison.misfit,
        "lack_of_fit_p": comparison.lack_of_fit,
        "rms": dict(comparison.rms),
        "explainable_rms": None if explainable is None else dict(explainable),
    }
