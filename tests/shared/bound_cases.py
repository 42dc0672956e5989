"""Arms and limits for the tests of the bound, symmetric and not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from design.bound import DualityBound, Effort, PolynomialDegrees, ViableStates, upper_bound
from design.bound.dual_function import DualFunction, DualVariables, PeriodicityConditions
from design.information import Experiment
from design.random_feasible import random_feasible_trajectory
from design.trajectories.fourier import FreeSeries
from design.trajectories.trajectory import Trajectory
from modeling.chain.model import planar
from modeling.kinematics.arm import PlanarArm
from modeling.rig import Limits

Array = NDArray[np.float64]
ARM = PlanarArm((0.6, 0.4))
ONE = PlanarArm((0.5,))
QUICK = Effort(tolerance=0.05, starts=2000, proof_seconds=0)


def limits(position: object, velocity: object, acceleration: object) -> Limits:
    first, second, third = (np.array(pairs, dtype=float) for pairs in (position, velocity, acceleration))
    return Limits(position=first, velocity=second, acceleration=third)


SYMMETRIC = limits([[-1.2, 1.2], [-1.4, 1.4]], [[-2, 2], [-3, 3]], [[-8, 8], [-12, 12]])
SKEW = limits([[-0.9, 1.3], [-0.4, 1.4]], [[-2.5, 1.5], [-2, 3]], [[-6, 9], [-12, 7]])
SINGLE = limits([[-1.2, 1.2]], [[-3, 3]], [[-10, 10]])
SKEW_SINGLE = limits([[-0.7, 1.2]], [[-2, 4]], [[-6, 11]])
CASES = {"symmetric": (ARM, SYMMETRIC), "skew": (ARM, SKEW), "single": (ONE, SINGLE), "skew single": (ONE, SKEW_SINGLE)}


def bound_of(case: str, degrees: PolynomialDegrees, effort: Effort = QUICK) -> DualityBound:
    arm, within = CASES[case]
    return upper_bound(planar(), arm, within, samples=200, degrees=degrees, effort=effort)


def viable_states(viable: ViableStates, count: int, rng: np.random.Generator) -> Array:
    """Random states with accelerations inside their limits too."""
    q, dq = viable.phase(rng.uniform(-1, 1, (count, 2 * viable.joints)))
    low, high = viable.limits.acceleration.T
    return np.hstack([q, dq, rng.uniform(low, high, q.shape)])


def random_motion(case: str, seed: int) -> Trajectory:
    arm, within = CASES[case]
    series = FreeSeries(joints=arm.joints, harmonics=(1, 2, 3, 5, 8), period=2.0 + seed % 4)
    return random_feasible_trajectory(series, within, seed=seed)


def random_dual(function: DualFunction, seed: int) -> DualVariables:
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((function.size, function.size))
    return DualVariables(root @ root.T, rng.standard_normal(len(function.conditions)))


def plain_function(case: str, degrees: PolynomialDegrees) -> DualFunction:
    arm, within = CASES[case]
    conditions = PeriodicityConditions(viable=ViableStates(within), degrees=degrees)
    return DualFunction(Experiment.of(planar(), arm), conditions)
