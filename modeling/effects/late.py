"""Effects of a sensor that is late."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from modeling import symbolic as sp
from modeling.chain import Chain, Stage, laplace
from modeling.effect import Effect
from modeling.parameter import Parameter
from modeling.space import Space


@dataclass(frozen=True)
class SensorLag(Effect):
    """The sensor, or its filter, is a first-order low-pass: H(s) = 1 / (1 + s time_constant), in s."""

    id = "sensor_lag"
    title = "sensor or its filter lags (first order)"
    stage = Stage.MEMORY
    equation = "H(s) = 1 / (1 + s time_constant)"
    advice = "look up the sensor's filter setting; tap the tool and see how fast the reading decays"
    confused_with = "time_delay: in slow motion they are the same, and only fast motion parts them"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """The time constant in s."""
        return (Parameter(name="time_constant", unit="s", bounds=(0.0, 10.0)),)

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Low-pass every channel."""
        return replace(chain, memory=chain.memory / (1 + laplace() * p["time_constant"]))


@dataclass(frozen=True)
class TimeDelay(Effect):
    """The reading comes later than the motion by a pure delay (s): H(s) = exp(-s delay); negative when it leads."""

    id = "time_delay"
    title = "reading delayed against the motion"
    stage = Stage.MEMORY
    equation = "H(s) = exp(-s delay)"
    advice = "compare the clocks of robot and sensor; look for a buffer or a network between them"
    confused_with = "sensor_lag: in slow motion they are the same, and only fast motion parts them"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """The delay in s."""
        return (Parameter(name="delay", unit="s", bounds=(-10.0, 10.0)),)

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Delay every channel."""
        return replace(chain, memory=chain.memory * sp.exp(-laplace() * p["delay"]))
