"""Units: the dimension of a unit's text, and products and powers of dimensions."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from fractions import Fraction

from modeling.errors import InputError
from modeling.shown import shown

Powers = tuple[tuple[str, Fraction], ...]

LONGEST = 60
"""Characters of a unit's text: ten factors, each with a power."""
LARGEST_POWER = 12
"""Of a factor; no law of physics that a wrench obeys has more, and larger ones are slips of the key."""

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
"""Units that multiply without factors (SI); °C counts as K: differences of temperature are all that is multiplied."""

_INSTEAD: Mapping[str, str] = {
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
"""What to write instead of units that would need a factor."""

_NAMES = ("1", "N", "N m", "N/m", "N s/m", "N s²/m²", "N/m²", "N m/rad", "1/m", "1/s", "1/N", "m/s", "m/s²", "kg m")
"""Dimensions that are said like this; others in kg, m, s, K, A."""

_SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")
_DIGITS = str.maketrans("0123456789-/", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻ᐟ")
_TOKEN = re.compile(r"(?P<factor>1(?![0-9])|[A-Za-zµΩ°%]+)(?:\^?(?P<power>-?[0-9]{1,2}))?|(?P<sign>[/()*·]|\s+)")


@dataclass(frozen=True)
class Dimension:
    """Base units with their powers, sorted by name; none for a pure number."""

    powers: Powers = ()

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
        above = [_raised(unit, power) for unit, power in self.powers if power > 0]
        below = [_raised(unit, -power) for unit, power in self.powers if power < 0]
        under = " ".join(below) if len(below) < 2 else f"({' '.join(below)})"
        return (" ".join(above) or "1") + (f"/{under}" if below else "")


NUMBER = Dimension()
"""The dimension of a pure number, and of an angle."""


def dimension(unit: str, *, own: Collection[str] = (), where: str = "unit") -> Dimension:
    """The dimension of a unit such as `N s²/m²`, `N*s^2/m^2` or `rad/(N m)`.

    Factors stand side by side or with `*` between them; after `/` comes one factor, or several in brackets. `own` are
    units of which nothing is known but their name, each a dimension of its own.
    Raises InputError, naming the character at fault, for what is not a unit or would need a factor (mm, deg).
    """
    return _Reader(unit, own, where).read()


def _raised(unit: str, power: Fraction) -> str:
    return unit if power == 1 else unit + str(power).translate(_DIGITS)


class _Reader:
    """One pass over a unit's text."""

    def __init__(self, unit: str, own: Collection[str], where: str) -> None:
        self.unit, self.own, self.where = unit, own, where
        self.text = unit.translate(_SUPERSCRIPTS)
        self.total = NUMBER
        self.divides = self.inside = self.divided = False

    def read(self) -> Dimension:
        if not self.text.strip() or len(self.text) > LONGEST:
            raise self._refusal(0, "a unit was expected", "write one such as N s/m, or 1 for a pure number")
        place = 0
        while place < len(self.text):
            match = _TOKEN.match(self.text, place)
            if match is None:
                raise self._refusal(place, f"{shown(self.unit[place])} is no part of a unit", "write it like N s^2/m^2")
            if match["sign"]:
                self._sign(match["sign"].strip(), place)
            else:
                self._factor(match["factor"], int(match["power"] or 1), place)
            place = match.end()
        if self.inside or self.divides:
            raise self._refusal(len(self.text), "the unit ends too early", "write it like rad/(N m)")
        return self.total

    def _sign(self, sign: str, place: int) -> None:
        bracket = {"(": self.divides and not self.inside, ")": self.inside, "/": not (self.divides or self.inside)}
        if not bracket.get(sign, True):
            raise self._refusal(place, f"'{sign}' is not expected there", "use brackets after / only: rad/(N m)")
        self.inside = sign == "(" or (self.inside and sign != ")")
        if sign == "/":
            self.divides = True
        if sign == ")":
            self.divides, self.divided = False, True

    def _factor(self, factor: str, power: int, place: int) -> None:
        if self.divided and not self.divides:
            raise self._refusal(place, f"it is not clear whether '{factor}' divides", "use brackets: 1/(m s)")
        if not 0 < abs(power) <= LARGEST_POWER:
            raise self._refusal(place, f"the power {power} was not expected", f"use powers up to {LARGEST_POWER}")
        base = self._base(factor, place)
        self.total *= base ** (-power if self.divides else power)
        if self.divides and not self.inside:
            self.divides, self.divided = False, True

    def _base(self, factor: str, place: int) -> Dimension:
        if factor in self.own and factor not in _BASE:
            return Dimension.of({factor: Fraction(1)})
        if factor in _BASE:
            return Dimension.of({unit: Fraction(power) for unit, power in _BASE[factor].items()})
        if factor in _INSTEAD:
            remedy = f"use {_INSTEAD[factor]}, as nothing is converted"
        else:
            close = get_close_matches(factor, [*_BASE, *self.own], n=1)
            remedy = f"did you mean {close[0]}?" if close else f"use SI units: {', '.join(_BASE)}"
        raise self._refusal(place, f"{shown(factor)} is no unit that is known", remedy)

    def _refusal(self, place: int, what: str, remedy: str) -> InputError:
        return InputError(what=f"{what} (column {place + 1} of {shown(self.unit)})", where=self.where, remedy=remedy)
