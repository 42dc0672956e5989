"""Effects of the sensor: calibration, hysteresis, lag and delay, saturation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import permutations
from math import exp, inf, pi, sin
from typing import ClassVar

from modeling import symbolic as sp
from modeling.chain.chain import Chain, Stage
from modeling.chain.effect import Effect, NuisanceValues, SearchDomain
from modeling.chain.stages import Clipping, Gain, LinearDynamics, Mounting, Play, PolynomialGain
from modeling.compiled.straight_line_program import laplace
from modeling.parameter import Parameter
from modeling.sketch import Arc, Arrow, Axes, Length, Line, Name, Text, graph
from modeling.space import TORQUE_UNIT, Space, rotation_matrix, signals

# First-order lag and pure delay.


@dataclass(frozen=True)
class SensorLag(Effect):
    """First-order low-pass of the sensor or its filter: H(s) = 1 / (1 + s time_constant), time constant in s."""

    id = "sensor_lag"
    title = "first-order lag of the sensor or its filter"
    stage = Stage.LINEAR_DYNAMICS
    equation = "H(s) = 1 / (1 + s time_constant)"
    advice = "look up the sensor's filter setting; tap the tool and see how fast the reading decays"
    confused_with = "time_delay: at low frequencies the two are aliased, only fast motion discriminates"
    shows = "In proportion to the rate of the load, with a phase that grows with frequency and an amplitude that falls."
    provoked_by = "Fast motion: at low frequencies a lag is a delay; the amplitude at high ones separates them."
    amounts: ClassVar[Mapping[str, float]] = {"time_constant": 0.02}
    sketch = (
        Axes("time", "reading"),
        Line(((34, 120), (70, 120), (70, 34), (216, 34)), "ghost"),
        Line(graph(lambda x: 34 + 86 * exp(-(x - 70) / 40), 70, 216), "accent"),
        Length((70, 66), (110, 66), Name(116, 76, "time_constant")),
        Text(150, 28, "load"),
    )

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """The time constant in s."""
        return (
            Parameter(
                name="time_constant",
                unit="s",
                meaning="time in which 63 % of a step is shown",
                bounds=(0.0, 10.0),
            ),
        )

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Low-pass every channel."""
        return chain.with_stage(LinearDynamics(chain.transfer_function / (1 + laplace() * p["time_constant"])))


