"""Hysteresis of the sensor: a play operator between load and reading."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf

from modeling import symbolic as sp
from modeling.chain.chain import Chain, Stage
from modeling.chain.effect import Effect, NuisanceValues, SearchDomain
from modeling.chain.stages.play_stage import Play
from modeling.parameter import Parameter
from modeling.space import Space

HALF_WIDTH_FRACTIONS = (0.01, 0.05, 0.2)
"""Initial half-widths as fractions of the load's amplitude; smaller ones have the sensitivity of the first."""


@dataclass(frozen=True)
class SensorHysteresis(Effect):
    """Play operator of half-width w (N, N m) in each channel, between load and reading.

    The reading y is constant while the load is within w of it, and is pushed along beyond: max(y, load - w) while the
    load rises, min(y, load + w) while it falls. A load of larger amplitude draws a loop of width 2 w. Nominal 0; to
    first order it subtracts w in the direction of the load's change.
    """

    id = "sensor_hysteresis"
    title = "hysteresis between load and reading"
    stage = Stage.PLAY
    equation = "y = max(y, load - w) while the load rises, min(y, load + w) while it falls"
    advice = "load and unload the sensor slowly in steps and compare the readings; look for a loose cover or cable"
    confused_with = "coulomb_friction and joint_backlash; sensor_lag, whose loop widens with the rate of the load"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """One half-width per channel, in its unit."""
        return tuple(Parameter(name=c, unit=u, bounds=(0.0, inf)) for c, u in space.channel_units.items())

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Set the half-widths of the play operator."""
        return chain.with_stage(Play(sp.Matrix([p[channel] for channel in chain.space.channels])))

    def nuisance_grid(self, domain: SearchDomain) -> tuple[NuisanceValues, ...]:
        """Half-widths of 1 %, 5 % and 20 % of the load's amplitude in each channel."""
        space = Space.PLANE if len(domain.swing) == len(Space.PLANE.channels) else Space.SPACE
        return tuple(
            {channel: fraction * swing for channel, swing in zip(space.channels, domain.swing, strict=True)}
            for fraction in (HALF_WIDTH_FRACTIONS if domain.swing else ())
        )
