"""Arm, limits, series, samples and noise of a discrimination design."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Self

from design.criteria import Criterion
from design.discrimination.whitened_prediction import WhitenedPrediction
from design.information.experiment import Experiment
from design.information.joint_state import signal_names
from design.information.sampling import CLOCK_SIGNALS
from design.limits.limit_use import LimitUse
from design.limits.random_feasible import random_feasible_trajectory
from design.limits.rig_limits import arm_and_limits, require_enough_samples, require_motion_within_period
from design.optimiser.design_task import DesignTask
from design.optimiser.objective import Objective
from design.trajectories.trajectory import Trajectory, TrajectorySeries
from modeling.chain.model import WrenchModel
from modeling.errors import InputError
from modeling.kinematics.arm import Arm
from modeling.noise.stationary_noise import StationaryNoise
from modeling.rig.rig import Limits, Rig, Workspace

OPTIMISATION_SAMPLES = 128
"""Samples of a run in the optimisation: ten to the shortest wave of twelve harmonics, whose sums are then integrals to
a few per cent. Results are of all samples."""
DEFAULT_TIP_LENGTH = 0.2
"""m: tip length of a rig that states none; forces may act up to twice as far."""


@dataclass(frozen=True, eq=False, kw_only=True)
class DesignSetting:
    """An arm, its limits, the trajectory series, samples of one run and their noise."""

    arm: Arm
    limits: Limits
    series: TrajectorySeries
    samples: int
    noise: StationaryNoise
    workspace: Workspace | None = None
    tip_length: float | None = None

    @classmethod
    def of(cls, rig: Rig, *, series: TrajectorySeries, samples: int, noise: StationaryNoise) -> Self:
        """Of a rig; InputError when it has no arm or no limits, the samples are too few or the period is too short."""
        arm, limits = arm_and_limits(rig)
        require_enough_samples(series, samples)
        require_motion_within_period(series, limits)
        return cls(
            arm=arm,
            limits=limits,
            series=series,
            samples=samples,
            noise=noise,
            workspace=rig.workspace,
            tip_length=rig.tip_length,
        )

    @property
    def reach(self) -> float:
        """Largest distance along the tip at which a force may act, m."""
        return 2 * (self.tip_length or DEFAULT_TIP_LENGTH)

    @property
    def coarse(self) -> int:
        """Samples of one run in the optimisation."""
        return min(self.samples, OPTIMISATION_SAMPLES)

    def view(self, motion: Trajectory, samples: int | None = None) -> WhitenedPrediction:
        """Whitened predictions along one run of a trajectory."""
        return WhitenedPrediction.along(motion, self.arm, samples=samples or self.samples, noise=self.noise)

    def random(self, seed: tuple[int, ...]) -> Trajectory:
        """A random feasible trajectory, as large as the limits allow."""
        return random_feasible_trajectory(
            self.series,
            self.limits,
            workspace=self.workspace,
            arm=self.arm,
            tip_length=self.tip_length,
            seed=seed,
        )

    def task(self, experiment: Experiment, criterion: Criterion) -> DesignTask:
        """The optimisation of a criterion of an experiment."""
        return DesignTask(
            objective=Objective(experiment=experiment, criterion=criterion, series=self.series, samples=self.coarse),
            limits=self.limits,
            arm=self.arm,
            workspace=self.workspace,
            tip_length=self.tip_length,
        )

    def use(self, motion: Trajectory) -> LimitUse:
        """Use of the limits by a trajectory, at every instant."""
        return LimitUse.of(motion, self.limits, self.workspace, self.arm, self.tip_length)

    def require(self, models: Iterable[WrenchModel]) -> None:
        """InputError for recording-specific effects, and for signals that do not follow from this arm's joints."""
        known = {*signal_names(self.arm), *CLOCK_SIGNALS}
        for model in models:
            recording_specific = [e.id for e in model.effects if e.per_recording]
            unsuitable = [e.id for e in model.effects if not e.designable]
            missing = [name for name in model.inputs if name not in known]
            if recording_specific:
                what = f"{recording_specific[0]} is recording-specific, and no trajectory reproduces it"
                raise InputError(what=what, where="effects to be discriminated", remedy="leave it out")
            if unsuitable:
                what = f"{unsuitable[0]} is neither static nor linear dynamic, and no trajectory can be designed for it"
                raise InputError(what=what, where="effects to be discriminated", remedy="leave it out")
            if missing:
                what = f"'{missing[0]}' is needed by {' + '.join(e.id for e in model.effects)}"
                what += ", and does not follow from the joint states"
                raise InputError(what=what, where="effects to be discriminated", remedy="leave that effect out")
