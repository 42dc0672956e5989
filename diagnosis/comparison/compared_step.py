"""A step of a series of models, compared with recordings: what it shows of itself."""

from __future__ import annotations

from collections.abc import Sequence

from diagnosis.comparison.comparison import Comparison
from diagnosis.comparison.slow_residual import slow_residuals
from diagnosis.comparison.unrecorded_acceleration import lacks_acceleration
from estimation.fit import Fit
from modeling.chain.model import WrenchModel
from modeling.number_format import P_VALUE
from modeling.significance import LEVELS
from modeling.table import Column, Table, Tabular, Value


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
        fitted = [c.recording.name for c in misfitting(self.training, self.fit.model)]
        held_out = [c.recording.name for c in held_out_misfitting(self.validation)]
        return (*fitted, *(f"{name} (held out)" for name in held_out))

    def __repr__(self) -> str:
        held_out = [f"held out {c.recording.name}: {c.remarks()[0]}" for c in self.validation]
        return "; ".join([f"{type(self).__name__}: {self.label}, {self.training[0].remarks()[0]}", *held_out])

    @property
    def table(self) -> Table:
        """Error of each channel, reduced chi-square and lack of fit, by recording.

        The error is the systematic RMS, or its upper limit, with repeats, the RMS of the whole residual without.
        """
        units = self.training[0].space.channel_units.items()
        sizes = (Column(channel, unit, format=".3g") for channel, unit in units)
        measures = (Column("reduced chi-square", format=".3g"), Column("lack-of-fit p", format=P_VALUE))
        compared = [*((c, "fitted") for c in self.training), *((c, "held out") for c in self.validation)]
        return Table.of(("recording", *sizes, *measures), [_row(c, kind) for c, kind in compared])

    def printed(self) -> list[Table | str]:
        """What led to it, then its errors."""
        return [self.label, self.table]


def misfitting(training: Sequence[Comparison], model: WrenchModel) -> list[Comparison]:
    """Fitted recordings with a significant lack of fit, a slow residual above the noise, or motion not recorded."""
    slow = {s.recording for s in slow_residuals(training) if s.above_noise}
    return [
        c for c in training if c.lack_of_fit < LEVELS.effect or c.recording.name in slow or lacks_acceleration(c, model)
    ]


def held_out_misfitting(validation: Sequence[Comparison]) -> list[Comparison]:
    """Held-out recordings with a significant lack of fit."""
    return [c for c in validation if c.lack_of_fit < LEVELS.held_out]


def _row(comparison: Comparison, kind: str) -> tuple[Value, ...]:
    errors = (comparison.systematic_cell(c) for c in comparison.recording.channels)
    name = f"{comparison.recording.name} ({kind})"
    return (name, *errors, comparison.misfit, comparison.lack_of_fit_cell)
