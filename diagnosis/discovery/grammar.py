"""Terms of the grammar: forces, torques, gains and zeros of the chain's quantities, up to a stated complexity."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, Self

from diagnosis.discovery.leaves import DISTANCE, EDGE, LENGTH, NARROWEST, SCALAR_SIZE, SCALES, SHAPES, WIDTH, Leaf
from diagnosis.discovery.quantities import (
    HARMONIC,
    ONE,
    PARTS,
    POWER,
    QUADRATIC,
    SIGN,
    TINY,
    TOOL_CONSTANT,
    WORLD_CONSTANT,
    Components,
    Leaves,
    Quantity,
    constant,
)
from modeling import symbolic as sp
from modeling.effects.loads import TIP_DISTANCE
from modeling.formulas.custom_effect import CustomEffect
from modeling.formulas.python_definition import formula_text
from modeling.formulas.units import DIMENSIONLESS, Dimension, dimension
from modeling.rigid_body import contact_components, contact_force_torque
from modeling.space import FORCE_UNIT, TORQUE_UNIT, Space, signals, vector

COMPLEXITY = 6
"""Leaves and operations of a term, by default: |v|^3 v at a point has six, |w| (h x v) seven."""
NORM_POWERS = (0.5, 1, 1.5, 2, 3, -1)
SCALAR_POWERS = (1, 2, 3)
"""Exponents of a vector's length, and of a scalar that has a sign."""
PLACE_POWERS = (1, 2, -1, -2, -3, -4)
"""Exponents of the distance to a place, times the vector to it: |n|^-4 n falls with the third power, as the pull of a
magnet on iron nearby; |n|^2 n is a spring that stiffens."""
HARMONIC_ORDERS = range(1, 25)
"""Of an angle, by itself in a zero: those of a bearing, or of the teeth of a gear on the output side. What is faster
needs a joint that moves by hundredths of a radian between samples."""
LOW_ORDERS = (1, 2, 3)
"""Of an angle, as a factor of a force or torque."""

FORCE, TORQUE, GAIN, ZERO = "force", "torque", "gain", "zero"


