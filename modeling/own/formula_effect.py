"""FormulaEffect: an effect that a user has written down, as formulas of the signals of one sample."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, Self

from modeling import symbolic as sp
from modeling.chain import Chain, Stage, in_plane
from modeling.contact import applied, components
from modeling.effect import Effect, Extent, Values
from modeling.effects.push import pushed
from modeling.own.defining import defined
from modeling.own.definition import Definition
from modeling.own.formulas import formulas_of
from modeling.own.table import read_table
from modeling.own.trial import require_felt
from modeling.parameter import Parameter
from modeling.space import Space


def _stated(name: str) -> Any:
    """An attribute that the catalogue's effects have as a class, and one of these has for itself."""
    return property(lambda effect: getattr(effect.definition, name))


def _read(name: str) -> Any:
    """An attribute that follows from the formulas."""
    return property(lambda effect: getattr(formulas_of(effect.definition), name))


@dataclass(frozen=True)
class FormulaEffect(Effect):
    """Formulas over named signals, parameters and constants say what is added to one stage of the chain.

    tip body  force_x, force_y, force_z (N): the environment's force on the tool along the axes of the world, at the
              point `at` (m) along the tip, whose place is tip_x .. (m) and whose velocity tip_vx .. (m/s); or the
              components of its wrench in the tool's axes about the sensor origin: fcx, fcy, tauc, or fcx .. tcz
    gain      `<row>_<column>`: reading row += formula times the true channel column
    zero      fx, fy, tau or fx .. tz: added to the readings at last, whatever their sign convention

    Parameters that are searched mean nothing while the others are at their nominal values, where the effect vanishes.
    """

    definition: Definition

    id = _stated("id")
    title = _stated("title")
    stage = _stated("stage")
    equation = _stated("equation")
    advice = _stated("advice")
    per_recording = _stated("per_recording")
    spaces = _read("spaces")
    needs_repeats = _read("needs_repeats")

    @classmethod
    def from_data(cls, data: object, *, where: str = "effect") -> Self:
        """The effect of a plain table, as TOML and JSON give it.

        Raises InputError, in one line that names key and column, for whatever is no such effect: text that is no
        formula, units that do not agree, an effect that does not vanish at nominal values or cannot be seen there.
        """
        effect = cls(defined(read_table(data, where), where))
        require_felt(effect, where)
        return effect

    def to_data(self) -> dict[str, Any]:
        """The table that `from_data` takes."""
        return self.definition.to_data()

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """As stated, in either space."""
        return self.definition.parameters

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Add what the formulas say."""
        added, at = formulas_of(self.definition).values(chain, p)
        if self.stage is Stage.TIP_BODY:
            return _touched(chain, added, at)
        channels = chain.space.channels
        if self.stage is Stage.ZERO:
            return replace(chain, zero=chain.zero + sp.Matrix([added.get(c, sp.S.Zero) for c in channels]))
        size = len(channels)
        leak = sp.Matrix(size, size, lambda i, j: added.get(f"{channels[i]}_{channels[j]}", sp.S.Zero))
        return replace(chain, gain=(sp.eye(size) + leak) * chain.gain)

    def nuisance_grid(self, extent: Extent) -> tuple[Values, ...]:
        """Every combination of the values that are searched."""
        names = [name for name, _ in self.definition.search]
        return tuple(dict(zip(names, row, strict=True)) for row in product(*(v for _, v in self.definition.search)))


def _touched(chain: Chain, added: Mapping[str, sp.Expr], at: sp.Expr) -> Chain:
    """The chain with a wrench on the tool: in the tool's axes about the sensor, and forces of the world at a point."""
    force, torque = applied(chain.space, [added.get(name, sp.S.Zero) for name in components(chain.space)])
    chain = replace(chain, force=chain.force + force, torque=chain.torque + torque)
    world = in_plane(chain.space, *(added.get(f"force_{a}", sp.S.Zero) for a in chain.space.axes))
    return pushed(chain, chain.motion.rotation.T * world, at)
