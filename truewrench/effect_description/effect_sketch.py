"""Sketch of an effect, by its id, for reports, a manual or a page of the catalogue."""

from __future__ import annotations

from collections.abc import Callable

from modeling.chain.effect import Effect
from truewrench.effect_description.arm_sketches import ARM_SKETCHES
from truewrench.effect_description.drawing import Drawing
from truewrench.effect_description.sensor_sketches import SENSOR_SKETCHES
from truewrench.effect_description.tool_sketches import TOOL_SKETCHES

SKETCHES: dict[str, Callable[[Drawing], None]] = {
    draw.__name__: draw for draw in (*TOOL_SKETCHES, *ARM_SKETCHES, *SENSOR_SKETCHES)
}
"""What draws the effect of each id."""


def effect_sketch(effect: Effect) -> str:
    """The sketch as an SVG element with the names of the effect's parameters; empty for an effect that a user wrote."""
    if effect.id not in SKETCHES:
        return ""
    drawing = Drawing()
    SKETCHES[effect.id](drawing)
    return drawing.svg(f"Sketch: {effect.title}")
