"""The arm of a plan in a few postures: links, capsules, the path of its tip, and its closest approach."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Colormap, Normalize
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from design.clearance import ArmPlaces, Clearances, clearances
from design.limits import tip_path
from design.trajectories.trajectory import Trajectory
from modeling.kinematics.arm import Arm, PlanarArm, SpatialArm
from modeling.number_format import format_number
from modeling.rig import Capsule, HalfSpace, Limits, Workspace
from truewrench.plots.style import FAINT, INK, MEASURED, MISFIT_COLOUR, NOISE, QUIET_NOISE, SMALL, panel_title

Array = NDArray[np.float64]
PathColours = tuple[Array, Colormap, Normalize]
"""Values along the path at equally spaced instants (N,) of one period, with colour map and scale."""

POSTURES = 5
PATH_POINTS = 800
LABEL_DISTANCE = 13.0
"""Points from the tip to the centre of its label."""
ROUND = np.linspace(-np.pi / 2, np.pi / 2, 24)
"""rad: of the end of a capsule's outline."""
SIDEWAYS = 1e-3
"""Of a half-space's normal, the share out of the plane of a view up to which its boundary is a line there."""
UNCHANGED = 1e-3
"""m: by less a clearance does not change, of points that move together."""
BEYOND = 100.0
"""m: how far what lies beyond a half-space's boundary is shaded, which is beyond any picture."""


@dataclass(frozen=True)
class View:
    """An orthographic view: the axes of the world that are drawn, and what it is called."""

    across: int
    up: int
    name: str

    @property
    def seen(self) -> list[int]:
        """Indices of the coordinates."""
        return [self.across, self.up]


PLANE = View(0, 1, "")
FROM_THE_SIDE = View(0, 2, "from the side")
FROM_ABOVE = View(0, 1, "from above")


@dataclass(frozen=True, eq=False)
class Approach:
    """The closest approach of the arm's capsules to half-spaces, obstacles and one another.

    name       what comes close to what
    time       s
    left       m: what is left of the distance beyond the clearance that is asked for
    points     (2, 3): between which points, m
    """

    name: str
    time: float
    left: float
    points: Array

    def __str__(self) -> str:
        beyond = f"{1000 * self.left:.1f} mm beyond what is asked for"
        return f"Closest approach (red): {self.name} at {self.time:.2f} s, {beyond}."


@dataclass(frozen=True, eq=False, kw_only=True)
class ArmInMotion:
    """An arm along a trajectory, with its limits and its workspace; tip_length m."""

    motion: Trajectory
    arm: Arm
    tip_length: float
    limits: Limits
    workspace: Workspace | None = None

    @cached_property
    def time(self) -> Array:
        """(N,) of the path, s."""
        return np.linspace(0.0, self.motion.period, PATH_POINTS)

    @cached_property
    def tip(self) -> Array:
        """(N, 2), or (N, 3), m."""
        return tip_path(self.motion, self.arm, self.tip_length, self.time)

    @cached_property
    def shown(self) -> Array:
        """(P,): instants of the postures, s."""
        return self.time[farthest_points(self.tip, POSTURES)]

    @cached_property
    def clearances(self) -> Clearances | None:
        """What is asked for; None where nothing is."""
        return clearances(self.workspace, self.arm, self.limits.position)

    @cached_property
    def approach(self) -> Approach | None:
        """The closest one at the instants of the path."""
        asked = self.clearances
        if asked is None:
            return None
        q = self.motion.derivative(self.time, 0)
        values = asked.values(q)
        changing = changing_clearances(values)
        if not len(changing):
            return None
        which = changing[values[:, changing].min(axis=0).argmin()]
        instant = int(values[:, which].argmin())
        points = asked.nearest(q[instant], int(which))
        return Approach(asked.names[which], float(self.time[instant]), float(values[instant, which]), points)

    def links(self, time: Array) -> Array:
        """(P, L, 2 or 3), m: base, joints, sensor and tip at the times (P,)."""
        return link_positions(self.arm, self.tip_length, self.motion.derivative(time, 0))

    def outlines(self, capsules: Sequence[Capsule], time: float, view: View) -> list[Array]:
        """The outlines (V, 2), m, of capsules at an instant."""
        if not isinstance(self.arm, SpatialArm) or not capsules:
            return []
        places = ArmPlaces.of(self.arm, self.motion.derivative(np.array([time]), 0))
        joints = np.array([capsule.joint for capsule in capsules], dtype=np.intp)
        ends = [
            places.points(joints, np.array(own))[0] for own in zip(*((c.start, c.end) for c in capsules), strict=True)
        ]
        pairs = zip(*(end[:, view.seen] for end in ends), capsules, strict=True)
        return [outline(start, end, capsule.radius) for start, end, capsule in pairs]


def changing_clearances(values: Array) -> NDArray[np.intp]:
    """Which (C,) of the clearances (N, S) a motion changes: of points that keep their distance none is an approach."""
    return np.flatnonzero(np.ptp(values, axis=0) > UNCHANGED)


def link_positions(arm: Arm, tip_length: float, q: Array) -> Array:
    """Base, joints, sensor and tip (P, L, 2 or 3), m, in postures q (P, n); L = n + 2, or n + 3 of an arm of a URDF."""
    tip = np.array(arm.tip(tip_length).map(len(q))(q.T)).T[:, None]
    if isinstance(arm, SpatialArm):
        places = ArmPlaces.of(arm, q)
        sensor = places.points(np.array([arm.joints]), np.array([arm.sensor.position]))
        return np.concatenate([places.origins, sensor, tip], axis=1)
    ends = [np.zeros((len(q), tip.shape[2]))]
    if isinstance(arm, PlanarArm):  # each end is that of the arm up to there
        for cut in range(1, arm.joints + 1):
            ends.append(np.array(PlanarArm(arm.link_lengths[:cut], arm.base).tip(0.0).map(len(q))(q[:, :cut].T)).T)
    return np.concatenate([np.stack(ends, axis=1), tip], axis=1)


