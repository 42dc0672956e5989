"""Effects of the sensor's channels: how they are mounted, scaled, mixed, bent and clipped."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import inf, pi
from typing import Any

from modeling import symbolic as sp
from modeling.chain import Chain, Stage
from modeling.effect import Effect, Extent, Values
from modeling.parameter import Parameter
from modeling.space import Space, turned

CLIPPED_AT = (0.99, 0.96, 0.92, 0.85, 0.7)
"""Shares of the largest reading at which a level is sought first: noise lifts the largest above the level."""


@dataclass(frozen=True)
class SensorRotation(Effect):
    """The sensor is mounted turned against the frame that its motion is given in.

    The wrench is read in axes turned by the angle: R(angle)' F and R(angle)' T. One angle about e3 (rad, clockwise)
    in the plane; roll, pitch, yaw in six axes. The bias is added after it and does not turn with it.
    """

    id = "sensor_rotation"
    title = "sensor mounted turned"
    stage = Stage.MOUNTING
    equation = "reading = R(angle)' wrench"
    advice = "check the sensor's orientation mark and the flange transform; take poses about the tool axis"
    confused_with = "sensor_crosstalk between the forces, of which it is a special case; gravity_tilt, at one position"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """One angle in the plane, three in six axes, rad."""
        names = ("angle",) if space is Space.PLANE else ("roll", "pitch", "yaw")
        return tuple(Parameter(name=name, unit="rad", bounds=(-pi, pi)) for name in names)

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Turn the axes of the reading."""
        return replace(chain, mounting=turned(chain.space, tuple(p.values())).T * chain.mounting)


@dataclass(frozen=True)
class SensorGain(Effect):
    """Every channel but the first has a gain of its own: reading_i = gain_i wrench_i, the first channel's being 1.

    A gain that all channels share is a heavier tool and cannot be seen. gain_i has no unit, is 1 when nothing is wrong
    and positive; the bias is added after it.
    """

    id = "sensor_gain"
    title = "channels of different gain"
    stage = Stage.GAIN
    equation = "reading_i = gain_i wrench_i, gain_1 = 1"
    advice = "hang known weights along each axis; in the plane a torque gain is only shown by what fx and tau share"
    confused_with = "a wrong mass, which all channels share; link_length_error and crosstalk, for the torque"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """A gain for each channel after the first, unit 1."""
        return tuple(Parameter(name=c, unit="1", nominal=1.0, bounds=(0.2, 5.0)) for c in space.channels[1:])

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Scale the channels."""
        return replace(chain, gain=chain.gain * sp.diag(1, *p.values()))


@dataclass(frozen=True)
class SensorCrosstalk(Effect):
    """One channel leaks into another: reading = (1 + G) wrench with zero diagonal.

    G's element `<row>_<column>` is what the true channel `column` adds to the reading `row`, in units of the row's
    over the column's. The bias is added after it.
    """

    id = "sensor_crosstalk"
    title = "channels leak into one another"
    stage = Stage.GAIN
    equation = "reading_i = wrench_i + sum_j g_ij wrench_j"
    advice = "apply pure forces along one axis; compare the calibration matrix in use with the sensor's serial number"
    confused_with = "sensor_rotation, a special case of it; link_length_error, for the leak of fx into tau"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """The off-diagonal gains."""
        units = dict(zip(space.channels, space.units, strict=True))
        return tuple(
            Parameter(name=f"{row}_{column}", **_leak(units[row], units[column]))
            for row in space.channels
            for column in space.channels
            if row != column
        )

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Mix the channels."""
        channels = chain.space.channels
        leak = sp.Matrix(
            len(channels),
            len(channels),
            lambda i, j: 0 if i == j else p[f"{channels[i]}_{channels[j]}"],
        )
        return replace(chain, gain=(sp.eye(len(channels)) + leak) * chain.gain)


@dataclass(frozen=True)
class GainNonlinearity(Effect):
    """The gain of each channel depends on the load: reading = w + quadratic w² + cubic w³, the bias added after it.

    For each channel `<channel>_2` in 1/N and `<channel>_3` in 1/N² (1/(N m) and 1/(N m)² of a torque).
    """

    id = "gain_nonlinearity"
    title = "gain depends on the load"
    stage = Stage.NONLINEARITY
    equation = "reading_i = w_i + a_i w_i² + b_i w_i³"
    advice = "hang several known weights, or sweep the amplitude; look for a mechanical stop or an overload"
    confused_with = "sensor_gain, over a narrow range of loads; saturation, when only the tops are flat"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """The channels' quadratic gains in 1/N or 1/(N m), then the cubic ones in 1/N² or 1/(N m)²."""
        named = list(zip(space.channels, space.units, strict=True))
        squares = [Parameter(name=f"{c}_2", unit="1/N" if u == "N" else "1/(N m)") for c, u in named]
        return (*squares, *(Parameter(name=f"{c}_3", unit="1/N²" if u == "N" else "1/(N² m²)") for c, u in named))

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Bend the channels."""
        names = chain.space.channels
        quadratic, cubic = (sp.Matrix([p[f"{c}_{power}"] for c in names]) for power in (2, 3))
        return replace(chain, quadratic=quadratic, cubic=cubic)


@dataclass(frozen=True)
class Saturation(Effect):
    """Each channel is clipped: a reading, bias included, goes no further from zero than its level, towards either side.

    The level is in the channel's unit and positive, without end when nothing is clipped. Where a reading is clipped its
    residual tells of nothing but the level: the residuals are censored.
    """

    id = "saturation"
    title = "readings are clipped"
    stage = Stage.SATURATION
    equation = "reading_i = max(-level_i, min(level_i, reading_i))"
    advice = "compare the largest readings with the sensor's range; look for flat tops in the plot over time"
    confused_with = "gain_nonlinearity; a level that the readings just reach hides in the noise"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """The level of each channel, in the channel's unit."""
        return tuple(
            Parameter(name=c, unit=u, nominal=inf, bounds=(0.0, inf))
            for c, u in zip(space.channels, space.units, strict=True)
        )

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Clip the channels."""
        return replace(chain, level=sp.Matrix(list(p.values())))

    def nuisance_grid(self, extent: Extent) -> tuple[Values, ...]:
        """Levels somewhat below the largest reading of each channel."""
        space = Space.PLANE if len(extent.largest) == len(Space.PLANE.channels) else Space.SPACE
        return tuple(
            {c: share * size for c, size in zip(space.channels, extent.largest, strict=True)}
            for share in (CLIPPED_AT if extent.largest else ())
        )


def _leak(row: str, column: str) -> dict[str, Any]:
    """Unit and bounds of a leak: half of a channel, or the torque of a force 0.2 m away; more is no leak."""
    if row == column:
        return {"unit": "1", "bounds": (-0.5, 0.5)}
    return {"unit": "m", "bounds": (-0.2, 0.2)} if row == "N m" else {"unit": "1/m", "bounds": (-5.0, 5.0)}
