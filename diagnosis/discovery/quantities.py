"""Quantities of the chain, scalars and vectors with dimension and frame, as expressions of what a recording has.

A quantity is a tree of operations on leaves: velocity, angular rate, gravity's direction, constant directions, joint
angles, time. One description is evaluated twice: over a recording's samples, and as SymPy expressions, from which the
formulas of a custom effect are written.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, lru_cache
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from modeling import symbolic as sp
from modeling.chain.prediction import Signals, VectorFunction
from modeling.formulas.python_definition import formula_text
from modeling.formulas.units import DIMENSIONLESS, Dimension, dimension
from modeling.space import Space, signals, vector

Array = NDArray[np.float64]
Components = tuple[Any, ...]
"""One (scalar) or three (vector, tool axes) values: arrays (n, a) over samples and amplitudes, or SymPy expressions."""

DISTANCE = "d"
"""Parameter: distance (m) of the point from the sensor, along the tip."""
PLACE = ("x_0", "y_0", "z_0")
"""Parameters: a place in the world, m."""
EDGE, WIDTH = "s_0", "w_0"
"""Parameters: the coordinate (m) in the world from which something acts, and the length (m) in which it comes to its
full size."""
SPEED, RATE, TIME, LENGTH = "v_0", "u_0", "t_0", "l_0"
"""Parameters: a speed, m/s, and an angular rate, 1/s, from which on a force changes less; a time constant, s; a length,
m, in which something falls to 1/e."""
SHAPES = {
    **{DISTANCE: "m", **dict.fromkeys(PLACE, "m"), EDGE: "m", WIDTH: "m"},
    **{SPEED: "m/s", RATE: "1/s", TIME: "s", LENGTH: "m"},
}
"""Units of the parameters that terms are not linear in, by name."""
SCALES = (WIDTH, SPEED, RATE, TIME, LENGTH)
"""Those of them that divide, and are positive."""
NARROWEST = 1e-4
"""Of a width (m) or another scale, SI: a step in a tenth of a millimetre is one between any two samples."""
TINY = 1e-6
"""In SI units, added (squared) to a norm that is divided by, as in the catalogue's drag."""
SCALAR_SIZE = 2
"""Complexity of a scalar that is one signal, as of the length of a vector: a joint's angle or a coordinate is one of
more than the vectors of the chain, and no law of a rigid tool knows it."""
POWER, SIGN = "power", "sign"
TOOL_CONSTANT, WORLD_CONSTANT, HARMONIC, QUADRATIC = "h", "k", "harmonic", "quadratic"
"""What has amplitudes of its own: a constant vector in tool axes, one in the world, sine and cosine of an angle, a
scalar and its square."""
PARTS = {TOOL_CONSTANT: "xyz", WORLD_CONSTANT: "xyz", HARMONIC: ("sin", "cos"), QUADRATIC: ("1", "2")}
"""Amplitudes of each."""


