"""The Laplace variable of transfer functions; it needs no NumPy, like all that only describes an effect."""

from __future__ import annotations

from modeling import symbolic as sp


def laplace() -> sp.Symbol:
    """s, in 1/s."""
    return sp.Symbol("s")
