"""Effects that act at a point of the tool, and a force of the environment there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Self

from modeling import symbolic as sp
from modeling.chain.chain import Chain, point_on_tip
from modeling.chain.effect import Effect, SearchDomain
from modeling.parameter import Parameter, Role
from modeling.space import Space, vector

SMOOTHING_SPEED = 1e-6
"""Speed (m/s) or length (m) below which |v| is smoothed, so that it has a derivative at zero."""

TIP_DISTANCE = Parameter(name="d", unit="m", bounds=(-0.5, 1.5), role=Role.SHAPE)
OFFSETS = tuple(Parameter(name=name, unit="m", bounds=(-0.5, 0.5), role=Role.SHAPE) for name in ("x", "y"))
"""Position beside the tip axis, along the sensor's x and y axes: as far as a tool reaches."""
ON_AXIS = tuple(replace(p, bounds=(0.0, 0.0)) for p in OFFSETS)


@dataclass(frozen=True)
class PointEffect(Effect):
    """An effect that acts at a point of the tool: at d along the tip in the plane, at (x, y, d) in six axes.

    With `on_axis`, x and y are fixed at 0 in six axes, too; in the plane it has no meaning. A diagnosis searches on the
    axis: there an effect has the forces that it has 3 cm beside it, nearly, and a test of one amplitude needs less of
    it than one of three. x and y are then tested given all others.
    """

    on_axis: bool = False

    def point_parameters(self, space: Space) -> tuple[Parameter, ...]:
        """Coordinates of the point in the sensor frame, m: d in the plane; x, y, d in six axes."""
        if space is Space.PLANE:
            return (TIP_DISTANCE,)
        return (*(ON_AXIS if self.on_axis else OFFSETS), TIP_DISTANCE)

    def restricted(self, space: Space) -> Self:
        """The effect at a point on the tip axis."""
        return self if space is Space.PLANE else replace(self, on_axis=True)

    def unrestricted(self, space: Space) -> Self:
        """The effect at any point."""
        return self if space is Space.PLANE else replace(self, on_axis=False)


def point_of_application(chain: Chain, p: Mapping[str, sp.Expr]) -> sp.Matrix:
    """The point (m, sensor frame) of the coordinates among the parameters `p` of a `PointEffect`."""
    return point_on_tip(chain, p["d"]) + vector(p.get("x", 0), p.get("y", 0), 0)


def with_force(chain: Chain, force: sp.Matrix, point: sp.Matrix) -> Chain:
    """The chain with `force` (N, sensor frame, on the tool) acting at a `point` (m, sensor frame)."""
    return replace(chain, force=chain.force + force, torque=chain.torque + point.cross(force))


def tip_distances(domain: SearchDomain) -> list[float]:
    """Grid of points of application along the tip, m."""
    import numpy as np

    return [float(d) for d in np.linspace(0.0, domain.reach, 5)]
