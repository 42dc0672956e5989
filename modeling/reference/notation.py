"""Symbols of chapter 22 (Bassi et al.) in plain text and in LaTeX."""

from __future__ import annotations

import sympy as sp

LATEX = {
    "dphi": r"\dot\varphi", "ddphi": r"\ddot\varphi", "phi": r"\varphi", "ax": "a_x", "ay": "a_y", "vx": "v_x",
    "vy": "v_y", "mlg": "m l_g", "bias_fx": "b_x", "bias_fy": "b_y", "bias_tau": r"b_\tau", "fcx": "f_{cx}",
    "fcy": "f_{cy}", "tauc": r"\tau_c", "fx": "f_x", "fy": "f_y", "tau": r"\tau",
}  # fmt: skip
"""LaTeX of signals and parameters, by name."""


def as_text(matrix: sp.Matrix) -> str:
    """A matrix as text, row by row, entries separated by two spaces."""
    return "\n".join("  ".join(sp.sstr(e, full_prec=False) for e in matrix.row(i)) for i in range(matrix.rows))


def as_latex(matrix: sp.Matrix) -> str:
    """A matrix, or its single entry, as LaTeX without $."""
    names = {s: LATEX[s.name] for s in matrix.free_symbols if isinstance(s, sp.Symbol) and s.name in LATEX}
    return str(sp.latex(matrix[0] if matrix.shape == (1, 1) else matrix, symbol_names=names))


def latex_words(text: str) -> str:
    """Text within LaTeX, underscores escaped."""
    return rf"\text{{{text}}}".replace("_", r"\_")


def latex_lines(parts: list[str]) -> str:
    """Aligned lines of LaTeX, for a notebook."""
    return "$\\displaystyle \\begin{aligned}" + r" \\ ".join(f"&{part}" for part in parts) + r"\end{aligned}$"
