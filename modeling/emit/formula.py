"""Formula: names, expressions and matrices in LaTeX."""

from __future__ import annotations

import re
from collections.abc import Iterable

from modeling import symbolic as sp

DOTS = {"": "{}", "d": r"\dot{{{}}}", "dd": r"\ddot{{{}}}"}
"""How the rate of a letter is written."""

LETTERS = {
    "w": r"\omega",
    "omega": r"\omega",
    "al": r"\alpha",
    "alpha": r"\alpha",
    "p": "p",
    "v": "v",
    "vp": "v",
    "a": "a",
    "ap": "a",
    "q": "q",
    "m": "c",
    "I": "I",
    "r": "r",
    "lift": r"\ell",
}
"""Letters of vectors and tensors, whose components end in their axes: mx, my, mz are the first moment c."""

WORDS = {"phi": r"\varphi", "mlg": "m l_g", "mlx": "m l_x", "s": "s", "m": "m", "I": "I", "time": "t", "tau": r"\tau"}

JOINT = re.compile(r"(d{0,2})q(\d+)\Z")
COMPONENT = re.compile(rf"({'|'.join(sorted(LETTERS, key=len, reverse=True))})_?([xyz]{{1,2}})\Z")
STEP = re.compile(r"(shared|power|step|t)_?(\d+)\Z")


SPECIAL = {
    "\\": r"\textbackslash{}",
    "^": r"\textasciicircum{}",
    "~": r"\textasciitilde{}",
    "²": r"\textsuperscript{2}",
    "³": r"\textsuperscript{3}",
    "°": r"\textdegree{}",
}
"""Characters for which a backslash before them is not enough."""


def name(symbol: str) -> str:
    """The name of a symbol, as people write it; whatever has no letter of its own stands upright."""
    if symbol in WORDS:
        return WORDS[symbol]
    if symbol in ("dphi", "ddphi"):
        return DOTS[symbol[:-3]].format(r"\varphi")
    if found := JOINT.match(symbol):
        return f"{DOTS[found[1]].format('q')}_{{{found[2]}}}"
    if found := COMPONENT.match(symbol):
        return f"{LETTERS[found[1]]}_{{{found[2]}}}"
    if found := STEP.match(symbol):
        return f"t_{{{found[2]}}}"
    if symbol.startswith("rho_"):
        return rf"\rho_{{{symbol.removeprefix('rho_')}}}"
    if symbol.startswith("bias_"):
        return f"b_{{{upright(symbol.removeprefix('bias_'))}}}"
    effect, dot, own = symbol.partition(".")
    if dot:
        letter = own if len(own) == 1 and own.isalpha() else upright(own)
        return f"{letter}_{{{upright(effect)}}}"
    return upright(symbol)


def upright(text: str) -> str:
    """Upright letters, digits and underscores of a name in a formula; nothing else comes through."""
    plain = "".join(c for c in text if c.isascii() and (c.isalnum() or c == "_"))
    return r"\mathrm{" + plain.replace("_", r"\_") + "}"


def escaped(text: str) -> str:
    """Text of which TeX takes every character for itself."""
    return "".join(SPECIAL.get(c, f"\\{c}" if c in "#$%&_{}" else c) for c in text)


def formula(expression: sp.Expr) -> str:
    """An expression."""
    names = {symbol: name(symbol.name) for symbol in expression.free_symbols}
    return str(sp.latex(expression, symbol_names=names, mul_symbol=r" \, ", inv_trig_style="full"))


def matrix(rows: Iterable[Iterable[str]]) -> str:
    """A matrix of formulas."""
    body = " \\\\\n".join(" & ".join(row) for row in rows)
    return "\\begin{bmatrix}\n" + body + "\n\\end{bmatrix}"


def matrix_of(values: sp.Matrix) -> str:
    """A matrix of expressions."""
    return matrix([formula(values[i, j]) for j in range(values.cols)] for i in range(values.rows))


def document(source: str, body: Iterable[str]) -> str:
    """A whole document that LaTeX alone sets; `source` names the project and its version."""
    return "\n".join(
        [
            f"% Written by {source}.",
            r"\documentclass[a4paper]{article}",
            r"\usepackage[T1]{fontenc}",
            r"\usepackage{amsmath,longtable}",
            r"\usepackage[landscape,margin=15mm]{geometry}",
            r"\setcounter{MaxMatrixCols}{20}",
            r"\allowdisplaybreaks",
            r"\begin{document}",
            *body,
            r"\end{document}",
            "",
        ]
    )


def equations(pairs: Iterable[tuple[str, str]]) -> str:
    """Equations `left = right`, one a line, aligned at their signs."""
    return "\\begin{align}\n" + " \\\\\n".join(f"{left} &= {right}" for left, right in pairs) + "\n\\end{align}"
