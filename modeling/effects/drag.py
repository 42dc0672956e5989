"""Effects that resist the motion of the tool."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import inf

from modeling import symbolic as sp
from modeling.chain import Chain, Stage, velocity_on_tip
from modeling.effect import Effect, Extent, Values
from modeling.effects.push import DISTANCE, SLOWEST, distances, pushed
from modeling.parameter import Parameter
from modeling.space import Space

SLOWEST_TURN = 1e-3
"""Rate of turning (rad/s) below which friction is rounded off."""


@dataclass(frozen=True)
class ViscousDrag(Effect):
    """A force against the velocity of the point at distance d along the tip: F = -c v (on the tool, N).

    c in N s/m is positive (it takes energy away), d in m; the torque about the sensor is r x F.
    """

    id = "viscous_drag"
    title = "drag proportional to speed"
    stage = Stage.TIP_BODY
    equation = "F = -c v(d)"
    advice = "run the same path at half and double speed; look for a hose, a brush or a fluid that the tool moves in"
    confused_with = "quadratic_drag, in a narrow range of speeds; sensor_lag, in motion of one frequency"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """c in N s/m, d in m."""
        return (Parameter(name="c", unit="N s/m", bounds=(0.0, inf)), DISTANCE)

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Push the tool against its velocity."""
        return pushed(chain, -p["c"] * velocity_on_tip(chain, p["d"]), p["d"])

    def nuisance_grid(self, extent: Extent) -> tuple[Values, ...]:
        """Points along the tip."""
        return tuple({"d": d} for d in distances(extent))


@dataclass(frozen=True)
class QuadraticDrag(ViscousDrag):
    """A force against the velocity of the point at distance d, growing with its square: F = -c |v| v (N).

    c in N s²/m² is positive, d in m; |v| is rounded off below 1e-6 m/s.
    """

    id = "quadratic_drag"
    title = "drag proportional to speed squared"
    equation = "F = -c |v(d)| v(d)"
    advice = "run the same path at half and double speed: a quarter and four times the force; look for a large plate"
    confused_with = "viscous_drag, in a narrow range of speeds"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """c in N s²/m², d in m."""
        return (Parameter(name="c", unit="N s²/m²", bounds=(0.0, inf)), DISTANCE)

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Push the tool against its velocity times its speed."""
        velocity = velocity_on_tip(chain, p["d"])
        speed = sp.sqrt(velocity.dot(velocity) + SLOWEST**2)
        return pushed(chain, -p["c"] * speed * velocity, p["d"])


@dataclass(frozen=True)
class CoulombFriction(Effect):
    """A hose or cable rubs at the wrist: a torque of constant size against the rotation, T = -level omega/|omega|.

    level in N m is positive, omega is the tool's angular velocity over the ground; |omega| is rounded off below
    1e-3 rad/s, which is the width of the step at a reversal.
    """

    id = "coulomb_friction"
    title = "friction of constant torque against the rotation"
    stage = Stage.TIP_BODY
    equation = "T = -level omega / sqrt(omega² + (0.001 rad/s)²)"
    advice = "look for a hose or cable that rubs at the wrist; reverse slowly and fast: the step stays as large"
    confused_with = "sensor_hysteresis of the torque; viscous_drag, at nearly constant speed"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """level in N m."""
        return (Parameter(name="level", unit="N m", bounds=(0.0, inf)),)

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Turn the tool against its rotation."""
        omega = chain.motion.omega
        direction = omega / sp.sqrt(omega.dot(omega) + SLOWEST_TURN**2)
        return replace(chain, torque=chain.torque - p["level"] * direction)
