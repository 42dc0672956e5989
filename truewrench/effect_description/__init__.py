"""An effect as a reader sees it: sketch (SVG), equations (MathML), its size in a recording."""

from __future__ import annotations

from truewrench.effect_description.effect_sketch import SKETCH_STYLE, effect_sketch

__all__ = ["SKETCH_STYLE", "effect_sketch"]
