"""Command-line options of `truewrench design` resolved to rig, model, criterion, series and noise."""

from __future__ import annotations

import argparse
import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from multiprocessing import active_children, get_context
from pathlib import Path

import numpy as np

from design.criteria import AOptimal, Criterion, DOptimal, EOptimal
from design.criteria.criterion import Array
from design.information import DiscretePrior, Experiment, noise_equivalent_sizes
from design.limits import arm_and_limits
from design.trajectories.fourier import FreeSeries, PaperSeries
from design.trajectories.spline import RestToRest, SplineSeries
from design.trajectories.trajectory import TrajectorySeries
from modeling.chain.model import WrenchModel, planar, spatial
from modeling.errors import InputError
from modeling.kinematics.arm import Arm
from modeling.noise import NoiseModel
from modeling.rig import Convention, Rig
from modeling.space import Space
from truewrench.files.model_file import ModelFile
from truewrench.files.played_motion import played_format
from truewrench.options import available_cores, model_beside

ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM)
"""Of Ctrl-C, and of `timeout` or a job scheduler."""


@dataclass(frozen=True, eq=False)
class DesignRequest:
    """Options of `truewrench design` with their rig and model files.

    Raises InputError for files that cannot be used.
    """

    options: argparse.Namespace
    rig: Rig
    saved: ModelFile | None

    @classmethod
    def of(cls, options: argparse.Namespace) -> DesignRequest:
        """Read the rig and the model file; --out and --play are checked first."""
        if options.out is not None:
            _require_csv(options.out)
        formats = {path: played_format(path) for path in options.play}
        if formats and options.series != "rest":
            what = f"a robot starts and ends at rest, and --series {options.series} in motion"
            raise InputError(what=what, where="--play", remedy="add --series rest")
        path = options.model
        if path is None and options.next is not None:
            path = _require_beside(options.next)
        saved = None if path is None else ModelFile.read(path)
        request = cls(options, Rig.read(options.rig), saved)
        for path, kind in formats.items():
            if kind.joints not in (None, request.arm.joints):
                what = f"{kind.title}, is of robots with {kind.joints} joints, and the arm has {request.arm.joints}"
                raise InputError(what=what, where=str(path), remedy="give --play a name with .yaml or .csv")
        return request

    @property
    def arm(self) -> Arm:
        """The rig's arm."""
        return arm_and_limits(self.rig)[0]

    @property
    def joint_names(self) -> list[str]:
        """Names of the joints as the URDF has them, q1 .. qn of an arm without."""
        arm = self.rig.spatial_arm
        return [f"q{i + 1}" for i in range(self.arm.joints)] if arm is None else [joint.name for joint in arm.chain]

    @cached_property
    def model(self) -> WrenchModel:
        """Model of the model file, else the rigid tool of the rig; its sign convention may be undecided."""
        if self.saved is not None:
            return self.saved.model.designable
        model = (planar if self.arm.space is Space.PLANE else spatial)(self.rig)
        return replace(model, convention=Convention.ON_TOOL) if model.convention is Convention.AUTO else model

    @property
    def left_out(self) -> list[str]:
        """Ids of the effects of the model file for which no trajectory can be designed."""
        return [] if self.saved is None else [e.id for e in self.saved.model.effects if not e.designable]

    @property
    def not_carried(self) -> str:
        """A sentence on the tool of the model file where torques are limited: what is carried is in the rig file."""
        limits = self.rig.limits
        if self.saved is None or limits is None or limits.torque is None:
            return ""
        return (
            "Torque limits are kept with the masses of the URDF and of [[body]] in the rig file; the tool of the model"
            " file is not added to them."
        )

    @property
    def values(self) -> dict[str, float] | None:
        """Parameter values of the model file, without those of excluded effects."""
        if self.saved is None:
            return None
        return {p.name: self.saved.parameters[p.name].value for p in self.model.parameters}

    @property
    def prior(self) -> DiscretePrior | None:
        """Prior from estimates and covariance of the model file, with --averaged."""
        if not self.options.averaged:
            return None
        if self.saved is None or self.values is None:
            remedy = "add --model MODEL.json, of `truewrench fit --out`"
            raise InputError(what="the covariance of the parameters is unknown", where="--averaged", remedy=remedy)
        names = [p.name for p in self.saved.model.parameters]
        index = [names.index(p.name) for p in self.model.parameters]
        return DiscretePrior.around(self.model, self.values, self.saved.covariance[np.ix_(index, index)])

    @property
    def noise(self) -> NoiseModel:
        """Sensor noise of the model file, else of the rig file."""
        if self.saved is not None:
            return NoiseModel.white([self.saved.noise_floor[channel] for channel in self.model.channels])
        return NoiseModel.of_rig(self.rig, self.model.channels)

    @property
    def weight(self) -> NoiseModel | None:
        """Sensor noise that weights the readings, with --weighted."""
        return self.noise if self.options.weighted else None

    @property
    def criterion(self) -> Criterion:
        """D-, A- or E-optimality; A and E in noise-equivalent sizes of the parameters."""
        kinds: dict[str, Callable[[], Criterion]] = {
            "d": DOptimal,
            "a": lambda: AOptimal(self._scale),
            "e": lambda: EOptimal(self._scale),
        }
        return kinds[self.options.criterion]()

    @property
    def _scale(self) -> Array:
        """Noise-equivalent sizes of the parameters, (k,)."""
        experiment = Experiment.of(self.model, self.arm, self.values, noise=self.weight)
        return noise_equivalent_sizes(experiment, self.rig.limits)

    @property
    def series(self) -> TrajectorySeries:
        """Family of trajectories."""
        asked, joints, period = self.options, self.arm.joints, self.options.period
        free = FreeSeries(joints=joints, harmonics=tuple(range(1, asked.harmonics + 1)), period=period)
        kinds: dict[str, Callable[[], TrajectorySeries]] = {
            "free": lambda: free,
            "paper": lambda: PaperSeries(joints=joints, period=period),
            "spline": lambda: SplineSeries(joints=joints, knots=asked.knots, degree=asked.degree, period=period),
            "rest": lambda: RestToRest(inner=free, ramp=asked.ramp or period / 10),
        }
        return kinds[asked.series]()

    @contextmanager
    def pool(self) -> Iterator[Executor]:
        """Process pool of --workers, one for each core by default.

        One worker, too, is a process of its own, so that an interrupt never comes within CasADi. Workers do not see
        the signals that end the command, which reach every process of a terminal: they are killed when it is
        interrupted.
        """
        others = set(active_children())
        workers = self.options.workers or available_cores()
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as executor:
            masked = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING_SIGNALS)
            try:
                for _ in range(workers):
                    executor.submit(os.getpid)  # starts a process, which inherits the mask
            finally:
                signal.pthread_sigmask(signal.SIG_SETMASK, masked)
            try:
                yield executor
            except KeyboardInterrupt:
                executor.shutdown(wait=False, cancel_futures=True)
                for worker in set(active_children()) - others:
                    worker.kill()
                raise


def _require_beside(result: Path) -> Path:
    """model.json in the folder of result.json; InputError where one of them is not there."""
    path = model_beside(result)
    if not result.is_file():
        raise InputError(
            what="No such file", where=str(result), remedy="give result.json of `truewrench diagnose --out`"
        )
    if not path.exists():
        what = "the fitted model is not beside it as model.json"
        raise InputError(what=what, where=str(result), remedy="add --model MODEL.json, of the same diagnosis")
    return path


def plot_path(path: Path) -> Path:
    """PLAN.png beside PLAN.csv."""
    return path.parent / f"{path.stem}.png"


def _require_csv(path: Path) -> None:
    if plot_path(path) == path:
        what = "a table file was expected; its plot is written beside it as .png"
        raise InputError(what=what, where=str(path), remedy="give --out a name such as plan.csv")
