"""What a noise estimate rests on: repeats, rig or residual."""

from __future__ import annotations

from enum import Enum


class NoiseSource(Enum):
    """What a noise estimate rests on: the repeats, the std stated in the rig, or the residual of a fit."""

    REPEATS = "repeats"
    RIG = "rig"
    RESIDUAL = "residual"
