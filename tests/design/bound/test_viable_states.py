"""The states in which a motion can be that keeps its limits: every motion's, and not the whole box."""

from __future__ import annotations

import numpy as np
import pytest

from design.bound import ViableStates
from tests.shared.bound_cases import (
    CASES,
    SKEW_SINGLE,
    limits,
    random_motion,
)


@pytest.mark.parametrize("seed", range(8))
def test_every_motion_stays_among_the_viable_states(case: str, seed: int) -> None:
    motion = random_motion(case, seed)
    states = motion.evaluate(np.linspace(0, motion.period, 2000))
    assert ViableStates(CASES[case][1]).excess(*states).max() <= 1e-12  # rounding of the states


def test_the_viable_states_are_not_the_whole_box(case: str) -> None:
    viable = ViableStates(CASES[case][1])
    corner = np.stack([viable.limits.position[:, 1], viable.limits.velocity[:, 1], viable.limits.acceleration[:, 0]])
    assert viable.excess(*corner[:, None, :])[0] > 0.05


def test_the_ends_of_the_viable_positions_are_reached() -> None:
    # From rest at the low end with full acceleration, then full braking to rest at the high end; and back.
    viable = ViableStates(SKEW_SINGLE)
    (low, high), (slow, fast) = SKEW_SINGLE.position[0], SKEW_SINGLE.acceleration[0]
    dq = np.linspace(0, 1.9, 20)[:, None]
    for sign in (1, -1):
        first, last = viable.ends(sign * dq)
        assert np.allclose(first, low + dq**2 / (2 * fast)), "leaving the low end, or stopping before it"
        assert np.allclose(last, high + dq**2 / (2 * slow)), "stopping before the high end, or leaving it"


def test_the_cube_is_mapped_into_the_viable_states_and_onto_their_ends(case: str) -> None:
    viable = ViableStates(CASES[case][1])
    points = np.random.default_rng(0).uniform(-1, 1, (500, 2 * viable.joints))
    still = np.zeros((500, viable.joints))
    assert viable.excess(*viable.phase(points), still).max() <= 1e-12
    points[:, : viable.joints] = 1
    q, dq = viable.phase(points)
    assert np.allclose(q, viable.ends(dq)[1])


def test_a_joint_that_cannot_stop_within_its_range_never_gets_to_its_fastest() -> None:
    viable = ViableStates(limits([[-0.1, 0.1]], [[-5, 5]], [[-2, 8]]))
    top = np.sqrt(0.2 / (1 / 16 + 1 / 4))
    assert np.allclose(viable.speeds, [[-top, top]])
