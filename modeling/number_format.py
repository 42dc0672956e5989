"""Formatting of numbers, units, p-values and estimates ± std: plain in text, with powers of ten typeset in HTML."""

from __future__ import annotations

import re
from dataclasses import dataclass
from math import floor, isfinite, log10
from typing import Any

P_VALUE = "p"
"""Format of a p-value, beside the format specifications of Python such as `.3g` and `.2f`."""
SHARE = "%"
"""Format of a share, likewise."""
SMALLEST_P_VALUE = 1e-300
"""p-values below are not told apart: their tail is beyond double precision."""
LEAST_PROBABILITY = 1e-3
"""Of a model that is said as a number: smaller ones rest on tails of the noise that nobody has seen."""

_POWER = re.compile(r"(?<![\w.])(\d+(?:\.\d+)?)e([+-]\d+)(?!\w)")
_UNIT_PRODUCT = re.compile(r"(?<=\bN) (?=[ms](?![a-z]))|(?<=\bN²) (?=m)|(?<=\bkg) (?=m(?![a-z]))")
_MINUS = re.compile(r"(?<![\w.)\]-])-(?=\d)")
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
NOT_IDENTIFIABLE = "not identifiable"
"""Printed for an unidentifiable parameter, whose standard deviation is infinite and whose value means nothing."""
NO_VALUE = "–"
"""Printed where there is no number."""


def finite(value: Any) -> Any:
    """The same data for JSON, with None for every number that is not finite."""
    if isinstance(value, dict):
        return {k: finite(v) for k, v in value.items()}
    if isinstance(value, list):
        return [finite(v) for v in value]
    if isinstance(value, float):
        return float(value) if isfinite(value) else None
    return value


def plain_number(value: float, spec: str) -> str:
    """A finite number as plain text, in a format of Python, `P_VALUE` or `SHARE`."""
    if spec == P_VALUE:
        return f"< {SMALLEST_P_VALUE:.0e}" if value < SMALLEST_P_VALUE else f"{value:.2g}"
    return format_percentage(value) if spec == SHARE else f"{value:{spec}}"


def p_value_text(p: float, relation: str = "=") -> str:
    """A p-value with its name as plain text: `p = 0.02`, `p < 1e-300`."""
    number = plain_number(p, P_VALUE)
    return f"p {number}" if number.startswith("<") else f"p {relation} {number}"


def typeset_number(value: float, spec: str) -> str:
    """A finite number for HTML, in a format of Python, `P_VALUE` or `SHARE`."""
    if spec == P_VALUE:
        return format_p_value(value)
    if spec == SHARE:
        return format_percentage(value)
    return format_number(value, int(spec[1:-1])) if spec.endswith("g") else f"{value:{spec}}".replace("-", "−")


def as_sentence(text: str) -> str:
    """The text with a capital and a full stop; empty for none."""
    return f"{text[0].upper()}{text[1:]}." if text else ""


def typeset_text(text: str) -> str:
    """A sentence with its numbers and units as in a typeset table: `7e-05 N m` is 7·10⁻⁵ N·m."""
    return typeset_units(_POWER.sub(_typeset_power, text))


def typeset_units(text: str) -> str:
    """The text with factors of units joined by a dot, and with minus signs: `-2 N m` is −2 N·m."""
    return _MINUS.sub("−", _UNIT_PRODUCT.sub("·", text))


def _typeset_power(power: re.Match[str]) -> str:
    lead = "" if power[1] == "1" else f"{power[1]}·"
    return f"{lead}10{_superscript(int(power[2]))}"


def format_number(value: float | None, digits: int = 3) -> str:
    """A number to so many significant digits; a dash for none."""
    if value is None or not isfinite(value):
        return NO_VALUE
    if value == 0:
        return "0"
    exponent = floor(log10(abs(value)))
    if exponent < -4 or exponent > 5:
        return f"{_signed(value / 10.0**exponent, digits - 1)}·10{_superscript(exponent)}"
    return _signed(value, max(0, digits - 1 - exponent))


