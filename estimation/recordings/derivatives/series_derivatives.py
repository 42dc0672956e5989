"""A sampled series with its first two derivatives in time."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimation.recordings.derivatives.smoothing_spline import SmoothingSpline

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Derivatives:
    """A series and its first two derivatives in time, each (N, k), per s and per s².

    `score` (k,) is the Bayesian information criterion n ln RSS + p ln n of the fit, by which two fits to the same
    series are compared. `spline` is the smoothing spline that they come from, None for a Fourier series and static
    poses.
    """

    value: Array
    first: Array
    second: Array
    score: Array
    spline: SmoothingSpline | None = None

    def rows(self, chosen: slice) -> Derivatives:
        """Some rows of the series, without its spline."""
        value, first, second = (part[chosen] for part in (self.value, self.first, self.second))
        return replace(self, value=value, first=first, second=second, spline=None)

    def one_after_another(self, count: int) -> Derivatives:
        """Of `count` series side by side, each (N, k): as series (count N, k), without their splines."""
        parts = (np.concatenate(np.hsplit(part, count)) for part in (self.value, self.first, self.second))
        value, first, second = parts
        return Derivatives(value=value, first=first, second=second, score=self.score[: value.shape[1]])