@dataclass(frozen=True)
class Term:
    """One term of the grammar: an amplitude, or the components of a constant vector, times a quantity.

    kind       "force" (on the tool), "torque" (on the tool, about the sensor), "gain" (a load times the quantity, added
               to the readings) or "zero" (added to the readings last)
    quantity   a vector in tool axes; of a gain and a zero a scalar, with an amplitude for each channel
    load       of a gain, the channel of the load
    at_point   whether the force acts at a point at some distance along the tip, and the quantity is that of the point
    kept       places of the amplitudes that it has, of all; None for all
    """

    kind: str
    quantity: Quantity
    load: str = ""
    at_point: bool = False
    kept: tuple[int, ...] | None = None

    def shapes(self, leaves: Mapping[str, Leaf]) -> tuple[str, ...]:
        """Names of the parameters that it is not linear in, of `SHAPES`."""
        used = frozenset[str]().union(*(leaves[name].shapes for name in self.quantity.leaves if name in leaves))
        return tuple(name for name in SHAPES if name in (used | {DISTANCE} if self.at_point else used - {DISTANCE}))

    @property
    def complexity(self) -> int:
        """Number of leaves and operations, with the point."""
        return self.quantity.size + self.at_point + (SCALAR_SIZE + (self.quantity.size > 0) if self.load else 0)

    def all_amplitudes(self, space: Space) -> tuple[str, ...]:
        """Names of all amplitudes that a term of its kind may have; those of a channel together."""
        own = self.quantity.amplitudes
        return tuple(f"{name}_{c}" for c in space.channels for name in own) if self.by_channel else own

    @property
    def by_channel(self) -> bool:
        """Whether it is added to the readings, with amplitudes for each channel."""
        return self.kind in (GAIN, ZERO)

    def amplitudes(self, space: Space) -> tuple[str, ...]:
        """Names of its amplitudes."""
        names = self.all_amplitudes(space)
        return names if self.kept is None else tuple(names[place] for place in self.kept)

    @property
    def formula(self) -> str:
        """As it is printed: force, torque or zero as a product; of a zero the channels, where they are not all."""
        amplitude = "c " if self.quantity.amplitudes == ("c",) else ""
        left = {FORCE: "F", TORQUE: "T"}.get(self.kind, "zero")
        product = self.quantity.formula
        if self.load:
            own = re.fullmatch(rf"{self.load}(?:\^(\d))?", product)  # times the same load
            product = f"{self.load}^{int(own[1] or 1) + 1}" if own else f"{product} {self.load}".strip()
        return f"{left} = {amplitude}{product}" + (f" at {DISTANCE}" if self.at_point else "")

    def printed(self, space: Space) -> str:
        """Its formula, with the channels of a zero and the parts of a sinusoid that it has."""
        names = self.amplitudes(space)
        formula = self.formula
        if self.by_channel:
            channels = [c for c in space.channels if any(name.endswith(f"_{c}") for name in names)]
            formula = formula.replace(
                "zero", "zero" if len(channels) == len(space.channels) else ", ".join(channels), 1
            )
        parts = {name.split("_")[1] for name in names if name.startswith("c_")}
        if self.quantity.operation == QUADRATIC:
            of = self.quantity.operands[0].formula
            both = f"c_1 {of} + c_2 {of}^2"
            sums = both if len(parts) == 2 else f"c {of}^2" if parts == {"2"} else f"c {of}"
            return formula.replace(self.quantity.formula, sums)
        (part,) = parts if len(parts) == 1 else ("harmonic",)
        return formula.replace(HARMONIC, f"c {part}" if part in ("sin", "cos") else HARMONIC)

    def units(self, space: Space) -> dict[str, str]:
        """Unit of each amplitude."""
        by_channel = space.channel_units
        units = {}
        for name in self.amplitudes(space):
            of_target = {FORCE: FORCE_UNIT, TORQUE: TORQUE_UNIT}.get(self.kind) or by_channel[name.rsplit("_", 1)[1]]
            of_load = dimension(by_channel[self.load]) if self.load else DIMENSIONLESS
            squared = self.quantity.operation == QUADRATIC and name.startswith("c_2")
            of_square = self.quantity.dimension if squared else DIMENSIONLESS
            units[name] = str(dimension(of_target) / of_load / self.quantity.dimension / of_square)
        return units

    def effect(
        self,
        space: Space,
        effect_id: str,
        leaves: Mapping[str, Leaf],
        inputs: Mapping[str, str],
        shapes: Mapping[str, Collection[float]],
    ) -> CustomEffect:
        """The term as a custom effect.

        `inputs` are units of a recording's other columns, by name; `shapes` are values (m) to search of each parameter
        that it is not linear in.
        """
        parameters: dict[str, Any] = dict(self.units(space))
        present = set(parameters)
        symbolic = SymbolicLeaves(leaves, at_point=self.at_point)

        def value(suffix: str) -> Components:
            names = {own: own + suffix for own in self.quantity.amplitudes}
            chosen = {own: signals(name)[0] if name in present else sp.S.Zero for own, name in names.items()}
            components = self.quantity.evaluated(symbolic.with_amplitudes(chosen))
            return tuple(component * chosen.get("c", sp.S.One) for component in components)

        if self.by_channel:
            stage, suffix = self.kind, f"_{self.load}" if self.load else ""
            formulas = {channel + suffix: value(f"_{channel}")[0] for channel in space.channels}
        else:
            parts, nothing = vector(*value("")), vector(0, 0, 0)
            arm = signals(DISTANCE)[0] * space.tip_axis if self.at_point else nothing
            force, torque = (parts, arm.cross(parts)) if self.kind == FORCE else (nothing, parts)
            stage, formulas = "tip_body", contact_values(space, force, torque)
        for name in self.shapes(leaves):
            bounds: dict[str, Any] = {"bounds": list(TIP_DISTANCE.bounds)} if name == DISTANCE else {}
            bounds |= {"bounds": [NARROWEST, None]} if name in SCALES and name != WIDTH else {}
            parameters[name] = {"unit": SHAPES[name], "search": sorted(map(float, shapes[name])), **bounds}
        symbols = {s.name for formula in formulas.values() for s in formula.free_symbols}
        steps = {name: step for name, step in symbolic.steps.items() if name in symbols}
        for step in steps.values():
            symbols |= set(re.findall(r"[A-Za-z_]\w*", step))
        parameters = {name: value for name, value in parameters.items() if name in symbols}  # in the plane k has no z
        used = {name: unit for name, unit in inputs.items() if name in symbols}
        texts = {name: formula_text(formula) for name, formula in formulas.items() if formula != 0}
        table = {"id": effect_id, "title": self.printed(space), "parameters": parameters, stage: texts}
        more = {"inputs": used, "constants": symbolic.constants, "let": steps}
        return CustomEffect.from_data(table | {key: names for key, names in more.items() if names}, where=effect_id)


def contact_values(space: Space, force: sp.Matrix, torque: sp.Matrix) -> dict[str, sp.Expr]:
    """The components of a contact wrench, by name, of a force and a torque about the sensor in tool axes."""
    names = contact_components(space)
    symbols = signals(*names)
    wrench = sp.Matrix.vstack(*contact_force_torque(space, symbols)).jacobian(sp.Matrix(symbols))
    return dict(zip(names, wrench.T * sp.Matrix.vstack(force, torque), strict=True))


