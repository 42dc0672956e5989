"""Which unknowns several recordings of one rig and tool share, and which each has for itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.recording import Recording
from estimation.response import missing_inputs
from modeling.model import WrenchModel
from modeling.parameter import Parameter
from modeling.prediction import compiled

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Layout:
    """The unknowns of a fit of one model to one or more recordings.

    parameters  every unknown; the model's own first, then the biases of the further recordings
    models      the model of each recording: effects that belong to one recording act in the first that can have them
    index       per recording, where the parameters of its model stand among the unknowns
    """

    parameters: tuple[Parameter, ...]
    models: tuple[WrenchModel, ...]
    index: tuple[NDArray[np.intp], ...]

    @property
    def size(self) -> int:
        """The number of unknowns."""
        return len(self.parameters)


def layout(model: WrenchModel, recordings: Sequence[Recording]) -> Layout:
    """Shared parameters, but biases of each recording's own (a sensor is zeroed between runs)."""
    homes = {e.id: _home(model, e.id, recordings) for e in model.effects if e.per_recording}
    unknowns = list(model.parameters)
    names = [r.name for r in recordings]
    labels = [name if names.count(name) == 1 else f"{name}#{i}" for i, name in enumerate(names)]
    models, index = [], []
    for number in range(len(recordings)):
        own = model
        for effect_id, home in homes.items():
            own = own if home == number else own.without(effect_id)
        place = {p.name: i for i, p in enumerate(model.parameters)}
        if number:
            for bias in model.biases:
                place[bias.name] = len(unknowns)
                unknowns.append(Parameter(name=f"{bias.name}@{labels[number]}", unit=bias.unit, nominal=bias.nominal))
        models.append(own)
        index.append(np.array([place[p.name] for p in own.parameters], dtype=np.intp))
    return Layout(tuple(unknowns), tuple(models), tuple(index))


def _home(model: WrenchModel, effect_id: str, recordings: Sequence[Recording]) -> int:
    effect = next(e for e in model.effects if e.id == effect_id)
    alone = compiled(model.base + effect).model  # derived once, not at each call
    for number, recording in enumerate(recordings):
        if not missing_inputs(alone, recording):
            return number
    return 0
