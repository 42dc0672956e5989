"""The parts of a model as functions of signals that nobody recorded."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from modeling.chain.model import WrenchModel
from modeling.chain.prediction import VectorFunction, compiled_prediction
from tests.modeling.effects.cases import Case

Array = NDArray[np.float64]


def part_units(case: Case) -> dict[str, tuple[str, ...]]:
    """The parts of the model that there are, with the units of their elements."""
    chain, units = case.model.chain, case.space.units
    names = ["load", *(name for stage in chain.dynamics for name in stage.vectors())]
    turns = {} if chain.deflection is None else {"equilibrium": ("rad",) * len(case.space.turns)}
    return dict.fromkeys(names, units) | turns


@cache
def part(model: WrenchModel, name: str) -> VectorFunction:
    """A part of a model by name, as a function of signals and, where the tool bends, of the bend's as well."""
    chain = model.chain
    if chain.deflection is None or name == "bias":
        return compiled_prediction(model).vector(name)
    expression = chain.equilibrium() if name == "equilibrium" else model.load
    own = (model.inputs_of(expression), tuple(s.name for s in chain.deflection.signals))
    return VectorFunction.of(expression, own[0] + own[1], tuple(p.symbol for p in model.parameters), model.definitions)


def random_signals(case: Case, names: Sequence[str], samples: int, rng: np.random.Generator) -> dict[str, Array]:
    """Signals (samples,) by name: of 1 to 3 in their units either way, times off the edges of the case's events."""
    found = {name: rng.choice([-1.0, 1.0], samples) * rng.uniform(1.0, 3.0, samples) for name in names}
    turn = rng.normal(size=(4, samples))
    found["progress"] = rng.uniform(-1.0, 1.0, samples)
    found |= dict(zip(("qx", "qy", "qz", "qw"), turn / np.linalg.norm(turn, axis=0), strict=True))
    return found | {"time": np.linspace(0.05, 4.55, samples)} | {n: 0.1 * found[n] for n in names if "bend" in n}
