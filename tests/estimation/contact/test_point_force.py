"""22.14 to 22.16 corrected: the force at the tip's end from an over-determined contact wrench, and its direction."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from estimation.contact.contact_wrench import PointForce
from modeling.reference import printed_direction

Array = NDArray[np.float64]

NOISE = np.array([[0.04, 0.01, 0.002], [0.01, 0.09, 0.0], [0.002, 0.0, 4e-4]])  # N², N² m, N² m²
ARM = 0.3


def wrench(size: float, direction: float, arm: float = ARM) -> Array:
    """A force of the environment at the tip's end: (fcx, fcy, tauc), 22.14 with its sign corrected."""
    return size * np.array([np.sin(direction), np.cos(direction), arm * np.sin(direction)])


def drawn(true: Array, count: int, seed: int) -> PointForce:
    noise = np.random.default_rng(seed).multivariate_normal(np.zeros(3), NOISE, size=count)
    return PointForce.of(true + noise, np.broadcast_to(NOISE, (count, 3, 3)), NOISE, ARM)


@given(st.floats(0.1, 100), st.floats(-3.14, 3.14), st.floats(0.0, 2.0))
def test_every_quadrant_comes_back(size: float, direction: float, arm: float) -> None:
    """Rounding only: the three numbers agree, whatever their weights."""
    found = PointForce.of(wrench(size, direction, arm)[None], NOISE[None], NOISE, arm)
    assert found.magnitude[0] == pytest.approx(size, rel=1e-9)
    assert np.angle(np.exp(1j * (found.direction[0] - direction))) == pytest.approx(0, abs=1e-9)
    assert found.misfit[0] == pytest.approx(0, abs=1e-9 * size**2 / NOISE[2, 2])


def test_equal_weights_are_the_corrected_closed_form() -> None:
    """tan b = (fcx + tauc d) / (fcy (1 + d²)): PHYSICS.md, erratum 3, where the printed one has a minus sign."""
    reading = np.array([[1.3, -0.4, 0.2]])
    found = PointForce.of(reading, np.eye(3)[None], np.eye(3), ARM)
    across = (reading[0, 0] + reading[0, 2] * ARM) / (1 + ARM**2)
    assert found.force[0] == pytest.approx([across, reading[0, 1]], rel=1e-12)


def test_the_printed_formula_is_wrong_where_the_errata_say() -> None:
    """It is right only without a torque and in front: the sign of its torque and its quadrant are lost."""
    front, back = wrench(5.0, 0.3)[None], wrench(5.0, np.pi - 0.3)[None]
    assert abs(printed_direction(front, ARM)[0] - 0.3) > 0.03
    assert printed_direction(front, 0.0)[0] == pytest.approx(0.3)
    assert printed_direction(back, 0.0)[0] == pytest.approx(-0.3)


def test_std_is_that_of_draws() -> None:
    """Over 4000 draws the spread has a relative error of 1.1 %; six of those."""
    found = drawn(wrench(20.0, 2.0), 4000, seed=1)
    assert found.magnitude.std() == pytest.approx(found.magnitude_std.mean(), rel=0.07)
    assert found.direction.std() == pytest.approx(found.direction_std.mean(), rel=0.07)
    assert found.misfit.mean() == pytest.approx(1.0, abs=6 * np.sqrt(2 / 4000))


def test_weights_are_the_best() -> None:
    """No other weights give a smaller spread: against equal ones, for which a N counts like a N m."""
    true = wrench(20.0, 0.2)
    noise = np.random.default_rng(2).multivariate_normal(np.zeros(3), NOISE, size=4000)
    spread = [
        PointForce.of(true + noise, np.broadcast_to(NOISE, (4000, 3, 3)), weight, ARM).direction.std()
        for weight in (NOISE, np.eye(3))
    ]
    assert spread[0] < 0.8 * spread[1]


def test_a_clear_direction_is_within_two_standard_deviations() -> None:
    """95 % of large forces; of 2000 draws, five standard errors below would be one test in 3 million."""
    found = drawn(wrench(5.0, -1.0), 2000, seed=3)
    off = np.abs(np.angle(np.exp(1j * (found.direction + 1.0))))
    assert found.clear.all()
    assert (found.direction_std < 0.25).all()
    assert (off <= 1.96 * found.direction_std).mean() > 0.95 - 5 * np.sqrt(0.95 * 0.05 / 2000)


def test_noise_alone_has_hardly_a_clear_direction() -> None:
    """Twice the std along itself by chance: exp(-2) = 14 % for equal noise of both components."""
    assert drawn(wrench(0.0, -1.0), 2000, seed=3).clear.mean() < 0.2


def test_without_a_distance_the_torque_says_nothing() -> None:
    found = PointForce.of(wrench(5.0, 0.3)[None], NOISE[None], NOISE, None)
    assert found.direction[0] == pytest.approx(0.3)
    assert np.isnan(found.misfit[0])
