"""Parameters shared by several recordings, and the biases that each has for itself."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.model_response import missing_inputs
from estimation.recordings.recording import Recording
from modeling.chain.model import WrenchModel
from modeling.chain.prediction import compiled_prediction
from modeling.errors import InputError, quoted, suggestion
from modeling.parameter import Parameter

Array = NDArray[np.float64]


def require_known_start(start: Iterable[str], model: WrenchModel, unknowns: Iterable[Parameter]) -> None:
    """Raise InputError for the first initial value of no unknown; biases of other recordings (`bias_fx@name`) pass."""
    names = [p.name for p in unknowns]
    biases = {p.name for p in model.biases}
    for name in start:
        label, _, recording = name.partition("@")
        if name not in names and not (recording and label in biases):
            what = f"no parameter is called {quoted(name)}"
            raise InputError(what=what, where="start", remedy=suggestion(name, names))


@dataclass(frozen=True, eq=False)
class ParameterLayout:
    """The unknowns of a fit of one model to one or more recordings.

    model       the model
    parameters  every unknown; the model's own first, then the biases of the further recordings
    models      the model of each recording: a recording-specific effect acts in the first that has its signals
    index       per recording, positions of its model's parameters among the unknowns
    """

    model: WrenchModel
    parameters: tuple[Parameter, ...]
    models: tuple[WrenchModel, ...]
    index: tuple[NDArray[np.intp], ...]

    @property
    def size(self) -> int:
        """The number of unknowns."""
        return len(self.parameters)

    def values_of(self, number: int, values: Mapping[str, float]) -> Array:
        """Parameters (k,) of a recording's model from values of unknowns by name; nominal where there is none."""
        return np.array([values.get(self.parameters[i].name, self.parameters[i].nominal) for i in self.index[number]])


def parameter_layout(model: WrenchModel, recordings: Sequence[Recording]) -> ParameterLayout:
    """Layout with shared parameters and recording-specific biases (a sensor is zeroed between runs)."""
    homes = {e.id: _recording_of_effect(model, e.id, recordings) for e in model.effects if e.per_recording}
    unknowns = list(model.parameters)
    names = [r.name for r in recordings]
    labels = [name if names.count(name) == 1 else f"{name}#{i}" for i, name in enumerate(names)]
    models, index = [], []
    for number in range(len(recordings)):
        reduced = model
        for effect_id, home in homes.items():
            reduced = reduced if home == number else reduced.without(effect_id)
        place = {p.name: i for i, p in enumerate(model.parameters)}
        if number:
            for bias in model.biases:
                place[bias.name] = len(unknowns)
                unknowns.append(Parameter(name=f"{bias.name}@{labels[number]}", unit=bias.unit, nominal=bias.nominal))
        models.append(reduced)
        index.append(np.array([place[p.name] for p in reduced.parameters], dtype=np.intp))
    return ParameterLayout(model, tuple(unknowns), tuple(models), tuple(index))


def _recording_of_effect(model: WrenchModel, effect_id: str, recordings: Sequence[Recording]) -> int:
    effect = next(e for e in model.effects if e.id == effect_id)
    alone = compiled_prediction(model.base + effect).model  # cached: derived once
    for number, recording in enumerate(recordings):
        if not missing_inputs(alone, recording):
            return number
    return 0
