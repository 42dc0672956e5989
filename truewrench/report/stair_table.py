"""Stair table: how the error of each recording falls, step by step, as text and as a picture."""

from __future__ import annotations

from dataclasses import dataclass

from diagnosis.comparison import Comparison
from diagnosis.diagnosis import Diagnosis
from truewrench.plots.image import Image, image_of
from truewrench.plots.number import figures, probability
from truewrench.plots.staircase_plot import Flight, size_of, size_text, staircase_figure, step_names


@dataclass(frozen=True)
class Cell:
    """An error as text: what can be explained of it, the whole, and how it stands to floor and tolerance."""

    explainable: str
    whole: str
    kind: str


@dataclass(frozen=True)
class StairRow:
    """One step of one recording, a cell for each channel."""

    name: str
    cells: tuple[Cell, ...]
    misfit: str
    lack_of_fit: str


@dataclass(frozen=True)
class StairTable:
    """All steps of one recording."""

    name: str
    fitted: bool
    floor: tuple[str, ...]
    rows: tuple[StairRow, ...]


def stair_table(diagnosis: Diagnosis, flight: Flight) -> StairTable:
    """Explainable and whole RMS of one recording after each step, per channel."""
    floor = flight.comparisons[0].noise_floor
    rows = [
        StairRow(
            name=name,
            cells=tuple(_cell(c, k, diagnosis.tolerance[k]) for k in floor),
            misfit=figures(c.misfit),
            lack_of_fit=probability(c.lack_of_fit),
        )
        for name, c in zip(step_names(diagnosis), flight.comparisons, strict=True)
    ]
    return StairTable(flight.name, flight.fitted, tuple(figures(v) for v in floor.values()), tuple(rows))


def _cell(comparison: Comparison, channel: str, tolerance: float) -> Cell:
    whole = comparison.rms[channel]
    if comparison.explainable_rms is None:
        return Cell(figures(None), figures(whole), "unknown")
    size = comparison.explainable_rms[channel]
    kind = "within" if size <= tolerance else "loud" if size > comparison.noise_floor[channel] else "above"
    return Cell(size_text(comparison, channel), figures(whole), kind)


def staircase_image(diagnosis: Diagnosis) -> Image:
    """All recordings' errors step by step, per channel."""
    sizes = [f"{n} {figures(_worst(diagnosis, i), 2)}" for i, n in enumerate(step_names(diagnosis))]
    alt = f"Error over noise floor after each step, worst channel: {', '.join(sizes)}."
    return image_of(staircase_figure(diagnosis), alt)


def _worst(diagnosis: Diagnosis, step: int) -> float:
    comparison = diagnosis.steps[step].training[0]
    return max(v / max(comparison.noise_floor[c], 1e-300) for c, v in size_of(comparison).items())
