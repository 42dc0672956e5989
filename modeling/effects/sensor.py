"""Effects of the sensor: how it is mounted, how its channels leak, and how it remembers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import pi
from typing import Any

import sympy as sp

from modeling.chain import LAPLACE, Chain, Stage
from modeling.effect import Effect
from modeling.parameter import Parameter
from modeling.space import Space, turned


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

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """One angle in the plane, three in six axes, rad."""
        names = ("angle",) if space is Space.PLANE else ("roll", "pitch", "yaw")
        return tuple(Parameter(name=name, unit="rad", bounds=(-pi, pi)) for name in names)

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Turn the axes of the reading."""
        return replace(chain, mounting=turned(chain.space, tuple(p.values())).T * chain.mounting)


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
class SensorLag(Effect):
    """The sensor, or its filter, is a first-order low-pass: H(s) = 1 / (1 + s time_constant), in s."""

    id = "sensor_lag"
    title = "sensor or its filter lags (first order)"
    stage = Stage.MEMORY
    equation = "H(s) = 1 / (1 + s time_constant)"
    advice = "look up the sensor's filter setting; tap the tool and see how fast the reading decays"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """The time constant in s."""
        return (Parameter(name="time_constant", unit="s", bounds=(0.0, 10.0)),)

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Low-pass every channel."""
        return replace(chain, memory=chain.memory / (1 + LAPLACE * p["time_constant"]))


@dataclass(frozen=True)
class TimeDelay(Effect):
    """The reading comes later than the motion by a pure delay (s): H(s) = exp(-s delay); negative when it leads."""

    id = "time_delay"
    title = "reading delayed against the motion"
    stage = Stage.MEMORY
    equation = "H(s) = exp(-s delay)"
    advice = "compare the clocks of robot and sensor; look for a buffer or a network between them"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """The delay in s."""
        return (Parameter(name="delay", unit="s", bounds=(-10.0, 10.0)),)

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Delay every channel."""
        return replace(chain, memory=chain.memory * sp.exp(-LAPLACE * p["delay"]))


def _leak(row: str, column: str) -> dict[str, Any]:
    """Unit and bounds of a leak: half of a channel, or the torque of a force 0.2 m away; more is no leak."""
    if row == column:
        return {"unit": "1", "bounds": (-0.5, 0.5)}
    return {"unit": "m", "bounds": (-0.2, 0.2)} if row == "N m" else {"unit": "1/m", "bounds": (-5.0, 5.0)}
