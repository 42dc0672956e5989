"""Tension of a cable between the tool and an anchor in the cell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from math import dist, inf

from modeling import symbolic as sp
from modeling.chain.chain import Chain, Stage, world_vector
from modeling.chain.effect import NuisanceValues, SearchDomain
from modeling.effects.point_effect import SMOOTHING_SPEED, PointEffect, point_of_application, with_force
from modeling.parameter import Parameter, Role
from modeling.space import Space

ANCHOR_BOUNDS = (-5.0, 5.0)
"""Bounds of the anchor (m, each world axis): the robot's cell. A more distant anchor gives a constant force."""


@dataclass(frozen=True)
class CableSpring(PointEffect):
    """A unilateral linear spring pulls a point of the tool towards an anchor.

    With u the vector from the point to the anchor (world, m), F = k max(0, |u| - length) u/|u|: k in N/m,
    length (m) is its natural length. The point is at the distance d (m) along the tip; in six axes it is (x, y, d) in
    the sensor frame.
    """

    id = "cable_spring"
    title = "tether or cable pulling at the tool"
    stage = Stage.TIP_BODY
    equation = "F = k max(0, |u| - length) u/|u|, u = anchor - point"
    advice = "look for a cable or hose that goes taut in part of the workspace; free it and record again"
    confused_with = "gravity_tilt, for a distant anchor; any other force that depends on the position alone"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """k in N/m; anchor, length and the point in m."""
        anchor = tuple(
            Parameter(name=f"anchor_{a}", unit="m", bounds=ANCHOR_BOUNDS, role=Role.SHAPE) for a in space.axes
        )
        length = Parameter(name="length", unit="m", bounds=(0.0, inf), role=Role.SHAPE)
        return (Parameter(name="k", unit="N/m", bounds=(0.0, inf)), *anchor, length, *self.point_parameters(space))

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Add the spring force to the tool."""
        anchor = world_vector(chain.space, *(p[f"anchor_{a}"] for a in chain.space.axes))
        motion, point = chain.motion, point_of_application(chain, p)
        to_anchor = motion.rotation.T * (anchor - motion.position) - point
        distance = sp.sqrt(to_anchor.dot(to_anchor) + SMOOTHING_SPEED**2)
        stretch = sp.Max(0, distance - p["length"])
        return with_force(chain, p["k"] * stretch / distance * to_anchor, point)

    def nuisance_grid(self, domain: SearchDomain) -> tuple[NuisanceValues, ...]:
        """Anchors in and around the workspace of the recording, for cables always taut and taut in part of it."""
        import numpy as np

        if not domain.low:
            return ()
        low, high = np.array(domain.low), np.array(domain.high)
        margin = np.maximum(high - low, 0.3) * 1.5
        count = 8 if len(low) == 2 else 5
        lines = [np.linspace(a, b, count) for a, b in zip(low - margin, high + margin, strict=True)]
        names = [f"anchor_{a}" for a in "xyz"[: len(low)]]
        return tuple(
            dict(zip(names, map(float, anchor), strict=True)) | {"length": length, "d": d}
            for anchor in product(*lines)
            for length in _slack_lengths(anchor, domain)
            for d in (0.0, 0.5 * domain.reach, domain.reach)
        )


def _slack_lengths(anchor: Sequence[float], domain: SearchDomain) -> list[float]:
    """Natural lengths between zero and the farthest corner of the box from the anchor."""
    corners = [dist(corner, anchor) for corner in product(*zip(domain.low, domain.high, strict=True))]
    nearest, farthest = min(corners), max(corners)
    return [0.0, nearest + 0.25 * (farthest - nearest), nearest + 0.6 * (farthest - nearest)]
