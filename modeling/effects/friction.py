"""Viscous, quadratic and Coulomb friction on the tool."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import inf

from modeling import symbolic as sp
from modeling.chain.chain import Chain, Stage, velocity_of_point
from modeling.chain.effect import Effect, NuisanceValues, SearchDomain
from modeling.effects.point_effect import (
    SMOOTHING_SPEED,
    PointEffect,
    point_of_application,
    tip_distances,
    with_force,
)
from modeling.parameter import Parameter
from modeling.space import Space

SMOOTHING_RATE = 1e-3
"""Angular velocity (rad/s) below which Coulomb friction is smoothed."""


@dataclass(frozen=True)
class ViscousDrag(PointEffect):
    """A force against the velocity of a point of the tool: F = -c v (on the tool, N).

    c in N s/m is positive (dissipative). The point r is at the distance d (m) along the tip; in six axes it is
    (x, y, d) in the sensor frame. The torque about the sensor is r x F.
    """

    id = "viscous_drag"
    title = "drag proportional to speed"
    stage = Stage.TIP_BODY
    equation = "F = -c v(r)"
    advice = "run the same path at half and double speed; look for a hose, a brush or a fluid that the tool moves in"
    confused_with = "quadratic_drag, in a narrow range of speeds; sensor_lag, in motion of one frequency"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """c in N s/m, the point in m."""
        return (Parameter(name="c", unit="N s/m", bounds=(0.0, inf)), *self.point_parameters(space))

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Add the drag force to the tool."""
        point = point_of_application(chain, p)
        return with_force(chain, -p["c"] * velocity_of_point(chain, point), point)

    def nuisance_grid(self, domain: SearchDomain) -> tuple[NuisanceValues, ...]:
        """Points along the tip."""
        return tuple({"d": d} for d in tip_distances(domain))


@dataclass(frozen=True)
class QuadraticDrag(ViscousDrag):
    """A force against the velocity of a point of the tool, proportional to its square: F = -c |v| v (N).

    c in N s²/m² is positive; |v| is smoothed below 1e-6 m/s. The point r is at the distance d (m) along the tip; in six
    axes it is (x, y, d) in the sensor frame. The torque about the sensor is r x F.
    """

    id = "quadratic_drag"
    title = "drag proportional to speed squared"
    equation = "F = -c |v(r)| v(r)"
    advice = "run the same path at half and double speed: a quarter and four times the force; look for a large plate"
    confused_with = "viscous_drag, in a narrow range of speeds"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """c in N s²/m², the point in m."""
        return (Parameter(name="c", unit="N s²/m²", bounds=(0.0, inf)), *self.point_parameters(space))

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Add the quadratic drag force to the tool."""
        point = point_of_application(chain, p)
        velocity = velocity_of_point(chain, point)
        speed = sp.sqrt(velocity.dot(velocity) + SMOOTHING_SPEED**2)
        return with_force(chain, -p["c"] * speed * velocity, point)


@dataclass(frozen=True)
class CoulombFriction(Effect):
    """A torque of constant magnitude against the rotation, T = -level omega/|omega|: a hose or cable rubs at the wrist.

    level in N m is positive, omega is the tool's angular velocity in the world; |omega| is smoothed below 1e-3 rad/s,
    the width of the step at a reversal.
    """

    id = "coulomb_friction"
    title = "Coulomb friction torque against the rotation"
    stage = Stage.TIP_BODY
    equation = "T = -level omega / sqrt(omega² + (0.001 rad/s)²)"
    advice = "look for a hose or cable that rubs at the wrist; reverse slowly and fast: the step has the same height"
    confused_with = "sensor_hysteresis of the torque; viscous_drag, at nearly constant speed"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """level in N m."""
        return (Parameter(name="level", unit="N m", bounds=(0.0, inf)),)

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Add the friction torque to the tool."""
        omega = chain.motion.omega
        direction = omega / sp.sqrt(omega.dot(omega) + SMOOTHING_RATE**2)
        return replace(chain, torque=chain.torque - p["level"] * direction)
