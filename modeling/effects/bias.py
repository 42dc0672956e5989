"""Bias drift, thermal drift and line interference."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf

from modeling import symbolic as sp
from modeling.chain.chain import Chain, Stage
from modeling.chain.effect import Effect, NuisanceValues, SearchDomain
from modeling.chain.stages import Bias
from modeling.parameter import Parameter, Role
from modeling.space import Space, signals


@dataclass(frozen=True)
class BiasDrift(Effect):
    """Bias drift: adds sum_k b_k P_k(progress) to each channel, with Legendre polynomials P_1 .. P_degree.

    `progress` runs from -1 to 1 over the recording (over the sequence of static poses); the b_k are in the channel's
    unit. A higher degree would be aliased with temperature: the default allows four oscillations.
    """

    degree: int = 8

    id = "bias_drift"
    title = "bias drift"
    stage = Stage.BIAS
    equation = "reading_i += sum_k b_ik P_k(progress)"
    advice = "let the sensor warm up, record a static pose of the same duration, zero it before each run"
    confused_with = "thermal_drift, while the temperature rises steadily; a gradual payload_change"
    per_recording = True
    needs_repeats = True

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """Coefficients per channel and degree, in the channel's unit."""
        return tuple(
            Parameter(name=f"{channel}_{k}", unit=unit)
            for channel, unit in space.channel_units.items()
            for k in range(1, self.degree + 1)
        )

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Add the polynomials to the bias."""
        (progress,) = signals("progress")
        basis = [sp.legendre(k, progress) for k in range(1, self.degree + 1)]
        curve = [
            sum((p[f"{channel}_{k}"] * b for k, b in enumerate(basis, start=1)), sp.S.Zero)
            for channel in chain.space.channels
        ]
        return chain.with_stage(Bias(chain.bias + sp.Matrix(curve)))


@dataclass(frozen=True)
class ThermalDrift(Effect):
    """Bias proportional to the recorded temperature (°C): reading_i += b_i (temperature - 20)."""

    id = "thermal_drift"
    title = "bias depends on the temperature"
    stage = Stage.BIAS
    equation = "reading_i += b_i (temperature - 20 °C)"
    advice = "warm the sensor up before use, or compensate with the coefficient and the logged temperature"
    confused_with = "bias_drift, while the temperature rises steadily"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """One coefficient per channel, in the channel's unit per K."""
        return tuple(Parameter(name=channel, unit=f"{unit}/K") for channel, unit in space.channel_units.items())

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Add the thermal term to the bias."""
        (temperature,) = signals("temperature")
        return chain.with_stage(Bias(chain.bias + (temperature - 20) * sp.Matrix(list(p.values()))))


@dataclass(frozen=True)
class LineInterference(Effect):
    """A sinusoidal disturbance of fixed frequency, not synchronous with the motion: mains, a fan, a pump.

    reading_i += sin_i sin(2 pi frequency time) + cos_i cos(2 pi frequency time), amplitudes in the channel's unit,
    frequency in Hz. Its phase is specific to the recording.
    """

    id = "line_interference"
    title = "sinusoidal interference of fixed frequency"
    stage = Stage.BIAS
    equation = "reading_i += s_i sin(2 pi frequency time) + c_i cos(2 pi frequency time)"
    advice = "look for mains hum, fans and pumps at that frequency or its alias; check shielding and grounding"
    confused_with = "a vibration of the tool, if its frequency changes with the robot's speed"
    per_recording = True

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """frequency in Hz, then sine and cosine of each channel in the channel's unit."""
        named = space.channel_units.items()
        waves = tuple(Parameter(name=f"{c}_{wave}", unit=u) for c, u in named for wave in ("sin", "cos"))
        return (Parameter(name="frequency", unit="Hz", bounds=(0.0, inf), role=Role.FREQUENCY), *waves)

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Add the sinusoid to the bias."""
        (time,) = signals("time")
        angle = 2 * sp.pi * p["frequency"] * time
        sinusoid = [p[f"{c}_sin"] * sp.sin(angle) + p[f"{c}_cos"] * sp.cos(angle) for c in chain.space.channels]
        return chain.with_stage(Bias(chain.bias + sp.Matrix(sinusoid)))

    def nuisance_grid(self, domain: SearchDomain) -> tuple[NuisanceValues, ...]:
        """The non-excited spectral lines found in the residual."""
        return tuple({"frequency": frequency} for frequency in domain.tones)
