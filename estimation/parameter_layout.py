"""Parameters shared by several recordings, the biases that each has for itself, and the moments that each tool has."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimation.model_response import missing_inputs
from estimation.recordings.recording import Recording
from modeling.chain.model import WrenchModel
from modeling.chain.prediction import compiled_prediction
from modeling.effects.geometry import CentreOfMassOffset
from modeling.errors import InputError, quoted, suggestion
from modeling.parameter import Parameter
from modeling.rigid_body import inertial_parameters

Array = NDArray[np.float64]


def require_known_start(start: Iterable[str], model: WrenchModel, unknowns: Iterable[Parameter]) -> None:
    """Raise InputError for the first initial value of no unknown; those of other recordings (`bias_fx@name`) pass."""
    names = [p.name for p in unknowns]
    of_others = {p.name for p in (*model.biases, *of_tool(model))}
    for name in start:
        label, _, recording = name.partition("@")
        if name not in names and not (recording and label in of_others):
            what = f"no parameter is called {quoted(name)}"
            raise InputError(what=what, where="start", remedy=suggestion(name, names))


@dataclass(frozen=True, eq=False)
class ParameterLayout:
    """The unknowns of a fit of one model to one or more recordings.

    model       the model
    parameters  every unknown; the model's own first, then the biases of the further recordings, and before those of
                the first with another tool the moments of that tool
    models      the model of each recording: a recording-specific effect acts in the first that has its signals
    index       per recording, positions of its model's parameters among the unknowns
    """

    model: WrenchModel
    parameters: tuple[Parameter, ...]
    models: tuple[WrenchModel, ...]
    index: tuple[NDArray[np.intp], ...]

    @property
    def other_tools(self) -> tuple[str, ...]:
        """Names of the tools with unknown loads, whose moments are parameters of their own."""
        mass = f"{inertial_parameters(self.model.space)[0].name}@"
        return tuple(p.name.removeprefix(mass) for p in self.parameters if p.name.startswith(mass))

    @property
    def size(self) -> int:
        """The number of unknowns."""
        return len(self.parameters)

    def values_of(self, number: int, values: Mapping[str, float]) -> Array:
        """Parameters (k,) of a recording's model from values of unknowns by name; nominal where there is none."""
        return np.array([values.get(self.parameters[i].name, self.parameters[i].nominal) for i in self.index[number]])


def of_tool(model: WrenchModel) -> tuple[Parameter, ...]:
    """The parameters of a model that are another tool's where a recording has another: its moments."""
    moved = [effect for effect in model.effects if isinstance(effect, CentreOfMassOffset)]
    return (*inertial_parameters(model.space), *(p for effect in moved for p in effect.qualified(model.space)))


def main_tool(recordings: Sequence[Recording]) -> str:
    """Name of the tool that the model's own parameters are of: empty, the tool alone, if one recording has that."""
    tools = [recording.tool for recording in recordings]
    return "" if "" in tools else tools[0]


def parameter_layout(model: WrenchModel, recordings: Sequence[Recording]) -> ParameterLayout:
    """Layout with shared parameters, recording-specific biases (a sensor is zeroed between runs), and a tool's own.

    With an unknown load the tool is another one, of which each moment is a parameter `m@name`.
    """
    homes = {e.id: _recording_of_effect(model, e.id, recordings) for e in model.effects if e.per_recording}
    unknowns = list(model.parameters)
    names = [r.name for r in recordings]
    labels = [name if names.count(name) == 1 else f"{name}#{i}" for i, name in enumerate(names)]
    models, index, tools = [], [], {main_tool(recordings): dict[str, int]()} if recordings else {}
    for number, recording in enumerate(recordings):
        reduced = model
        for effect_id, home in homes.items():
            reduced = reduced if home == number else reduced.without(effect_id)
        place = {p.name: i for i, p in enumerate(model.parameters)}
        if (tool := recording.tool) not in tools:
            tools[tool] = {p.name: len(unknowns) + i for i, p in enumerate(of_tool(model))}
            unknowns += [replace(p, name=f"{p.name}@{tool}") for p in of_tool(model)]
        place |= tools[tool]
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