@dataclass(frozen=True)
class TimeDelay(Effect):
    """Pure delay (s) of the reading against the motion: H(s) = exp(-s delay); negative for a lead."""

    id = "time_delay"
    title = "reading delayed against the motion"
    stage = Stage.LINEAR_DYNAMICS
    equation = "H(s) = exp(-s delay)"
    advice = "compare the clocks of robot and sensor; look for a buffer or a network between them"
    confused_with = "sensor_lag: at low frequencies the two are aliased, only fast motion discriminates"
    shows = (
        "In proportion to the rate of the load, with a phase that grows with the frequency and an unchanged amplitude."
    )
    provoked_by = "Fast motion, and one sharp event that both the robot and the sensor record."
    amounts: ClassVar[Mapping[str, float]] = {"delay": 0.012}
    sketch = (
        Axes("time", "reading"),
        Line(graph(lambda x: 74 - 34 * sin((x - 34) * pi / 60), 34, 210), "ghost"),
        Line(graph(lambda x: 74 - 34 * sin((x - 52) * pi / 60), 52, 214), "accent"),
        Length((64, 34), (82, 34), Name(88, 32, "delay")),
        Text(40, 34, "load"),
    )

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """The delay in s."""
        return (
            Parameter(
                name="delay",
                unit="s",
                meaning="time by which the reading follows the motion",
                bounds=(-10.0, 10.0),
            ),
        )

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Delay every channel."""
        return chain.with_stage(LinearDynamics(chain.transfer_function * sp.exp(-laplace() * p["delay"])))


# Sensor rotation, gain, crosstalk, nonlinearity and saturation.


SATURATION_FRACTIONS = (0.99, 0.96, 0.92, 0.85, 0.7)
"""Initial saturation levels as fractions of the largest reading, which noise lifts above the level."""

GAIN_BOUNDS = (0.2, 5.0)
"""Of a gain: what is beyond is another unit."""
THERMAL_BOUNDS = (-0.002, 0.002)
"""1/K, of a gain: twice the largest that sheets of force/torque sensors state, 0.1 %; more is another mass."""
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
    shows = "Each force channel has a part of the other's load, with opposite signs."
    provoked_by = (
        "Static poses turned about the tool axis: crosstalk of one channel does not keep the length of the force."
    )
    amounts: ClassVar[Mapping[str, float]] = {"rad": 0.05}
    sketch = (
        Arrow((96, 112), (184, 112), "ghost"),
        Arrow((96, 112), (96, 24), "ghost"),
        Arrow((96, 112), (177.6, 79.0)),
        Arrow((96, 112), (63.0, 30.4)),
        Arc(96, 112, 60, 0, -22),
        Name(164, 104, "angle; roll,"),
        Name(164, 130, "pitch, yaw"),
        Text(20, 142, "dashed: axes as assumed"),
    )

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """One angle in the plane, three in six axes, rad."""
        meanings = (
            {"angle": "angle of the sensor's axes to those assumed"}
            if space is Space.PLANE
            else {name: f"{name} of the sensor's axes against those assumed" for name in ("roll", "pitch", "yaw")}
        )
        return tuple(
            Parameter(name=name, unit="rad", meaning=words, bounds=(-pi, pi)) for name, words in meanings.items()
        )

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
    shows = "The residual of a channel has the shape of its own load, fast and slow parts alike."
    provoked_by = (
        "Known weights along each axis; in motion, loads that are large in every channel compared with one another."
    )
    letter = "gain"
    amounts: ClassVar[Mapping[str, float]] = {"1": 1.03}
    sketch = (
        Axes("load", "reading", centred=True),
        Line(((58, 136), (178, 16)), "ghost"),
        Line(((32, 118), (204, 34)), "accent"),
        Text(182, 22, "gain 1"),
        Name(150, 112, "slope fy, tau, ..."),
    )

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """A gain for each channel after the first, unit 1."""
        return tuple(
            Parameter(
                name=channel,
                unit="1",
                meaning=f"gain of channel {channel}, relative to the first",
                nominal=1.0,
                bounds=GAIN_BOUNDS,
            )
            for channel in space.channels[1:]
        )

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Scale the channels."""
        return chain.with_stage(replace(chain[Gain], matrix=chain[Gain].matrix * sp.diag(1, *p.values())))


@dataclass(frozen=True)
class ChannelGain(SensorGain):
    """Gain of every channel by itself: reading_i = gain_i wrench_i.

    The scale of all is collinear with the mass, and no recording of one weight tells it: recordings with known loads
    do, and a budget states it, from the sensor's sheet.
    """

    id = "gain"
    title = "gain of every channel"
    equation = "reading_i = gain_i wrench_i"
    scales_mass = True
    advice = "weigh the loads and measure where they hang; hang another known weight along each axis"
    confused_with = "masses or places of the known loads that are not as stated"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """A gain for each channel, unit 1."""
        return tuple(
            Parameter(name=channel, unit="1", meaning=f"gain of channel {channel}", nominal=1.0, bounds=GAIN_BOUNDS)
            for channel in space.channels
        )

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Scale the channels."""
        return chain.with_stage(replace(chain[Gain], matrix=chain[Gain].matrix * sp.diag(*p.values())))


@dataclass(frozen=True)
class CommonGain(ChannelGain):
    """One gain of all channels, such as that of the supply: reading = gain wrench."""

    id = "common_gain"
    title = "gain of all channels together"
    equation = "reading = gain wrench"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """One gain, unit 1."""
        return (Parameter(name="gain", unit="1", meaning="gain of all channels", nominal=1.0, bounds=GAIN_BOUNDS),)

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Scale all channels."""
        return chain.with_stage(replace(chain[Gain], matrix=p["gain"] * chain[Gain].matrix))


