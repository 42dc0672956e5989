"""Motions that nobody optimised for this problem: x_opt of 22.17 made to fit, and random ones."""

from __future__ import annotations

import numpy as np

from benchmarks.rivals.objective import Objective
from benchmarks.rivals.reference import CHAPTER, FREE, LIMITS
from benchmarks.rivals.trace import Recorder, Trace
from design.limits import LimitUse
from design.random_feasible import random_feasible_trajectory
from design.trajectories.fourier import CHAPTER_OPTIMUM_DEGREES
from design.trajectories.trajectory import Trajectory

RANDOM = 1000


def chapter_optimum() -> Trajectory:
    """x_opt of 22.17, in degrees, scaled until it touches the limits."""
    motion = Trajectory(CHAPTER, np.radians(CHAPTER_OPTIMUM_DEGREES))
    return motion.scaled(1 / LimitUse.of(motion, LIMITS).worst.use)


def scaled_optimum() -> Trace:
    """Its ln det."""
    recorder = Recorder(Objective(CHAPTER), "x_opt of 22.17, scaled")
    recorder.cost(chapter_optimum().coefficients / recorder.objective.unit)
    return recorder.trace()


def random_motions(seed: int, count: int = RANDOM) -> Trace:
    """The best of many random motions of the free series that touch the limits."""
    recorder = Recorder(Objective(FREE), f"best of {count} random motions")
    for number in range(count):
        motion = random_feasible_trajectory(FREE, LIMITS, seed=[seed, number])
        recorder.cost(motion.coefficients / recorder.objective.unit)
    return recorder.trace()
