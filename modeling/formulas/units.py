"""Dimensions of units, parsed from text, with products and powers."""

from __future__ import annotations

import ast
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from fractions import Fraction

from modeling.errors import InputError, quoted
from modeling.formulas.parser import FORMULA_FUNCTIONS, FormulaSource, UnitRule, child_nodes, exponent, signed_parts

UnitPowers = tuple[tuple[str, Fraction], ...]

LONGEST_UNIT = 60
"""Characters of a unit's text at most: ten factors, each with a power."""
LARGEST_POWER = 12
"""Power of a factor at most; larger ones are typing errors."""

_BASE: Mapping[str, Mapping[str, int]] = {
    "1": {},
    "rad": {},
    "kg": {"kg": 1},
    "m": {"m": 1},
    "s": {"s": 1},
    "K": {"K": 1},
    "°C": {"K": 1},
    "A": {"A": 1},
    "N": {"kg": 1, "m": 1, "s": -2},
    "J": {"kg": 1, "m": 2, "s": -2},
    "W": {"kg": 1, "m": 2, "s": -3},
    "Pa": {"kg": 1, "m": -1, "s": -2},
    "Hz": {"s": -1},
    "C": {"A": 1, "s": 1},
    "V": {"kg": 1, "m": 2, "s": -3, "A": -1},
    "T": {"kg": 1, "s": -2, "A": -1},
}
"""Coherent SI units; °C counts as K, since only temperature differences are multiplied."""

_SI_EQUIVALENTS: Mapping[str, str] = {
    **dict.fromkeys(("mm", "cm", "km", "µm", "um", "inch", "in", "ft"), "m"),
    **dict.fromkeys(("ms", "µs", "us", "min", "h"), "s"),
    **dict.fromkeys(("g", "mg", "t", "lb"), "kg"),
    **dict.fromkeys(("deg", "°", "grad"), "rad"),
    **dict.fromkeys(("mN", "kN", "lbf"), "N"),
    **dict.fromkeys(("Nm", "Nmm"), "N m"),
    **dict.fromkeys(("bar", "mbar", "hPa", "kPa", "MPa", "psi"), "Pa"),
    **dict.fromkeys(("F", "°F"), "K"),
    **dict.fromkeys(("rpm", "kHz", "MHz"), "Hz"),
    **dict.fromkeys(("mA",), "A"),
    **dict.fromkeys(("mV", "kV"), "V"),
}
"""SI unit to use instead of one with a conversion factor."""

_NAMES = ("1", "N", "N m", "N/m", "N s/m", "N s²/m²", "N/m²", "N m/rad", "1/m", "1/s", "1/N", "m/s", "m/s²", "kg m")
"""Preferred names of dimensions; others print in kg, m, s, K, A."""

_SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻ᐟ", "0123456789-:")
_DIGITS = str.maketrans("0123456789-/", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻ᐟ")
_TOKEN = re.compile(
    r"(?P<factor>1(?![0-9])|[A-Za-zµΩ°%]+)(?:\^?(?P<power>-?[0-9]{1,2})(?::(?P<root>[2-9]))?)?|(?P<sign>[/()*·]|\s+)"
)


@dataclass(frozen=True)
class Dimension:
    """Base units with their powers, sorted by name; none if dimensionless."""

    powers: UnitPowers = ()

    @classmethod
    def of(cls, powers: Mapping[str, Fraction]) -> Dimension:
        """The dimension of base units raised to these powers."""
        return cls(tuple(sorted((unit, power) for unit, power in powers.items() if power)))

    def __mul__(self, other: Dimension) -> Dimension:
        mine = dict(self.powers)
        return Dimension.of(mine | {unit: mine.get(unit, Fraction(0)) + power for unit, power in other.powers})

    def __truediv__(self, other: Dimension) -> Dimension:
        return self * other ** Fraction(-1)

    def __pow__(self, exponent: Fraction | int) -> Dimension:
        return Dimension.of({unit: power * exponent for unit, power in self.powers})

    def __str__(self) -> str:
        for name in _NAMES:
            if dimension(name) == self:
                return name
        numerator = [_raised(unit, power) for unit, power in self.powers if power > 0]
        denominator = [_raised(unit, -power) for unit, power in self.powers if power < 0]
        divisor = " ".join(denominator) if len(denominator) < 2 else f"({' '.join(denominator)})"
        return (" ".join(numerator) or "1") + (f"/{divisor}" if denominator else "")


DIMENSIONLESS = Dimension()
"""The dimension of a number and of an angle."""


def dimension(unit: str, *, own_units: Collection[str] = (), where: str = "unit") -> Dimension:
    """The dimension of a unit such as `N s²/m²`, `N*s^2/m^2` or `rad/(N m)`.

    Factors are separated by spaces or `*`; after `/` comes one factor, or several in brackets. `own_units` are further
    ones, known by name only, each a dimension of its own.
    Raises InputError, naming the column, for an invalid unit or one with a conversion factor (mm, deg).
    """
    return _UnitParser(unit, own_units, where).read()


def _raised(unit: str, power: Fraction) -> str:
    return unit if power == 1 else unit + str(power).translate(_DIGITS)


class _UnitParser:
    """One pass over a unit's text."""

    def __init__(self, unit: str, own_units: Collection[str], where: str) -> None:
        self.unit, self.own_units, self.where = unit, own_units, where
        self.text = unit.translate(_SUPERSCRIPTS)
        self.total = DIMENSIONLESS
        self.divides = self.inside = self.divided = False

    def read(self) -> Dimension:
        if not self.text.strip() or len(self.text) > LONGEST_UNIT:
            raise self._error(0, "expected a unit", "write one such as N s/m, or 1 if dimensionless")
        place = 0
        while place < len(self.text):
            match = _TOKEN.match(self.text, place)
            if match is None:
                raise self._error(
                    place, f"{quoted(self.unit[place])} is not allowed in a unit", "write it like N s^2/m^2"
                )
            if match["sign"]:
                self._sign(match["sign"].strip(), place)
            else:
                self._factor(match["factor"], Fraction(int(match["power"] or 1), int(match["root"] or 1)), place)
            place = match.end()
        if self.inside or self.divides:
            raise self._error(len(self.text), "the unit is incomplete", "write it like rad/(N m)")
        return self.total

    def _sign(self, sign: str, place: int) -> None:
        bracket = {"(": self.divides and not self.inside, ")": self.inside, "/": not (self.divides or self.inside)}
        if not bracket.get(sign, True):
            raise self._error(place, f"'{sign}' is not expected there", "use brackets after / only: rad/(N m)")
        self.inside = sign == "(" or (self.inside and sign != ")")
        if sign == "/":
            self.divides = True
        if sign == ")":
            self.divides, self.divided = False, True

    def _factor(self, factor: str, power: Fraction, place: int) -> None:
        if self.divided and not self.divides:
            raise self._error(place, f"it is ambiguous whether '{factor}' divides", "use brackets: 1/(m s)")
        if not 0 < abs(power) <= LARGEST_POWER:
            raise self._error(place, f"the power {power} is out of range", f"use powers up to {LARGEST_POWER}")
        base = self._base(factor, place)
        self.total *= base ** (-power if self.divides else power)
        if self.divides and not self.inside:
            self.divides, self.divided = False, True

    def _base(self, factor: str, place: int) -> Dimension:
        if factor in self.own_units and factor not in _BASE:
            return Dimension.of({factor: Fraction(1)})
        if factor in _BASE:
            return Dimension.of({unit: Fraction(power) for unit, power in _BASE[factor].items()})
        if factor in _SI_EQUIVALENTS:
            remedy = f"use {_SI_EQUIVALENTS[factor]}: units are not converted"
        else:
            close = get_close_matches(factor, [*_BASE, *self.own_units], n=1)
            remedy = f"did you mean {close[0]}?" if close else f"use SI units: {', '.join(_BASE)}"
        raise self._error(place, f"{quoted(factor)} is not a known unit", remedy)

    def _error(self, place: int, what: str, remedy: str) -> InputError:
        return InputError(what=f"{what} (column {place + 1} of {quoted(self.unit)})", where=self.where, remedy=remedy)


# Dimensional analysis of a formula's syntax tree; errors name the column.


UNIT_REMEDY = 'correct it, or give the constant its unit: constants = { x0 = "0.1 m" }'


def require_unit(tree: ast.expr, units: Mapping[str, Dimension], expected: Dimension, source: FormulaSource) -> None:
    """Raise InputError unless the formula has the unit `expected` and is consistent in itself."""
    unit = unit_of(tree, units, source)
    if unit is not None and unit != expected:
        what = f"its unit is {_unit_text(unit)}, expected {_unit_text(expected)}"
        raise source.error(tree.col_offset, what, UNIT_REMEDY)


def unit_of(tree: ast.expr, units: Mapping[str, Dimension], source: FormulaSource) -> Dimension | None:
    """The unit of a formula whose names have these units; None for a literal 0, which has any unit.

    Other literal numbers are dimensionless.
    Raises InputError, naming the column, for terms of different units or a function's argument of a wrong one.
    """
    match tree:
        case ast.Constant(value=value):
            return DIMENSIONLESS if value else None
        case ast.Name(id=name):
            return units[name]
        case ast.BinOp(op=ast.Pow()):
            return (unit_of(tree.left, units, source) or DIMENSIONLESS) ** exponent(tree)
        case ast.BinOp(op=ast.Mult() | ast.Div()):
            total = DIMENSIONLESS
            for sign, child in signed_parts(tree):
                total *= (unit_of(child, units, source) or DIMENSIONLESS) ** sign
            return total
        case ast.Call(func=ast.Name(id=name), args=arguments):
            return _of_call(name, arguments, units, source)
        case _:
            return _common_unit(child_nodes(tree), units, source)


def _of_call(
    name: str, arguments: Sequence[ast.expr], units: Mapping[str, Dimension], source: FormulaSource
) -> Dimension | None:
    rule = FORMULA_FUNCTIONS[name].rule
    if rule is UnitRule.SAME:
        return _common_unit(arguments, units, source)
    if rule is UnitRule.RATIO:
        _common_unit(arguments, units, source)
        return DIMENSIONLESS
    (argument,) = arguments
    unit = unit_of(argument, units, source) or DIMENSIONLESS
    if rule is UnitRule.ROOT:
        return unit ** Fraction(1, 2)
    if unit != DIMENSIONLESS:
        what = f"{name} needs a dimensionless argument, got {_unit_text(unit)}"
        raise source.error(argument.col_offset, what, "divide by a constant or parameter of that unit")
    return DIMENSIONLESS


def _common_unit(
    operands: Sequence[ast.expr], units: Mapping[str, Dimension], source: FormulaSource
) -> Dimension | None:
    """The common unit of all parts."""
    common: Dimension | None = None
    for operand in operands:
        unit = unit_of(operand, units, source)
        if common is not None and unit is not None and unit != common:
            what = f"incompatible units {_unit_text(unit)} and {_unit_text(common)}"
            raise source.error(operand.col_offset, what, UNIT_REMEDY)
        common = common if unit is None else unit
    return common


def _unit_text(unit: Dimension) -> str:
    return "1 (dimensionless)" if unit == DIMENSIONLESS else str(unit)
