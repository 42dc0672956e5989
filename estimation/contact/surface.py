"""Known surfaces of a tool in the sensor frame: sphere, plane, capsule."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modeling.errors import InputError

Array = NDArray[np.float64]


class Surface(ABC):
    """Surface of a tool: intersections with lines and outward normals. Lengths in m, sensor frame."""

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
