"""Setting: the arm, its limits and the readings that a motion is designed for."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Self

from design.criterion import Criterion
from design.discrimination.view import View
from design.information.experiment import Experiment
from design.information.noise import SensorNoise
from design.information.sampling import CLOCK
from design.information.state import signal_names
from design.limit_use import LimitUse
from design.motion.series import Motion, Series
from design.optimiser.objective import Objective
from design.optimiser.optimiser import Task
from design.place import place_of, require_samples
from design.random_feasible import random_feasible
from modeling.errors import InputError
from modeling.kinematics import Arm
from modeling.model import WrenchModel
from modeling.rig import Limits, Rig, Workspace

ENOUGH = 128
"""Readings of a run that a motion is optimised with: ten to the shortest wave of twelve harmonics, whose sums are then
integrals but for percents. What is reported is of all readings."""
REACH = 0.2
"""m: how far the tip of a rig that does not say so is taken to reach; forces may act up to twice as far."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Setting:
    """An arm, its limits, the series of its motions, readings in one run and their noise."""

    arm: Arm
    limits: Limits
    series: Series
    samples: int
    noise: SensorNoise
    workspace: Workspace | None = None
    tip_length: float | None = None

    @classmethod
    def of(cls, rig: Rig, *, series: Series, samples: int, noise: SensorNoise) -> Self:
        """Of a rig; InputError when it has no arm or no limits, or the samples are too few for the series."""
        arm, limits = place_of(rig)
        require_samples(series, samples)
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
        """How far along the tip a force may act, m."""
        return 2 * (self.tip_length or REACH)

    @property
    def coarse(self) -> int:
        """Readings of one run for the optimisation."""
        return min(self.samples, ENOUGH)

    def view(self, motion: Motion, samples: int | None = None) -> View:
        """One run of a motion."""
        return View.along(motion, self.arm, samples=samples or self.samples, noise=self.noise)

    def random(self, seed: tuple[int, ...]) -> Motion:
        """A random motion within the limits, as large as they allow."""
        return random_feasible(
            self.series,
            self.limits,
            workspace=self.workspace,
            arm=self.arm,
            tip_length=self.tip_length,
            seed=seed,
        )

    def task(self, experiment: Experiment, criterion: Criterion) -> Task:
        """The optimisation of a criterion of an experiment."""
        return Task(
            objective=Objective(experiment=experiment, criterion=criterion, series=self.series, samples=self.coarse),
            limits=self.limits,
            arm=self.arm,
            workspace=self.workspace,
            tip_length=self.tip_length,
        )

    def use(self, motion: Motion) -> LimitUse:
        """How much of the limits a motion uses, at every instant."""
        return LimitUse.of(motion, self.limits, self.workspace, self.arm, self.tip_length)

    def require(self, models: Iterable[WrenchModel]) -> None:
        """InputError for an effect of one recording only, and for a signal that this arm's joints do not give."""
        known = {*signal_names(self.arm), *CLOCK}
        for model in models:
            passing = [e.id for e in model.effects if e.per_recording]
            strange = [e.id for e in model.effects if not e.designable]
            missing = [name for name in model.inputs if name not in known]
            if passing:
                what, remedy = f"{passing[0]} belongs to one recording, and no motion brings it back", "leave it out"
                raise InputError(what=what, where="effects to be told apart", remedy=remedy)
            if strange:
                what = f"{strange[0]} is neither of one instant nor linear in the past, and no design can count on it"
                raise InputError(what=what, where="effects to be told apart", remedy="leave it out")
            if missing:
                what = f"'{missing[0]}' is needed by {' + '.join(e.id for e in model.effects)}"
                what += ", and no motion of the joints gives it"
                raise InputError(what=what, where="effects to be told apart", remedy="leave that effect out")
