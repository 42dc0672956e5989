"""A force of the environment at a point along the tip."""

from __future__ import annotations

from dataclasses import replace

from modeling import symbolic as sp
from modeling.chain.chain import Chain, point_on_tip
from modeling.chain.effect import SearchDomain
from modeling.parameter import Parameter, Role

SMOOTHING_SPEED = 1e-6
"""Speed (m/s) or length (m) below which |v| is smoothed, so that it has a derivative at zero."""

TIP_DISTANCE = Parameter(name="d", unit="m", bounds=(-0.5, 1.5), role=Role.SHAPE)


def with_tip_force(chain: Chain, force: sp.Matrix, distance: sp.Expr) -> Chain:
    """The chain with `force` (N, sensor frame, on the tool) acting at `distance` along the tip."""
    torque = point_on_tip(chain, distance).cross(force)
    return replace(chain, force=chain.force + force, torque=chain.torque + torque)


def tip_distances(domain: SearchDomain) -> list[float]:
    """Grid of points of application along the tip, m."""
    import numpy as np

    return [float(d) for d in np.linspace(0.0, domain.reach, 5)]
