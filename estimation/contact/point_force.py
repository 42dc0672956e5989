"""Planar contact wrench as one force at a known point of the tip, by 22.14 to 22.16 corrected.

Equation numbers: chapter 22, "Characterization of the Dynamical Model of a Force Sensor for Robot Manipulators"
(Bassi et al.).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PointForce:
    """A force (n, 2) in N along x' and y', with covariance (n, 2, 2), that acts at one point of the tip.

    misfit    (n,) chi-square, one degree of freedom, of the torque's residual; nan without a tip length
    """

    force: Array
    covariance: Array
    misfit: Array

    @classmethod
    def of(cls, wrench: Array, covariance: Array, weight: Array, distance: float | None) -> PointForce:
        """The force that fits contact wrenches (n, 3) = (fcx, fcy, tauc) best.

        22.14 in the tip frame, with the signs of a contact on the tool: a force K (sin b, cos b) at `distance` d (m)
        from the sensor along the tip is (fcx, fcy, tauc) = (K sin b, K cos b, K d sin b). That is linear in
        s = (K sin b, K cos b), wrench = H s with H = [[1, 0], [0, 1], [d, 0]], so that least squares weighted with the
        inverse W of the channels' noise covariance `weight` (3, 3) has the closed form s = (H' W H)^-1 H' W wrench.
        With W = 1 it is s = ((fcx + tauc d) / (1 + d²), fcy): PHYSICS.md, errata 3, 4 and 7. `covariance` (n, 3, 3) is
        that of the wrenches, whatever it comes from. Without a distance the torque is not used: s = (fcx, fcy).
        """
        if distance is None:
            return cls(wrench[:, :2], covariance[:, :2, :2], np.full(len(wrench), np.nan))
        arm = np.array([[1.0, 0.0], [0.0, 1.0], [distance, 0.0]])
        inverse = np.linalg.inv(weight)
        gain = np.linalg.solve(arm.T @ inverse @ arm, arm.T @ inverse)
        residual = wrench - wrench @ gain.T @ arm.T
        return cls(wrench @ gain.T, gain @ covariance @ gain.T, np.einsum("ni,ij,nj->n", residual, inverse, residual))

    @cached_property
    def magnitude(self) -> Array:
        """Size of the force, N (n,)."""
        return np.asarray(np.hypot(self.force[:, 0], self.force[:, 1]))

    @cached_property
    def direction(self) -> Array:
        """Angle of the force from y', clockwise, rad (n,), in (-pi, pi]."""
        return np.arctan2(self.force[:, 0], self.force[:, 1])

    @cached_property
    def magnitude_std(self) -> Array:
        """Standard deviation along the force, N (n,)."""
        return std_along(self.covariance, self._unit)

    @cached_property
    def direction_std(self) -> Array:
        """Standard deviation across the force over its size, rad (n,); valid for forces large against it."""
        across = np.stack([self._unit[:, 1], -self._unit[:, 0]], axis=1)
        return np.asarray(std_along(self.covariance, across) / np.maximum(self.magnitude, 1e-300))

    @property
    def clear(self) -> NDArray[np.bool_]:
        """Whether the size is at least twice its standard deviation: only then is its direction defined."""
        return np.asarray(self.magnitude >= 2 * self.magnitude_std)

    @cached_property
    def _unit(self) -> Array:
        size = np.maximum(self.magnitude, 1e-300)[:, None]
        return np.where(self.magnitude[:, None] > 0, self.force / size, np.array([0.0, 1.0]))


def std_along(covariance: Array, direction: Array) -> Array:
    """Standard deviations (n,) along directions (n, d) of vectors with covariances (n, d, d)."""
    return np.asarray(np.sqrt(np.einsum("ni,nij,nj->n", direction, covariance, direction)))