@dataclass(frozen=True)
class Quantity:
    """A scalar, or a vector in tool axes: a leaf, or an operation on others.

    formula    as it is printed
    size       number of leaves and operations: the complexity
    exponent   of a power (a multiple of 1/2); order of a harmonic
    """

    operation: str
    operands: tuple[Quantity, ...]
    formula: str
    vector: bool
    dimension: Dimension
    size: int = 1
    exponent: float = 1

    @cached_property
    def leaves(self) -> frozenset[str]:
        """Names of the leaves in it, and of what has amplitudes."""
        own = frozenset({self.operation}) if not self.operands or self.operation in PARTS else frozenset[str]()
        return own.union(*(operand.leaves for operand in self.operands))

    @cached_property
    def amplitudes(self) -> tuple[str, ...]:
        """Names of the amplitudes that it is linear in; it is multiplied by c where it has none of its own."""
        of = next((name for name in PARTS if name in self.leaves), "")
        return tuple(f"{of if len(of) == 1 else 'c'}_{part}" for part in PARTS[of]) if of else ("c",)

    @property
    def has_constant(self) -> bool:
        """Whether it has amplitudes of its own: at most one of two factors may."""
        return self.amplitudes != ("c",)

    def cross(self, other: Quantity) -> Quantity:
        """The cross product of two vectors."""
        return self._with("cross", other, f"{_grouped(self)} x {_grouped(other)}", vector=True)

    def dot(self, other: Quantity) -> Quantity:
        """The scalar product of two vectors."""
        return self._with("dot", other, f"{_grouped(self)}.{_grouped(other)}", vector=False)

    def times(self, other: Quantity) -> Quantity:
        """The product of a scalar and anything."""
        return self._with("times", other, f"{_factor(self)} {_factor(other)}", vector=other.vector)

    def norm(self) -> Quantity:
        """The length of a vector."""
        return Quantity("norm", (self,), f"|{self.formula}|", False, self.dimension, self.size + 1)

    def power(self, exponent: float) -> Quantity:
        """A power of a scalar, of a norm where it is no positive integer; a negative one smoothed at zero."""
        if exponent == 1:
            return self
        formula, unit = f"{_grouped(self)}^{exponent:g}", self.dimension ** Fraction(exponent)
        size = self.size + 1 + (exponent % 1 != 0)
        return Quantity(POWER, (self,), formula, False, unit, size, exponent)

    def sign(self) -> Quantity:
        """The sign of a scalar."""
        return Quantity(SIGN, (self,), f"sign({self.formula})", False, DIMENSIONLESS, self.size + 1)

    def harmonic(self, order: int) -> Quantity:
        """A sinusoid of a multiple of an angle, of any phase."""
        formula = f"harmonic({order} {self.formula})" if order > 1 else f"harmonic({self.formula})"
        return Quantity(HARMONIC, (self,), formula, False, DIMENSIONLESS, self.size + 1, order)

    def quadratic(self) -> Quantity:
        """Itself and its square, each with an amplitude."""
        formula = f"quadratic({self.formula})"
        return Quantity(QUADRATIC, (self,), formula, False, self.dimension, self.size + 1)

    def _with(self, operation: str, other: Quantity, formula: str, *, vector: bool) -> Quantity:
        unit = self.dimension * other.dimension
        return Quantity(operation, (self, other), formula, vector, unit, self.size + other.size + 1)

    def evaluated(self, leaves: Leaves) -> Components:
        """Its components, of those of the leaves. Those of its operands are kept, as many terms share them."""
        if not self.operands:
            return leaves.components(self.operation)
        for operand in self.operands:
            if operand not in leaves.evaluated:
                leaves.evaluated[operand] = operand.evaluated(leaves)
        return _operation(leaves, self)(*(leaves.evaluated[operand] for operand in self.operands))


ONE = Quantity("one", (), "", False, DIMENSIONLESS, size=0)
"""The number."""


def _grouped(quantity: Quantity) -> str:
    return f"({quantity.formula})" if quantity.operation in ("cross", "times", "dot") else quantity.formula


def _factor(quantity: Quantity) -> str:
    return f"({quantity.formula})" if quantity.operation in ("cross", "dot") else quantity.formula


def _operation(leaves: Leaves, quantity: Quantity) -> Callable[..., Components]:
    """The operation of a quantity on the components of its operands."""
    functions, exponent = leaves.functions, quantity.exponent

    def inverse(value: Any) -> Any:
        return 1 / functions.sqrt(value**2 + leaves.tiny(quantity.operands[0].dimension) ** 2)

    operations: Mapping[str, Callable[..., Components]] = {
        "dot": lambda one, other: (_dot(one, other),),
        "cross": lambda one, other: tuple(one[i - 2] * other[i - 1] - one[i - 1] * other[i - 2] for i in range(3)),
        "times": lambda one, other: tuple(one[0] * component for component in other),
        "norm": lambda one: (functions.sqrt(_dot(one, one)),),
        POWER: lambda one: (one[0] ** exponent if exponent > 0 else inverse(one[0]) ** -exponent,),
        SIGN: lambda one: (one[0] * inverse(one[0]),),
        HARMONIC: lambda one: (
            leaves.sum_of(HARMONIC, functions.sin(exponent * one[0]), functions.cos(exponent * one[0])),
        ),
        QUADRATIC: lambda one: (leaves.sum_of(QUADRATIC, one[0], one[0] ** 2),),
    }
    return operations[quantity.operation]


def _dot(one: Components, other: Components) -> Any:
    products = [a * b for a, b in zip(one, other, strict=True)]
    return products[0] + products[1] + products[2]


# ------------------------------------------------------------------------------------------------ leaves


