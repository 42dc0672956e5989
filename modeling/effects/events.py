"""Effects that begin, or end, within a recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import combinations, product

from modeling import symbolic as sp
from modeling.chain import Chain, Stage, point_on_tip
from modeling.contact import applied, components
from modeling.effect import Combination, Effect, Extent, Values
from modeling.effects.push import DISTANCE
from modeling.parameter import Parameter
from modeling.space import Space, signals
from modeling.tip import Body

EDGE = Fraction(1, 100)
"""Seconds in which an event begins or ends, so that its times have a derivative."""
NEVER = 1e9
"""An end (s) that no recording reaches."""


@dataclass(frozen=True)
class PayloadChange(Effect):
    """A point mass appears on the tool at a time, at distance d along the tip; one that leaves has negative mass.

    mass in kg, d in m, time in s; with the point r = d along the tip, mass adds to m, mass r to the first moment and
    mass (r·r - r r') to the inertia about the sensor. It comes within 10 ms.
    """

    id = "payload_change"
    title = "load taken up or put down"
    stage = Stage.TIP_BODY
    equation = "m += mass, c += mass r, I += mass (r·r - r r') for time > time_0"
    advice = "look at what the gripper did at that time; identify the tool before and after by themselves"
    confused_with = "a lasting push along gravity (contact_event); bias_drift that comes quickly"
    per_recording = True

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """mass in kg, d in m, time in s."""
        return (
            Parameter(name="mass", unit="kg"),
            DISTANCE,
            Parameter(name="time", unit="s", nuisance=True),
        )

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Hang the mass on the tool."""
        (time,) = signals("time")
        mass, r = p["mass"] * risen(time - p["time"]), point_on_tip(chain, p["d"])
        inertia = mass * (r.dot(r) * sp.eye(3) - r * r.T)
        body = chain.body
        heavier = Body(body.mass + mass, body.first_moment + mass * r, body.inertia + inertia)
        return replace(chain, body=heavier)

    def nuisance_grid(self, extent: Extent) -> tuple[Values, ...]:
        """Edges of what was noticed and 31 times over the recording, each at three points of the tip."""
        import numpy as np

        edges = [edge for event in extent.events for edge in event]
        times = [*edges, *map(float, np.linspace(extent.start, extent.end, 33)[1:-1])]
        return tuple({"d": d, "time": t} for t, d in product(times, (0.0, 0.5 * extent.reach, extent.reach)))


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
    confused_with = "payload_change, where the tool hardly turns; bias_drift, when the push is slow"
    per_recording = True

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        """start and end in s, then the wrench in N and N m."""
        times = tuple(Parameter(name=name, unit="s", nuisance=True) for name in ("start", "end"))
        return times + tuple(Parameter(name=n, unit=u) for n, u in zip(components(space), space.units, strict=True))

    def perturb(self, chain: Chain, p: Mapping[str, sp.Expr]) -> Chain:
        """Push the tool during the interval."""
        (time,) = signals("time")
        during = sp.Min(risen(time - p["start"]), risen(p["end"] - time))
        force, torque = applied(chain.space, [p[name] for name in components(chain.space)])
        return replace(chain, force=chain.force + during * force, torque=chain.torque + during * torque)

    def nuisance_grid(self, extent: Extent) -> tuple[Values, ...]:
        """Intervals that were noticed, and those between the points of a grid of 17 times over the recording."""
        import numpy as np

        times = np.linspace(extent.start, extent.end, 17)
        windows = [*extent.events, *combinations(map(float, times), 2)]
        return tuple({"start": start, "end": end} for start, end in windows)

    def combination(self, points: Sequence[Values]) -> Combination:
        """A push that has come to its full height is one that starts and stays, less another that starts at its end.

        min(risen(t - start), risen(end - t)) = risen(t - start) + risen(end - t) - 1 when end - start is an edge or
        more, and risen(end - t) = 1 - risen(t - end).
        """
        whole = [v["end"] - v["start"] >= float(EDGE) for v in points]
        starts = sorted({t for v, w in zip(points, whole, strict=True) if w for t in (v["start"], v["end"])})
        place = {t: i for i, t in enumerate(starts)}
        blocks: list[Values] = [{"start": t, "end": NEVER} for t in starts]
        index, weights = [], []
        for values, combined in zip(points, whole, strict=True):
            if combined:
                index.append((place[values["start"]], place[values["end"]]))
                weights.append((1.0, -1.0))
            else:
                index.append((len(blocks), len(blocks)))
                weights.append((1.0, 0.0))
                blocks.append(values)
        return Combination(blocks=tuple(blocks), index=tuple(index), weights=tuple(weights))


def risen(late: sp.Expr) -> sp.Expr:
    """0 before, 1 after the time at which `late` (s) is zero, straight in between within `EDGE`."""
    return sp.Min(1, sp.Max(0, late / EDGE + sp.Rational(1, 2)))
