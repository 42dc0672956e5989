"""Our design with a trace of what it found by when, as the rivals have."""

from __future__ import annotations

from time import process_time

import numpy as np

from benchmarks.rivals.reference import RIG
from benchmarks.rivals.trace import Trace
from design.information.experiment import Experiment
from design.trajectories.trajectory import Trajectory, TrajectorySeries
from design.trajectory_design import DesignStage, design
from modeling.chain.model import planar, spatial
from modeling.rig import Rig
from modeling.space import Space


def traced(seed: int, starts: int | None = None, rig: Rig = RIG, series: TrajectorySeries | None = None) -> Trace:
    """`design` as a user calls it, in one process, without the bound: its motions that keep the limits at any instant.

    Deriving is outside the clock, as for the rivals; building the optimiser's graphs is on it.
    """
    arm, notes = rig.arm, list[tuple[float, float, Trajectory]]()
    if arm is not None:
        Experiment.of((planar if arm.space is Space.PLANE else spatial)(rig), arm).sample()
    began = process_time()

    def progress(step: DesignStage) -> None:
        if step.best is not None and (not notes or step.best.value > notes[-1][1]):
            notes.append((process_time() - began, step.best.value, step.best.motion))

    evaluations = design(rig, series=series, seed=seed, starts=starts, bounded=False, progress=progress).evaluations
    return Trace(
        name="truewrench",
        seconds=np.array([seconds for seconds, _, _ in notes]),
        evaluations=np.full(len(notes), np.nan),
        logdet=np.array([logdet for _, logdet, _ in notes]),
        motion=notes[-1][2] if notes else None,
        total_seconds=process_time() - began,
        total_evaluations=evaluations,
    )