class SymbolicLeaves(Leaves):
    """As SymPy symbols v_1 .. v_3.

    steps      formulas of those that were used, by name and in order
    constants  what is added to norms that are divided by, with its unit
    """

    functions = sp

    def __init__(self, leaves: Mapping[str, Leaf], *, at_point: bool) -> None:
        super().__init__()
        self.leaves = leaves
        self._amplitudes: Mapping[str, sp.Expr] = {}
        self._at_point = at_point
        self.steps: dict[str, str] = {}
        self.constants: dict[str, str] = {}

    def with_amplitudes(self, amplitudes: Mapping[str, sp.Expr]) -> Self:
        """Themselves, with these symbols as amplitudes."""
        self._amplitudes, self.evaluated = amplitudes, {}
        return self

    def components(self, name: str) -> Components:
        """Symbols, of what is not simpler as it is; of a constant vector, those of its amplitudes."""
        if name == ONE.operation:
            return (sp.S.One,)
        if name == TOOL_CONSTANT:
            return self._vector_of(name)
        if name == WORLD_CONSTANT:
            return self._named(name, self.leaves["turn"].expression.reshape(3, 3) * sp.Matrix(self._vector_of(name)))
        self.constants |= {symbol: f"{value!r} {unit}" for symbol, value, unit in self.leaves[name].constants}
        return self._named(name, self.leaves[name].expression)

    def _vector_of(self, name: str) -> Components:
        return tuple(self._amplitudes[f"{name}_{axis}"] for axis in "xyz")

    def _named(self, name: str, expressions: sp.Matrix) -> Components:
        symbols = []
        for number, at_distance in enumerate(expressions, start=1):
            expression = at_distance if self._at_point else at_distance.subs(signals(DISTANCE)[0], 0)
            if not expression.args:  # a number or a signal
                symbols.append(expression)
                continue
            step = f"{name}_{number}" if len(expressions) > 1 else f"{name}_here"
            self.steps[step] = formula_text(expression)
            symbols.append(signals(step)[0])
        return tuple(symbols)

    def sum_of(self, operation: str, one: sp.Expr, other: sp.Expr) -> sp.Expr:
        """Their sum with its two amplitudes."""
        first, second = (self._amplitudes[f"c_{part}"] for part in PARTS[operation])
        return first * one + second * other

    def tiny(self, of: Dimension) -> sp.Expr:
        """A constant of that dimension."""
        quantity = f"{TINY!r} {of}"
        known = next((name for name, text in self.constants.items() if text == quantity), None)
        name = known or f"tiny_{len(self.constants) + 1}"
        self.constants[name] = quantity
        return signals(name)[0]


# ------------------------------------------------------------------------------------------- enumeration

VECTORS = ("v", "a", "w", "al", "up", "r", "e")
MOVING = ("v", "a", "w", "al", "r")
AXES = ("e", "up")
LEVELLING = {FORCE: ("v_sat", "v_drop"), TORQUE: ("w_sat", "w_drop")}
"""By themselves."""


def terms(
    leaves: Mapping[str, Leaf],
    angles: Collection[str],
    columns: Collection[str],
    loads: Collection[str],
    complexity: int,
) -> list[Term]:
    """All terms up to a complexity, of the vectors of the chain, and of these angles, other columns and loads.

    force, torque  V or S V; V a vector of the chain, a constant one, the cross product of two, w x (w x r), or the part
                   of one along the tip or along gravity
    zero           S, a quadratic of an angle or another column, or what fades with time
    gain           a load times 1, S, or a power of that load or another one
    S              a power of a scalar, its sign, a sinusoid of an angle, or the product of two scalars; of another
                   column a power

    Besides a force or torque along a velocity or angular rate that saturates, or falls beyond some rate.

    Equal ones that follow from rules of the algebra are left out; others are merged by what they give
    (`diagnosis/discovery/dictionary.py`).
    """
    coordinates = [name for name in ("x", "y", "z") if name in leaves]
    coordinates += [f"d{angle}" for angle in angles if f"d{angle}" in leaves and re.fullmatch(r"q\d+", angle)]
    present = [name for name in VECTORS if name in leaves]  # without positions there is no velocity
    named = {name: leaves[name].quantity for name in (*present, *coordinates, *angles, *columns)}
    directions = _vectors(named)
    factors = _factors(named, [*coordinates, *angles], angles)
    plain = [s for s in factors if s.operation not in (POWER, SIGN, HARMONIC)]
    low = [s for s in factors if s.operation == HARMONIC]
    products = [*factors, *(one.times(other) for one, other in combinations(plain, 2))]
    found = [Term(ZERO, s) for s in products if s.size <= complexity]
    higher = [named[angle].harmonic(order) for angle in angles for order in HARMONIC_ORDERS if order not in LOW_ORDERS]
    of_columns = [named[name].power(k) for name in columns for k in SCALAR_POWERS]
    quadratics = [leaf.quantity.quadratic() for name, leaf in leaves.items() if name.endswith("_dev")]
    fading = [leaves[name].quantity for name in ("fading",) if name in leaves]
    found += [Term(ZERO, s) for s in (*higher, *of_columns, *quadratics, *fading) if s.size <= complexity]
    for kind in (FORCE, TORQUE):
        for direction in [*directions, *(leaves[n].quantity for n in LEVELLING[kind] if n in leaves)]:
            scaled = [direction]
            scaled += [
                s.times(direction)
                for s in (products if direction.formula not in LEVELLING[kind] else ())
                if s.size + direction.size + 1 <= complexity + _is_half(s)
                and not (s.has_constant and direction.has_constant)
            ]
            found += [Term(kind, quantity) for quantity in scaled]
            if kind == FORCE:
                found += [Term(kind, q, at_point=True) for q in scaled if q.size - _is_half(q) < complexity]
    slowly = [s.times(vector) for s in of_columns for vector in directions if not vector.operands]
    found += [Term(kind, q) for q in slowly for kind in (FORCE, TORQUE) if q.size <= complexity]
    found += _of_a_place(named, leaves, complexity)
    found += _of_loads([leaves[name].quantity for name in loads], [*plain, *low, *of_columns, *fading], complexity)
    return sorted(dict.fromkeys(found), key=lambda term: (term.complexity, term.formula))


