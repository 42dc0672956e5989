"""Weak duality checked along one trajectory, and its quadrature error."""

from __future__ import annotations

from dataclasses import dataclass
from math import log

import numpy as np
from numpy.typing import NDArray

from design.bound.dual_function import DualFunction, DualVariables
from design.trajectories.trajectory import Trajectory
from modeling.table import Table, Tabular

Array = NDArray[np.float64]

GAUSS_POINTS = 8
"""Points of the Gauss-Legendre rule in each piece: exact to degree 15."""
PIECES_PER_STRETCH = 16
"""Pieces between two breaks of a series: F has some ten times the frequencies of the trajectory."""
FEWEST_PIECES = 400
"""Pieces of a whole period at least, for series that have no breaks: 20 per wave of a 20th harmonic."""


@dataclass(frozen=True, eq=False, kw_only=True)
class WeakDuality(Tabular):
    """Weak duality along one trajectory; all ln det are of N samples.

    excess      largest violation of viability by its states, in shares of the limits; negative inside
    dual        mean of F over a period: at most k when the trajectory is within the limits
    conditions  largest |mean of L h| over the rms of L h: zero but for quadrature and rounding
    logdet      of N times the mean over time, to which the bound applies
    sampled     of the N equally spaced samples
    weak        -ln det D + k ln(mean F / k) + k ln N: between logdet and the bound
    """

    excess: float
    dual: float
    conditions: float
    logdet: float
    sampled: float
    weak: float

    @property
    def quadrature(self) -> float:
        """sampled - logdet: the quadrature error of the samples in ln det of the mean over time."""
        return self.sampled - self.logdet

    @property
    def table(self) -> Table:
        """Each quantity that weak duality relates."""
        rows = [
            ("violation of viability", f"{self.excess:.1e} of the limits"),
            ("mean of F over the period", f"{self.dual:.4f}"),
            ("largest mean of a periodicity condition", f"{self.conditions:.1e} of its rms"),
            ("ln det, mean over time", f"{self.logdet:.4f}"),
            ("ln det, samples", f"{self.sampled:.4f}: quadrature error {self.quadrature:+.1e}"),
            ("weak duality: bound from its mean of F", f"{self.weak:.4f}"),
        ]
        return Table.of(("", ""), rows)

    @classmethod
    def of(cls, function: DualFunction, dual: DualVariables, motion: Trajectory, samples: int) -> WeakDuality:
        """By quadrature between the breaks of the series."""
        time, weights = _quadrature(motion)
        q, dq, ddq = motion.evaluate(time)
        gram, rates = function.moments(np.hstack([q, dq, ddq]))
        mean, rate = np.tensordot(weights, gram, axes=1), weights @ rates
        value, k = float(np.sum(dual.D * mean) + rate @ dual.c), function.size
        rms = np.sqrt(weights @ rates**2)
        share = np.abs(rate) / np.where(rms > 0, rms, 1.0)
        sampled = function.experiment.information(motion, samples)
        return cls(
            excess=float(function.viable.excess(q, dq, ddq).max()),
            dual=value,
            conditions=float(share.max(initial=0.0)),
            logdet=float(np.linalg.slogdet(mean)[1]) + k * log(samples),
            sampled=float(np.linalg.slogdet(sampled)[1]),
            weak=dual.value + k * log(max(value, np.finfo(float).tiny) / k) + k * log(samples),
        )


def _quadrature(motion: Trajectory) -> tuple[Array, Array]:
    """Gauss-Legendre nodes in (0, T) and weights that sum to one."""
    breaks = motion.series.breaks
    pieces = max(PIECES_PER_STRETCH, -(-FEWEST_PIECES // (len(breaks) - 1)))
    fine = np.interp(np.arange(pieces * (len(breaks) - 1) + 1) / pieces, np.arange(len(breaks)), breaks)
    nodes, weights = np.polynomial.legendre.leggauss(GAUSS_POINTS)
    middle, half = (fine[1:] + fine[:-1]) / 2, np.diff(fine) / 2
    time = (middle[:, None] + half[:, None] * nodes).ravel()
    return time, (half[:, None] * weights).ravel() / (breaks[-1] - breaks[0])
