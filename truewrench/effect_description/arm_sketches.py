"""Sketches of effects of the arm: its joints and links."""

from __future__ import annotations

from truewrench.effect_description.drawing import Drawing


def joint_offset(d: Drawing) -> None:
    """A joint stands at another angle than is recorded."""
    d.base()
    d.arm(hand=(196, 60), kind="ghost")
    d.arm(hand=(186, 100))
    d.text(232, 48, "recorded", "end")
    d.text(192, 114, "true")
    d.arc(112, 52, 52, 6, 34)
    d.parameter(172, 82, "offset_j")


def joint_elasticity(d: Drawing) -> None:
    """A joint gives way under the tool's weight."""
    d.base()
    d.arm(hand=(196, 56), kind="ghost")
    d.arm(hand=(190, 84))
    d.arrow(190, 86, 190, 124, "ink")
    d.text(196, 122, "weight")
    d.arc(112, 52, 14, -150, 150)
    d.parameter(100, 32, "compliance_j", "middle")


def joint_backlash(d: Drawing) -> None:
    """A joint rests at either end of a gap."""
    d.base()
    d.arm(hand=(196, 44), kind="ghost")
    d.arm(hand=(184, 98))
    d.arc(112, 52, 62, -6, 32)
    d.parameter(182, 68, "width_j")
    d.text(232, 120, "rests where the weight pulls it", "end")


def link_length_error(d: Drawing) -> None:
    """A link is longer than described."""
    d.base()
    d.arm(hand=(166, 64))
    d.line(166, 64, 206, 73, "accent")
    d.circle(206, 73, 3, "accent dot")
    d.dimension(162, 82, 202, 91, "error_j", (182, 108), "middle")
    d.text(130, 44, "as described")


ARM_SKETCHES = (joint_offset, joint_elasticity, joint_backlash, link_length_error)
