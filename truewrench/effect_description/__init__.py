"""Sketches of effects (SVG), with what each parameter is."""

from __future__ import annotations

from truewrench.effect_description.effect_sketch import SKETCH_STYLE, SKETCHES, effect_sketch
from truewrench.effect_description.effect_words import parameter_meaning

__all__ = ["SKETCHES", "SKETCH_STYLE", "effect_sketch", "parameter_meaning"]
