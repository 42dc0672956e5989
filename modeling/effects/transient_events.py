"""Transient events: payload changes and contacts at unknown times."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import combinations, product

from modeling import symbolic as sp
from modeling.chain.chain import Chain, Stage
from modeling.chain.effect import Effect, GridSuperposition, NuisanceValues, SearchDomain
from modeling.effects.point_effect import PointEffect, point_of_application
from modeling.parameter import Parameter, Role
from modeling.space import Space, signals
from modeling.tool.rigid_body import RigidBody
from modeling.tool.wrench_components import contact_components, contact_force_torque

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

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """mass in kg, the point in m, time in s."""
        return (
            Parameter(name="mass", unit="kg"),
            *self.point_parameters(space),
            Parameter(name="time", unit="s", role=Role.ONSET),
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

    The wrench is the environment's on the tool: along x' and y' and clockwise about the sensor in the plane, in the
    sensor frame in six axes. It rises and falls within 10 ms, so that the reading is differentiable in the times.
    """

    id = "contact_event"
    title = "contact wrench during an interval"
    stage = Stage.TIP_BODY
    equation = "F += Fc, T += Tc for start < time < end"
    advice = "check what touched the tool at that time; exclude the interval from the identification"
    confused_with = "payload_change, if the tool hardly rotates; bias_drift, if the push is slow"
    per_recording = True

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """start and end in s, then the wrench in N and N m."""
        times = tuple(Parameter(name=name, unit="s", role=Role.ONSET) for name in ("start", "end"))
        return times + tuple(
            Parameter(name=n, unit=u) for n, u in zip(contact_components(space), space.units, strict=True)
        )

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Add the contact wrench during the interval."""
        (time,) = signals("time")
        during = sp.Min(ramp(time - p["start"]), ramp(p["end"] - time))
        force, torque = contact_force_torque(chain.space, [p[name] for name in contact_components(chain.space)])
        return replace(chain, force=chain.force + during * force, torque=chain.torque + during * torque)

    def nuisance_grid(self, domain: SearchDomain) -> tuple[NuisanceValues, ...]:
        """Intervals of detected events, and those between the points of a grid of 17 times over the recording."""
        import numpy as np

        times = np.linspace(domain.start, domain.end, 17)
        windows = [*domain.events, *combinations(map(float, times), 2)]
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


def ramp(elapsed: sp.Expr) -> sp.Expr:
    """Step from 0 to 1 at `elapsed` (s) = 0, linear within `RAMP_TIME`."""
    return sp.Min(1, sp.Max(0, elapsed / RAMP_TIME + sp.Rational(1, 2)))
