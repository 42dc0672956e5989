"""What the manual says of calibration in place: named effects carry over to other loads, where polynomials do not."""

from __future__ import annotations

from math import comb

import numpy as np
import pytest

from benchmarks.in_situ import DEGREE, NOISE, compared, monomials

pytest.importorskip("mujoco")


def test_there_are_330_monomials_of_seven_variables() -> None:
    rows = monomials(np.full((2, 6), 100.0), np.full(2, 30.0), DEGREE)
    assert rows.shape == (2, comb(7 + DEGREE, DEGREE)) == (2, 330)


@pytest.mark.long(15)
def test_sixty_named_parameters_leave_little_beyond_the_noise_on_loads_that_they_were_not_fitted_to() -> None:
    frame = compared(0.0).to_frame().set_index("correction")
    assert frame.loc["named", "numbers"] == 60
    forces = frame[[column for column in frame if str(column).endswith(", N")]]
    assert (forces.loc["named"] < 1.2 * NOISE[0]).all()
    assert forces.loc["degree 4"].iloc[0] < 0.5 * forces.loc["affine"].iloc[0]
    assert (forces.loc["degree 4"].iloc[1:] > 5 * forces.loc["named"].iloc[1:]).all()
