"""Hypothesis: model with parameter values, and what distinguishes two models."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from design.information.parameter_values import ParameterValues, parameter_vector
from modeling.chain.effect import Effect
from modeling.chain.model import WrenchModel
from modeling.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A model at theta (k,), in its order and units."""

    model: WrenchModel
    theta: Array

    @classmethod
    def of(cls, model: WrenchModel, values: ParameterValues) -> Self:
        """The model at values by name; names of other models are ignored, and values are nominal where not named."""
        own = {p.name: values[p.name] for p in model.parameters if p.name in values}
        return cls(model.unrestricted, parameter_vector(model, own))

    @property
    def values(self) -> dict[str, float]:
        """theta by name."""
        return {p.name: float(v) for p, v in zip(self.model.parameters, self.theta, strict=True)}

    def without_effects(self, ids: tuple[str, ...]) -> Self:
        """The same with the amplitudes of these effects at their nominal values, at which they change no reading."""
        nominal = [
            p.nominal if p.name.partition(".")[0] in ids and not p.nuisance else v
            for p, v in zip(self.model.parameters, self.theta, strict=True)
        ]
        return type(self)(self.model, np.array(nominal))


def effects_only_in(model: WrenchModel, other: WrenchModel) -> tuple[str, ...]:
    """Ids of the effects that a model has and the other has not."""
    return tuple(e.id for e in model.effects if e.id not in {o.id for o in other.effects})


def distinguishing_effects(model: WrenchModel, other: WrenchModel) -> str:
    """Name of a model by the effects that distinguish it from another one."""
    return " + ".join(effects_only_in(model, other)) or "no further effect"


def with_effect_replaced(model: WrenchModel, effect_id: str, rival: Effect) -> WrenchModel:
    """The model with one of its effects replaced by another; InputError when it does not have it."""
    _require(model, (effect_id,))
    return model.without(effect_id) + rival


def rival_models(model: WrenchModel, one: Effect, other: Effect) -> tuple[WrenchModel, WrenchModel]:
    """The model with that one of two effects which it has, and with the other one in its place.

    The first is taken where it has both. Raises InputError when it has neither, or both are the same.
    """
    if one.id == other.id:
        what = f"{one.id} came twice"
        raise InputError(what=what, where="effects to be discriminated", remedy="name two effects")
    known, rival = (one, other) if one.id in {e.id for e in model.effects} else (other, one)
    _require(model, (known.id, rival.id))
    alone = model.without(rival.id) if rival.id in {e.id for e in model.effects} else model
    return alone, alone.without(known.id) + rival


def _require(model: WrenchModel, ids: tuple[str, ...]) -> None:
    if not set(ids) & {e.id for e in model.effects}:
        raise InputError(
            what=f"the model has no {' or '.join(ids)}, and its values are unknown",
            where="effects to be discriminated",
            remedy=f"give a model with one of them: `truewrench fit REC --add {ids[0]} --out MODEL.json`",
        )
