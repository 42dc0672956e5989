"""Effects of what ties the tool to the cell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from math import dist, inf

from modeling import symbolic as sp
from modeling.chain import Chain, Stage, in_plane, point_on_tip
from modeling.effect import Effect, Extent, Values
from modeling.effects.push import DISTANCE, SLOWEST, pushed
from modeling.parameter import Parameter
from modeling.space import Space

CELL = (-5.0, 5.0)
"""Where a tether can be tied (m, each world axis): in the robot's cell. From farther away it is a constant force."""


@dataclass(frozen=True)
class CableSpring(Effect):
    """A tether pulls the point at d along the tip towards an anchor, and never pushes.

    With u the vector from the point to the anchor (world, m), F = k max(0, |u| - length) u/|u|: k in N/m,
    length (m) is where it goes taut.
    """

    id = "cable_spring"
    title = "tether or cable pulling at the tool"
    stage = Stage.TIP_BODY
    equation = "F = k max(0, |u| - length) u/|u|, u = anchor - point(d)"
    advice = "look for a cable or hose that goes taut in part of the workspace; free it and record again"
    confused_with = "gravity_tilt, when the anchor is far away; any other force that depends on the position alone"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """k in N/m; anchor, length and d in m."""
        anchor = tuple(Parameter(name=f"anchor_{a}", unit="m", bounds=CELL, nuisance=True) for a in space.axes)
        length = Parameter(name="length", unit="m", bounds=(0.0, inf), nuisance=True)
        return (Parameter(name="k", unit="N/m", bounds=(0.0, inf)), *anchor, length, DISTANCE)

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Pull the tool towards the anchor."""
        anchor = in_plane(chain.space, *(p[f"anchor_{a}"] for a in chain.space.axes))
        motion = chain.motion
        to_anchor = motion.rotation.T * (anchor - motion.position) - point_on_tip(chain, p["d"])
        distance = sp.sqrt(to_anchor.dot(to_anchor) + SLOWEST**2)
        stretch = sp.Max(0, distance - p["length"])
        return pushed(chain, p["k"] * stretch / distance * to_anchor, p["d"])

    def nuisance_grid(self, extent: Extent) -> tuple[Values, ...]:
        """Anchors in and around the box that was visited, for cables always taut and taut in a part of it."""
        import numpy as np

        if not extent.low:
            return ()
        low, high = np.array(extent.low), np.array(extent.high)
        margin = np.maximum(high - low, 0.3) * 1.5
        count = 8 if len(low) == 2 else 5
        lines = [np.linspace(a, b, count) for a, b in zip(low - margin, high + margin, strict=True)]
        names = [f"anchor_{a}" for a in "xyz"[: len(low)]]
        return tuple(
            dict(zip(names, map(float, anchor), strict=True)) | {"length": length, "d": d}
            for anchor in product(*lines)
            for length in _slack_lengths(anchor, extent)
            for d in (0.0, 0.5 * extent.reach, extent.reach)
        )


def _slack_lengths(anchor: Sequence[float], extent: Extent) -> list[float]:
    """Natural lengths between zero and the farthest corner of the box from the anchor."""
    corners = [dist(corner, anchor) for corner in product(*zip(extent.low, extent.high, strict=True))]
    nearest, farthest = min(corners), max(corners)
    return [0.0, nearest + 0.25 * (farthest - nearest), nearest + 0.6 * (farthest - nearest)]
