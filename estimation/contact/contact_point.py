"""Contact point on a known tool surface from the contact wrench, with its covariance."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimation.contact.contact_wrench import std_along
from modeling.errors import InputError
from modeling.table import Column, Table, Tabular

Array = NDArray[np.float64]


class Surface(ABC):
    """Surface of a tool: intersections with lines and outward normals. Lengths in m, in the axes of the wrench.

    These are sensor axes, unless `compensate` was asked for others that are fixed to the tool.
    """

    @abstractmethod
    def crossings(self, origin: Array, direction: Array) -> Array:
        """Parameters s (n, k), m, at which lines origin + s direction (n, 3; unit) cross it; nan without."""

    @abstractmethod
    def outward(self, points: Array) -> Array:
        """Unit normals (..., 3) at points (..., 3) of the surface."""

    @abstractmethod
    def clearance(self, origin: Array, direction: Array) -> Array:
        """Distance of the lines from the surface (n,), m; at most zero where they meet it."""


@dataclass(frozen=True, eq=False)
class Sphere(Surface):
    """A sphere, such as a probe's tip.

    Parameters
    ----------
    centre : array (3,)
        Centre in the sensor frame, m.
    radius : float
        Radius, m.

    Raises
    ------
    InputError
        When the centre does not have three finite components, or the radius is not positive.

    Examples
    --------
    >>> import truewrench as tw
    >>> tip = tw.Sphere(centre=(0, 0, 0.2), radius=0.01)
    >>> tip.outward(tip.centre + [[0, 0.01, 0]]).round(6).tolist()
    [[0.0, 1.0, 0.0]]
    """

    centre: Array
    radius: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre", _vector(self.centre, "centre"))
        _require_positive(self.radius, "radius")

    def crossings(self, origin: Array, direction: Array) -> Array:
        """Entry and exit of each line."""
        return _roots(origin - self.centre, direction, self.radius)

    def outward(self, points: Array) -> Array:
        """Away from the centre."""
        return _unit(points - self.centre)

    def clearance(self, origin: Array, direction: Array) -> Array:
        """Distance of the line from the centre less the radius."""
        return np.asarray(np.linalg.norm(_orthogonal(origin - self.centre, direction), axis=1) - self.radius)


@dataclass(frozen=True, eq=False)
class Plane(Surface):
    """A flat face of the tool, unbounded.

    Parameters
    ----------
    point : array (3,)
        A point of the plane in the sensor frame, m.
    normal : array (3,)
        Normal out of the tool in the sensor frame, of any length: it is scaled to 1.

    Raises
    ------
    InputError
        When a vector does not have three finite components, or the normal is zero.

    Examples
    --------
    >>> import truewrench as tw
    >>> face = tw.Plane(point=(0, 0, 0.1), normal=(0, 0, 2))
    >>> face.normal.tolist()
    [0.0, 0.0, 1.0]
    """

    point: Array
    normal: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "point", _vector(self.point, "point"))
        normal = _vector(self.normal, "normal")
        _require_positive(float(np.linalg.norm(normal)), "length of the normal")
        object.__setattr__(self, "normal", _unit(normal))

    def crossings(self, origin: Array, direction: Array) -> Array:
        """One crossing, unless the line is parallel to the plane."""
        along, height = direction @ self.normal, (origin - self.point) @ self.normal
        return np.asarray(np.divide(-height, along, out=np.full(len(origin), np.nan), where=along != 0)[:, None])

    def outward(self, points: Array) -> Array:
        """The normal, everywhere."""
        return np.broadcast_to(self.normal, points.shape)

    def clearance(self, origin: Array, direction: Array) -> Array:
        """The distance of a line that is parallel, else zero."""
        return np.where(direction @ self.normal == 0, np.abs((origin - self.point) @ self.normal), 0.0)


@dataclass(frozen=True, eq=False)
class Capsule(Surface):
    """A cylinder about a segment, closed by half spheres: a finger, a round tip.

    Parameters
    ----------
    start, end : array (3,)
        Ends of the segment in the sensor frame, m.
    radius : float
        Radius of cylinder and half spheres, m.

    Raises
    ------
    InputError
        When a vector does not have three finite components, or radius or length is not positive.

    Examples
    --------
    >>> import truewrench as tw
    >>> finger = tw.Capsule(start=(0, 0, 0.02), end=(0, 0, 0.12), radius=0.008)
    >>> round(finger.length, 3), finger.axis.tolist()
    (0.1, [0.0, 0.0, 1.0])
    """

    start: Array
    end: Array
    radius: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "start", _vector(self.start, "start"))
        object.__setattr__(self, "end", _vector(self.end, "end"))
        _require_positive(self.radius, "radius")
        _require_positive(self.length, "length")

    @property
    def length(self) -> float:
        """Length of the segment, m."""
        return float(np.linalg.norm(self.end - self.start))

    @property
    def axis(self) -> Array:
        """Unit vector from start to end."""
        return _unit(self.end - self.start)

    def crossings(self, origin: Array, direction: Array) -> Array:
        """Two crossings at the most: on the cylinder between the ends, on the spheres beyond them."""
        side = _roots(_orthogonal(origin - self.start, self.axis), _orthogonal(direction, self.axis), self.radius)
        ends = [_roots(origin - centre, direction, self.radius) for centre in (self.start, self.end)]
        places = np.concatenate([side, *ends], axis=1)
        heights = ((origin - self.start) @ self.axis)[:, None] + (direction @ self.axis)[:, None] * places
        first, middle, last = heights < 0, (heights >= 0) & (heights <= self.length), heights > self.length
        return np.where(np.concatenate([middle[:, :2], first[:, 2:4], last[:, 4:]], axis=1), places, np.nan)

    def outward(self, points: Array) -> Array:
        """Away from the nearest point of the segment."""
        height = np.clip((points - self.start) @ self.axis, 0.0, self.length)
        return _unit(points - self.start - height[..., None] * self.axis)

    def clearance(self, origin: Array, direction: Array) -> Array:
        """Distance between line and segment less the radius.

        Its square is convex along the segment: the minimum over the whole axis, clipped to the segment.
        """
        away, slope = _orthogonal(origin - self.start, direction), _orthogonal(self.axis[None], direction)
        place = np.sum(away * slope, axis=1) / np.maximum(np.sum(slope**2, axis=1), np.finfo(float).tiny)
        gap = away - np.clip(place, 0.0, self.length)[:, None] * slope
        return np.asarray(np.linalg.norm(gap, axis=1) - self.radius)


def _roots(origin: Array, direction: Array, radius: float) -> Array:
    """Parameters s (n, 2) with |origin + s direction| = radius; nan or infinite without one."""
    square, half = np.sum(direction**2, axis=1), np.sum(origin * direction, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        root = np.sqrt(half**2 - square * (np.sum(origin**2, axis=1) - radius**2))
        return np.stack([(-half - root) / square, (-half + root) / square], axis=1)


def _orthogonal(vectors: Array, axis: Array) -> Array:
    """The component of vectors (n, 3) orthogonal to unit axes (3,) or (n, 3)."""
    return np.asarray(vectors - np.sum(vectors * axis, axis=1, keepdims=True) * axis)


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def _vector(values: ArrayLike, what: str) -> Array:
    vector = np.array(values, dtype=float)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise InputError(what=f"{what} {vector.tolist()}", where="surface", remedy="give three numbers in sensor axes")
    return vector


def _require_positive(value: float, what: str) -> None:
    if not (np.isfinite(value) and value > 0):
        raise InputError(what=f"{what} {value:g}", where="surface", remedy="give a positive number")


SampleMask = NDArray[np.bool_]

MIN_FORCE_TO_STD = 2.0
"""Least ratio of a force to its std for its line of action to be defined: as for `PointForce.direction`."""


@dataclass(frozen=True, eq=False)
class ContactPoint(Tabular):
    """Contact point of a pure force (no free torque) on the surface, sample by sample. SI, axes of wrench and surface.

    point       (n, 3) m; nan where the force is not `clear`, its line misses the surface, or it points outwards
    covariance  (n, 3, 3) m², to first order; it has no component along the surface's normal
    torsion     (n,) N m about the line of action, zero for a point contact without torsion
    torsion_std (n,) its standard deviation
    clearance   (n,) m, distance of the line of action from the surface, at most zero where it meets it
    clear       (n,) whether the force is at least twice its standard deviation; all other fields are nan where not
    """

    point: Array
    covariance: Array
    torsion: Array
    torsion_std: Array
    clearance: Array
    clear: SampleMask

    @property
    def found(self) -> SampleMask:
        """Which samples (n,) have a point."""
        return np.asarray(np.isfinite(self.point).all(axis=1))

    @property
    def missed(self) -> SampleMask:
        """Samples (n,) of a clear force whose line of action misses the surface: no single contact there."""
        return np.asarray(self.clear & (self.clearance > 0))

    @property
    def pulled(self) -> SampleMask:
        """Samples (n,) of a clear force whose line meets the surface, but which points out of the tool."""
        return np.asarray(self.clear & ~self.missed & ~self.found)

    @property
    def misfit(self) -> Array:
        """Chi-square (n,) of the torsion, one degree of freedom."""
        return np.asarray((self.torsion / self.torsion_std) ** 2)

    @property
    def std(self) -> Array:
        """Standard deviations (n, 3), m."""
        return np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))

    @property
    def table(self) -> Table:
        """Number of samples of each kind; for those with a point its median and median std."""
        kinds = {
            "point found": self.found,
            "line of action misses": self.missed,
            "force points outwards": self.pulled,
            "force too small": ~self.clear,
        }
        rows: list[tuple[str, int | str]] = [(name, int(which.sum())) for name, which in kinds.items()]
        if self.found.any():
            median, median_std = (np.median(values[self.found], axis=0) for values in (self.point, self.std))
            medians = zip("xyz", median, median_std, strict=True)
            name = "median, in the axes of the wrench"
            rows += [(f"{axis}, {name}", f"{value:.4g} ± {std:.2g} m") for axis, value, std in medians]
        return Table.of(("contact point", Column("samples", format="d")), rows)


def contact_point(wrench: Array, covariance: Array, surface: Surface) -> ContactPoint:
    """Where on a surface of the tool contact wrenches act.

    Parameters
    ----------
    wrench : array (n, 6)
        Contact wrenches fcx .. tcz, N and N m, of the environment on the tool, about the sensor origin, in the axes of
        the surface: sensor axes, as `compensate` gives them, or those of the logged pose.
    covariance : array (6, 6) or (n, 6, 6)
        Covariance of the wrenches, N², N² m and N² m².
    surface : Surface
        Surface of the tool in the same axes, from the sensor origin: `Sphere`, `Plane` or `Capsule`.

    Returns
    -------
    ContactPoint
        Point (n, 3), m, in these axes, with covariance (n, 3, 3), and torsion (n,), N m, with its std. The point
        is nan where the force is not twice its std, its line misses the surface, or it points out of the tool.

    Raises
    ------
    InputError
        When the wrenches do not have six components.

    Notes
    -----
    A force f at r has the torque t = r x f, so that it acts on the line r = f x t / |f|² + s f / |f| (the wrench's
    axis), and with t . f = 0. Of the points where the line crosses the surface it is the one where the force pushes
    into the tool, f . n < 0 with n outward: the first that the force meets. The wrenches' covariance propagates to the
    point by the implicit function theorem (`_covariance`), and to the torsion t . u, u = f / |f|, by d(t . u) = u . dt
    + (t - (t . u) u) . df / |f|.

    Examples
    --------
    >>> import truewrench as tw
    >>> covariance = [[1e-4 * (i == j) for j in range(6)] for i in range(6)]
    >>> finger = tw.Capsule(start=(0, 0, 0), end=(0, 0, 0.2), radius=0.01)
    >>> contact = tw.contact_point([[0, -5, 0, 0.5, 0, 0]], covariance, finger)  # from +y, 0.1 m along the finger
    >>> [round(float(x), 3) + 0 for x in contact.point[0]]
    [0.0, 0.01, 0.1]
    """
    wrench = np.asarray(wrench, dtype=float)
    if wrench.ndim != 2 or wrench.shape[1] != 6:
        remedy = "give contact wrenches of six axes"
        raise InputError(what=f"contact wrenches of shape {wrench.shape}", where="contact point", remedy=remedy)
    covariance = np.broadcast_to(covariance, (len(wrench), 6, 6))
    force, torque = wrench[:, :3], wrench[:, 3:]
    size = np.linalg.norm(force, axis=1)
    unit = force / np.maximum(size, np.finfo(float).tiny)[:, None]
    clear = size >= np.maximum(MIN_FORCE_TO_STD * std_along(covariance[:, :3, :3], unit), np.finfo(float).tiny)

    torsion = np.sum(torque * unit, axis=1)
    scale = np.where(clear, size, 1.0)[:, None]
    slope = np.concatenate([(torque - torsion[:, None] * unit) / scale, unit], axis=1)
    foot = np.cross(force, torque) / scale**2
    point = np.where(clear[:, None], _first_inward_crossing(foot, unit, surface), np.nan)
    return ContactPoint(
        point=point,
        covariance=_covariance(point, wrench, covariance, surface),
        torsion=np.where(clear, torsion, np.nan),
        torsion_std=np.where(clear, std_along(covariance, slope), np.nan),
        clearance=np.where(clear, surface.clearance(foot, unit), np.nan),
        clear=clear,
    )


def _first_inward_crossing(foot: Array, unit: Array, surface: Surface) -> Array:
    """The first crossing (n, 3) at which the force pushes into the tool; nan without one."""
    places = surface.crossings(foot, unit)
    points = foot[:, None, :] + places[..., None] * unit[:, None, :]
    into = np.sum(surface.outward(points) * unit[:, None, :], axis=2) < 0
    place = np.min(np.where(into, places, np.inf), axis=1)
    place[~np.isfinite(place)] = np.nan
    return np.asarray(foot + place[:, None] * unit)


def _covariance(point: Array, wrench: Array, covariance: Array, surface: Surface) -> Array:
    """Covariance (n, 3, 3) of points (n, 3) of the surface.

    Point r and pitch h solve r x f + h f - t = 0 (the wrench's axis) and g(r) = 0 (the surface, with gradient n):
    four equations. Along their solution, with [v] the matrix of v x,
        [[-[f], f], [n', 0]] (dr, dh) = -[[[r] + h 1, -1], [0, 0]] (df, dt),
    whose left side is regular unless the force is tangential, f . n = 0.
    """
    has_point = np.isfinite(point).all(axis=1)
    result = np.full((len(point), 3, 3), np.nan)
    r, f, t = point[has_point], wrench[has_point, :3], wrench[has_point, 3:]
    pitch = np.sum(f * t, axis=1) / np.sum(f * f, axis=1)
    left, right = np.zeros((len(r), 4, 4)), np.zeros((len(r), 4, 6))
    left[:, :3, :3], left[:, :3, 3], left[:, 3, :3] = -_cross(f), f, surface.outward(r)
    right[:, :3, :3] = -_cross(r) - pitch[:, None, None] * np.eye(3)
    right[:, :3, 3:] = np.eye(3)
    slope = np.linalg.solve(left, right)[:, :3]
    result[has_point] = slope @ covariance[has_point] @ slope.transpose(0, 2, 1)
    return result


def _cross(vectors: Array) -> Array:
    """Matrices (n, 3, 3) of v x."""
    return np.asarray(np.cross(vectors[:, None, :], np.eye(3)).transpose(0, 2, 1))
