"""Effects on the zero point, which wanders with time, temperature and the mains."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import inf

from modeling import symbolic as sp
from modeling.chain import Chain, Stage
from modeling.effect import Effect, Extent, Values
from modeling.parameter import Parameter
from modeling.space import Space, signals


@dataclass(frozen=True)
class BiasDrift(Effect):
    """The zero point wanders: each channel gets sum_k b_k P_k(progress) with Legendre polynomials P_1 .. P_degree.

    `progress` runs from -1 to 1 over the recording (over the order of poses at rest); the b_k are in the channel's
    unit. A free enough curve would mimic temperature, so that it gets no more than four swings.
    """

    degree: int = 8

    id = "bias_drift"
    title = "zero point wanders"
    stage = Stage.ZERO
    equation = "reading_i += sum_k b_ik P_k(progress)"
    advice = "let the sensor warm up, record a still pose for as long, zero it before each run"
    confused_with = "thermal_drift, while the temperature rises steadily; payload_change that comes slowly"
    per_recording = True
    needs_repeats = True

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """Coefficients per channel and degree, in the channel's unit."""
        return tuple(
            Parameter(name=f"{channel}_{k}", unit=unit)
            for channel, unit in zip(space.channels, space.units, strict=True)
            for k in range(1, self.degree + 1)
        )

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Add the polynomials to the zero."""
        (progress,) = signals("progress")
        basis = [sp.legendre(k, progress) for k in range(1, self.degree + 1)]
        curve = [
            sum((p[f"{channel}_{k}"] * b for k, b in enumerate(basis, start=1)), sp.S.Zero)
            for channel in chain.space.channels
        ]
        return replace(chain, zero=chain.zero + sp.Matrix(curve))


@dataclass(frozen=True)
class ThermalDrift(Effect):
    """The zero point follows the recorded temperature (°C): reading_i += b_i (temperature - 20)."""

    id = "thermal_drift"
    title = "zero point follows the temperature"
    stage = Stage.ZERO
    equation = "reading_i += b_i (temperature - 20 °C)"
    advice = "warm the sensor up before use, or subtract the coefficient with the logged temperature"
    confused_with = "bias_drift, while the temperature rises steadily"

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """One coefficient per channel, in the channel's unit per K."""
        return tuple(
            Parameter(name=channel, unit=f"{unit}/K") for channel, unit in zip(space.channels, space.units, strict=True)
        )

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Add the temperature to the zero."""
        (temperature,) = signals("temperature")
        return replace(chain, zero=chain.zero + (temperature - 20) * sp.Matrix(list(p.values())))


@dataclass(frozen=True)
class LineInterference(Effect):
    """A tone of fixed frequency in the readings, not locked to the motion: the mains, a fan, a pump.

    reading_i += sin_i sin(2 pi frequency time) + cos_i cos(2 pi frequency time), amplitudes in the channel's unit,
    frequency in Hz. Its phase belongs to one recording.
    """

    id = "line_interference"
    title = "tone of a fixed frequency"
    stage = Stage.ZERO
    equation = "reading_i += s_i sin(2 pi frequency time) + c_i cos(2 pi frequency time)"
    advice = "look for mains hum, fans and pumps at that frequency or its alias; check shielding and grounding"
    confused_with = "a vibration of the tool, when its frequency goes with the robot's speed"
    per_recording = True

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """frequency in Hz, then sine and cosine of each channel in the channel's unit."""
        named = zip(space.channels, space.units, strict=True)
        waves = tuple(Parameter(name=f"{c}_{wave}", unit=u) for c, u in named for wave in ("sin", "cos"))
        return (Parameter(name="frequency", unit="Hz", bounds=(0.0, inf), nuisance=True), *waves)

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Add the tone to the zero."""
        (time,) = signals("time")
        angle = 2 * sp.pi * p["frequency"] * time
        tone = [p[f"{c}_sin"] * sp.sin(angle) + p[f"{c}_cos"] * sp.cos(angle) for c in chain.space.channels]
        return replace(chain, zero=chain.zero + sp.Matrix(tone))

    def nuisance_grid(self, extent: Extent) -> tuple[Values, ...]:
        """The tones that the residual has."""
        return tuple({"frequency": frequency} for frequency in extent.tones)
