"""Mean contact wrench over an interval, with covariance, and the test whether a force at the tip explains it.

Equation numbers: chapter 22, "Characterization of the Dynamical Model of a Force Sensor for Robot Manipulators"
(Bassi et al.).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.autoregression import fit_autoregression
from estimation.contact.contact_detection import ContactDetection, ContactInterval
from estimation.contact.point_force import PointForce
from estimation.contact.variance_of_means import MeanDifferences, VarianceOfMeans
from estimation.distributions import chi2_sf
from modeling.noise.channel_whitening import block_means

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ContactMean:
    """Mean contact wrench over a detected interval, its forces, and its force at the tip.

    wrench         (p,) mean of the components, N and N m; `covariance` (p, p): noise of that mean, parameters, zero and
                   the model's systematic residual
    force          N, size of the mean force; `largest_force` that of one sample, with its noise
    tip_force      N, size of the point force at the tip that fits `wrench` best; nan without a tip length
    tip_p_value    of the chi-square test that a force at the tip explains `wrench`; nan without a tip length
    """

    interval: ContactInterval
    wrench: Array
    covariance: Array
    force: float
    largest_force: float
    tip_force: float
    tip_p_value: float

    @property
    def std(self) -> Array:
        """Std (p,) of the mean of each component."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))


@dataclass(frozen=True, eq=False)
class ContactSeries:
    """Contact wrenches of a recording, and what the means of its intervals need.

    wrench      (n, p); `systematic` (n, p, p) covariance from parameters and zero; `noise` (p, p) of one sample
    inverse     (p, p) from reading to contact wrench; `remainder` (p,) systematic residual of the readings
    forces      number of components that are forces, which come first
    tip_length  m, of a planar contact; None for none
    """

    wrench: Array
    systematic: Array
    noise: Array
    inverse: Array
    remainder: Array
    detection: ContactDetection
    forces: int
    tip_length: float | None

    def mean(self, interval: ContactInterval) -> ContactMean:
        """The mean over one interval."""
        inside = slice(interval.first, interval.last)
        wrench, systematic = self.wrench[inside].mean(axis=0), self.systematic[inside].mean(axis=0)
        blocks = self.detection.blocks(interval.last - interval.first)
        covariance = systematic + self.inverse @ self.detection.noise.covariance(blocks) @ self.inverse.T
        size = np.linalg.norm(self.wrench[inside, : self.forces], axis=1)
        tip_force, p_value = self._tip_force(wrench, covariance, systematic, blocks)
        return ContactMean(
            interval=interval,
            wrench=wrench,
            covariance=covariance,
            force=float(np.linalg.norm(wrench[: self.forces])),
            largest_force=float(size.max()),
            tip_force=tip_force,
            tip_p_value=p_value,
        )

    def _tip_force(self, wrench: Array, covariance: Array, systematic: Array, blocks: int) -> tuple[float, float]:
        """Size of the force at the tip that fits a mean wrench, and the p-value of what the fit leaves.

        A force at d along the tip is (fcx, fcy, tauc) = H s with H = [[1, 0], [0, 1], [d, 0]] (22.14 corrected). v =
        (-d, 0, 1) is orthogonal to H, so that the chi-square of the residual of the weighted fit, with one degree of
        freedom, is (v' wrench)² over the variance of v' wrench. That variance is estimated from the series v' wrench of
        the samples without contact: correlation between the channels, colour of the noise and few samples included.
        """
        if self.tip_length is None:
            return np.nan, np.nan
        fitted = PointForce.of(wrench[None], covariance[None], self.noise, self.tip_length)
        contrast = np.array([-self.tip_length, 0.0, 1.0])
        variance = float(contrast @ systematic @ contrast) + self._noise_of_mean(contrast, blocks)
        return float(fitted.magnitude[0]), float(chi2_sf(float(contrast @ wrench) ** 2 / variance, 1.0))

    def _noise_of_mean(self, contrast: Array, blocks: int) -> float:
        """Variance of the mean of `contrast @ wrench` over so many blocks, by noise and systematic residual."""
        detection = self.detection
        means = block_means(self.wrench @ contrast[:, None], detection.block)
        quiet = block_means(detection.free[:, None].astype(float), detection.block)[:, 0] > 1 - 1e-9
        if quiet.sum() < 2:
            return float(contrast @ self.noise @ contrast)
        constant = np.atleast_1d((contrast @ self.inverse) ** 2 @ self.remainder**2)
        fitted = fit_autoregression(means - means[quiet].mean(axis=0), quiet)
        noise = VarianceOfMeans.of_autoregression(fitted, len(means), constant).at_least(
            MeanDifferences.of(means, quiet).variance_of_means(constant)
        )
        return float(noise.covariance(min(blocks, len(means)))[0, 0])
