"""Discrimination: motions along which rival models of one rig predict different readings."""

from __future__ import annotations

from design.discrimination.direction import Direction
from design.discrimination.distinction import Distinction
from design.discrimination.hypothesis import Hypothesis, in_place_of, opponents
from design.discrimination.imitation import Imitation, imitate
from design.discrimination.pair import Pair, Separation, Verdict
from design.discrimination.search import Round
from design.discrimination.setting import Setting
from design.discrimination.telling import tell_apart
from design.discrimination.view import View

__all__ = [
    "Direction",
    "Distinction",
    "Hypothesis",
    "Imitation",
    "Pair",
    "Round",
    "Separation",
    "Setting",
    "Verdict",
    "View",
    "imitate",
    "in_place_of",
    "opponents",
    "tell_apart",
]
