"""Tip flexibility: the tool on a rotational spring and damper at the sensor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product
from math import inf, sqrt

from modeling import symbolic as sp
from modeling.chain.chain import Chain, Stage
from modeling.chain.effect import Effect, NuisanceValues, SearchDomain
from modeling.dynamics.deflection import Deflection
from modeling.parameter import Parameter, Role
from modeling.space import Space

LOWEST_STIFFNESS = 1.0
"""Lower bound of the stiffness (N m/rad): 0.1 kg at 0.1 m would deflect it by six degrees."""

HIGHEST_STIFFNESS = 1e4
"""Upper end of the stiffness grid (N m/rad): a torque of 10 N m rotates the tool by a milliradian."""

NATURAL_FREQUENCIES = (2.0, 40.0)
"""Range of natural frequencies (Hz) of the grid: softer mountings droop, stiffer ones are not identifiable."""

TYPICAL_MASS = 1.0
"""Mass (kg) of a tool on a wrist sensor, for the order of magnitude of an unknown inertia."""


@dataclass(frozen=True)
class TipFlexibility(Effect):
    """The tool is mounted on a rotational spring and damper at the sensor's origin.

    The torque of the sensor on the tool about the origin is -stiffness theta - damping omega_rel (N m), theta the
    rotation vector (rad; the angle in the plane) of the tool relative to the sensor and omega_rel the relative angular
    velocity; weight, inertia and applied forces rotate with the tool (`modeling.dynamics.deflection`). The effect
    vanishes as 1/stiffness.
    """

    id = "tip_flexibility"
    title = "tip on a spring and damper"
    stage = Stage.DEFLECTION
    equation = "T = -stiffness theta - damping dtheta/dt, theta the rotation of the tool relative to the sensor"
    advice = "tap the tool and watch it ring; push it by hand and measure its rotation; tighten the flange's screws"
    confused_with = "joint_elasticity and gain_nonlinearity, in slow motion; sensor_lag, which never overshoots"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """Stiffness in N m/rad, infinite for a rigid mounting, and damping in N m s/rad."""
        return (
            Parameter(name="stiffness", unit="N m/rad", nominal=inf, bounds=(LOWEST_STIFFNESS, inf), start=300.0),
            Parameter(name="damping", unit="N m s/rad", bounds=(0.0, inf), role=Role.SHAPE, start=1.0),
        )

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Mount the tool on the spring."""
        return replace(chain, deflection=Deflection(chain.space, p["stiffness"], p["damping"]))

    def nuisance_grid(self, domain: SearchDomain) -> tuple[NuisanceValues, ...]:
        """Natural frequencies of 2 to 40 Hz, each with a damping ratio of 0.05 and 0.5.

        stiffness = inertia (2 pi f)², damping = 2 ratio sqrt(stiffness inertia); for an unknown inertia, that of
        a rod as long as `reach`.
        """
        import numpy as np

        inertia = domain.inertia or TYPICAL_MASS * domain.reach**2 / 3
        stiffnesses = np.clip(
            inertia * (2 * np.pi * np.geomspace(*NATURAL_FREQUENCIES, 8)) ** 2, LOWEST_STIFFNESS, HIGHEST_STIFFNESS
        )
        return tuple(
            {"stiffness": float(k), "damping": 2 * ratio * sqrt(k * inertia)}
            for k, ratio in product(stiffnesses, (0.05, 0.5))
        )
