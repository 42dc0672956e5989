"""Sketches of effects of the sensor: its axes, characteristic, dynamics and bias."""

from __future__ import annotations

from math import cos, exp, pi, radians, sin

from truewrench.effect_description.drawing import Drawing


def sensor_rotation(d: Drawing) -> None:
    """The sensor's axes are turned against those that are assumed."""
    for turn, kind in ((0.0, "ghost"), (-22.0, "accent")):
        for quarter in (0.0, -90.0):
            a = radians(turn + quarter)
            d.arrow(96, 112, 96 + 88 * cos(a), 112 + 88 * sin(a), kind)
    d.arc(96, 112, 60, 0, -22)
    d.parameter(164, 104, "angle; roll,")
    d.parameter(164, 130, "pitch, yaw")
    d.text(20, 142, "dashed: axes as assumed")


def sensor_gain(d: Drawing) -> None:
    """The reading is a multiple of the load."""
    d.axes("load", "reading", centred=True)
    d.line(58, 136, 178, 16, "ghost")
    d.line(32, 118, 204, 34, "accent")
    d.text(182, 22, "gain 1")
    d.parameter(150, 112, "slope fy, tau, ...")


def sensor_crosstalk(d: Drawing) -> None:
    """A load in one channel shows in the reading of another."""
    for y, name in ((42, "fx"), (104, "fy")):
        d.text(36, y + 4, f"load {name}", "middle")
        d.arrow(66, y, 170, y, "ink")
        d.text(176, y + 4, f"reading {name}")
    d.arrow(66, 46, 168, 98)
    d.parameter(132, 70, "fy_fx")
    d.text(120, 140, "names: reading, then load", "middle")


def gain_nonlinearity(d: Drawing) -> None:
    """The reading bends away from a straight line."""
    d.axes("load", "reading", centred=True)
    d.line(48, 132, 188, 20, "ghost")

    def bent(x: float) -> float:
        u = (x - 118) / 70
        return 76 - 56 * (u - 0.14 * u**2 - 0.3 * u**3)

    d.curve(bent, 44, 198)
    d.parameter(140, 112, "+ fx_2 · load²")
    d.parameter(140, 126, "+ fx_3 · load³")


def sensor_hysteresis(d: Drawing) -> None:
    """The reading follows the load only after a play."""
    d.axes("load", "reading", centred=True)
    d.path([(54, 122), (92, 122), (190, 30), (152, 30)], "accent", closed=True)
    d.dimension(74, 104, 112, 104, "2 h", (128, 108))
    d.text(232, 138, "h: fx, fy, tau, ...", "end", "parameter")


def sensor_lag(d: Drawing) -> None:
    """After a step of the load the reading follows exponentially."""
    d.axes("time", "reading")
    d.path([(34, 120), (70, 120), (70, 34), (216, 34)], "ghost")
    d.curve(lambda x: 34 + 86 * exp(-(x - 70) / 40), 70, 216)
    d.dimension(70, 66, 110, 66, "time_constant", (116, 76))
    d.text(150, 28, "load")


def time_delay(d: Drawing) -> None:
    """The reading is the load of a moment ago."""
    d.axes("time", "reading")

    def load(x: float) -> float:
        return 74 - 34 * sin(2 * pi * (x - 34) / 120)

    d.curve(load, 34, 210, "ghost")
    d.curve(lambda x: load(x - 18), 52, 214)
    d.dimension(64, 34, 82, 34, "delay", (88, 32))
    d.text(40, 34, "load")


def saturation(d: Drawing) -> None:
    """The reading stops at a level."""
    d.axes("load", "reading", centred=True)
    d.line(178, 26, 200, 8, "ghost")
    d.path([(26, 124), (60, 124), (176, 28), (220, 28)], "accent")
    d.dimension(206, 30, 206, 74, "level", (200, 58), "end")
    d.text(40, 142, "levels fx, fy, tau, ...", "", "parameter")


def bias_drift(d: Drawing) -> None:
    """The bias wanders over the record."""
    d.axes("progress of the record", "bias")
    d.line(34, 92, 214, 92, "ghost")
    d.curve(lambda x: 92 - 34 * sin((x - 34) / 62) - 0.07 * (x - 34), 34, 214)
    d.parameter(92, 40, "fx_1 P₁ + fx_2 P₂ + ...")


def thermal_drift(d: Drawing) -> None:
    """The bias changes with the temperature."""
    d.axes("temperature", "bias")
    d.line(40, 116, 206, 32, "accent")
    d.line(98, 126, 98, 88, "faint")
    d.text(98, 140, "20 °C", "middle")
    d.parameter(150, 88, "slope fx, fy, ...")


def line_interference(d: Drawing) -> None:
    """A sinusoid of a frequency that the motion has not."""
    d.axes("time", "reading")
    d.curve(lambda x: 80 - 26 * sin(2 * pi * (x - 34) / 44), 34, 214)
    d.dimension(45, 44, 89, 44, "1 / frequency", (96, 48))
    d.dimension(133, 54, 133, 80, "fx_sin, fx_cos", (44, 142))


SENSOR_SKETCHES = (
    sensor_rotation,
    sensor_gain,
    sensor_crosstalk,
    gain_nonlinearity,
    sensor_hysteresis,
    sensor_lag,
    time_delay,
    saturation,
    bias_drift,
    thermal_drift,
    line_interference,
)
