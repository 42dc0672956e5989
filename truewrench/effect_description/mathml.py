"""Expressions as MathML (presentation form), by SymPy's printer."""

from __future__ import annotations

import re
from typing import Any
from xml.dom.minidom import Element
from xml.sax.saxutils import escape

import sympy as sp
from sympy.printing.mathml import MathMLPresentationPrinter

from modeling.chain.effect import Effect
from modeling.space import Space
from truewrench.effect_description.formula_mathml import GREEK

_ENTITY = re.compile(r"&(?!#|amp;|lt;|gt;|quot;|apos;)(\w+);")
_ENTITIES = {"InvisibleTimes": "&#x2062;", "ApplyFunction": "&#x2061;", "ExponentialE": "e", "dd": "d"}


CHANNELS = frozenset(channel for space in Space for channel in space.channels)


def channel_letter(effect: Effect, parameter: str) -> str:
    """The letter of a parameter that has the name of its channel; empty for any other."""
    return effect.letter if parameter in CHANNELS else ""


class FormulaPrinter(MathMLPresentationPrinter):  # type: ignore[misc]  # SymPy has no types
    """SymPy's printer, with the parameters of an effect marked by a class and under their names as they stand.

    One that is named as its channel is a letter with the channel as its index, as the load has that name too. The
    printer writes text as it is, so that names are escaped here.
    """

    def __init__(self, effect: Effect | None) -> None:
        super().__init__({"mul_symbol": "dot"})
        self.effect = effect

    def _print_Symbol(self, sym: sp.Symbol, style: str = "plain") -> Any:  # noqa: N802, SymPy calls it by this name
        if self.effect is None or not sym.name.startswith(f"{self.effect.id}."):
            plain = escape(sym.name)
            return super()._print_Symbol(sym if plain == sym.name else sp.Symbol(plain), style=style)
        name = sym.name.removeprefix(f"{self.effect.id}.")
        letter = channel_letter(self.effect, name)
        if not letter:
            return self._parameter("mi", escape(name))
        indexed: Element = self._parameter("msub")
        for text in (letter, GREEK.get(name, name)):
            indexed.appendChild(self._parameter("mi", text))
        return indexed

    def _parameter(self, tag: str, text: str = "") -> Element:
        element: Element = self.dom.createElement(tag)
        element.setAttribute("class", "parameter")
        if text:
            element.appendChild(self.dom.createTextNode(text))
        return element


def mathml(expression: sp.Basic, effect: Effect | None = None) -> str:
    """The expression as the content of a `<math>` element; well-formed XML without named entities."""
    text: str = FormulaPrinter(effect).doprint(expression)
    return _ENTITY.sub(lambda entity: _ENTITIES.get(entity[1], " "), text)


def equation_mathml(left: sp.Basic, right: sp.Basic, effect: Effect | None = None) -> str:
    """`left = right` as a `<math>` element of its own line."""
    sides = f"{mathml(left, effect)}<mo>=</mo>{mathml(right, effect)}"
    return f'<math display="block"><mrow>{sides}</mrow></math>'
