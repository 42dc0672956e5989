"""Contact point on a known tool surface from the contact wrench, with its covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.contact.point_force import std_along
from estimation.contact.surface import Surface
from modeling.errors import InputError
from modeling.table import Column, Table, Tabular

Array = NDArray[np.float64]
SampleMask = NDArray[np.bool_]

MIN_FORCE_TO_STD = 2.0
"""Least ratio of a force to its std for its line of action to be defined: as for `PointForce.direction`."""


@dataclass(frozen=True, eq=False)
class ContactPoint(Tabular):
    """Contact point of a pure force (no free torque) on the surface, sample by sample. Sensor frame, SI.

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
            rows += [(f"{axis}, median", f"{value:.4g} ± {std:.2g} m") for axis, value, std in medians]
        return Table.of(("contact point", Column("samples", format="d")), rows)


def contact_point(wrench: Array, covariance: Array, surface: Surface) -> ContactPoint:
    """Where on a surface of the tool contact wrenches act.

    Parameters
    ----------
    wrench : array (n, 6)
        Contact wrenches fcx .. tcz, N and N m, of the environment on the tool, about the sensor origin, in the sensor
        frame.
    covariance : array (6, 6) or (n, 6, 6)
        Covariance of the wrenches, N², N² m and N² m².
    surface : Surface
        Surface of the tool in the sensor frame: `Sphere`, `Plane` or `Capsule`.

    Returns
    -------
    ContactPoint
        Point (n, 3), m, in the sensor frame, with covariance (n, 3, 3), and torsion (n,), N m, with its std. The point
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
    >>> found = tw.contact_point([[0, -5, 0, 0.5, 0, 0]], covariance, finger)  # from +y, 0.1 m along the finger
    >>> [round(float(x), 3) + 0 for x in found.point[0]]
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
    found = np.isfinite(point).all(axis=1)
    result = np.full((len(point), 3, 3), np.nan)
    r, f, t = point[found], wrench[found, :3], wrench[found, 3:]
    pitch = np.sum(f * t, axis=1) / np.sum(f * f, axis=1)
    left, right = np.zeros((len(r), 4, 4)), np.zeros((len(r), 4, 6))
    left[:, :3, :3], left[:, :3, 3], left[:, 3, :3] = -_cross(f), f, surface.outward(r)
    right[:, :3, :3] = -_cross(r) - pitch[:, None, None] * np.eye(3)
    right[:, :3, 3:] = np.eye(3)
    slope = np.linalg.solve(left, right)[:, :3]
    result[found] = slope @ covariance[found] @ slope.transpose(0, 2, 1)
    return result


def _cross(vectors: Array) -> Array:
    """Matrices (n, 3, 3) of v x."""
    return np.asarray(np.cross(vectors[:, None, :], np.eye(3)).transpose(0, 2, 1))
