"""A custom effect: formulas of one sample's signals that perturb one stage of the chain."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

from modeling import symbolic as sp
from modeling.chain.chain import Chain, Stage, point_on_tip, world_vector
from modeling.chain.effect import Effect, NuisanceValues, SearchDomain
from modeling.chain.stages.bias_stage import Bias
from modeling.chain.stages.calibration_stage import Gain
from modeling.effects.point_effect import with_force
from modeling.formulas.custom_effects.definition import EffectDefinition
from modeling.formulas.custom_effects.definition_parser import parse_definition
from modeling.formulas.custom_effects.effect_check import require_identifiable
from modeling.formulas.custom_effects.effect_schema import read_table
from modeling.formulas.custom_effects.parsed_formulas import parsed_formulas
from modeling.parameter import Parameter
from modeling.space import Space
from modeling.tool.wrench_components import contact_components, contact_force_torque


def _from_definition(name: str) -> Any:
    """An attribute of the definition; a class attribute of the catalogue's effects."""
    return property(lambda effect: getattr(effect.definition, name))


def _from_formulas(name: str) -> Any:
    """An attribute that follows from the formulas."""
    return property(lambda effect: getattr(parsed_formulas(effect.definition), name))


@dataclass(frozen=True)
class CustomEffect(Effect):
    """Formulas of named signals, parameters and constants, added to one stage of the chain.

    tip body  force_x, force_y, force_z (N): the environment's force on the tool along the world's axes, at the point
              `at` (m) along the tip, with position tip_x .. (m) and velocity tip_vx .. (m/s); or the components of
              its wrench in the tool's axes about the sensor origin: fcx, fcy, tauc, or fcx .. tcz
    gain      `<row>_<column>`: reading row += formula times the true channel column
    zero      bias fx, fy, tau or fx .. tz: added to the readings last, in any sign convention

    Nuisance parameters (grid search) are not identifiable at the nominal values of the others: the effect vanishes.
    """

    definition: EffectDefinition
    reads_motion = True  # a formula of any stage may

    id = _from_definition("id")
    title = _from_definition("title")
    stage = _from_definition("stage")
    equation = _from_definition("equation")
    advice = _from_definition("advice")
    per_recording = _from_definition("per_recording")
    spaces = _from_formulas("spaces")
    needs_repeats = _from_formulas("needs_repeats")

    @classmethod
    def from_data(cls, data: object, *, where: str = "effect") -> Self:
        """The effect from a table of plain data, as read from TOML and JSON.

        Raises InputError, in one line that names key and column, for an invalid definition: syntax errors, wrong
        units, an effect that does not vanish at nominal values or is not identifiable to first order there.
        """
        definition = parse_definition(read_table(data, where), where)
        require_identifiable(definition, where)
        return cls(definition)

    def to_data(self) -> dict[str, Any]:
        """The table that `from_data` takes."""
        return self.definition.to_data()

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """Those of the definition, in either space."""
        return self.definition.parameters

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Add the formulas to their stage."""
        added, at = parsed_formulas(self.definition).values(chain, p)
        if self.stage is Stage.TIP_BODY:
            return _with_contact_wrench(chain, added, at)
        channels = chain.space.channels
        if self.stage is Stage.BIAS:
            return chain.with_stage(Bias(chain.bias + sp.Matrix([added.get(c, sp.S.Zero) for c in channels])))
        size = len(channels)
        increment = sp.Matrix(size, size, lambda i, j: added.get(f"{channels[i]}_{channels[j]}", sp.S.Zero))
        return chain.with_stage(replace(chain[Gain], matrix=(sp.eye(size) + increment) * chain[Gain].matrix))

    def nuisance_grid(self, domain: SearchDomain) -> tuple[NuisanceValues, ...]:
        """Every combination of the values of the nuisance parameters."""
        return self.definition.nuisance_grid


def _with_contact_wrench(chain: Chain, added: Mapping[str, sp.Expr], at: sp.Expr) -> Chain:
    """The chain with a wrench on the tool: in its axes about the sensor, plus world-frame forces at a point."""
    force, torque = contact_force_torque(
        chain.space, [added.get(name, sp.S.Zero) for name in contact_components(chain.space)]
    )
    chain = replace(chain, force=chain.force + force, torque=chain.torque + torque)
    world = world_vector(chain.space, *(added.get(f"force_{a}", sp.S.Zero) for a in chain.space.axes))
    return with_force(chain, chain.motion.rotation.T * world, point_on_tip(chain, at))
