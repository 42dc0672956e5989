"""Hypothesis: a model with all its numbers, and how two of them differ."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from design.information.values import Values, values_of
from modeling.effect import Effect
from modeling.errors import InputError
from modeling.model import WrenchModel

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A model at theta (k,), in its order and units."""

    model: WrenchModel
    theta: Array

    @classmethod
    def of(cls, model: WrenchModel, values: Values) -> Self:
        """The model at values by name, of which those of other models may be among; nominal where not named."""
        own = {p.name: values[p.name] for p in model.parameters if p.name in values}
        return cls(model, values_of(model, own))

    @property
    def values(self) -> dict[str, float]:
        """theta by name."""
        return {p.name: float(v) for p, v in zip(self.model.parameters, self.theta, strict=True)}

    def less(self, ids: tuple[str, ...]) -> Self:
        """The same with the amplitudes of these effects at their nominal values, which leave no trace of them."""
        nominal = [
            p.nominal if p.name.partition(".")[0] in ids and not p.nuisance else v
            for p, v in zip(self.model.parameters, self.theta, strict=True)
        ]
        return type(self)(self.model, np.array(nominal))


def own_effects(model: WrenchModel, other: WrenchModel) -> tuple[str, ...]:
    """Ids of the effects that a model has and the other has not."""
    return tuple(e.id for e in model.effects if e.id not in {o.id for o in other.effects})


def label(model: WrenchModel, other: WrenchModel) -> str:
    """What a model is called beside another one: by its own effects."""
    return " + ".join(own_effects(model, other)) or "nothing more"


def in_place_of(model: WrenchModel, effect_id: str, rival: Effect) -> WrenchModel:
    """The model with another effect in the place of one of its own; InputError when it has not got that."""
    _require(model, (effect_id,))
    return model.without(effect_id) + rival


def opponents(model: WrenchModel, one: Effect, other: Effect) -> tuple[WrenchModel, WrenchModel]:
    """The model with the one of two effects whose size it knows, and with the other one in its place.

    The first is taken where it has both. Raises InputError when it has neither, or both are one.
    """
    if one.id == other.id:
        what = f"{one.id} came twice"
        raise InputError(what=what, where="effects to be told apart", remedy="name two effects")
    known, rival = (one, other) if one.id in {e.id for e in model.effects} else (other, one)
    _require(model, (known.id, rival.id))
    return model.without(rival.id), model.without(rival.id).without(known.id) + rival


def _require(model: WrenchModel, ids: tuple[str, ...]) -> None:
    if not set(ids) & {e.id for e in model.effects}:
        raise InputError(
            what=f"the model has no {' or '.join(ids)}, so that nothing says how large it is",
            where="effects to be told apart",
            remedy=f"give a model with one of them: `truewrench fit REC --add {ids[0]} --out MODEL.json`",
        )
