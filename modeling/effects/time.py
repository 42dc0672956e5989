"""Effects in time: a zero that wanders or follows temperature, and somebody touching the tool."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import sympy as sp

from modeling.chain import Chain, Stage
from modeling.contact import applied, components
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
class ContactEvent(Effect):
    """Something pushes the tool with a constant wrench between start and end (s).

    The wrench is the environment's on the tool: along x' and y' and clockwise about the sensor in the plane, in the
    sensor frame in six axes. It rises and falls over 10 ms, so that the times have a derivative.
    """

    id = "contact_event"
    title = "external push during an interval"
    stage = Stage.TIP_BODY
    equation = "F += Fc, T += Tc for start < time < end"
    advice = "look at what touched the tool at that time; leave the interval out of the identification"
    per_recording = True

    edge = sp.Rational(1, 100)

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """start and end in s, then the wrench in N and N m."""
        times = tuple(Parameter(name=name, unit="s", nuisance=True) for name in ("start", "end"))
        return times + tuple(Parameter(name=n, unit=u) for n, u in zip(components(space), space.units, strict=True))

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Push the tool during the interval."""
        (time,) = signals("time")
        rising, falling = ((time - p["start"]) / self.edge, (p["end"] - time) / self.edge)
        during = sp.Min(1, sp.Max(0, sp.Min(rising, falling) + sp.Rational(1, 2)))
        force, torque = applied(chain.space, [p[name] for name in components(chain.space)])
        return replace(chain, force=chain.force + during * force, torque=chain.torque + during * torque)

    def nuisance_grid(self, extent: Extent) -> tuple[Values, ...]:
        """Intervals that were noticed, and those between the points of a grid of 17 times over the recording."""
        times = np.linspace(extent.start, extent.end, 17)
        windows = [*extent.events, *combinations(map(float, times), 2)]
        return tuple({"start": start, "end": end} for start, end in windows)