def _is_half(quantity: Quantity) -> bool:
    """Whether it has a half power: allowed where whole ones are, and less likely."""
    return quantity.exponent % 1 != 0 or any(map(_is_half, quantity.operands))


def _of_loads(loads: Sequence[Quantity], factors: Sequence[Quantity], complexity: int) -> list[Term]:
    """Loads times nothing, a scalar, another load or a power of themselves."""
    gains = []
    for place, load in enumerate(loads):
        by = [ONE, load, load.power(2), *loads[:place], *factors]
        gains += [Term(GAIN, quantity, load=load.formula) for quantity in by]
    return [term for term in gains if term.complexity <= complexity]


def _of_a_place(named: Mapping[str, Quantity], leaves: Mapping[str, Leaf], complexity: int) -> list[Term]:
    """Forces that depend on the distance to a place in the world, or begin at a coordinate.

    Towards the place, or along the velocity near it; in a constant direction, or along the velocity, beyond an edge.
    """
    if "n" not in leaves or "v" not in leaves:
        return []
    near = leaves["n"].quantity
    lengths = [near.norm().power(k) for k in PLACE_POWERS]
    quantities = [near, *(s.times(v) for s in lengths for v in (near, named["v"]))]
    edges = [leaf.quantity for leaf in leaves.values() if leaf.shapes & {EDGE, LENGTH}]
    about = leaves["rho"].quantity
    quantities += [about, *(about.norm().power(k).times(about) for k in PLACE_POWERS)]
    quantities += [s.times(v) for s in edges for v in (constant(WORLD_CONSTANT), named["up"], named["v"])]
    forces = [Term(FORCE, q, at_point=at) for q in quantities for at in (False, True)]
    return [term for term in forces if term.complexity <= complexity + 1]


def _vectors(named: Mapping[str, Quantity]) -> list[Quantity]:
    """Vectors of the chain, constant ones, their cross products, and parts along an axis."""
    simple = [named[name] for name in VECTORS if name in named] + [constant(TOOL_CONSTANT), constant(WORLD_CONSTANT)]
    crossed = [
        one.cross(other)
        for one, other in combinations(simple, 2)
        if not (one.has_constant and other.has_constant) and {one.formula, other.formula} != {"e", TOOL_CONSTANT}
    ]
    spun = [named["w"].cross(named["w"].cross(named[name])) for name in ("r", "e") if {"w", name} <= set(named)]
    moving = [named[name] for name in MOVING if name in named]
    along = [vector.dot(named[axis]).times(named[axis]) for vector in moving for axis in AXES]
    return [*simple, *crossed, *spun, *along]


def _factors(named: Mapping[str, Quantity], scalars: Collection[str], angles: Collection[str]) -> list[Quantity]:
    """Powers of scalars, signs, and sinusoids of angles."""
    lengths = [named[name].norm() for name in ("v", "a", "w", "al") if name in named]
    moving = [named[name] for name in MOVING if name in named]
    signed = [vector.dot(named[axis]) for vector in moving for axis in AXES] + [named["e"].dot(named["up"])]
    signed += [named[name] for name in scalars]
    powers = [s.power(k) for s in lengths for k in NORM_POWERS] + [s.power(k) for s in signed for k in SCALAR_POWERS]
    return [*powers, *(s.sign() for s in signed), *(named[a].harmonic(k) for a in angles for k in LOW_ORDERS)]
