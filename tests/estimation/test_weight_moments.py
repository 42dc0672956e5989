"""The best direction of gravity is a minimum: no direction near it fits better."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from estimation.gravity.gravity_estimate import WeightMoments

Array = NDArray[np.float64]
NEAREST, FURTHEST = 1e-4, 0.05
"""rad, of directions that are compared."""


def moments(rng: np.random.Generator, axes: int, turn: float, noise: float) -> WeightMoments:
    """Of a tool with any mounting in any gravity, whose orientations differ by about `turn` rad."""
    count = int(rng.integers(30, 300))
    angles = turn * rng.normal(size=(count, 3 if axes == 3 else 1))
    turns = Rotation.from_rotvec(angles if axes == 3 else angles * np.array([0.0, 0.0, 1.0])).as_matrix()
    to_sensor = turns[:, :axes, :axes].swapaxes(1, 2)
    acceleration, down = rng.normal(size=(count, axes)), rng.normal(size=axes)
    specific = acceleration - 9.81 * down / np.linalg.norm(down)
    force = np.einsum("nij,nj->ni", to_sensor, specific) @ rng.normal(size=(axes, axes))
    return WeightMoments.of(to_sensor, acceleration, force + noise * rng.normal(size=(count, axes)), 9.81)


@pytest.mark.parametrize("axes", [2, 3])
@given(seed=st.integers(0, 2**32 - 1), turn=st.floats(0.1, 2.0), noise=st.floats(0.0, 10.0))
def test_no_direction_near_the_best_one_fits_better(axes: int, seed: int, turn: float, noise: float) -> None:
    rng = np.random.default_rng(seed)
    of = moments(rng, axes, turn, noise)
    best = of.fit(of.best_direction).rms
    assert np.linalg.norm(of.best_direction) == pytest.approx(1.0)
    for distance in np.geomspace(NEAREST, FURTHEST, 12):
        other = of.best_direction + distance * rng.normal(size=axes)
        assert of.fit(other / np.linalg.norm(other)).rms >= best * (1 - 1e-9) - 1e-9 * of.force
