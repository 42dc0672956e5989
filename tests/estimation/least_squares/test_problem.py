"""The whitened residual without a derivative is the one with it: of every effect, on Fourier lines and in a single run.

Repeats with motions of their own are in `tests/estimation/recordings/test_repeat_motion.py`.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from estimation.case import initial_noise
from estimation.least_squares.problem import Problem
from estimation.noise.recording_noise import RecordingNoise
from estimation.recordings.recording import Recording
from modeling.space import Space
from tests.modeling.effects.cases import CASES, Case

ROUNDING = 1e-9
"""Of the residual's length: a deflection is solved by iteration, to 1e-11 of itself."""


@cache
def noisy(space: Space, repeats: int) -> tuple[Case, Recording, tuple[RecordingNoise, ...]]:
    """A recording of noise alone in so many repeats, and its noise."""
    case = next(case for case in CASES if case.space is space)
    recording = case.recording
    rng = np.random.default_rng(repeats)
    recording = recording.moved(repeats=repeats).with_readings(rng.standard_normal(recording.wrench.shape))
    return case, recording, initial_noise(case.plain, (recording,))


@pytest.mark.parametrize("repeats", [2, 1])
@pytest.mark.parametrize("case", CASES, ids=str)
def test_residual_is_that_of_the_linearised_rows(case: Case, repeats: int) -> None:
    _, recording, noise = noisy(case.space, repeats)
    several = (recording, replace(recording, name="other", wrench=-recording.wrench))
    problem = Problem.of(case.model, several, (*noise, *noise))
    theta = np.array(
        [
            {p.name: v for p, v in zip(case.model.parameters, case.theta, strict=True)}.get(p.name, 0.3)
            for p in problem.layout.parameters
        ]
    )
    expected = problem.linearised(theta)
    found = problem.residual(theta)
    assert found.shape == expected.residual.shape
    assert np.linalg.norm(found - expected.residual) <= ROUNDING * np.linalg.norm(expected.residual)
    assert problem.chi_square(theta) == pytest.approx(expected.cost, rel=2 * ROUNDING)
