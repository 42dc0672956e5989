"""First-order lag and pure delay."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from modeling import symbolic as sp
from modeling.chain.chain import Chain, Stage
from modeling.chain.effect import Effect
from modeling.chain.stages.linear_dynamics_stage import LinearDynamics
from modeling.expressions.laplace_variable import laplace
from modeling.parameter import Parameter
from modeling.space import Space


@dataclass(frozen=True)
class SensorLag(Effect):
    """First-order low-pass of the sensor or its filter: H(s) = 1 / (1 + s time_constant), time constant in s."""

    id = "sensor_lag"
    title = "first-order lag of the sensor or its filter"
    stage = Stage.LINEAR_DYNAMICS
    equation = "H(s) = 1 / (1 + s time_constant)"
    advice = "look up the sensor's filter setting; tap the tool and see how fast the reading decays"
    confused_with = "time_delay: at low frequencies the two are aliased, only fast motion discriminates"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """The time constant in s."""
        return (Parameter(name="time_constant", unit="s", bounds=(0.0, 10.0)),)

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

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """The delay in s."""
        return (Parameter(name="delay", unit="s", bounds=(-10.0, 10.0)),)

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Delay every channel."""
        return chain.with_stage(LinearDynamics(chain.transfer_function * sp.exp(-laplace() * p["delay"])))
