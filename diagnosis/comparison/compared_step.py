"""A step of a series of models, compared with recordings: what it shows of itself."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from diagnosis.comparison.comparison import MEASURES, Comparison, size_columns
from diagnosis.comparison.slow_residual import lacks_acceleration, slow_residuals
from estimation.fit import Fit
from modeling.chain.model import WrenchModel
from modeling.number_format import format_number
from modeling.significance import LEVELS
from modeling.table import Cell, Column, Table, Tabular, Value

# Table of the systematic error of each channel after each step of a series of models, on each recording.


@dataclass(frozen=True, eq=False)
class RecordingErrors:
    """Comparisons of one recording at every selection step, and whether it was fitted."""

    name: str
    comparisons: tuple[Comparison, ...]
    fitted: bool

    def floor(self, channel: str) -> float:
        """Noise floor of a channel, never zero."""
        return max(noise_floors(self.comparisons)[channel], 1e-300)

    @property
    def label(self) -> str:
        """Name, and whether it was fitted."""
        return f"{self.name} ({'fitted' if self.fitted else 'held out'})"


def recording_errors(steps: Sequence[ComparedFit]) -> tuple[RecordingErrors, ...]:
    """Training recordings, then validation recordings."""
    trained = zip(*(s.training for s in steps), strict=True)
    held_out = zip(*(s.validation for s in steps), strict=True)
    series = [(c, True) for c in trained] + [(c, False) for c in held_out]
    return tuple(RecordingErrors(c[0].recording.name, c, fitted) for c, fitted in series)


def noise_floors(comparisons: Sequence[Comparison]) -> dict[str, float]:
    """Noise floor of each channel of a recording, which several models were compared with.

    The smallest: a floor that is estimated from the residual contains whatever the model lacks.
    """
    return {c: min(each.noise_floor[c] for each in comparisons) for c in comparisons[0].noise_floor}


def systematic_error(comparison: Comparison) -> Mapping[str, float]:
    """Systematic RMS per channel; the total RMS without repeats."""
    return comparison.explainable_rms if comparison.explainable_rms is not None else comparison.rms


def systematic_error_text(comparison: Comparison, channel: str, digits: int = 3) -> str:
    """Systematic error of a channel; its upper limit where it is not significant."""
    cell = comparison.systematic_cell(channel)
    return cell.mark + format_number(float(cell.value or 0.0), 2 if cell.mark else digits)


def error_table(steps: Sequence[ComparedFit], names: Sequence[str], tolerance: Mapping[str, float]) -> Table:
    """Systematic RMS of each channel of each recording after each step, by its name, with noise floor and tolerance.

    The total RMS is the note of a cell; without repeats it stands in the cell itself, marked `~`.
    """
    first = steps[0].training[0]
    head = [Cell(tolerance[c], kind="floor") for c in first.recording.channels]
    rows = [row for errors in recording_errors(steps) for row in _rows(errors, names, tolerance)]
    columns: tuple[Column | str, ...] = ("recording", "model", *size_columns(first.space), *MEASURES)
    return Table.of(columns, [("", "tolerance", *head, "", ""), *rows])


def _rows(errors: RecordingErrors, names: Sequence[str], tolerance: Mapping[str, float]) -> Iterator[tuple[Value, ...]]:
    floors = noise_floors(errors.comparisons)
    yield (errors.label, "noise floor", *(Cell(floor, kind="floor") for floor in floors.values()), "", "")
    for name, c in zip(names, errors.comparisons, strict=True):
        cells = (_error_cell(c, channel, tolerance[channel]) for channel in floors)
        yield (errors.label, name, *cells, c.misfit, c.lack_of_fit_cell)


def _error_cell(comparison: Comparison, channel: str, tolerance: float) -> Cell:
    whole = comparison.rms[channel]
    if comparison.explainable_rms is None:
        return Cell(whole, mark="~")
    size = comparison.explainable_rms[channel]
    kind = "within" if size <= tolerance else "above_noise" if size > comparison.noise_floor[channel] else ""
    systematic = comparison.systematic_cell(channel)
    return Cell(systematic.value, systematic.mark, kind, f"({format_number(whole)})")


class ComparedFit(Tabular):
    """A fit compared with the recordings it was fitted to, and with held-out ones."""

    fit: Fit
    training: tuple[Comparison, ...]
    validation: tuple[Comparison, ...]

    @property
    def label(self) -> str:
        """What led to it."""
        return "model"

    @property
    def misfitting(self) -> tuple[str, ...]:
        """The recordings that the model does not fit, the held-out ones named as such."""
        return misfitting_names(self.training, self.validation, self.fit.model)

    def __repr__(self) -> str:
        held_out = [f"held out {c.recording.name}: {c.remarks()[0]}" for c in self.validation]
        return "; ".join([f"{type(self).__name__}: {self.label}, {self.training[0].remarks()[0]}", *held_out])

    @property
    def table(self) -> Table:
        """Error of each channel, reduced chi-square and lack of fit, by recording.

        The error is the systematic RMS, or its upper limit, with repeats, the RMS of the whole residual without.
        """
        compared = [*((c, "fitted") for c in self.training), *((c, "held out") for c in self.validation)]
        rows = [(f"{c.recording.name} ({kind})", *c.errors) for c, kind in compared]
        return Table.of(("recording", *size_columns(self.training[0].space), *MEASURES), rows)

    def printed(self) -> list[Table | str]:
        """What led to it, then its errors."""
        return [self.label, self.table]


def misfitting_names(
    training: Sequence[Comparison], validation: Sequence[Comparison], model: WrenchModel
) -> tuple[str, ...]:
    """Names of the recordings that a model does not fit, the held-out ones named as such.

    A fitted one has a significant lack of fit, a slow residual above the noise, or a motion that was not recorded; a
    held-out one a significant lack of fit.
    """
    slow = {s.recording for s in slow_residuals(training) if s.above_noise}
    fitted = (
        c.recording.name
        for c in training
        if c.lack_of_fit < LEVELS.effect or c.recording.name in slow or lacks_acceleration(c, model)
    )
    held_out = (c.recording.name for c in validation if c.lack_of_fit < LEVELS.held_out)
    return (*fitted, *(f"{name} (held out)" for name in held_out))
