"""Constrained fits of recordings of the simulated rig: what is repaired, what is found out, and that it is optimal.

Every random test is seeded, so that it fails always or never; the probabilities are those of another seed's failing.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from estimation.case import initial_noise
from estimation.fit import initial_values
from estimation.least_squares.bounds import Bounds
from estimation.least_squares.constrained_minimum import ConstrainedMinimum, ConstraintInterpretation
from estimation.least_squares.constrained_minimum import minimise_constrained as constrained
from estimation.least_squares.constraints import Constraints
from estimation.least_squares.problem import Problem
from estimation.recordings.reading import from_columns
from estimation.recordings.recording import Recording
from modeling import effects
from modeling.chain.effect import Effect
from modeling.chain.model import planar
from modeling.rig import Convention, Rig, SensorDescription
from tests.shared.recordings import Silence
from truewrench import simulated_rig as simulated

Array = NDArray[np.float64]

SAMPLES = 150


@cache
def columns(limit: float, hidden: tuple[simulated.HiddenEffect, ...]) -> tuple[simulated.PlanarRig, dict[str, Array]]:
    """A rig whose joints move by up to `limit` rad, and its recording without noise."""
    rig = simulated.PlanarRig(position_limit=limit, velocity_limit=5 * limit, acceleration_limit=25 * limit)
    motion = rig.random_motion(seed=5)
    frame = simulated.simulate(rig, motion, hidden=hidden, repeats=4, samples_per_period=SAMPLES, noise=Silence())
    return rig, {str(name): frame[name].to_numpy(dtype=float) for name in frame if name != "temperature"}


def recorded(*hidden: simulated.HiddenEffect, seed: int, limit: float = 1.2, sign: int = 1) -> Recording:
    rig, clean = columns(limit, hidden)
    draws = np.random.default_rng(seed).normal(size=(4 * SAMPLES, 3))
    found = dict(clean) | {c: sign * (clean[c] + rig.noise[i] * draws[:, i]) for i, c in enumerate(rig.channels)}
    sensor = SensorDescription(convention=Convention.ON_TOOL)
    return from_columns(found, rig=Rig(link_lengths=rig.link_lengths, sensor=sensor))


def posed_of(recording: Recording, *added: Effect) -> Problem:
    model = planar() + added
    return Problem.of(model, [recording], initial_noise(model, (recording,)))


def solved_of(posed: Problem, constraints: Constraints) -> ConstrainedMinimum:
    return constrained(posed, initial_values(posed.layout, {}), constraints)


def test_consistency_repairs_what_little_motion_leaves_open() -> None:
    """Joints that move by 5 mrad do not show an inertia of 0.013 kg m² to better than 0.022: I - mlg²/m of the free
    minimum is negative in 35 % of the draws, 1 to 10 of 12 (3 sigma). Physical consistency mends each, blames noise,
    and brings the inertia nearer to the truth."""
    rig, _ = columns(0.005, ())
    truth = np.array([rig.mass, rig.mlg, rig.inertia])
    errors = []
    for seed in range(12):
        found = solved_of(posed_of(recorded(seed=seed, limit=0.005)), Constraints(physical=True))
        m, mlg, inertia = found.theta[3:]
        assert found.converged
        assert m * inertia >= mlg**2 * (1 - 1e-12)
        assert abs(inertia - truth[2]) < 3.5 * np.sqrt(found.covariance[5, 5])  # 1 in 2000 each
        if found.free.theta[3] * found.free.theta[5] < found.free.theta[4] ** 2:
            assert found.active[0].quantity == "inertia about the centre of mass"
            assert found.active[0].pressure is ConstraintInterpretation.WITHIN_NOISE
            errors.append([abs(found.free.theta[5] - truth[2]), abs(inertia - truth[2])])
    assert 1 <= len(errors) <= 10
    free, repaired = np.sqrt(np.mean(np.square(errors), axis=0))
    assert repaired < 0.7 * free


def test_a_recording_with_the_other_sign_is_found_out() -> None:
    """The readings' signs turned round: the mass wants to be -0.9 kg, far beyond noise, and the sentence says why."""
    rig, _ = columns(1.2, ())
    posed = posed_of(recorded(seed=1, sign=-1))
    for constraints in (Constraints(physical=True), Constraints(bounds=Bounds({"m": (0.0, 3.0)}))):
        found = solved_of(posed, constraints)
        assert found.converged
        worst = found.active[0]
        assert worst.wanted is not None
        assert worst.std is not None
        assert abs(worst.wanted + rig.mass) < 5 * worst.std
        assert worst.distance > 100
        assert worst.p_value < 1e-100
        assert "the readings have the sign convention opposite to the stated one" in worst.sentence


def test_optimality_of_a_model_that_is_not_straight() -> None:
    """Drag at an unknown distance, its coefficient held too low and the tool consistent: the conditions again, the
    gradient by differences of the chi-square (over 1e-4 std, central: 1e-6 of its parts)."""
    posed = posed_of(recorded(simulated.ViscousDrag(), seed=2), effects.viscous_drag())
    names = [p.name for p in posed.layout.parameters]
    free = solved_of(posed, Constraints())
    value = dict(zip(names, free.theta, strict=True))
    held = Bounds({"viscous_drag.c": (0.0, 0.8 * value["viscous_drag.c"]), "mlg": (1.02 * value["mlg"], 1.0)})
    found = solved_of(posed, Constraints(bounds=held, physical=True))
    assert found.converged
    assert {active.quantity for active in found.active} >= {"viscous_drag.c", "mlg"}
    std = np.sqrt(np.diag(free.covariance))
    pushed = (found.optimality.bound_multipliers(lower=True) - found.optimality.bound_multipliers(lower=False)) * std
    pushed += np.einsum("nm,knm->k", found.optimality.Z, found.region.slopes) * std
    for i, unit in enumerate(np.diag(std)):
        costs = [float(np.sum(posed.evaluate(found.theta + sign * 1e-4 * unit)[0] ** 2)) for sign in (1, -1)]
        assert (costs[0] - costs[1]) / 2e-4 == pytest.approx(pushed[i], abs=2e-3 + 1e-6 * np.abs(pushed).max())


def test_an_effects_own_range_is_kept_and_reported() -> None:
    """A force that gives energy: the drag's coefficient wants to be negative, and is held at 0 with no bound stated."""
    posed = posed_of(recorded(simulated.ViscousDrag(c=-0.15), seed=3), effects.viscous_drag())
    found = solved_of(posed, Constraints(physical=True))
    (active,) = (a for a in found.active if a.quantity == "viscous_drag.c")
    assert found.theta[[p.name for p in posed.layout.parameters].index("viscous_drag.c")] == 0
    assert active.constraint == "viscous_drag.c >= 0 N s/m (its effect's range)"
    assert active.pressure is ConstraintInterpretation.CONTRADICTED
    assert active.wanted is not None
    assert active.wanted < 0
