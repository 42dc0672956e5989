"""Design request: the objects that the options of `truewrench design` name."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import cached_property
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from design.criterion import AOptimal, Criterion, DOptimal, EOptimal
from design.information import Experiment, Prior, SensorNoise, WhiteNoise, magnitudes
from design.motion.fourier import FreeSeries, PaperSeries
from design.motion.rest_to_rest import RestToRest
from design.motion.series import Series
from design.motion.spline import SplineSeries
from design.place import place_of
from diagnosis.workers import cores
from modeling.errors import InputError
from modeling.kinematics import Arm
from modeling.model import WrenchModel, planar, spatial
from modeling.rig import Convention, Rig
from modeling.space import Space
from truewrench.model_file import ModelFile


@dataclass(frozen=True, eq=False)
class DesignRequest:
    """The options, with the files that they name read.

    Raises InputError for files that cannot be used.
    """

    options: argparse.Namespace
    rig: Rig
    saved: ModelFile | None

    @classmethod
    def of(cls, options: argparse.Namespace) -> DesignRequest:
        """Read the rig and the model file; what --out asks for is looked at before any work."""
        if options.out is not None:
            _require_csv(options.out)
        saved = None if options.model is None else ModelFile.read(options.model)
        return cls(options, Rig.read(options.rig), saved)

    @property
    def arm(self) -> Arm:
        """The rig's arm."""
        return place_of(self.rig)[0]

    @cached_property
    def model(self) -> WrenchModel:
        """The model file's, else the rigid tool of the rig; a sign that is still open does not matter here."""
        if self.saved is not None:
            return self.saved.model.designable
        model = (planar if self.arm.space is Space.PLANE else spatial)(self.rig)
        return replace(model, convention=Convention.ON_TOOL) if model.convention is Convention.AUTO else model

    @property
    def left_out(self) -> list[str]:
        """Effects of the model file for which no motion can be designed."""
        return [] if self.saved is None else [e.id for e in self.saved.model.effects if not e.designable]

    @property
    def values(self) -> dict[str, float] | None:
        """The parameters in the model file, those of effects left out excepted."""
        if self.saved is None:
            return None
        return {p.name: self.saved.parameters[p.name].value for p in self.model.parameters}

    @property
    def prior(self) -> Prior | None:
        """What the model file's parameters might be, where they are to be averaged over."""
        if not self.options.averaged:
            return None
        if self.saved is None or self.values is None:
            remedy = "add --model MODEL.json, of `truewrench fit --out`"
            raise InputError(what="nothing says how uncertain the parameters are", where="--averaged", remedy=remedy)
        names = [p.name for p in self.saved.model.parameters]
        own = [names.index(p.name) for p in self.model.parameters]
        return Prior.around(self.model, self.values, self.saved.covariance[np.ix_(own, own)])

    @property
    def noise(self) -> SensorNoise:
        """That of the model file's recording, else what the rig states."""
        if self.saved is not None:
            return WhiteNoise.of_std([self.saved.noise_floor[channel] for channel in self.model.channels])
        return WhiteNoise.of_rig(self.rig, self.model.channels)

    @property
    def weight(self) -> SensorNoise | None:
        """The noise where it is to count."""
        return self.noise if self.options.weighted else None

    @property
    def criterion(self) -> Criterion:
        """D, or A or E with each parameter counted in the size that shows as much as the noise does."""
        if self.options.criterion == "d":
            return DOptimal()
        experiment = Experiment.of(self.model, self.arm, self.values, noise=self.weight)
        scale = magnitudes(experiment, self.rig.limits)
        return AOptimal(scale) if self.options.criterion == "a" else EOptimal(scale)

    @property
    def series(self) -> Series:
        """The family of motions."""
        asked, joints, period = self.options, self.arm.joints, self.options.period
        free = FreeSeries(joints=joints, harmonics=tuple(range(1, asked.harmonics + 1)), period=period)
        kinds: dict[str, Callable[[], Series]] = {
            "free": lambda: free,
            "paper": lambda: PaperSeries(joints=joints, period=period),
            "spline": lambda: SplineSeries(joints=joints, knots=asked.knots, degree=asked.degree, period=period),
            "rest": lambda: RestToRest(inner=free, ramp=asked.ramp or period / 10),
        }
        return kinds[asked.series]()

    def pool(self) -> AbstractContextManager[Executor | None]:
        """As many processes as are asked for, one for each core by default; none for one."""
        workers = self.options.workers or cores()
        if workers == 1:
            return nullcontext()
        return ProcessPoolExecutor(workers, mp_context=get_context("spawn"))


def picture_beside(path: Path) -> Path:
    """PLAN.png beside PLAN.csv."""
    return path.with_suffix(".png")


def _require_csv(path: Path) -> None:
    if path.is_dir() or not path.name or picture_beside(path) == path:
        what = "a file for a table was expected, whose picture goes beside it"
        raise InputError(what=what, where=str(path), remedy="give --out a name such as plan.csv")