@dataclass(frozen=True, eq=False)
class Leaf:
    """A quantity that the chain has: its expressions of the signals, and of the parameters `SHAPES`.

    constants  values and units of other symbols in it, by name
    printed    as it is printed, its name if empty
    size       number of leaves and operations in it, where it is more than one signal or vector
    """

    name: str
    expression: sp.Matrix
    dimension: Dimension
    constants: tuple[tuple[str, float, str], ...] = ()
    printed: str = ""
    size: int = 0

    @cached_property
    def quantity(self) -> Quantity:
        """As a tree of one leaf."""
        vector = len(self.expression) == 3
        size = self.size or (1 if vector else SCALAR_SIZE)
        return Quantity(self.name, (), self.printed or self.name, vector, self.dimension, size)

    @cached_property
    def signals(self) -> frozenset[str]:
        """Names of the recording's signals that it needs."""
        fixed = {name for name, _, _ in self.constants}
        return frozenset(s.name for s in self.expression.free_symbols) - {*SHAPES} - fixed

    @cached_property
    def shapes(self) -> frozenset[str]:
        """Which of the parameters `SHAPES` it depends on."""
        return frozenset(s.name for s in self.expression.free_symbols) & {*SHAPES}

    @cached_property
    def function(self) -> VectorFunction:
        """Its components as a function of the signals and of `SHAPES`."""
        numbers = {signals(name)[0]: value for name, value, _ in self.constants}
        return VectorFunction.of(self.expression.xreplace(numbers), tuple(sorted(self.signals)), signals(*SHAPES))


@lru_cache(maxsize=2)
def chain_leaves(space: Space) -> Mapping[str, Leaf]:
    """What the motion of the sensor gives, by name: vectors in tool axes, and the world's axes.

    v, a     velocity and acceleration of the point, m/s, m/s²
    r        its position from the origin of the world, m; x, y, z its coordinates there
    n        from it to a place in the world, m
    over_x, under_x   how far (m) its coordinate is above an edge, or below it, else 0; and so in y and z
    onto_x, into_x    the same in a width, 1 at the most
    falling_x, rising_x   exponentials of its coordinate over l_0 (`exponential_leaves`); and so in y and z
    v_sat, v_drop     v over v_0 + |v|, and v over 1 + (|v| / v_0)²; w_sat, w_drop likewise
    fading   exp(-time / t_0)
    w, al    angular rate and acceleration, rad/s, rad/s²
    up       unit vector opposite to gravity
    e        unit vector along the tip
    turn     rotation matrix from world to tool axes, by rows
    """
    motion, (d, *fixed, edge, width, speed, rate, constant_time, _, time) = space.motion, signals(*SHAPES, "time")
    arm, to_tool, w, al = d * space.tip_axis, motion.rotation.T, motion.omega, motion.alpha
    place = motion.position + motion.rotation * arm
    there = vector(*(x if i < len(space.axes) else sp.S.Zero for i, x in enumerate(fixed)))
    named = {
        "v": (to_tool * motion.velocity + w.cross(arm), "m/s"),
        "a": (to_tool * motion.acceleration + al.cross(arm) + w.cross(w.cross(arm)), "m/s²"),
        "r": (to_tool * motion.position + arm, "m"),
        "w": (w, "1/s"),
        "al": (al, "1/s²"),
        "up": (to_tool * space.up, "1"),
        "e": (space.tip_axis, "1"),
        "turn": (to_tool.reshape(9, 1), "1"),
        "n": (to_tool * (there - place), "m"),
        **{axis: (sp.Matrix([place[i]]), "m") for i, axis in enumerate(space.axes)},
    }
    for name, scale in (("v", speed), ("w", rate)):
        moving, unit = named[name]
        size = sp.sqrt(moving.dot(moving))
        named |= {
            f"{name}_sat": (moving / (scale + size), "1"),
            f"{name}_drop": (moving / (1 + (size / scale) ** 2), unit),
        }
    named |= {"fading": (sp.Matrix([sp.exp(-time / constant_time)]), "1")}
    for coordinate, axis in zip(place, space.axes, strict=False):
        for side, beyond, within in ((1, "over", "onto"), (-1, "under", "into")):
            depth = sp.Max(0, side * (coordinate - edge))
            named |= {f"{beyond}_{axis}": (sp.Matrix([depth]), "m")}
            named |= {f"{within}_{axis}": (sp.Matrix([sp.Min(1, depth / width)]), "1")}
    sizes = {"fading": 3, "v_sat": 4, "w_sat": 4, "v_drop": 5, "w_drop": 5}
    return {name: Leaf(name, e, dimension(unit), size=sizes.get(name, 0)) for name, (e, unit) in named.items()}


