"""Our design of the reference problem, with a trace of what it found by when, as the rivals have."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter

import numpy as np

from benchmarks.rivals.reference import ARM, RIG
from benchmarks.rivals.trace import Trace
from design.information.experiment import Experiment
from design.trajectories.trajectory import Trajectory
from design.trajectory_design import DesignStage, design
from modeling.chain.model import planar

OnImprovement = Callable[[float, float, Trajectory], None]
"""Told of the seconds since the start, ln det, and a motion that keeps the limits at every instant."""


def ours(seed: int, on_improvement: OnImprovement, starts: int | None = None) -> int:
    """`design` as a user calls it, in one process, without the bound; returns the evaluations.

    Deriving is outside the clock, as for the rivals; building the optimiser's graphs is on it.
    """
    Experiment.of(planar(RIG), ARM).sample()
    began = perf_counter()

    def progress(step: DesignStage) -> None:
        if step.best is not None:
            on_improvement(perf_counter() - began, step.best.value, step.best.motion)

    return design(RIG, seed=seed, starts=starts, bounded=False, progress=progress).evaluations


def traced(seed: int, starts: int | None = None) -> Trace:
    """The run of `ours` as a trace."""
    notes: list[tuple[float, float, Trajectory]] = []
    began = perf_counter()

    def note(seconds: float, logdet: float, motion: Trajectory) -> None:
        if not notes or logdet > notes[-1][1]:
            notes.append((seconds, logdet, motion))

    evaluations = ours(seed, note, starts)
    return Trace(
        name="truewrench",
        seconds=np.array([seconds for seconds, _, _ in notes]),
        evaluations=np.full(len(notes), np.nan),
        logdet=np.array([logdet for _, logdet, _ in notes]),
        motion=notes[-1][2] if notes else None,
        total_seconds=perf_counter() - began,
        total_evaluations=evaluations,
    )
