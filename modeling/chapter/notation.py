"""Notation: the chapter's symbols as a person reads them, in plain text and in LaTeX."""

from __future__ import annotations

import sympy as sp

LATEX = {
    "dphi": r"\dot\varphi", "ddphi": r"\ddot\varphi", "phi": r"\varphi", "ax": "a_x", "ay": "a_y", "vx": "v_x",
    "vy": "v_y", "mlg": "m l_g", "bias_fx": "b_x", "bias_fy": "b_y", "bias_tau": r"b_\tau", "fcx": "f_{cx}",
    "fcy": "f_{cy}", "tauc": r"\tau_c", "fx": "f_x", "fy": "f_y", "tau": r"\tau",
}  # fmt: skip
"""Letters for the signals and parameters whose names are words."""


def as_text(matrix: sp.Matrix) -> str:
    """A matrix row by row, entries parted by two blanks."""
    return "\n".join("  ".join(sp.sstr(e, full_prec=False) for e in matrix.row(i)) for i in range(matrix.rows))


def as_latex(matrix: sp.Matrix) -> str:
    """A matrix, or its one entry, without dollars."""
    names = {s: LATEX[s.name] for s in matrix.free_symbols if isinstance(s, sp.Symbol) and s.name in LATEX}
    return str(sp.latex(matrix[0] if matrix.shape == (1, 1) else matrix, symbol_names=names))


def words(text: str) -> str:
    """Words within LaTeX; an underscore would be an index."""
    return rf"\text{{{text}}}".replace("_", r"\_")


def lines(parts: list[str]) -> str:
    """Lines of LaTeX under one another, for a notebook."""
    return "$\\displaystyle \\begin{aligned}" + r" \\ ".join(f"&{part}" for part in parts) + r"\end{aligned}$"
