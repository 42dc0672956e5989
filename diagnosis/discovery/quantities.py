"""Quantities of the chain, scalars and vectors with dimension and frame, as expressions of what a recording has.

A quantity is a tree of operations on leaves: velocity, angular rate, gravity's direction, constant directions, joint
angles, time. One description is evaluated twice: over a recording's samples, and as SymPy expressions, from which the
formulas of a custom effect are written.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

from modeling.formulas.units import DIMENSIONLESS, Dimension

Components = tuple[Any, ...]
"""One (scalar) or three (vector, tool axes) values: arrays (n, a) over samples and amplitudes, or SymPy expressions."""

TINY = 1e-6
"""In SI units, added (squared) to a norm that is divided by, as in the catalogue's drag."""
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


def constant(name: str) -> Quantity:
    """A constant vector, in tool axes or in the world."""
    return Quantity(name, (), name, True, DIMENSIONLESS)


class Leaves:
    """Components of leaves, and of what was built of them; `functions` (sqrt, sin, cos) of the same kind."""

    functions: Any

    def __init__(self) -> None:
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
