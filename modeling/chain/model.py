"""Wrench model: channels, inputs, parameters and symbolic prediction."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from html import escape
from itertools import permutations, product
from typing import Any, NoReturn, Self, TypeVar

from modeling import symbolic as sp
from modeling.chain.chain import Chain, rigid_chain
from modeling.chain.effect import Effect, effects_of
from modeling.chain.stages import Bias, LinearDynamics, Stage
from modeling.compiled.cache import PlainData, cached, canonical_data
from modeling.compiled.straight_line_program import Definitions, symbols_of
from modeling.compiled.symbolic_vector import SymbolicVector
from modeling.errors import InputError, kind_of, quoted, suggestion
from modeling.kinematics.arm import Arm
from modeling.kinematics.perturbed_arm import PerturbedArm
from modeling.kinematics.placement import Direction
from modeling.parameter import Parameter
from modeling.rig import STANDARD_GRAVITY, Convention, Rig
from modeling.rigid_body import inertial_parameters
from modeling.space import Space
from modeling.table import Column, Table


@dataclass(frozen=True, kw_only=True)
class ModelPart:
    """Outline of a vector of expressions: its input signals, parameter names, and active parameters."""

    inputs: tuple[str, ...]
    names: tuple[str, ...]
    active: tuple[int, ...]

    def among(self, fewer: Sequence[str], more: Sequence[str]) -> ModelPart:
        """The part of a model with the parameters `fewer` in one with `more` of them, in place of its own."""
        names = (*more, *self.names[len(fewer) :])
        return ModelPart(inputs=self.inputs, names=names, active=tuple(names.index(self.names[i]) for i in self.active))


@dataclass(frozen=True, kw_only=True)
class ModelOutline:
    """Outline of a model: its parts by name (see `WrenchModel.columns`), and the classes of stages after the load."""

    parts: Mapping[str, ModelPart]
    stages: tuple[str, ...]

    @classmethod
    def of(cls, model: WrenchModel) -> Self:
        """The outline of derived expressions."""
        load, sensor = model.of_load, model.of_sensor
        if model not in (load, sensor):
            return cls(parts=_parts_in(model, load) | _parts_in(model, sensor), stages=sensor.outline.stages)
        parts = {n: ModelPart(inputs=c.inputs, names=c.names, active=c.active) for n, c in model.columns.items()}
        return cls(parts=parts, stages=tuple(type(stage).__name__ for stage in model.chain.dynamics))

    @classmethod
    def from_data(cls, data: Mapping[str, Any]) -> Self:
        """Inverse of `to_data`; KeyError or TypeError for other data."""
        parts = {name: _part(**fields) for name, fields in data["parts"].items()}
        return cls(parts=parts, stages=tuple(data["stages"]))

    def to_data(self) -> dict[str, Any]:
        """The outline as plain data."""
        return asdict(self)

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of all input signals of the parts, and the time if the model has a transfer function."""
        names = {name for part in self.parts.values() for name in part.inputs}
        return tuple(sorted(names | ({"time"} if LinearDynamics.__name__ in self.stages else set())))


def _parts_in(model: WrenchModel, reduced: WrenchModel) -> dict[str, ModelPart]:
    """The parts of the model that one with fewer effects has as well, by name."""
    fewer, more = ([p.name for p in m.parameters] for m in (reduced, model))
    parts = reduced.outline.parts.items()
    return {name: part.among(fewer, more) for name, part in parts if model.reduced_to(name) == reduced}


def _part(*, inputs: list[str], names: list[str], active: list[int]) -> ModelPart:
    return ModelPart(inputs=tuple(inputs), names=tuple(names), active=tuple(active))


LOAD_PARTS = ("load", "deflected load", "equilibrium")
"""Parts that no effect after the nonlinearity acts on; effects up to the nonlinearity act on no other part."""

T = TypeVar("T")
QuarterTurnRotation = tuple[tuple[int, int, int], tuple[int, int, int], tuple[int, int, int]]
ALIGNED_MOUNTING: QuarterTurnRotation = ((1, 0, 0), (0, 1, 0), (0, 0, 1))


