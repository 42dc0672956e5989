"""Push: a force of the environment at a point along the tip."""

from __future__ import annotations

from dataclasses import replace

from modeling import symbolic as sp
from modeling.chain import Chain, point_on_tip
from modeling.effect import Extent
from modeling.parameter import Parameter

SLOWEST = 1e-6
"""Speed (m/s) or length (m) below which |v| is rounded off, so that it has a derivative at rest."""

DISTANCE = Parameter(name="d", unit="m", bounds=(-0.5, 1.5), nuisance=True)


def pushed(chain: Chain, force: sp.Matrix, distance: sp.Expr) -> Chain:
    """The chain with `force` (N, sensor frame, on the tool) acting at `distance` along the tip."""
    torque = point_on_tip(chain, distance).cross(force)
    return replace(chain, force=chain.force + force, torque=chain.torque + torque)


def distances(extent: Extent) -> list[float]:
    """Where along the tip a force may act, m."""
    import numpy as np

    return [float(d) for d in np.linspace(0.0, extent.reach, 5)]