def signal_leaf(name: str, unit: str) -> Leaf:
    """A signal of the recording as a scalar."""
    return Leaf(name, sp.Matrix([signals(name)[0]]), dimension(unit, own_units=(unit,)))


def deviation_leaf(name: str, unit: str, values: Array) -> Leaf:
    """A signal of the recording less a round value in the middle of its range: its powers are not all one."""
    middle = _round_middle(values)
    symbol, reference = signals(name, f"{name}_ref")
    dimensions, constants = dimension(unit, own_units=(unit,)), ((reference.name, middle, unit),)
    shown = f"({name} {'+' if middle < 0 else '-'} {abs(middle):.6g})" if middle else name
    return Leaf(f"{name}_dev", sp.Matrix([symbol - reference]), dimensions, constants, shown)


def exponential_leaves(coordinate: Leaf, values: Array) -> Mapping[str, Leaf]:
    """What falls, and what rises, by e in a length, with a coordinate of the point, and is 1 in its middle."""
    (place,), (length, reference) = coordinate.expression, signals(LENGTH, f"{coordinate.name}_ref")
    constants = ((reference.name, _round_middle(values), "m"),)
    return {
        f"{name}_{coordinate.name}": Leaf(
            f"{name}_{coordinate.name}",
            sp.Matrix([sp.exp(side * (place - reference) / length)]),
            DIMENSIONLESS,
            constants,
            size=3,
        )
        for name, side in (("falling", -1), ("rising", 1))
    }


def _round_middle(values: Array) -> float:
    """A round number in the middle of a range."""
    low, high = float(values.min()), float(values.max())
    step = 10.0 ** np.floor(np.log10((high - low) / 2))
    return float(np.round((low + high) / 2 / step) * step)


def constant(name: str) -> Quantity:
    """A constant vector, in tool axes or in the world."""
    return Quantity(name, (), name, True, DIMENSIONLESS)


class Leaves:
    """Components of leaves, and of what was built of them; `functions` (sqrt) of the same kind."""

    functions: Any

    def __init__(self, leaves: Mapping[str, Leaf]) -> None:
        self.leaves = leaves
        self.evaluated: dict[Quantity, Components] = {}

    def components(self, name: str) -> Components:
        """Those of a leaf by its name."""
        raise NotImplementedError

    def sum_of(self, operation: str, one: Any, other: Any) -> Any:
        """Two values with the amplitudes of an operation."""
        raise NotImplementedError

    def tiny(self, of: Dimension) -> Any:
        """`TINY` in a dimension."""
        raise NotImplementedError


class SampledLeaves(Leaves):
    """Over the first samples of a recording, at values of `SHAPES` (0 where not given): arrays (n, a).

    a is the number of amplitudes of a constant vector, or of an operation with two, of which each has the other ones
    zero; else 1.
    """

    functions = np

    def __init__(self, leaves: Mapping[str, Leaf], values: Signals, samples: int, shapes: Mapping[str, float]) -> None:
        super().__init__(leaves)
        self._values, self._samples = values, samples
        self._theta = np.array([shapes.get(name, float(name in SCALES)) for name in SHAPES])

    def components(self, name: str) -> Components:
        """Arrays over the samples; of a constant vector those of its unit vectors."""
        if name == ONE.operation:
            return (np.ones((self._samples, 1)),)
        if name == TOOL_CONSTANT:
            return tuple(np.eye(3)[:, None, :])
        rows = self.leaves["turn" if name == WORLD_CONSTANT else name].function.value(
            self._values, self._theta, self._samples
        )
        if name == WORLD_CONSTANT:
            return tuple(rows.reshape(len(rows), 3, 3).transpose(1, 0, 2))
        return tuple(rows.T[:, :, None])

    def sum_of(self, operation: str, one: Array, other: Array) -> Array:
        """Both (n, 2)."""
        return np.hstack([one, other])

    def tiny(self, of: Dimension) -> float:
        """The number."""
        return TINY


class SymbolicLeaves(Leaves):
    """As SymPy symbols v_1 .. v_3.

    steps      formulas of those that were used, by name and in order
    constants  what is added to norms that are divided by, with its unit
    """

    functions = sp

    def __init__(self, leaves: Mapping[str, Leaf], *, at_point: bool) -> None:
        super().__init__(leaves)
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
