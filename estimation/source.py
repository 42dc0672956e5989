"""Source: what the noise of a recording is known from."""

from __future__ import annotations

from enum import Enum


class NoiseSource(Enum):
    """What the noise is known from."""

    REPEATS = "repeats"
    RIG = "rig"
    RESIDUAL = "residual"
