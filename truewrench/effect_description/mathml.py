"""Expressions as MathML (presentation form), by SymPy's printer."""

from __future__ import annotations

import re
from typing import Any
from xml.dom.minidom import Element
from xml.sax.saxutils import escape

import sympy as sp
from sympy.printing.mathml import MathMLPresentationPrinter

_ENTITY = re.compile(r"&(?!#|amp;|lt;|gt;|quot;|apos;)(\w+);")
_ENTITIES = {"InvisibleTimes": "&#x2062;", "ApplyFunction": "&#x2061;", "ExponentialE": "e", "dd": "d"}


class FormulaPrinter(MathMLPresentationPrinter):  # type: ignore[misc]  # SymPy has no types
    """SymPy's printer, with the parameters of an effect marked by a class and under their names as they stand.

    It writes text as it is, so that names are escaped here.
    """

    def __init__(self, effect: str) -> None:
        super().__init__({"mul_symbol": "dot"})
        self.prefix = f"{effect}."

    def _print_Symbol(self, sym: sp.Symbol, style: str = "plain") -> Any:  # noqa: N802, SymPy calls it by this name
        if not sym.name.startswith(self.prefix):
            plain = escape(sym.name)
            return super()._print_Symbol(sym if plain == sym.name else sp.Symbol(plain), style=style)
        named: Element = self.dom.createElement("mi")
        named.setAttribute("class", "parameter")
        named.appendChild(self.dom.createTextNode(escape(sym.name.removeprefix(self.prefix))))
        return named


def mathml(expression: sp.Basic, effect: str = "") -> str:
    """The expression as the content of a `<math>` element; well-formed XML without named entities."""
    text: str = FormulaPrinter(effect).doprint(expression)
    return _ENTITY.sub(lambda found: _ENTITIES.get(found[1], " "), text)


def equation_mathml(left: sp.Basic, right: sp.Basic, effect: str = "") -> str:
    """`left = right` as a `<math>` element of its own line."""
    sides = f"{mathml(left, effect)}<mo>=</mo>{mathml(right, effect)}"
    return f'<math display="block"><mrow>{sides}</mrow></math>'
