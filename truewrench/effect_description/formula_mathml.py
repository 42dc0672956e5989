"""Formulas that are text as MathML (presentation form), piece by piece; nothing is evaluated."""

from __future__ import annotations

import re
from xml.sax.saxutils import escape

_TOKEN = re.compile(
    r"(?P<number>\d+(?:\.\d+)?)|(?P<name>[^\W\d_²³⁴]+(?:_[^\W²³⁴]+)?)|(?P<inverse>(?:\*\*|\^)-\d+)|(?P<power>[²³⁴]|\*\*|\^)|(?P<prime>')"
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
    return escape(re.sub(r"[^\W\d_]+", lambda word: GREEK.get(word[0], word[0]), part))


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
    for match in _TOKEN.finditer(part):
        kind, token = match.lastgroup, match[0]
        if kind == "inverse" and pieces:
            raised = f"<mrow><mo>−</mo><mn>{token.rpartition('-')[2]}</mn></mrow>"
            pieces[-1] = f"<msup>{pieces[-1]}{raised}</msup>"
        elif kind == "power" and token not in SUPERSCRIPT_DIGITS:
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
    if token == "|":
        return '<mo stretchy="false" lspace="0" rspace="0">|</mo>'  # what it is raised to stands beside it
    if kind == "operator":
        return f"<mo>{escape(OPERATORS.get(token, token))}</mo>"
    if kind != "name" or token in PROSE:
        return f"<mtext>{escape(token)}</mtext>"
    base, _, index = token.partition("_")
    if len(index) > LONGEST_INDEX:
        return f"<mi>{escape(token)}</mi>"
    letter = f"<mi>{escape(GREEK.get(base, base))}</mi>"
    return f"<msub>{letter}<mi>{escape(index)}</mi></msub>" if index else letter
