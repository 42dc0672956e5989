"""Sensor rotation, gain, crosstalk, nonlinearity and saturation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import permutations
from math import inf, pi

from modeling import symbolic as sp
from modeling.chain.chain import Chain, Stage
from modeling.chain.effect import Effect, NuisanceValues, SearchDomain
from modeling.chain.stages.calibration_stage import Gain, Mounting, PolynomialGain
from modeling.chain.stages.saturation_stage import Clipping
from modeling.parameter import Parameter
from modeling.space import TORQUE_UNIT, Space, rotation_matrix

SATURATION_FRACTIONS = (0.99, 0.96, 0.92, 0.85, 0.7)
"""Initial saturation levels as fractions of the largest reading, which noise lifts above the level."""

CROSSTALK_BOUNDS = {"1": (-0.5, 0.5), "m": (-0.2, 0.2), "1/m": (-5.0, 5.0)}
"""Bounds of a crosstalk gain by its unit: at most half of a channel, or a force-to-torque lever of 0.2 m."""


@dataclass(frozen=True)
class SensorRotation(Effect):
    """Rotation of the sensor relative to the frame in which its motion is given.

    The wrench is read in rotated axes: R(angle)' F and R(angle)' T. One angle about e3 (rad, clockwise) in the plane;
    roll, pitch, yaw in six axes. The bias is added after the rotation.
    """

    id = "sensor_rotation"
    title = "sensor mounted at an angle"
    stage = Stage.MOUNTING
    equation = "reading = R(angle)' wrench"
    advice = "check the sensor's orientation mark and the flange transform; record static poses about the tool axis"
    confused_with = "sensor_crosstalk between the forces, of which it is a special case; gravity_tilt, in a single pose"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """One angle in the plane, three in six axes, rad."""
        names = ("angle",) if space is Space.PLANE else ("roll", "pitch", "yaw")
        return tuple(Parameter(name=name, unit="rad", bounds=(-pi, pi)) for name in names)

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Rotate the axes of the reading."""
        return chain.with_stage(
            replace(
                chain[Mounting], rotation=rotation_matrix(chain.space, tuple(p.values())).T * chain[Mounting].rotation
            )
        )


@dataclass(frozen=True)
class SensorGain(Effect):
    """Gain of each channel relative to the first: reading_i = gain_i wrench_i, gain_1 = 1.

    A common gain of all channels is collinear with the mass and not identifiable. gain_i is dimensionless and positive,
    nominally 1; the bias is added after it.
    """

    id = "sensor_gain"
    title = "channels of different gain"
    stage = Stage.GAIN
    equation = "reading_i = gain_i wrench_i, gain_1 = 1"
    advice = "hang known weights along each axis; in the plane only the mlg that fx and tau share excites a torque gain"
    confused_with = "a wrong mass, which affects all channels; link_length_error and crosstalk, for the torque"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """A gain for each channel after the first, unit 1."""
        return tuple(Parameter(name=c, unit="1", nominal=1.0, bounds=(0.2, 5.0)) for c in space.channels[1:])

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Scale the channels."""
        return chain.with_stage(replace(chain[Gain], matrix=chain[Gain].matrix * sp.diag(1, *p.values())))


@dataclass(frozen=True)
class SensorCrosstalk(Effect):
    """Crosstalk between channels: reading = (1 + G) wrench with zero diagonal of G.

    Element `<row>_<column>` of G is the gain from true channel `column` to reading `row`, in the row's unit over the
    column's. The bias is added after it.
    """

    id = "sensor_crosstalk"
    title = "crosstalk between channels"
    stage = Stage.GAIN
    equation = "reading_i = wrench_i + sum_j g_ij wrench_j"
    advice = "apply pure forces along one axis; compare the calibration matrix in use with the sensor's serial number"
    confused_with = "sensor_rotation, a special case of it; link_length_error, for the crosstalk from fx to tau"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """The off-diagonal gains."""
        units = space.channel_units
        return tuple(
            Parameter(name=f"{row}_{column}", unit=unit, bounds=CROSSTALK_BOUNDS[unit])
            for row, column in permutations(space.channels, 2)
            for unit in (gain_unit(units[row], units[column]),)
        )

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Mix the channels."""
        channels = chain.space.channels
        crosstalk = sp.Matrix(
            len(channels),
            len(channels),
            lambda i, j: 0 if i == j else p[f"{channels[i]}_{channels[j]}"],
        )
        return chain.with_stage(replace(chain[Gain], matrix=(sp.eye(len(channels)) + crosstalk) * chain[Gain].matrix))


@dataclass(frozen=True)
class GainNonlinearity(Effect):
    """Polynomial nonlinearity of each channel: reading = w + quadratic w² + cubic w³, the bias added after it.

    For each channel `<channel>_2` in 1/N and `<channel>_3` in 1/N² (1/(N m) and 1/(N m)² of a torque).
    """

    id = "gain_nonlinearity"
    title = "gain depends on the load"
    stage = Stage.NONLINEARITY
    equation = "reading_i = w_i + a_i w_i² + b_i w_i³"
    advice = "hang several known weights, or vary the amplitude; look for a mechanical stop or an overload"
    confused_with = "sensor_gain, over a narrow range of loads; saturation, if only the peaks are flat"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """The channels' quadratic gains in 1/N or 1/(N m), then the cubic ones in 1/N² or 1/(N m)²."""
        named = space.channel_units.items()
        squares = [Parameter(name=f"{c}_2", unit="1/N" if u == "N" else "1/(N m)") for c, u in named]
        return (*squares, *(Parameter(name=f"{c}_3", unit="1/N²" if u == "N" else "1/(N² m²)") for c, u in named))

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Set the quadratic and cubic gains."""
        names = chain.space.channels
        quadratic, cubic = (sp.Matrix([p[f"{c}_{power}"] for c in names]) for power in (2, 3))
        return chain.with_stage(PolynomialGain(quadratic, cubic))


@dataclass(frozen=True)
class Saturation(Effect):
    """Symmetric saturation of each channel: the absolute reading, bias included, does not exceed its level.

    The level is in the channel's unit, positive, and nominally infinite. A saturated reading carries information about
    the level alone: the residuals are censored.
    """

    id = "saturation"
    title = "readings saturate"
    stage = Stage.SATURATION
    equation = "reading_i = max(-level_i, min(level_i, reading_i))"
    advice = "compare the largest readings with the sensor's range; look for flat peaks in the plot over time"
    confused_with = "gain_nonlinearity; a level that the readings just reach is masked by the noise"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """The level of each channel, in the channel's unit."""
        named = space.channel_units.items()
        return tuple(Parameter(name=c, unit=u, nominal=inf, bounds=(0.0, inf)) for c, u in named)

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Set the saturation levels."""
        return chain.with_stage(Clipping(sp.Matrix(list(p.values()))))

    def nuisance_grid(self, domain: SearchDomain) -> tuple[NuisanceValues, ...]:
        """Levels slightly below the largest reading of each channel."""
        space = Space.PLANE if len(domain.largest) == len(Space.PLANE.channels) else Space.SPACE
        return tuple(
            {c: fraction * size for c, size in zip(space.channels, domain.largest, strict=True)}
            for fraction in (SATURATION_FRACTIONS if domain.largest else ())
        )


def gain_unit(row: str, column: str) -> str:
    """Unit of a gain from a channel of the unit `column` to a reading of the unit `row`."""
    if row == column:
        return "1"
    return "m" if row == TORQUE_UNIT else "1/m"
