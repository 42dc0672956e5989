"""A custom effect: formulas of one sample's signals that perturb one stage of the chain."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from modeling import symbolic as sp
from modeling.chain.chain import Chain, Stage, point_on_tip, rigid_chain, world_vector
from modeling.chain.effect import Effect, NuisanceValues, SearchDomain
from modeling.chain.prediction import Signals, VectorFunction
from modeling.chain.stages import Bias, Gain
from modeling.effects.loads import with_force
from modeling.errors import InputError
from modeling.formulas.definition import EffectDefinition, parse_definition, parsed_formulas, read_table
from modeling.parameter import Parameter
from modeling.rigid_body import contact_components, contact_force_torque
from modeling.space import Space

Array = NDArray[np.float64]

# Checks that a custom effect is finite, vanishes at nominal values and is identifiable to first order.


RANDOM_POINTS = 1024
"""Random points at which an effect is evaluated: enough for one that acts in a hundredth of the space."""
SIGNAL_DECADES = 2.0
"""Random signals are 10^-2 to 10^2 of their unit, of either sign: beyond any rig, below any overflow."""
GRID_CHUNK = 64
"""Grid points evaluated together: all of them with all samples would not fit into memory."""
VANISHING_TOLERANCE = 1e-9
"""Of values of order one, far above the rounding of a few hundred operations."""


def require_identifiable(definition: EffectDefinition, where: str) -> None:
    """Raise InputError unless the effect vanishes at nominal values and is identifiable to first order there.

    The score test uses the derivative at the nominal values: it would never find an amplitude that enters squared.
    """
    space = parsed_formulas(definition).spaces[0]
    try:
        value, derivative = _at_random_points(definition, space)
    except (InputError, TypeError, ValueError):  # SymPy simplified it to a function that CasADi lacks
        remedy = "give atan2, abs, min and max arguments that are real and not constant"
        place = f"{where}: {definition.key}"
        raise InputError(
            what="one of its functions has no counterpart in generated code", where=place, remedy=remedy
        ) from None
    keys = [f"{definition.key}.{name}" for name, _ in definition.formulas]
    finite = np.isfinite(value) & np.isfinite(derivative).all(axis=2)
    for channel, key in enumerate(keys):
        if not finite[:, channel].any():
            remedy = "check for a root of a negative number, a division by zero, an exp of a large number"
            raise InputError(what="it is not finite at any random point", where=f"{where}: {key}", remedy=remedy)
        if np.abs(value[finite[:, channel], channel]).max() > VANISHING_TOLERANCE:
            what = "it does not vanish at the nominal values of its amplitudes"
            remedy = "multiply it by an amplitude, or give the nominal values"
            raise InputError(what=what, where=f"{where}: {key}", remedy=remedy)
    largest = np.where(finite[:, :, None], np.abs(derivative), 0.0).max(axis=(0, 1))
    for parameter, sensitivity in zip(_amplitudes(definition), largest, strict=True):
        if not sensitivity > 0:
            what = "it is not identifiable to first order: the effect has no sensitivity to it at nominal values"
            remedy = "let the effect be proportional to it, or give it `search` as a nuisance parameter"
            raise InputError(what=what, where=f"{where}: parameters.{parameter.name}", remedy=remedy)


def require_finite(definition: EffectDefinition, space: Space, signals: Signals, samples: int, where: str) -> None:
    """Raise InputError where the effect is not finite on a recording's signals, at any point of the search grid.

    `signals` are those of the recording by name, each (samples,); nothing is checked when one is missing.
    """
    parameters = definition.parameters
    function = _vector_function(definition, space, tuple(p.name for p in parameters))
    if not set(function.inputs) <= set(signals):
        return
    amplitudes = tuple(i for i, p in enumerate(parameters) if not p.nuisance)
    grid = [[values.get(p.name, p.nominal) for p in parameters] for values in definition.nuisance_grid]
    for first in range(0, len(grid), GRID_CHUNK):
        derivative = function.jacobians(signals, np.array(grid[first : first + GRID_CHUNK]), amplitudes, samples)
        wrong = np.argwhere(~np.isfinite(derivative))
        if len(wrong):
            sample, formula, point, _ = wrong[0]
            key = f"{definition.key}.{definition.formulas[formula][0]}"
            at = ", ".join(
                f"{p.name} = {v:.4g}" for p, v in zip(parameters, grid[first + point], strict=True) if p.nuisance
            )
            what = f"{definition.id}: {key} is not finite at sample {sample + 1}{' with ' * bool(at)}{at}"
            remedy = "keep roots and quotients away from that sample, or search other values"
            raise InputError(what=what, where=where, remedy=remedy)


def _amplitudes(definition: EffectDefinition) -> list[Parameter]:
    return [p for p in definition.parameters if not p.nuisance]


def _at_random_points(definition: EffectDefinition, space: Space) -> tuple[Array, Array]:
    """Values (points, formulas) and derivatives (points, formulas, amplitudes) at nominal amplitudes."""
    amplitudes = _amplitudes(definition)
    function = _vector_function(definition, space, tuple(p.name for p in amplitudes))
    nominal = np.array([p.nominal for p in amplitudes])
    return function.tangent(_random_signals(definition, function.inputs), nominal, RANDOM_POINTS)


def _vector_function(definition: EffectDefinition, space: Space, names: tuple[str, ...]) -> VectorFunction:
    """The formulas as a function of the parameters `names`; other parameters are inputs, like signals."""
    size = len(space.channels)
    chain = rigid_chain(space, gravity=0.0, sign=(1,) * size, bias=sp.zeros(size, 1), mounting=sp.eye(3))
    parameters = {p.name: sp.Symbol(p.name, real=True) for p in definition.parameters}
    added, _ = parsed_formulas(definition).values(chain, parameters)
    expressions, symbols = sp.Matrix(list(added.values())), tuple(parameters[name] for name in names)
    inputs = tuple(sorted(s.name for s in expressions.free_symbols - set(symbols)))
    return VectorFunction.of(expressions, inputs, symbols)


def _random_signals(definition: EffectDefinition, inputs: tuple[str, ...]) -> dict[str, Array]:
    rng, searched = np.random.default_rng(0), dict(definition.search)
    values = {}
    for name in inputs:
        size = 10.0 ** rng.uniform(-SIGNAL_DECADES, SIGNAL_DECADES, RANDOM_POINTS)
        values[name] = size * rng.choice([-1.0, 1.0], RANDOM_POINTS)
        if name in searched:
            values[name] = rng.choice(np.array(searched[name]), RANDOM_POINTS)
    if "time" in values:
        values["time"] = np.abs(values["time"])
    quaternion = rng.normal(size=(4, RANDOM_POINTS))
    return values | dict(zip(("qx", "qy", "qz", "qw"), quaternion / np.linalg.norm(quaternion, axis=0), strict=True))


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
    gain      `<row>_<column>`: reading row += formula times the true channel column; the formula may name channels,
              which are the true loads
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