def _quarter_turns() -> tuple[QuarterTurnRotation, ...]:
    """The 24 proper rotations that map axes to axes: signed permutations of determinant 1."""
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
    """Model of the readings of a wrist sensor that carries a rigid tool, with the given effects.

    `planar` and `spatial` give one; `model + effect` is a model again.

    Parameters
    ----------
    space : Space
        Plane or six axes.
    gravity : float, optional
        m/s², by default 9.806.
    gravity_direction : tuple of float, optional
        Unit vector along gravity in base axes, as the rig has it; the world of the recordings is then the base turned
        by the least angle that points gravity down. By default not stated.
    convention : Convention, optional
        Sign of the readings: ON_TOOL is F = m (a - g) (22.8, Bassi et al., in the plane) and the default, ON_SENSOR its
        negative, AUTO is estimated before a fit.
    mirror_y : bool, optional
        Whether the y channel is inverted, by default False.
    mounting : rows of a rotation, optional
        By multiples of 90° from the axes of the motion to those of the readings; other angles are an effect
        (`sensor_rotation`).
    effects : tuple of Effect, optional
        In the order of addition.
    arm : Arm, optional
        On which effects of joints and links act.

    Notes
    -----
    reading = clip(H(s) play(load(signals; parameters)) + bias(signals; parameters)), most terms absent in most models.

    Examples
    --------
    >>> import truewrench as tw
    >>> model = tw.planar() + "viscous_drag"  # or an effect: + tw.effects.viscous_drag()
    >>> [p.name for p in model.parameters][-2:]
    ['viscous_drag.c', 'viscous_drag.d']
    """

    space: Space
    gravity: float = STANDARD_GRAVITY
    gravity_direction: Direction | None = None
    convention: Convention = Convention.ON_TOOL
    mirror_y: bool = False
    mounting: QuarterTurnRotation = ALIGNED_MOUNTING
    effects: tuple[Effect, ...] = ()
    arm: Arm | None = None

    def __repr__(self) -> str:
        kind = "planar" if self.space is Space.PLANE else "six axes"
        tool = " + ".join(["rigid tool", *(effect.id for effect in self.effects)])
        parameters = ", ".join(parameter.name for parameter in self.parameters)
        return f"WrenchModel: {tool}, {kind}, {self.convention.value}, g = {self.gravity} m/s²; {parameters}"

    @property
    def table(self) -> Table:
        """Every parameter with its unit and range, those of effects with the nominal value, without effect."""
        numbers = (Column(name, format=".4g") for name in ("nominal", "low", "high"))
        nominal = [None] * self.base_size + [p.nominal for p in self.parameters[self.base_size :]]
        rows = [(p.name, p.unit, value, *p.bounds) for p, value in zip(self.parameters, nominal, strict=True)]
        return Table.of(("parameter", "unit", *numbers), rows)

    def _repr_html_(self) -> str:
        return f"<p>{escape(repr(self).partition(';')[0])}</p>\n{self.table.to_html()}"

    def __add__(self, effect: Effect | str | Iterable[Effect | str]) -> WrenchModel:
        """The model with one more effect (or several) in its chain, each itself or by its id."""
        added = effects_of(effect)
        for place, new in enumerate(added):
            if self.space not in new.spaces:
                raise InputError(
                    what=f"'{new.id}' is not defined for {len(self.space.channels)} channels",
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

    def __sub__(self, effect: object) -> NoReturn:
        remedy = "leave an effect out by its id: model.without('viscous_drag')"
        raise InputError(what="nothing is subtracted from a model", where="model", remedy=remedy)

    def without(self, effect: str | Effect) -> WrenchModel:
        """The model without that effect, by its id or itself; InputError when the model lacks it."""
        effect_id, ids = effect if isinstance(effect, str) else effect.id, [e.id for e in self.effects]
        if effect_id not in ids:
            remedy = suggestion(effect_id, ids) if ids else "the model is the rigid tool alone"
            raise InputError(what=f"{quoted(effect_id)} is not in the model", where="effect id", remedy=remedy)
        return replace(self, effects=tuple(e for e in self.effects if e.id != effect_id))

    def with_arm(self, arm: Arm | None) -> WrenchModel:
        """The model with that arm, unless it already has one or is of another space."""
        if self.arm is not None or arm is None or arm.space is not self.space:
            return self
        return replace(self, arm=arm, effects=tuple(effect.fitting(arm) for effect in self.effects))

    @property
    def base(self) -> WrenchModel:
        """The model of the rigid tool alone."""
        return replace(self, effects=())

    @property
    def without_recording_specific(self) -> WrenchModel:
        """The model without recording-specific effects (contact event, bias drift)."""
        return replace(self, effects=tuple(e for e in self.effects if not e.per_recording))

    @property
    def designable(self) -> WrenchModel:
        """The model without effects for which no exciting trajectory can be designed, no parameter fixed."""
        return replace(self.unrestricted, effects=tuple(e for e in self.unrestricted.effects if e.designable))

    @property
    def unrestricted(self) -> WrenchModel:
        """The model with all parameters of its effects free; they have the same names and order."""
        return replace(self, effects=tuple(e.unrestricted(self.space) for e in self.effects))

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the wrench's channels."""
        return self.space.channels

    @cached_property
    def biases(self) -> tuple[Parameter, ...]:
        """The bias of each channel, in its unit."""
        return tuple(
            Parameter(name=f"bias_{channel}", unit=unit)
            for channel, unit in zip(self.channels, self.space.units, strict=True)
        )

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Biases, inertial parameters (22.6), then those of the effects in the order of addition."""
        of_effects = tuple(p for effect in self.effects for p in effect.qualified(self.space))
        return self.biases + inertial_parameters(self.space) + of_effects

    @property
    def base_size(self) -> int:
        """Number of parameters of the rigid tool and the biases."""
        return len(self.biases) + len(inertial_parameters(self.space))

    @cached_property
    def chain(self) -> Chain:
        """The measurement chain with all effects, applied in the order of the stages."""
        sign = -1 if self.convention is Convention.ON_SENSOR else 1
        signs = tuple(-sign if self.mirror_y and c == "fy" else sign for c in self.channels)
        perturbed = self.arm is not None and any(effect.needs_joints for effect in self.effects)
        chain = rigid_chain(
            self.space,
            gravity=self.gravity,
            sign=signs,
            bias=sp.Matrix([p.symbol for p in self.biases]),
            mounting=sp.Matrix(self.mounting),
            arm=PerturbedArm.as_described(self.arm) if perturbed and self.arm is not None else None,
        )
        for effect in sorted(self.effects, key=lambda e: e.stage.number):
            chain = effect.applied(chain)
        return chain

    @cached_property
    def load(self) -> sp.Matrix:
        """The reading before play, transfer function and bias, (p, 1), in signals and `definitions`."""
        return self.chain.load()

    @cached_property
    def definitions(self) -> Definitions:
        """Intermediate variables in order, of joint signals and of deflection; mostly none."""
        return self.chain.definitions()

    @property
    def bias(self) -> sp.Matrix:
        """Biases and drift, added after the transfer function, (p, 1)."""
        return self.chain.bias

    @property
    def transfer_function(self) -> sp.Expr:
        """Transfer function in s from load to reading."""
        return self.chain.transfer_function

    @property
    def direct(self) -> bool:
        """Whether the model is load, transfer function and bias: no play, deflection, saturation or perturbed arm."""
        chain = self.chain
        return chain.deflection is None and chain.arm is None and {*map(type, chain.dynamics)} <= {LinearDynamics, Bias}

    def require_direct(self, where: str) -> None:
        """Raise InputError, naming the effects at fault, when the model is not `direct`."""
        if not self.direct:
            names = ", ".join(e.id for e in self.effects if e.needs_joints or not (self.base + e).direct)
            raise InputError(what=f"it does not support {names}", where=where, remedy="leave that effect out")

    def inputs_of(self, expression: sp.Matrix) -> tuple[str, ...]:
        """Sorted names of the signals on which an expression of this model depends, intermediate variables resolved."""
        used = symbols_of(self.definitions, expression)
        resolved = {p.symbol for p in self.parameters} | {symbol for symbol, _ in self.definitions}
        deflection = () if self.chain.deflection is None else self.chain.deflection.signals
        return tuple(sorted(s.name for s in used - resolved - set(deflection) if isinstance(s, sp.Symbol)))

    @cached_property
    def columns(self) -> Mapping[str, SymbolicVector]:
        """The symbolic parts as vectors of expressions: the load, those of the stages after it, and the deflection.

        `deflected load` and `equilibrium` have the deflection signals among their parameters, and the same inputs.
        """
        chain, symbols = self.chain, tuple(p.symbol for p in self.parameters)
        vectors = {"load": self.load} | {name: vector for s in chain.dynamics for name, vector in s.vectors().items()}
        columns = {
            name: SymbolicVector(vector, self.inputs_of(vector), symbols, self.definitions)
            for name, vector in vectors.items()
        }
        if chain.deflection is not None:
            deflected, equilibrium = symbols + chain.deflection.signals, chain.equilibrium()
            inputs = self.inputs_of(sp.Matrix.vstack(self.load, equilibrium))
            columns["deflected load"] = SymbolicVector(self.load, inputs, deflected, self.definitions)
            columns["equilibrium"] = SymbolicVector(equilibrium, inputs, deflected, self.definitions)
        return columns

    @cached_property
    def outline(self) -> ModelOutline:
        """Outline of the model, from the disk cache if it was derived before."""
        return self.stored("outline", lambda: ModelOutline.of(self).to_data(), ModelOutline.from_data)

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of all input signals of the prediction."""
        return self.outline.inputs

    def reduced_to(self, part_name: str) -> WrenchModel:
        """The model with those effects alone that act on a part: many models have it in common."""
        return self.of_load if part_name in LOAD_PARTS else self.of_sensor

    @cached_property
    def of_load(self) -> WrenchModel:
        """With the effects up to the load alone; itself with an effect of another module, which may act anywhere."""
        return self._with_effects(lambda effect: not _after_load(effect))

    @cached_property
    def of_sensor(self) -> WrenchModel:
        """With the effects after the load alone; itself with an effect of another module, which may act anywhere.

        Where one of these reads the motion, with the effects on the joints as well, which change it.
        """
        moved = any(effect.reads_motion for effect in self.effects if _after_load(effect))
        return self._with_effects(lambda effect: _after_load(effect) or (moved and effect.needs_joints))

    def _with_effects(self, wanted: Callable[[Effect], bool]) -> WrenchModel:
        effects = tuple(filter(wanted, self.effects))
        return self if self._described is None or effects == self.effects else replace(self, effects=effects)

    def stored(self, part_name: str, derive: Callable[[], PlainData], read: Callable[[PlainData], T]) -> T:
        """`read` of the data from `derive` for a part of this model, cached on disk for all processes."""
        if self._described is None:
            return read(derive())
        return cached({"part": part_name, "model": self._described}, derive, read)

    @cached_property
    def _described(self) -> str | None:
        """Cache key of the derivations; None with an effect of another module, whose source is not tracked."""
        jointed = any(effect.needs_joints for effect in self.effects)
        derived_from = replace(self, gravity_direction=None, arm=self.arm if jointed else None)
        try:
            return json.dumps(canonical_data(derived_from), sort_keys=True)
        except TypeError:
            return None


def _after_load(effect: Effect) -> bool:
    """Whether an effect acts on the readings after the load."""
    return effect.stage.number > Stage.NONLINEARITY.number


def planar(rig: Rig | None = None) -> WrenchModel:
    """The planar model of 22.6, with the rig's gravity and signs.

    Parameters
    ----------
    rig : Rig, optional
        Gives gravity (m/s²), signs and arm; by default standard gravity and readings `on_tool`.

    Returns
    -------
    WrenchModel
        Parameters bias_fx, bias_fy, bias_tau, m, mlg, I; N, N m, kg, kg m, kg m².

    Examples
    --------
    >>> import truewrench as tw
    >>> model = tw.planar()
    >>> [p.name for p in model.parameters][3:]
    ['m', 'mlg', 'I']
    """
    return _of_rig(Space.PLANE, rig, Convention.ON_TOOL)


def spatial(rig: Rig | None = None) -> WrenchModel:
    """The six-axis model; its sign is estimated unless the rig states it.

    Parameters
    ----------
    rig : Rig, optional
        Gives gravity (m/s²), signs and arm; by default standard gravity.

    Returns
    -------
    WrenchModel
        Six biases (N, N m) and ten inertial parameters (kg, kg m, kg m²) about the sensor origin, in its frame.

    Examples
    --------
    >>> import truewrench as tw
    >>> model = tw.spatial()
    >>> [p.name for p in model.parameters][6:10]
    ['m', 'mx', 'my', 'mz']
    """
    return _of_rig(Space.SPACE, rig, Convention.AUTO)


def require_model(given: object, where: str) -> None:
    """InputError, in a sentence, for what is no model."""
    if not isinstance(given, WrenchModel):
        remedy = f"give a model first: tw.{where}(tw.planar(rig), recording)"
        raise InputError(what=f"{kind_of(given)} is no model", where=where, remedy=remedy)


def _of_rig(space: Space, rig: Rig | None, default: Convention) -> WrenchModel:
    if rig is None:
        return WrenchModel(space=space, convention=default)
    given: object = rig
    if not isinstance(given, Rig):
        what = f"{kind_of(given)} is no rig"
        raise InputError(what=what, where="model", remedy="read it: tw.Rig.read(path), or tw.Rig.from_data(tables)")
    sensor, arm = rig.sensor, rig.arm if rig.arm is not None and rig.arm.space is space else None
    stated = sensor.convention if sensor is not None and sensor.convention is not None else default
    mirror = bool(sensor is not None and sensor.mirror_y)
    direction = rig.gravity_direction
    return WrenchModel(
        space=space,
        gravity=rig.gravity,
        gravity_direction=direction if direction is not None and len(direction) == space.value else None,
        convention=stated,
        mirror_y=mirror,
        arm=arm,
    )
