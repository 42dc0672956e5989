"""Expressions as MathML (presentation form), by SymPy's printer; formulas that are text, piece by piece."""

from __future__ import annotations

import re
from typing import Any
from xml.dom.minidom import Element
from xml.sax.saxutils import escape

import sympy as sp
from sympy.printing.mathml import MathMLPresentationPrinter

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


# ------------------------------------------------------------------------------------------- formulas that are text

_TOKEN = re.compile(
    r"(?P<number>\d+(?:\.\d+)?)|(?P<name>[^\W\d_²³⁴]+(?:_[^\W²³⁴]+)?)|(?P<power>[²³⁴]|\*\*|\^)|(?P<prime>')"
    r"|(?P<operator>\+=|-=|->|<=|>=|[-+*/=<>|()\[\]·,])|(?P<space>\s+)|(?P<other>.)"
)
_OPERATION = re.compile("[-=+*/<>|^]")
GREEK = {"pi": "π", "omega": "ω", "theta": "θ", "alpha": "α", "phi": "φ", "tau": "τ", "dtheta": "dθ"}
OPERATORS = {"-": "−", "*": "·", "->": "→", "<=": "≤", ">=": "≥", "+=": "+=", "-=": "−="}
SUPERSCRIPT_DIGITS = {"²": "2", "³": "3", "⁴": "4"}
WORDS = "for while the of to it is in and or with at relative rotation tool sensor rises falls"
PROSE = frozenset(WORDS.split())
"""Words between formulas."""
LONGEST_INDEX = 2
"""Characters: `time_0` has an index, `time_constant` is one name."""


def formula_mathml(text: str) -> str:
    """A formula that is text as MathML, an element for each part between commas; typeset by its signs, never evaluated.

    What it does not know is shown as it is, a part without any operator as words.
    """
    return ", ".join(
        f"<math><mrow>{_pieces(part)}</mrow></math>" if _OPERATION.search(part) else _words(part)
        for part in _parts(text)
    )


def _words(part: str) -> str:
    return escape(re.sub(r"[^\W\d_]+", lambda found: GREEK.get(found[0], found[0]), part))


def _parts(text: str) -> list[str]:
    """Between commas that are outside all brackets."""
    parts, depth = [""], 0
    for character in text:
        depth += (character in "([") - (character in ")]")
        if character == "," and depth <= 0:
            parts.append("")
        else:
            parts[-1] += character
    return [part.strip() for part in parts if part.strip()]


def _pieces(part: str) -> str:
    pieces: list[str] = []
    raise_next = False
    for found in _TOKEN.finditer(part):
        kind, token = found.lastgroup, found[0]
        if kind == "power" and token not in SUPERSCRIPT_DIGITS:
            raise_next = bool(pieces)
        elif kind in ("power", "prime") and pieces:
            raised = "<mo>′</mo>" if kind == "prime" else f"<mn>{SUPERSCRIPT_DIGITS[token]}</mn>"
            pieces[-1] = f"<msup>{pieces[-1]}{raised}</msup>"
        elif raise_next and kind != "space":
            pieces[-1], raise_next = f"<msup>{pieces[-1]}{_piece(kind, token)}</msup>", False
        elif not raise_next:
            pieces.append(_piece(kind, token))
    return "".join(pieces)


def _piece(kind: str | None, token: str) -> str:
    if kind == "space":
        return '<mspace width="0.2em"/>'
    if kind == "number":
        return f"<mn>{token}</mn>"
    if kind == "operator":
        return f"<mo>{escape(OPERATORS.get(token, token))}</mo>"
    if kind != "name" or token in PROSE:
        return f"<mtext>{escape(token)}</mtext>"
    base, _, index = token.partition("_")
    if len(index) > LONGEST_INDEX:
        return f"<mi>{escape(token)}</mi>"
    known = f"<mi>{escape(GREEK.get(base, base))}</mi>"
    return f"<msub>{known}<mi>{escape(index)}</mi></msub>" if index else known
