"""Disturbances: drift of the bias, interference, and what comes and goes at unknown times (payloads, contacts)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import combinations, product
from math import inf, pi, sin
from typing import ClassVar

from modeling import symbolic as sp
from modeling.chain.chain import Chain, Stage
from modeling.chain.effect import Effect, GridSuperposition, NuisanceValues, SearchDomain
from modeling.chain.stages import Bias
from modeling.effects.loads import POINT_AMOUNTS, PointEffect, point_of_application
from modeling.parameter import Parameter, Role
from modeling.rigid_body import RigidBody, contact_components, contact_force_torque
from modeling.sketch import Axes, Box, Length, Line, Name, Text, Tool, graph
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
    shows = "Slow, different in each repeat and in each channel, whatever the motion does."
    provoked_by = "Hold one pose for as long as the recording lasts, before and after it."
    disturbance = "drift"
    amounts: ClassVar[Mapping[str, float]] = {"N": 0.2, "N m": 0.01}
    sketch = (
        Axes("progress of the record", "bias"),
        Line(((34, 92), (214, 92)), "ghost"),
        Line(graph(lambda x: 92 - 34 * sin((x - 34) / 62) - 0.07 * (x - 34), 34, 214), "accent"),
        Name(92, 40, "fx_1 P₁ + fx_2 P₂ + ..."),
    )

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """Coefficients per channel and degree, in the channel's unit."""
        return tuple(
            Parameter(
                name=f"{channel}_{k}",
                unit=unit,
                meaning=f"coefficient of the Legendre polynomial {k} in channel {channel}",
            )
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
class ZeroDrift(Effect):
    """Linear drift of the zero: adds b_i progress / 2 to each channel, which changes by b_i over a recording.

    It is another one in each recording. A budget states it, from the sensor's sheet or temperature coefficient.
    """

    id = "zero_drift"
    title = "drift of the zero over a recording"
    stage = Stage.BIAS
    equation = "reading_i += b_i progress / 2, progress from -1 to 1"
    advice = BiasDrift.advice

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """b_i per channel, in the channel's unit."""
        return tuple(
            Parameter(name=channel, unit=unit, meaning=f"change of the zero of channel {channel} over a recording")
            for channel, unit in space.channel_units.items()
        )

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Add the line to the bias."""
        (progress,) = signals("progress")
        return chain.with_stage(Bias(chain.bias + progress / 2 * sp.Matrix(list(p.values()))))


@dataclass(frozen=True)
class ThermalDrift(Effect):
    """Bias proportional to the recorded temperature (°C): reading_i += b_i (temperature - 20)."""

    id = "thermal_drift"
    title = "bias depends on the temperature"
    stage = Stage.BIAS
    equation = "reading_i += b_i (temperature - 20 °C)"
    advice = "warm the sensor up before use, or compensate with the coefficient and the logged temperature"
    confused_with = "bias_drift, while the temperature rises steadily"
    shows = "Slow, in proportion to the logged temperature, whatever the motion does."
    provoked_by = "Record the warm-up from a cold start with the temperature logged, and a second time when warm."
    amounts: ClassVar[Mapping[str, float]] = {"N/K": 0.1, "N m/K": 0.01}
    sketch = (
        Axes("temperature", "bias"),
        Line(((40, 116), (206, 32)), "accent"),
        Line(((98, 126), (98, 88)), "faint"),
        Text(98, 140, "20 °C", "middle"),
        Name(150, 88, "slope fx, fy, ..."),
    )

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """One coefficient per channel, in the channel's unit per K."""
        return tuple(
            Parameter(
                name=channel,
                unit=f"{unit}/K",
                meaning=f"change of the bias of channel {channel} for each kelvin",
            )
            for channel, unit in space.channel_units.items()
        )

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
    shows = "One line in the spectrum that lies between the multiples of the motion's frequency."
    provoked_by = (
        "Another period of the motion, or another sampling rate: an alias moves, a resonance of the tool does not."
    )
    disturbance = "interference"
    amounts: ClassVar[Mapping[str, float]] = {"frequency": 7.3, "N": 0.3, "N m": 0.02}
    sketch = (
        Axes("time", "reading"),
        Line(graph(lambda x: 80 - 26 * sin((x - 34) * pi / 22), 34, 214), "accent"),
        Length((45, 44), (89, 44), Name(96, 48, "1 / frequency")),
        Length((133, 54), (133, 80), Name(44, 142, "fx_sin, fx_cos")),
    )

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """frequency in Hz, then sine and cosine of each channel in the channel's unit."""
        frequency = Parameter(
            name="frequency",
            unit="Hz",
            meaning="frequency of the interference",
            bounds=(0.0, inf),
            role=Role.FREQUENCY,
        )
        waves = (
            Parameter(
                name=f"{channel}_{wave}",
                unit=unit,
                meaning=f"amplitude of its {word} part in channel {channel}",
            )
            for channel, unit in space.channel_units.items()
            for wave, word in (("sin", "sine"), ("cos", "cosine"))
        )
        return (frequency, *waves)

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Add the sinusoid to the bias."""
        (time,) = signals("time")
        angle = 2 * sp.pi * p["frequency"] * time
        sinusoid = [p[f"{c}_sin"] * sp.sin(angle) + p[f"{c}_cos"] * sp.cos(angle) for c in chain.space.channels]
        return chain.with_stage(Bias(chain.bias + sp.Matrix(sinusoid)))

    def nuisance_grid(self, domain: SearchDomain) -> tuple[NuisanceValues, ...]:
        """The non-excited spectral lines found in the residual."""
        return tuple({"frequency": frequency} for frequency in domain.tones)


# Transient events: payload changes and contacts at unknown times.


RAMP_TIME = Fraction(1, 100)
"""Rise and fall time (s) of an event, so that the reading is differentiable in its onset and end."""
NO_END = 1e9
"""End time (s) beyond any recording."""


@dataclass(frozen=True)
class PayloadChange(PointEffect):
    """A point mass is added to the tool at an onset time; it is negative when the mass is removed.

    mass in kg, time in s. The point r is at the distance d (m) along the tip; in six axes it is (x, y, d) in the sensor
    frame. mass adds to m, mass r to the first moment and mass (r·r - r r') to the inertia about the sensor. The ramp
    takes 10 ms.
    """

    id = "payload_change"
    title = "payload picked up or released"
    stage = Stage.TIP_BODY
    equation = "m += mass, c += mass r, I += mass (r·r - r r') for time > time_0"
    advice = "check what the gripper did at that time; identify the tool before and after separately"
    confused_with = "a sustained push along gravity (contact_event); fast bias_drift"
    per_recording = True
    shows = (
        "The residual of the later repeats is that of another weight: a step between repeats, not within the mean of "
        "them."
    )
    provoked_by = (
        "Nothing to provoke: look at what the gripper did at the time found, and record before and after separately."
    )
    disturbance = "payload change"
    amounts: ClassVar[Mapping[str, float]] = {"mass": 0.1, "time": 2.003, **POINT_AMOUNTS}
    sketch = (
        Tool(),
        Box(106, 100, 28, 26, "accent"),
        Name(142, 118, "mass"),
        Name(142, 134, "from time on"),
        Line(((80, 28), (114, 28)), "faint"),
        Length((86, 28), (86, 112), Name(80, 76, "d", "end")),
    )

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """mass in kg, the point in m, time in s."""
        return (
            Parameter(name="mass", unit="kg", meaning="mass picked up; negative: released"),
            *self.point_parameters(space),
            Parameter(name="time", unit="s", meaning="when, from the first row", role=Role.ONSET),
        )

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Add the mass to the tool."""
        (time,) = signals("time")
        mass, r = p["mass"] * ramp(time - p["time"]), point_of_application(chain, p)
        inertia = mass * (r.dot(r) * sp.eye(3) - r * r.T)
        body = chain.body
        heavier = RigidBody(body.mass + mass, body.first_moment + mass * r, body.inertia + inertia)
        return replace(chain, body=heavier)

    def nuisance_grid(self, domain: SearchDomain) -> tuple[NuisanceValues, ...]:
        """Edges of the detected events and 31 times over the recording, each at three points of the tip."""
        import numpy as np

        edges = [edge for event in domain.events for edge in event]
        times = [*edges, *map(float, np.linspace(domain.start, domain.end, 33)[1:-1])]
        return tuple({"d": d, "time": t} for t, d in product(times, (0.0, 0.5 * domain.reach, domain.reach)))


@dataclass(frozen=True)
class ContactEvent(Effect):
    """A constant contact wrench on the tool between start and end (s).

    The wrench is the environment's on the tool: along x' and y' and clockwise about the sensor in the plane, along the
    axes of the logged pose in six axes. It rises and falls within 10 ms, so that the reading is differentiable in the
    times.
    """

    id = "contact_event"
    title = "contact wrench during an interval"
    stage = Stage.TIP_BODY
    equation = "F += Fc, T += Tc for start < time < end"
    advice = "check what touched the tool at that time; exclude the interval from the identification"
    confused_with = "payload_change, if the tool hardly rotates; bias_drift, if the push is slow"
    per_recording = True
    shows = "A pulse in one repeat that the others do not have."
    provoked_by = "Nothing to provoke: look at what touched the tool at the time found."
    disturbance = "contact"
    amounts: ClassVar[Mapping[str, float]] = {"start": 1.203, "end": 2.204, "N": 2.0, "N m": 0.1}
    sketch = (
        Axes("time", "force, torque"),
        Line(((34, 126), (92, 126), (94, 60), (166, 60), (168, 126), (214, 126)), "accent"),
        Name(92, 142, "start", "middle"),
        Name(168, 142, "end", "middle"),
        Length((128, 62), (128, 124), Name(134, 98, "fcx, ...")),
    )

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """start and end in s, then the wrench in N and N m."""
        meanings = {"start": "when the contact begins, from the first row", "end": "when it ends, from the first row"}
        times = tuple(Parameter(name=n, unit="s", meaning=words, role=Role.ONSET) for n, words in meanings.items())
        return times + tuple(
            Parameter(name=name, unit=unit, meaning=_component_in_words(name))
            for name, unit in zip(contact_components(space), space.units, strict=True)
        )

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Add the contact wrench during the interval."""
        (time,) = signals("time")
        during = sp.Min(ramp(time - p["start"]), ramp(p["end"] - time))
        force, torque = contact_force_torque(chain.space, [p[name] for name in contact_components(chain.space)])
        return replace(chain, force=chain.force + during * force, torque=chain.torque + during * torque)

    def nuisance_grid(self, domain: SearchDomain) -> tuple[NuisanceValues, ...]:
        """Intervals of detected events, and those between the points of a grid of 17 times over the recording.

        Of an event of any shape the interval is known: a pulse anywhere within it would do as well.
        """
        import numpy as np

        times = np.linspace(domain.start, domain.end, 17)
        windows = domain.contacts or [*domain.events, *combinations(map(float, times), 2)]
        return tuple({"start": start, "end": end} for start, end in windows)

    def combination(self, points: Sequence[NuisanceValues]) -> GridSuperposition:
        """A pulse of at least the rise time is the difference of two steps, one at its start and one at its end.

        min(ramp(t - start), ramp(end - t)) = ramp(t - start) + ramp(end - t) - 1 if end - start >= `RAMP_TIME`, and
        ramp(end - t) = 1 - ramp(t - end).
        """
        whole = [v["end"] - v["start"] >= float(RAMP_TIME) for v in points]
        starts = sorted({t for v, w in zip(points, whole, strict=True) if w for t in (v["start"], v["end"])})
        place = {t: i for i, t in enumerate(starts)}
        blocks: list[NuisanceValues] = [{"start": t, "end": NO_END} for t in starts]
        index, weights = [], []
        for values, combined in zip(points, whole, strict=True):
            if combined:
                index.append((place[values["start"]], place[values["end"]]))
                weights.append((1.0, -1.0))
            else:
                index.append((len(blocks), len(blocks)))
                weights.append((1.0, 0.0))
                blocks.append(values)
        return GridSuperposition(blocks=tuple(blocks), index=tuple(index), weights=tuple(weights))


def _component_in_words(name: str) -> str:
    """What a component of the contact's wrench is: `fcx`, or `tauc` in the plane."""
    kind = "force" if name.startswith("f") else "torque"
    return f"its {kind}, {name[-1]} axis of the logged pose" if name[-1] in "xyz" else f"its {kind}"


def ramp(elapsed: sp.Expr) -> sp.Expr:
    """Step from 0 to 1 at `elapsed` (s) = 0, linear within `RAMP_TIME`."""
    return sp.Min(1, sp.Max(0, elapsed / RAMP_TIME + sp.Rational(1, 2)))
