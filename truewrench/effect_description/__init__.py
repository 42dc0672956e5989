"""Sketches of effects (SVG), with what each parameter is."""

from __future__ import annotations

from truewrench.effect_description.effect_sketch import SKETCHES, effect_sketch
from truewrench.effect_description.parameter_meanings import parameter_meaning
from truewrench.effect_description.sketch_style import SKETCH_STYLE

__all__ = ["SKETCHES", "SKETCH_STYLE", "effect_sketch", "parameter_meaning"]
