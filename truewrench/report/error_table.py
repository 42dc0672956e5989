"""Table of systematic and total error after each selection step."""

from __future__ import annotations

from dataclasses import dataclass

from diagnosis.comparison.comparison import Comparison
from diagnosis.diagnosis import Diagnosis
from truewrench.plots.error_reduction_plot import (
    RecordingErrors,
    error_reduction_figure,
    step_names,
    systematic_error,
    systematic_error_text,
)
from truewrench.plots.svg_image import SvgImage, svg_image
from truewrench.text.number_format import format_number, format_p_value


@dataclass(frozen=True)
class ErrorCell:
    """Systematic and total error as text; `kind` relative to noise floor and tolerance."""

    explainable: str
    whole: str
    kind: str


@dataclass(frozen=True)
class ErrorRow:
    """One selection step on one recording, a cell for each channel."""

    name: str
    cells: tuple[ErrorCell, ...]
    misfit: str
    lack_of_fit: str


@dataclass(frozen=True)
class ErrorTable:
    """All selection steps on one recording."""

    name: str
    fitted: bool
    floor: tuple[str, ...]
    rows: tuple[ErrorRow, ...]


def error_reduction_table(diagnosis: Diagnosis, errors: RecordingErrors) -> ErrorTable:
    """Systematic and total RMS of one recording after each selection step, per channel."""
    floor = errors.comparisons[0].noise_floor
    rows = [
        ErrorRow(
            name=name,
            cells=tuple(_error_cell(c, k, diagnosis.tolerance[k]) for k in floor),
            misfit=format_number(c.misfit),
            lack_of_fit=format_p_value(c.lack_of_fit),
        )
        for name, c in zip(step_names(diagnosis), errors.comparisons, strict=True)
    ]
    return ErrorTable(errors.name, errors.fitted, tuple(format_number(v) for v in floor.values()), tuple(rows))


def _error_cell(comparison: Comparison, channel: str, tolerance: float) -> ErrorCell:
    whole = comparison.rms[channel]
    if comparison.explainable_rms is None:
        return ErrorCell(format_number(None), format_number(whole), "unknown")
    size = comparison.explainable_rms[channel]
    kind = "within" if size <= tolerance else "above_noise" if size > comparison.noise_floor[channel] else "above"
    return ErrorCell(systematic_error_text(comparison, channel), format_number(whole), kind)


def error_reduction_image(diagnosis: Diagnosis) -> SvgImage:
    """Figure of the errors of all recordings after each selection step, per channel."""
    sizes = [f"{n} {format_number(_largest_error_ratio(diagnosis, i), 2)}" for i, n in enumerate(step_names(diagnosis))]
    alt = f"Error / noise floor after each selection step, worst channel: {', '.join(sizes)}."
    return svg_image(error_reduction_figure(diagnosis), alt)


def _largest_error_ratio(diagnosis: Diagnosis, step: int) -> float:
    comparison = diagnosis.steps[step].training[0]
    return max(v / max(comparison.noise_floor[c], 1e-300) for c, v in systematic_error(comparison).items())