@dataclass(frozen=True)
class ThermalGain(ChannelGain):
    """Gain of every channel by the recorded temperature (°C): reading_i = (1 + b_i (temperature - 20)) wrench_i.

    The gain at 20 °C is that of `gain`, or one. Recordings at different temperatures tell it: of one tool, or of tools
    that differ by known loads.
    """

    id = "thermal_gain"
    title = "gain depends on the temperature"
    equation = "reading_i = (1 + b_i (temperature - 20 °C)) wrench_i"
    advice = "look up the sensor's temperature coefficient; log the temperature, and record cold and warm"
    confused_with = "a load that is not stated, on a warm day; thermal_drift, in poses with nearly the same load"
    shows = "The residual of a channel has the shape of its load: of one sign when warm, of the other when cold."
    provoked_by = "The same motion cold and warm, with the largest load that the sensor carries."
    letter = "b"

    @property
    def designable(self) -> bool:
        """No motion sets a temperature."""
        return False

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """A coefficient for each channel, 1/K."""
        return tuple(
            Parameter(
                name=channel,
                unit="1/K",
                meaning=f"change of the gain of channel {channel} for each kelvin",
                bounds=THERMAL_BOUNDS,
            )
            for channel in space.channels
        )

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Scale the channels by the temperature."""
        (temperature,) = signals("temperature")
        gains = [1 + (temperature - 20) * coefficient for coefficient in p.values()]
        return chain.with_stage(replace(chain[Gain], matrix=chain[Gain].matrix * sp.diag(*gains)))


@dataclass(frozen=True)
class SensorCrosstalk(Effect):
    """Crosstalk between channels: reading = (1 + G) wrench with zero diagonal of G.

    Element `<row>_<column>` of G is the gain from true channel `column` to reading `row`, in the row's unit over the
    column's. The bias is added after it. With `leaks` these elements alone are free, the others zero: poses at rest do
    not tell all of them apart.
    """

    leaks: tuple[str, ...] = ()

    id = "sensor_crosstalk"
    title = "crosstalk between channels"
    stage = Stage.GAIN
    equation = "reading_i = wrench_i + sum_j g_ij wrench_j"
    advice = "apply pure forces along one axis; compare the calibration matrix in use with the sensor's serial number"
    confused_with = "sensor_rotation, a special case of it; link_length_error, for the crosstalk from fx to tau"
    shows = "One channel's residual has the shape of another channel's load, at any frequency."
    provoked_by = "Poses or motions in which one channel is loaded and the others are not."
    amounts: ClassVar[Mapping[str, float]] = {"1": 0.03, "m": 0.003, "1/m": 0.3}
    sketch = (
        Text(36, 46, "load fx", "middle"),
        Arrow((66, 42), (170, 42), "ink"),
        Text(176, 46, "reading fx"),
        Text(36, 108, "load fy", "middle"),
        Arrow((66, 104), (170, 104), "ink"),
        Text(176, 108, "reading fy"),
        Arrow((66, 46), (168, 98)),
        Name(132, 70, "fy_fx"),
        Text(120, 140, "names: reading, then load", "middle"),
    )

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """The off-diagonal gains, or those that leak."""
        units = space.channel_units
        return tuple(
            Parameter(
                name=f"{row}_{column}",
                unit=unit,
                meaning=f"share of the load {column} in the reading {row}",
                bounds=CROSSTALK_BOUNDS[unit],
            )
            for row, column in permutations(space.channels, 2)
            for unit in (gain_unit(units[row], units[column]),)
            if not self.leaks or f"{row}_{column}" in self.leaks
        )

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Mix the channels."""
        channels = chain.space.channels
        crosstalk = sp.Matrix(
            len(channels),
            len(channels),
            lambda i, j: p.get(f"{channels[i]}_{channels[j]}", 0),
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
    shows = "Harmonics of a channel's own load; the residual against the load is a parabola or a cubic."
    provoked_by = "The same motion at several amplitudes, and with several known weights, up to the largest load."
    amounts: ClassVar[Mapping[str, float]] = {"1/N": 0.001, "1/(N m)": 0.02, "1/N²": 0.0001, "1/(N² m²)": 0.02}
    sketch = (
        Axes("load", "reading", centred=True),
        Line(((48, 132), (188, 20)), "ghost"),
        Line(
            graph(lambda x: 76 - 0.8 * (x - 118) + 1.6e-3 * (x - 118) ** 2 + 4.9e-5 * (x - 118) ** 3, 44, 198), "accent"
        ),
        Name(140, 112, "+ fx_2 · load²"),
        Name(140, 126, "+ fx_3 · load³"),
    )

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """The channels' quadratic gains in 1/N or 1/(N m), then the cubic ones in 1/N² or 1/(N m)²."""
        powers = (
            (2, "squared", {"N": "1/N", TORQUE_UNIT: "1/(N m)"}),
            (3, "cubed", {"N": "1/N²", TORQUE_UNIT: "1/(N² m²)"}),
        )
        return tuple(
            Parameter(
                name=f"{channel}_{power}",
                unit=units[unit],
                meaning=f"coefficient of the {word} load in channel {channel}",
            )
            for power, word, units in powers
            for channel, unit in space.channel_units.items()
        )

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
    shows = "Zero up to a level, then one-sided: the peaks of the reading are flat."
    provoked_by = "Larger loads: more of the peaks is cut. Smaller ones: it disappears."
    letter = "level"
    amounts: ClassVar[Mapping[str, float]] = {"N": 5.0, "N m": 0.2, "tz": 0.05}
    sketch = (
        Axes("load", "reading", centred=True),
        Line(((178, 26), (200, 8)), "ghost"),
        Line(((26, 124), (60, 124), (176, 28), (220, 28)), "accent"),
        Length((206, 30), (206, 74), Name(200, 58, "level", "end")),
        Name(40, 142, "levels fx, fy, tau, ..."),
    )

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """The level of each channel, in the channel's unit."""
        return tuple(
            Parameter(
                name=channel,
                unit=unit,
                meaning=f"largest reading of channel {channel}, either sign",
                nominal=inf,
                bounds=(0.0, inf),
            )
            for channel, unit in space.channel_units.items()
        )

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


# Hysteresis of the sensor: a play operator between load and reading.


HALF_WIDTH_FRACTIONS = (0.01, 0.05, 0.2)
"""Initial half-widths as fractions of the load's amplitude; smaller ones have the sensitivity of the first."""


@dataclass(frozen=True)
class SensorHysteresis(Effect):
    """Play operator of half-width w (N, N m) in each channel, between load and reading.

    The reading y is constant while the load is within w of it, and is pushed along beyond: max(y, load - w) while the
    load rises, min(y, load + w) while it falls. A load of larger amplitude draws a loop of width 2 w. Nominal 0; to
    first order it subtracts w in the direction of the load's change. Of a recording in motion the play begins in the
    state that its first readings show.
    """

    id = "sensor_hysteresis"
    title = "hysteresis between load and reading"
    stage = Stage.PLAY
    equation = "y = max(y, load - w) while the load rises, min(y, load + w) while it falls"
    advice = "load and unload the sensor slowly in steps and compare the readings; look for a loose cover or cable"
    confused_with = "coulomb_friction and joint_backlash; sensor_lag, whose loop widens with the rate of the load"
    shows = "A loop against the channel's own load, which does not widen with the speed."
    provoked_by = "Load and unload slowly, in large loops and in small ones within them."
    letter = "h"
    amounts: ClassVar[Mapping[str, float]] = {"N": 0.2, "N m": 0.01}
    sketch = (
        Axes("load", "reading", centred=True),
        Line(((54, 122), (92, 122), (190, 30), (152, 30)), "accent", closed=True),
        Length((74, 104), (112, 104), Name(128, 108, "2 h")),
        Name(232, 138, "h: fx, fy, tau, ...", "end"),
    )

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """One half-width per channel, in its unit."""
        return tuple(
            Parameter(
                name=channel,
                unit=unit,
                meaning=f"half width of the play of channel {channel}",
                bounds=(0.0, inf),
            )
            for channel, unit in space.channel_units.items()
        )

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
