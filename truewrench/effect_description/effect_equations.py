"""Equations of an effect, derived: what it changes of the readings, from its perturbation of the chain."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import sympy as sp

from modeling.chain.chain import Chain
from modeling.chain.effect import Effect
from modeling.chain.model import WrenchModel
from modeling.chain.stages import Bias, LinearDynamics, Mounting, Play, Stage, SymbolicMap
from modeling.kinematics.perturbed_arm import PerturbedArm
from modeling.space import SensorMotion, Space, vector
from truewrench.effect_description.mathml import channel_letter, equation_mathml

MOST_OPERATIONS = 60
"""Of a right side that a reader takes in; longer ones are left out."""
MOST_EQUATIONS = 6
NEGLIGIBLE = 1e-9
"""A constant below it is there to smooth a root at zero."""
MOTION = (
    "Δ is the change of the reading. In the axes of the logged pose: v is the velocity of the sensor's origin, a its "
    "acceleration less gravity, ω the angular velocity, α the angular acceleration."
)
EVENT = " S is 1 during the event, and 0 before and after."
GRAVITY = "g is gravity in world axes."
DEFLECTION = "T is the torque of the sensor on the tool, θ the rotation of the tool relative to the sensor."
READING = "w is the wrench at the sensor, y the reading; the subscript is the channel."
DYNAMICS = "H is the transfer function from load to reading, s the Laplace variable."
BIAS = "Δ is the change of the reading."
JOINT = "q and l are as recorded and described, T is the torque of the tool's weight about the joint."
SENTENCES = dict.fromkeys(Stage, READING) | {
    Stage.JOINTS: JOINT,
    Stage.KINEMATICS: JOINT,
    Stage.TIP_BODY: MOTION,
    Stage.DEFLECTION: DEFLECTION,
    Stage.LINEAR_DYNAMICS: DYNAMICS,
    Stage.BIAS: BIAS,
}
"""On the symbols, by the stage that an effect acts on."""


@dataclass(frozen=True)
class EffectEquations:
    """Equations, pairs of a left and a right side, and a sentence on their symbols.

    effect   whose parameters are in the equations
    """

    pairs: tuple[tuple[sp.Basic, sp.Basic], ...]
    symbols: str
    effect: Effect

    @property
    def mathml(self) -> list[str]:
        """Each equation as a `<math>` element."""
        return [equation_mathml(left, right, self.effect) for left, right in self.pairs]


class ChainInSensorAxes(Chain):
    """A chain whose motion is given in sensor axes, which keeps its equations short."""

    @property
    def motion(self) -> SensorMotion:
        """Velocity, angular velocity and the like of the sensor, in its own axes."""
        return SensorMotion(
            rotation=sp.eye(3),
            omega=_turning(self.space, "omega"),
            alpha=_turning(self.space, "alpha"),
            position=_along(self.space, "p"),
            velocity=_along(self.space, "v"),
            acceleration=_along(self.space, "a") + self.gravity,
        )


def effect_equations(effect: Effect, model: WrenchModel) -> EffectEquations | None:
    """What the effect changes, derived from its perturbation; None where no equation is short enough to be read."""
    chain = _chain_in_sensor_axes(model)
    changes = list(_changes(chain, effect.applied(chain)))
    if not changes or any(right.has(*_position(model.space)) for _, right in changes):
        return None
    pairs = [(left, _readable(right)) for left, right in changes]
    if max(sp.count_ops(right) for _, right in pairs) > MOST_OPERATIONS:
        return None
    symbols = GRAVITY if pairs[0][0] == sp.Symbol("g_x") else SENTENCES[effect.stage]
    symbols += _letter_sentence(effect, model.space)
    symbols += EVENT if any(right.has(sp.Symbol("S")) for _, right in pairs) else ""
    return EffectEquations(tuple(pairs[:MOST_EQUATIONS]), symbols, effect)


def _letter_sentence(effect: Effect, space: Space) -> str:
    """What a letter with a channel as its index is, where parameters are named as channels."""
    letters = {channel_letter(effect, p.name): p.name for p in effect.parameters(space)}
    letters.pop("", None)
    return "".join(f" {letter} is the parameter of the channel in its index." for letter in letters)


def _readable(expression: sp.Expr) -> sp.Expr:
    """The expression without constants that only smooth it, and with S for what switches an event on."""
    tiny = {number: sp.S.Zero for number in expression.atoms(sp.Float) if 0 < abs(number) < NEGLIGIBLE}
    short = expression.xreplace(tiny)
    switches = [s for s in short.atoms(sp.Min) if s.has(sp.Symbol("time", real=True))]
    for switch in sorted(switches, key=sp.count_ops, reverse=True):
        short = short.xreplace({switch: sp.Symbol("S")})
    return sp.factor_terms(sp.expand(short)) if sp.count_ops(short) > sp.count_ops(sp.expand(short)) else short


def _chain_in_sensor_axes(model: WrenchModel) -> ChainInSensorAxes:
    """The chain of the model without its effects, about a general motion, with an arm whose errors are zero."""
    bare = replace(model, effects=()).chain
    fields = {name: getattr(bare, name) for name in bare.__dataclass_fields__}
    joints = 0 if model.arm is None else model.arm.joints
    none = (sp.S.Zero,) * joints
    arm = PerturbedArm(arm=cast("Any", None), offsets=none, compliances=none, widths=none, errors=none)
    gravity = -sp.Symbol("g") * model.space.up
    return ChainInSensorAxes(**fields | {"gravity": gravity, "arm": arm})


def _changes(before: Chain, after: Chain) -> Iterator[tuple[sp.Basic, sp.Basic]]:
    """Every quantity of the chain that differs, as an equation."""
    if after.arm != before.arm:
        yield from _joint_equations(cast("PerturbedArm", after.arm))
    elif after.deflection is not None:
        angle = sp.Symbol("theta")
        rate = sp.Derivative(angle, sp.Symbol("t"))
        yield sp.Symbol("T"), -after.deflection.stiffness * angle - after.deflection.damping * rate
    elif after.gravity != before.gravity:
        yield from zip(sp.symbols("g_x g_y g_z"), list(after.gravity)[: len(before.space.axes)], strict=False)
    elif (after.force, after.torque, after.body) != (before.force, before.torque, before.body):
        yield from _named("Delta", before, list(after.load() - before.load()))
    for stage in after.stages:
        if stage not in before.stages:
            yield from _stage_equations(before, stage)


def _joint_equations(arm: PerturbedArm) -> Iterator[tuple[sp.Basic, sp.Basic]]:
    """The true coordinate of each joint, or the true length of each link."""
    errors = zip(arm.offsets, arm.compliances, arm.widths, arm.errors, strict=True)
    for number, (offset, compliance, width, error) in enumerate(errors, start=1):
        if error != 0:
            yield sp.Symbol(f"l_{number}^true"), sp.Symbol(f"l_{number}") + error
            continue
        load = sp.Symbol(f"T_{number}")
        yield (
            sp.Symbol(f"q_{number}^true"),
            sp.Symbol(f"q_{number}") + offset + compliance * load + width / 2 * sp.Function("sign")(load),
        )


def _stage_equations(before: Chain, stage: Any) -> Iterator[tuple[sp.Basic, sp.Basic]]:
    """What a stage of the sensor does to its input."""
    channels = before.space.channels
    if isinstance(stage, LinearDynamics):
        yield sp.Symbol("H"), stage.transfer_function
    elif isinstance(stage, Bias):
        yield from _named("Delta", before, list(stage.value - before.bias))
    elif isinstance(stage, Play):
        for channel, width in zip(channels, stage.width, strict=True):
            y, last, load = sp.Symbol(f"y_{channel}"), sp.Symbol(f"y_{channel}^last"), sp.Symbol(f"w_{channel}")
            yield y, sp.Min(sp.Max(last, load - width), load + width)
    elif isinstance(stage, SymbolicMap):
        wrench = [sp.Symbol(f"w_{name}") for name in channels]
        given = _true_wrench(before.space, wrench) if isinstance(stage, Mounting) else sp.Matrix(wrench)
        yield from _named("y", before, list(stage.map(given)))


def _true_wrench(space: Space, components: Sequence[sp.Symbol]) -> sp.Matrix:
    """The wrench (6, 1) with these measured components and zeros."""
    wrench = sp.zeros(6, 1)
    for row, component in zip(space.rows, components, strict=True):
        wrench[row] = component
    return wrench


def _named(letter: str, chain: Chain, values: Sequence[sp.Expr]) -> Iterator[tuple[sp.Basic, sp.Basic]]:
    """letter_channel = value, of the values that are not zero."""
    for channel, value in zip(chain.space.channels, values, strict=True):
        if value != 0:
            yield sp.Symbol(f"{letter}_{channel}"), value


# ------------------------------------------------------------------------------- symbols in sensor axes


def _along(space: Space, letter: str) -> sp.Matrix:
    """A vector by its components along x and y (planar e2 is -y), or along x, y and z."""
    x, y, z = (sp.Symbol(f"{letter}_{axis}", real=True) for axis in "xyz")
    return vector(x, -y, 0) if space is Space.PLANE else vector(x, y, z)


def _turning(space: Space, letter: str) -> sp.Matrix:
    """An axial vector."""
    if space is Space.PLANE:
        return vector(0, 0, sp.Symbol(letter, real=True))
    return vector(*(sp.Symbol(f"{letter}_{axis}", real=True) for axis in "xyz"))


def _position(space: Space) -> tuple[sp.Symbol, ...]:
    """Of the sensor in the world, about which an equation in sensor axes says nothing."""
    return tuple(_along(space, "p").free_symbols)
