"""Effects that remember and are no transfer functions: a tool on a spring, and play between load and reading."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product
from math import inf, sqrt

from modeling import symbolic as sp
from modeling.bend import Bend
from modeling.chain import Chain, Stage
from modeling.effect import Effect, Extent, Values
from modeling.parameter import Parameter
from modeling.space import Space

SOFTEST = 1.0
"""Stiffness (N m/rad) below which nobody would mount a tool: 0.1 kg at 0.1 m would hang askew by six degrees."""

STIFFEST = 1e4
"""Stiffness (N m/rad) at which a search ends: a torque of 10 N m turns the tool by a milliradian."""

RINGING = (2.0, 40.0)
"""Natural frequencies (Hz) between which a soft mounting is sought: slower ones droop, stiffer ones do not show."""

WIDTHS = (0.01, 0.05, 0.2)
"""Of a load's swing, where a play is sought first: below, it shows as well as at the first."""

TYPICAL_MASS = 1.0
"""Mass (kg) of a tool on a wrist sensor, for the order of magnitude of an inertia that is not known."""


@dataclass(frozen=True)
class TipFlexibility(Effect):
    """The tool hangs on a rotational spring and damper at the sensor's origin, and swings on it.

    The torque of the sensor on the tool about the origin is -stiffness theta - damping omega_rel (N m), theta the angle
    (rad, times its axis in six axes) by which the tool is turned against the sensor and omega_rel its rate; the tool's
    weight, inertia and all that acts on it follow the turn (`modeling.bend`). It vanishes as the stiffness goes to
    infinity, in proportion to 1/stiffness.
    """

    id = "tip_flexibility"
    title = "tip on a spring and damper"
    stage = Stage.BEND
    equation = "T = -stiffness theta - damping dtheta/dt, theta the turn of the tool against the sensor"
    advice = "tap the tool and watch it ring; push it by hand and measure how far it turns; tighten the flange's screws"
    confused_with = "joint_elasticity and gain_nonlinearity, in slow motion; sensor_lag, which never overshoots"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """Stiffness in N m/rad, infinite for a rigid mounting, and damping in N m s/rad."""
        return (
            Parameter(name="stiffness", unit="N m/rad", nominal=inf, bounds=(SOFTEST, inf), start=300.0),
            Parameter(name="damping", unit="N m s/rad", bounds=(0.0, inf), nuisance=True, start=1.0),
        )

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Hang the tool on the spring."""
        return replace(chain, bend=Bend(chain.space, p["stiffness"], p["damping"]))

    def nuisance_grid(self, extent: Extent) -> tuple[Values, ...]:
        """Natural frequencies of 2 to 40 Hz, each with a damping ratio of 0.05 and 0.5.

        stiffness = inertia (2 pi f)², damping = 2 ratio sqrt(stiffness inertia); where the inertia is not known, that
        of a rod as long as `reach`.
        """
        import numpy as np

        inertia = extent.inertia or TYPICAL_MASS * extent.reach**2 / 3
        stiffnesses = np.clip(inertia * (2 * np.pi * np.geomspace(*RINGING, 8)) ** 2, SOFTEST, STIFFEST)
        return tuple(
            {"stiffness": float(k), "damping": 2 * ratio * sqrt(k * inertia)}
            for k, ratio in product(stiffnesses, (0.05, 0.5))
        )


@dataclass(frozen=True)
class SensorHysteresis(Effect):
    """There is play of a half-width in each channel (N, N m) between load and reading.

    The reading stays where it is while the load moves within the half-width to both sides of it, and is pushed along
    beyond: max(y, load - w) while the load rises, min(y, load + w) while it falls. A load that goes up and down by
    more than that draws a loop 2 w wide. Nominal 0; from there it takes w off in the direction in which the load moves.
    """

    id = "sensor_hysteresis"
    title = "play between load and reading"
    stage = Stage.PLAY
    equation = "y = max(y, load - w) while the load rises, min(y, load + w) while it falls"
    advice = "load and unload the sensor slowly in steps and compare the readings; look for a loose cover or cable"
    confused_with = "coulomb_friction and joint_backlash; sensor_lag, whose loop grows with the speed of the load"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """One half-width per channel, in its unit."""
        return tuple(
            Parameter(name=channel, unit=unit, bounds=(0.0, inf))
            for channel, unit in zip(space.channels, space.units, strict=True)
        )

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Put the play between load and reading."""
        return replace(chain, play=sp.Matrix([p[channel] for channel in chain.space.channels]))

    def nuisance_grid(self, extent: Extent) -> tuple[Values, ...]:
        """Half-widths of a hundredth, a twentieth and a fifth of the load's swing in each channel."""
        space = Space.PLANE if len(extent.swing) == len(Space.PLANE.channels) else Space.SPACE
        return tuple(
            {channel: share * swing for channel, swing in zip(space.channels, extent.swing, strict=True)}
            for share in (WIDTHS if extent.swing else ())
        )