def format_with_std(value: float, std: float) -> str:
    """value ± std, both to two digits of the std; the value alone for a std of zero."""
    if not isfinite(value):
        return NO_VALUE
    if not isfinite(std):
        return NOT_IDENTIFIABLE
    if std <= 0:
        return format_number(value, 4)
    size = floor(log10(max(abs(value), std)))
    places = 1 - floor(log10(std))
    if size < -3 or size > 5:
        scale = 10.0**size
        shown = min(9, max(0, places + size))
        return f"({_signed(value / scale, shown)} ± {std / scale:.{shown}f})·10{_superscript(size)}"
    shown = min(9, max(0, places))
    return f"{_signed(value, shown)} ± {std:.{shown}f}"


def format_unit(unit: str) -> str:
    """A unit with its factors joined by a dot: `N m` is N·m; nothing for a plain number."""
    if unit == "1":
        return ""
    return unit if unit == "as recorded" else unit.replace(" ", "·")


def axis_label(name: str, unit: str) -> str:
    """The label of an axis: name and, in brackets, unit."""
    shown = format_unit(unit)
    return f"{name} ({shown})" if shown else name


def format_p_value(p: float | None) -> str:
    """A p-value; those below a millionth as a power of ten."""
    if p is None or not isfinite(p):
        return NO_VALUE
    if p <= SMALLEST_P_VALUE:
        return "< 10⁻³⁰⁰"
    if p < 1e-6:
        return f"10{_superscript(round(log10(p)))}"
    return "1" if p >= 0.995 else format_number(p, 2)


def probability_text(probability: float) -> str:
    """A probability as plain text, to two digits; nothing finer than `LEAST_PROBABILITY`, nor a 1 that is none."""
    if probability < LEAST_PROBABILITY:
        return f"below {LEAST_PROBABILITY:g}"
    return "above 0.99" if 0.995 <= probability < 1 else f"{probability:.2g}"


def format_percentage(share: float | None) -> str:
    """A share as a percentage that never rounds to a whole hundred or to zero when it is neither."""
    if share is None or not isfinite(share):
        return NO_VALUE
    if 0.999 < share < 1:
        return "> 99.9 %"
    if 0 < share < 0.001:
        return "< 0.1 %"
    return f"{100 * share:.1f} %" if share not in (0, 1) else f"{share:.0%}".replace("%", " %")


def _signed(value: float, places: int) -> str:
    return f"{value:.{places}f}".replace("-", "−")


def _superscript(exponent: int) -> str:
    return str(exponent).translate(SUPERSCRIPTS)


def estimate_text(value: float, std: float, unit: str) -> str:
    """An estimate as plain text `value ± std unit`, to two digits of its standard deviation; none of what has none."""
    unit = "" if unit == "1" else f" {unit}"
    if std == 0:
        return f"{value:.6g}{unit}, fixed"
    if not isfinite(std):
        return "not identifiable from these recordings"
    return f"{format_with_std(value, std)}{unit}".replace("−", "-")


def digits_of(value: float, std: float) -> str:
    """Format of a value to two digits of the standard deviation of its estimate; to six where it has none."""
    if not (isfinite(value) and isfinite(std) and std > 0):
        return ".6g"
    digits = 2 if value == 0 else 2 + floor(log10(abs(value))) - floor(log10(std))
    return f".{max(digits, 1)}g"


def interval_text(low: float, high: float, std: float) -> str:
    """An interval as plain text, to two digits of the standard deviation of its estimate."""
    return f"{low:{digits_of(low, std)}} to {high:{digits_of(high, std)}}"


@dataclass(frozen=True)
class FormattedQuantity:
    """A named number as text, with its unit."""

    name: str
    value: str
    unit: str

    @classmethod
    def of(
        cls, name: str, value: float | None, unit: str, std: float | None = None, *, digits: int = 3
    ) -> FormattedQuantity:
        """A value to so many significant digits, or with its std; one with a std of zero is fixed."""
        text = format_number(value, digits) if std is None or value is None else format_with_std(value, std)
        text += " (fixed)" if std == 0 else ""
        return cls(name, text, format_unit(unit))
