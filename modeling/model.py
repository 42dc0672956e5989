"""WrenchModel: channels, inputs, parameters and symbolic prediction, from which everything else is emitted."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import permutations, product
from typing import TypeVar

from modeling import symbolic as sp
from modeling.actual_arm import ActualArm
from modeling.chain import Chain, Stage, rigid_chain
from modeling.column import Column
from modeling.description import described
from modeling.effect import Effect
from modeling.errors import InputError
from modeling.kinematics import Arm
from modeling.outline import Outline
from modeling.parameter import Parameter
from modeling.rig import STANDARD_GRAVITY, Convention, Rig
from modeling.space import Space
from modeling.steps import Definitions, needed
from modeling.store import Data, stored
from modeling.tip import body_parameters

T = TypeVar("T")
QuarterTurns = tuple[tuple[int, int, int], tuple[int, int, int], tuple[int, int, int]]
ALIGNED: QuarterTurns = ((1, 0, 0), (0, 1, 0), (0, 0, 1))


def _quarter_turns() -> tuple[QuarterTurns, ...]:
    """The 24 rotations that take axes to axes: signed permutations without a mirror."""
    turns = []
    for order, signs in product(permutations(range(3)), product((1, -1), repeat=3)):
        rows = [[signs[i] if j == order[i] else 0 for j in range(3)] for i in range(3)]
        if _determinant(rows) == 1:
            first, second, third = ((row[0], row[1], row[2]) for row in rows)
            turns.append((first, second, third))
    return tuple(turns)


def _determinant(rows: list[list[int]]) -> int:
    a, b, c = rows
    return sum(a[i] * (b[i - 2] * c[i - 1] - b[i - 1] * c[i - 2]) for i in range(3))


QUARTER_TURNS = _quarter_turns()


@dataclass(frozen=True, kw_only=True)
class WrenchModel:
    """What a wrist sensor reads when a rigid tool with the given effects moves.

    reading = clip(H(s) play(load(signals; parameters)) + zero(signals; parameters)), most of it absent in most models;
    planar and six-axis models are two instances (`space`). `convention` is the sign of the readings: ON_TOOL is
    F = m (a - g) (22.8 in the plane), ON_SENSOR its negative, AUTO is decided from the data before a fit. `mirror_y`
    turns the y channel round. `mounting` are the rows of the rotation by quarter turns from the axes of the motion to
    those of the readings; smaller angles are an effect (`sensor_rotation`). `arm` is what effects of joints and links
    act on.
    """

    space: Space
    gravity: float = STANDARD_GRAVITY
    convention: Convention = Convention.ON_TOOL
    mirror_y: bool = False
    mounting: QuarterTurns = ALIGNED
    effects: tuple[Effect, ...] = ()
    arm: Arm | None = None

    def __add__(self, effect: Effect | Iterable[Effect]) -> WrenchModel:
        """The model with one more effect (or several) in its chain."""
        added = (effect,) if isinstance(effect, Effect) else tuple(effect)
        for place, new in enumerate(added):
            if self.space not in new.spaces:
                raise InputError(
                    what=f"'{new.id}' does not exist for {len(self.space.channels)} channels",
                    where="effect id",
                    remedy="see `truewrench effects` for where each applies",
                )
            if any(new.id == old.id for old in (*self.effects, *added[:place])):
                raise InputError(
                    what=f"'{new.id}' is in the model already",
                    where="effect id",
                    remedy="add each effect once",
                )
        return replace(self, effects=self.effects + tuple(new.fitting(self.arm) for new in added))

    def without(self, effect_id: str) -> WrenchModel:
        """The model less that effect."""
        return replace(self, effects=tuple(e for e in self.effects if e.id != effect_id))

    def of_arm(self, arm: Arm | None) -> WrenchModel:
        """The model with that arm, unless it has one."""
        if self.arm is not None or arm is None or arm.space is not self.space:
            return self
        return replace(self, arm=arm, effects=tuple(effect.fitting(arm) for effect in self.effects))

    @property
    def base(self) -> WrenchModel:
        """The model of the rigid tool alone."""
        return replace(self, effects=())

    @property
    def lasting(self) -> WrenchModel:
        """The model less the effects that belong to one recording (a push, a wandering zero)."""
        return replace(self, effects=tuple(e for e in self.effects if not e.per_recording))

    @property
    def designable(self) -> WrenchModel:
        """The model less the effects for which no motion can be designed."""
        return replace(self, effects=tuple(e for e in self.effects if e.designable))

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the wrench's channels."""
        return self.space.channels

    @cached_property
    def biases(self) -> tuple[Parameter, ...]:
        """The zero point of each channel, in its unit."""
        return tuple(
            Parameter(name=f"bias_{channel}", unit=unit)
            for channel, unit in zip(self.channels, self.space.units, strict=True)
        )

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Biases, inertial parameters (22.6), then those of the effects in the order added."""
        own = tuple(p for effect in self.effects for p in effect.qualified(self.space))
        return self.biases + body_parameters(self.space) + own

    @property
    def base_size(self) -> int:
        """How many of the parameters belong to the rigid tool and the biases."""
        return len(self.biases) + len(body_parameters(self.space))

    @cached_property
    def chain(self) -> Chain:
        """Every stage as an expression, with all effects in it, in the order of the stages."""
        sign = -1 if self.convention is Convention.ON_SENSOR else 1
        signs = tuple(-sign if self.mirror_y and c == "fy" else sign for c in self.channels)
        zero = sp.Matrix([p.symbol for p in self.biases])
        jointed = self.arm is not None and any(effect.needs_joints for effect in self.effects)
        chain = rigid_chain(
            self.space,
            gravity=self.gravity,
            sign=signs,
            zero=zero,
            mounting=sp.Matrix(self.mounting),
            arm=ActualArm.as_described(self.arm) if jointed and self.arm is not None else None,
        )
        stages = list(Stage)
        for effect in sorted(self.effects, key=lambda e: stages.index(e.stage)):
            chain = effect.applied(chain)
        return chain

    @cached_property
    def load(self) -> sp.Matrix:
        """The reading before play, memory and zero, (p, 1), in the signals that `definitions` explain."""
        return self.chain.load()

    @cached_property
    def definitions(self) -> Definitions:
        """Steps in order that say what signals are in terms of those of the joints; mostly none."""
        return self.chain.definitions()

    @property
    def zero(self) -> sp.Matrix:
        """What is added after memory: biases and drift, (p, 1)."""
        return self.chain.zero

    @property
    def memory(self) -> sp.Expr:
        """Transfer function in s from load to reading."""
        return self.chain.memory

    @property
    def direct(self) -> bool:
        """Whether load, memory and zero are all: no play, no bend, no clipping, no arm in between."""
        chain = self.chain
        return chain.play is None and chain.bend is None and chain.level is None and chain.arm is None

    def require_direct(self, where: str) -> None:
        """Raise InputError, naming the effects at fault, when the model is not `direct`."""
        if not self.direct:
            names = ", ".join(e.id for e in self.effects if e.needs_joints or not e.stage.adds)
            raise InputError(what=f"it cannot be done with {names}", where=where, remedy="leave that effect out")

    def inputs_of(self, expression: sp.Matrix) -> tuple[str, ...]:
        """Names of the signals that an expression of this model is made of in the end, sorted."""
        used = set(expression.free_symbols)
        for symbol, step in needed(self.definitions, expression):
            used = (used - {symbol}) | step.free_symbols
        own = {p.symbol for p in self.parameters} | {symbol for symbol, _ in self.definitions}
        bend = () if self.chain.bend is None else self.chain.bend.signals
        return tuple(sorted(s.name for s in used - own - set(bend) if isinstance(s, sp.Symbol)))

    @cached_property
    def columns(self) -> Mapping[str, Column]:
        """The symbolic parts: load and zero, play and level where there are such, and what a bend adds.

        `bent load` and `equilibrium` have the bend's signals among their parameters, and the same inputs.
        """
        chain, symbols = self.chain, tuple(p.symbol for p in self.parameters)
        parts = {"load": self.load, "zero": chain.zero, "play": chain.play, "level": chain.level}
        there = {name: part for name, part in parts.items() if part is not None}
        found = {n: Column(part, self.inputs_of(part), symbols, self.definitions) for n, part in there.items()}
        if chain.bend is not None:
            bent, equilibrium = symbols + chain.bend.signals, chain.equilibrium()
            inputs = self.inputs_of(sp.Matrix.vstack(self.load, equilibrium))
            found["bent load"] = Column(self.load, inputs, bent, self.definitions)
            found["equilibrium"] = Column(equilibrium, inputs, bent, self.definitions)
        return found

    @cached_property
    def outline(self) -> Outline:
        """What can be said of the model before it is evaluated, from the store where it was derived once."""
        return self.stored("outline", lambda: Outline.of(self.columns, self.memory).to_data(), Outline.from_data)

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of all signals that the prediction needs."""
        return self.outline.inputs

    def stored(self, part: str, derive: Callable[[], Data], read: Callable[[Data], T]) -> T:
        """What `read` makes of the data that `derive` gives of a part of this model, derived once for all processes."""
        if self._described is None:
            return read(derive())
        return stored({"part": part, "model": self._described}, derive, read)

    @cached_property
    def _described(self) -> str | None:
        """All that its derivations depend on; None with an effect from elsewhere, whose source nobody follows."""
        own = self if any(effect.needs_joints for effect in self.effects) else replace(self, arm=None)
        try:
            return json.dumps(described(own), sort_keys=True)
        except TypeError:
            return None


def planar(rig: Rig | None = None) -> WrenchModel:
    """The planar model of 22.6: bias_fx, bias_fy, bias_tau, m, mlg, I, in the rig's gravity and signs.

    Readings are `on_tool` unless the rig says otherwise.
    """
    return _of_rig(Space.PLANE, rig, Convention.ON_TOOL)


def spatial(rig: Rig | None = None) -> WrenchModel:
    """The six-axis model: six biases and ten inertial parameters; its sign is decided by the data unless stated."""
    return _of_rig(Space.SPACE, rig, Convention.AUTO)


def _of_rig(space: Space, rig: Rig | None, default: Convention) -> WrenchModel:
    if rig is None:
        return WrenchModel(space=space, convention=default)
    sensor, arm = rig.sensor, rig.arm if rig.arm is not None and rig.arm.space is space else None
    stated = sensor.convention if sensor is not None and sensor.convention is not None else default
    mirror = bool(sensor is not None and sensor.mirror_y)
    return WrenchModel(space=space, gravity=rig.gravity, convention=stated, mirror_y=mirror, arm=arm)
