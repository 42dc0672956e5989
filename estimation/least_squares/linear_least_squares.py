"""Linear least squares by scaled SVD, without the directions that are not identifiable."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimation.least_squares.square_root_information import SquareRootInformation
from modeling.identifiability import ScaledSVD

Array = NDArray[np.float64]


def least_squares_solution(information: SquareRootInformation, *, rounding: float, faint: float = 0.0) -> Array:
    """The minimiser (k,) of |R x - z| where R is more than rounding, with no component in its null space."""
    return np.asarray(ScaledSVD.of(information.root, rounding, faint).inverse @ information.target)
