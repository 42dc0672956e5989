"""Quantity: a named number as text."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Quantity:
    """A named number as text, with its unit."""

    name: str
    value: str
    unit: str
