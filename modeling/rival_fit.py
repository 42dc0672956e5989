"""Model discrimination: the best fit of a rival model to a true model's prediction, and its noncentrality lambda."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RivalFit:
    """A rival model fitted to the noise-free prediction of a true model.

    theta          (k,) the rival's values
    noncentrality  lambda = |y_truth - y_rival(theta)|², the squared distance of the whitened predictions
    converged      whether that is a minimum; else lambda is at most what is given
    """

    theta: Array
    noncentrality: float
    converged: bool = True

    @property
    def error_probability(self) -> float:
        """Error probability of choosing between the two models by their chi-square."""
        return error_probability(self.noncentrality)


class RivalProblem(Protocol):
    """A rival model, and the whitened prediction of a true one on some data, recorded or designed."""

    def fitted(self, start: Array) -> RivalFit:
        """The fit within the rival's physical bounds, from an initial value (k,)."""


def fit_rival(problem: RivalProblem, starts: Iterable[Array]) -> RivalFit:
    """The fit of least noncentrality lambda from several initial values (k,): how well the rival imitates the truth.

    lambda = min over theta of |y_truth - y_rival(theta)|² is the noncentrality of the chi-square test that rejects the
    rival when the truth holds (T-optimality maximises it: Atkinson and Fedorov, Biometrika 62, 1975).
    """
    return min((problem.fitted(start) for start in starts), key=lambda fit: fit.noncentrality)


def error_probability(noncentrality: float) -> float:
    """Error probability Phi(-sqrt(lambda) / 2) of choosing the model with the lower chi-square.

    The difference of the two chi-squares is normal with mean lambda and variance 4 lambda under either model.
    """
    from scipy.special import ndtr

    return float(ndtr(-np.sqrt(noncentrality) / 2))
