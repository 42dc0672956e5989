"""Example of an effect: a simulated rig that hides it, as `truewrench demo --effect ID` records, and its diagnosis."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import truewrench as tw
from modeling.chain.effect import Effect
from modeling.chain.stages import Stage
from modeling.errors import InputError
from modeling.number_format import format_number, format_unit, format_with_std
from modeling.table import Column, Table
from truewrench.files.demonstration import TRAINING, VALIDATION, hidden_effect_by_id, record
from truewrench.plots.style import MISFIT_COLOUR
from truewrench.plots.time_series_plot import LabelledComparison, nonperiodic_residual_figure
from truewrench.text.diagnosis_text import RECORD_VERDICT_LABELS, RIGID_TOOL

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from diagnosis.diagnosis import Diagnosis
    from diagnosis.study import Study

MOST_SUSPECTS = 6
"""Rows of the table of score tests."""
MOST_SIZES = 8
"""Rows of the table of sizes."""
CAPTIONS = {
    "residual": "Measured and predicted by the rigid tool, and the residual below, with the noise as grey bands.",
    "map": "Residual map: the residual against the variables that explain most of it.",
    "spectrum": "Spectrum of the residual: a systematic error appears at the excited lines only.",
    "nonperiodic": "Residual over the whole record, less its mean over the repeats; band: two standard deviations.",
}


@dataclass(frozen=True)
class EffectExample:
    """An effect of the catalogue, hidden in recordings that are written to a folder."""

    effect: Effect
    folder: Path

    @cached_property
    def hidden(self) -> Any:
        """What is hidden, with its location and times."""
        return record(hidden_effect_by_id(self.effect.id), self.folder, (TRAINING, VALIDATION))

    @cached_property
    def study(self) -> Study:
        """The rigid tool, fitted to the first recording, the second held out."""
        assert self.hidden is not None
        rig = tw.Rig.read(self.folder / "rig.toml")
        recordings = [tw.read(self.folder / run.name, rig=rig) for run in (TRAINING, VALIDATION)]
        return tw.study(rig, recordings[0], validate=recordings[1])

    @cached_property
    def suspects(self) -> Table:
        """The score tests of the rigid tool's residual, those that remove most of it first."""
        found = self.study.suspects()
        tests = found.tests[:MOST_SUSPECTS]
        rows = [(t.effect.id, found.p_values.get(t.effect.id), found.share(t)) for t in tests]
        return Table.of(found.table.columns[:3], rows)

    @cached_property
    def diagnosis(self) -> Diagnosis:
        """What the diagnosis finds."""
        study = self.study
        return tw.diagnose(study.steps[0].fit.model, study.fit.recordings, validate=self._held_out)

    @property
    def _held_out(self) -> list[Any]:
        return [tw.read(self.folder / VALIDATION.name, rig=self.study.fit.recordings[0].rig)]

    @property
    def verdict(self) -> str:
        """The verdict in a sentence, with the effects added."""
        found = self.diagnosis
        added = " and ".join(f"`{i}`" for i in found.added) or "nothing"
        return f"{RECORD_VERDICT_LABELS[found.verdict]}; added: {added}"

    @property
    def aliases(self) -> tuple[str, ...]:
        """Ids of the effects that this recording does not separate from the one added."""
        added = self.diagnosis.added
        return tuple(i for f in self.diagnosis.findings if f.effect.id in added for i in f.confusable_with)

    @property
    def sizes(self) -> Table:
        """What was hidden, and what was found where the effect was added; of many parameters the most significant."""
        hidden = {n: v for n, v in asdict(self.hidden).items() if isinstance(v, float)}
        estimates = self.diagnosis.fit.parameters
        own = {n.partition(".")[2]: e for n, e in estimates.items() if n.startswith(f"{self.effect.id}.")}
        ranked = sorted(own, key=lambda n: -abs(own[n].value) / max(own[n].std, 1e-300))[:MOST_SIZES]
        rows = [
            (n, format_number(hidden.get(n)), format_with_std(e.value, e.std), format_unit(e.unit))
            for n, e in own.items()
            if n in ranked
        ]
        return Table.of((Column("parameter"), Column("hidden"), Column("found"), Column("unit")), rows)

    @property
    def hidden_words(self) -> str:
        """What was hidden, by the simulator's own names."""
        settings = {n: v for n, v in asdict(self.hidden).items() if v is not None}
        return ", ".join(f"{name} = {_plain(value)}" for name, value in settings.items())

    def figures(self) -> dict[str, Figure]:
        """Pictures of the rigid tool's residual by kind; kinds that say nothing of this recording are left out."""
        first = self.study.steps[0]
        kinds = ["residual", "map", "spectrum"]
        found = {}
        for kind in kinds:
            try:
                found[kind] = first.fit.plot(kind=kind)
            except InputError:
                continue
        if self.effect.per_recording or self.effect.stage is Stage.BIAS:
            side = LabelledComparison(RIGID_TOOL, MISFIT_COLOUR, first.training[0])
            found = {"nonperiodic": nonperiodic_residual_figure([side]), **found}
        return found


def _plain(value: Any) -> str:
    """A setting of the simulator without digits that nobody typed."""
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, tuple | list):
        return f"({', '.join(_plain(v) for v in value)})"
    return str(value)