def outline(start: Array, end: Array, radius: float) -> Array:
    """(V, 2): of all points within a radius of a segment between points (2,)."""
    along = np.arctan2(end[1] - start[1], end[0] - start[0])
    halves = [(end, along + ROUND), (start, along + np.pi + ROUND)]
    return np.vstack([at + radius * np.column_stack([np.cos(angle), np.sin(angle)]) for at, angle in halves])


def farthest_points(points: Array, count: int) -> list[int]:
    """Indices of `count` points of (N, d): the first, then each time the one farthest from those chosen."""
    chosen = [0]
    while len(chosen) < count:
        distance = np.linalg.norm(points[:, None] - points[chosen], axis=2).min(axis=1)
        chosen.append(int(distance.argmax()))
    return chosen


def draw_arm(axes: Axes, moved: ArmInMotion, view: View, colours: PathColours | None) -> None:
    """The arm at a few instants, with its capsules, and the path of its tip, m; the closest approach emphasised."""
    workspace, approach = moved.workspace or Workspace(), moved.approach
    carried = [capsule for capsule in workspace.capsules if capsule.joint]
    fixed = moved.outlines([c for c in workspace.capsules if not c.joint], 0.0, view)
    faint = [edge for time in moved.shown for edge in moved.outlines(carried, time, view)]
    close = [] if approach is None else moved.outlines(carried, approach.time, view)
    axes.add_collection(PolyCollection(fixed, facecolor=QUIET_NOISE, edgecolor=INK, lw=0.8, zorder=1))
    axes.add_collection(PolyCollection(faint, facecolor=FAINT, edgecolor="none", alpha=0.25, zorder=1))
    axes.add_collection(PolyCollection(close, facecolor="none", edgecolor=INK, lw=0.7, zorder=3))
    drawn = moved.links(moved.shown)[..., view.seen]
    for time, links in zip(moved.shown, drawn, strict=True):
        _links(axes, links, MEASURED, 0.55)
        if view is not FROM_ABOVE:
            _label(axes, links, f"{format_number(float(time), 2)} s")
    seen = [moved.tip[:, view.seen], drawn.reshape(-1, 2), *faint, *close, *fixed, np.zeros((1, 2))]
    if approach is not None:
        _links(axes, moved.links(np.array([approach.time]))[0][:, view.seen], INK, 1.0)
        axes.plot(*approach.points[:, view.seen].T, color=MISFIT_COLOUR, lw=2.0, zorder=7, solid_capstyle="round")
        seen.append(approach.points[:, view.seen])
    axes.plot(0, 0, "s", color=INK, ms=6, zorder=4)
    _path(axes, moved.tip[:, view.seen], colours)
    low, high = (getattr(np.vstack(seen), side)(axis=0) for side in ("min", "max"))
    margin = 0.08 * float((high - low).max())
    axes.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))
    axes.set_aspect("equal", adjustable="box", anchor="NW")
    for half_space in workspace.half_spaces:
        _draw_half_space(axes, half_space, view)
    axes.set_xlabel(f"{'xyz'[view.across]} (m)")
    axes.set_ylabel(f"{'xyz'[view.up]} (m)")
    panel_title(axes, ", ".join(["arm and path of its tip", *([view.name] if view.name else [])]))


def _links(axes: Axes, links: Array, colour: str, alpha: float) -> None:
    axes.plot(*links.T, color=colour, lw=1.5, alpha=alpha, solid_joinstyle="round", zorder=2)
    axes.plot(*links[1:-1].T, "o", color=colour, ms=3, zorder=2)
    axes.plot(*links[-1], "o", color=INK, ms=3, zorder=5)


def _label(axes: Axes, links: Array, text: str) -> None:
    along = links[-1] - links[0]
    beyond = LABEL_DISTANCE * along / max(float(np.hypot(*along)), 1e-9)
    style: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": SMALL, "color": INK, "zorder": 6}
    style["path_effects"] = [withStroke(linewidth=2.0, foreground="white")]
    axes.annotate(text, links[-1], tuple(beyond), textcoords="offset points", **style)


def _path(axes: Axes, tip: Array, colours: PathColours | None) -> None:
    if colours is None:
        axes.plot(*tip.T, color=INK, lw=2.0, zorder=3)
        return
    values, cmap, norm = colours
    pieces = np.stack([tip[:-1], tip[1:]], axis=1)
    nearest = (np.arange(len(pieces)) * len(values)) // len(pieces)
    lines = LineCollection(list(pieces), array=values[nearest], cmap=cmap, norm=norm, lw=3.0, zorder=3)
    lines.set_capstyle("round")
    axes.add_collection(lines)


def _draw_half_space(axes: Axes, half_space: HalfSpace, view: View) -> None:
    """Its boundary, shaded beyond, where that is a line in the view."""
    normal = np.array(half_space.normal)
    seen = normal[view.seen]
    if np.linalg.norm(seen) ** 2 < 1 - SIDEWAYS:
        return
    along = BEYOND * np.array([-seen[1], seen[0]])
    ends = np.stack([-half_space.offset * seen - along, -half_space.offset * seen + along])
    beyond = np.vstack([ends, ends[::-1] - BEYOND * seen])
    axes.add_collection(PolyCollection([beyond], facecolor=NOISE, edgecolor="none", zorder=0), autolim=False)
    axes.plot(*ends.T, color=INK, lw=0.9, zorder=1, scalex=False, scaley=False)
