"""Expressions as MathML (presentation form), by SymPy's printer."""

from __future__ import annotations

import re
from typing import Any
from xml.dom.minidom import Element
from xml.sax.saxutils import escape

import sympy as sp
from sympy.printing.mathml import MathMLPresentationPrinter

from truewrench.effect_description.formula_mathml import GREEK

_ENTITY = re.compile(r"&(?!#|amp;|lt;|gt;|quot;|apos;)(\w+);")
_ENTITIES = {"InvisibleTimes": "&#x2062;", "ApplyFunction": "&#x2061;", "ExponentialE": "e", "dd": "d"}


CHANNELS = frozenset(("fx", "fy", "fz", "tau", "tx", "ty", "tz"))
LETTERS = {"sensor_hysteresis": "h", "sensor_gain": "gain", "saturation": "level", "thermal_drift": "b"}
"""Of parameters that are named as the channel that they belong to, by effect."""


def channel_letter(effect: str, parameter: str) -> str:
    """The letter of a parameter that has the name of its channel; empty for any other."""
    return LETTERS.get(effect, "b") if parameter in CHANNELS else ""


class FormulaPrinter(MathMLPresentationPrinter):  # type: ignore[misc]  # SymPy has no types
    """SymPy's printer, with the parameters of an effect marked by a class and under their names as they stand.

    One that is named as its channel is a letter with the channel as its index, as the load has that name too. The
    printer writes text as it is, so that names are escaped here.
    """

    def __init__(self, effect: str) -> None:
        super().__init__({"mul_symbol": "dot"})
        self.effect = effect
        self.prefix = f"{effect}."

    def _print_Symbol(self, sym: sp.Symbol, style: str = "plain") -> Any:  # noqa: N802, SymPy calls it by this name
        if not sym.name.startswith(self.prefix):
            plain = escape(sym.name)
            return super()._print_Symbol(sym if plain == sym.name else sp.Symbol(plain), style=style)
        name = sym.name.removeprefix(self.prefix)
        letter = channel_letter(self.effect, name)
        if not letter:
            return self._parameter("mi", escape(name))
        found: Element = self._parameter("msub")
        for text in (letter, GREEK.get(name, name)):
            found.appendChild(self._parameter("mi", text))
        return found

    def _parameter(self, tag: str, text: str = "") -> Element:
        found: Element = self.dom.createElement(tag)
        found.setAttribute("class", "parameter")
        if text:
            found.appendChild(self.dom.createTextNode(text))
        return found


def mathml(expression: sp.Basic, effect: str = "") -> str:
    """The expression as the content of a `<math>` element; well-formed XML without named entities."""
    text: str = FormulaPrinter(effect).doprint(expression)
    return _ENTITY.sub(lambda found: _ENTITIES.get(found[1], " "), text)


def equation_mathml(left: sp.Basic, right: sp.Basic, effect: str = "") -> str:
    """`left = right` as a `<math>` element of its own line."""
    sides = f"{mathml(left, effect)}<mo>=</mo>{mathml(right, effect)}"
    return f'<math display="block"><mrow>{sides}</mrow></math>'
