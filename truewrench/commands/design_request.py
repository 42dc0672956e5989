"""Options of `truewrench design` as rig, model, criterion, series and noise, and what a diagnosis asks of --next."""

from __future__ import annotations

import argparse
import json
import os
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from multiprocessing import active_children, get_context
from pathlib import Path
from typing import Any

import numpy as np

from design.criteria import AOptimal, Criterion, DOptimal, EOptimal
from design.criteria.criterion import Array
from design.discrimination import DesignSetting, DiscriminationDesign, with_effect_replaced
from design.discrimination.discriminating_trajectory import RARE
from design.information import DiscretePrior, Experiment, noise_equivalent_sizes
from design.limits import arm_and_limits
from design.trajectories.fourier import FreeSeries, PaperSeries
from design.trajectories.spline import RestToRest, SplineSeries
from design.trajectories.trajectory import TrajectorySeries
from diagnosis.next_experiment import IntervalDesign, KnownEstimates
from modeling.chain.effect import Effect
from modeling.chain.model import WrenchModel, planar, spatial
from modeling.effects import CATALOGUE, named
from modeling.errors import InputError, file_text
from modeling.kinematics.arm import Arm
from modeling.noise import NoiseModel
from modeling.rig import Convention, Rig
from modeling.space import Space
from truewrench.files.effects_file import read_effects
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


# What a diagnosis leaves open, which the motion of --next is designed to settle.


AGREEMENT = 1e-6
"""Relative difference up to which a value in result.json is that in model.json: both have all digits."""
UNEXPLAINED = "unexplained"
INTERVALS = "it is designed to narrow the widest interval, beside what the recordings have told already"


@dataclass(frozen=True, eq=False, kw_only=True)
class NextQuestion:
    """What the next motion is designed for.

    known    model, estimates and noise
    rivals   the model with an effect replaced by one that it is not told from; none: the intervals are the question
    reasons  sentences: the verdict, and what is not told apart
    """

    known: KnownEstimates
    rivals: tuple[WrenchModel, ...]
    reasons: tuple[str, ...]

    @classmethod
    def of(cls, request: DesignRequest, path: Path) -> NextQuestion:
        """Of result.json and the model file of the same diagnosis.

        Raises InputError for another file, for a verdict that says that the model is not the right one, and for a model
        file of another diagnosis.
        """
        result, saved = _result(path), request.saved
        assert saved is not None  # `DesignRequest.of` reads the one beside the result
        _require_explained(result, str(path))
        _require_same(result, saved, str(path))
        known = KnownEstimates(
            model=saved.model,
            values={name: estimate.value for name, estimate in saved.parameters.items()},
            covariance=saved.covariance,
            noise=request.noise,
        )
        rivals, words = _rivals(request, known.designable, result["effects"])
        reasons = [f"verdict: {result['verdict']}", *words]
        if result["verdict"] == "partly_explained":
            reasons.append("what is still missing from the model is in none of its intervals")
        return cls(known=known, rivals=rivals, reasons=tuple(reasons))

    def separation(self, plan: DiscriminationDesign) -> str:
        """How likely the effects are still confused after the motion."""
        errors = [pair.error_probability(pair.after) for pair in plan.pairs]
        likely = max((error for error in errors if error is not None), default=None)
        times = f"{plan.runs} run{'s' * (plan.runs > 1)} of it alone"
        if likely is None:
            return f"the motion shows the difference with lambda {min(p.after for p in plan.pairs):.3g} in {times}"
        return f"expected probability of taking one for the other: {max(likely, RARE):.2g} at most after {times}"

    def narrowing(self, plan: IntervalDesign) -> str:
        """What is widest, and how wide it is expected to be after the motion."""
        name, size = plan.widest, plan.sizes[plan.widest]
        before, after = self.known.std[name], plan.expected[name]
        unit = next(p.unit for p in self.known.designable.parameters if p.name == name)
        if not np.isfinite(before):
            return f"{INTERVALS}: {name} is not identifiable so far; expected then ± {after:.2g} {unit}"
        share = f"{before / size:.2g} of its size"
        return (
            f"{INTERVALS}: {name} ± {before:.2g} {unit}, {share}; expected then ± {after:.2g}, {after / size:.2g} of it"
        )


def _result(path: Path) -> dict[str, Any]:
    """The data of result.json, as far as it is read here."""
    text, remedy = file_text(path, kind="result.json", syntax="JSON"), "give result.json of `truewrench diagnose --out`"
    try:
        data = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(what=f"not a JSON file: {error}", where=str(path), remedy=remedy) from None
    effects = data.get("effects") if isinstance(data, dict) else None
    proper = (
        isinstance(effects, list)
        and all(isinstance(e, dict) and isinstance(e.get("id"), str) for e in effects)
        and all(isinstance(e.get("confusable_with", []), list) for e in effects)
        and all(isinstance(other, str) for e in effects for other in e.get("confusable_with", []))
        and isinstance(data.get("verdict"), str)
        and isinstance(data.get("parameters"), dict)
        and isinstance(data.get("readings", []), list)
    )
    if not proper:
        raise InputError(what="it is no result of a diagnosis", where=str(path), remedy=remedy)
    return dict(data)


def _require_explained(result: Mapping[str, Any], where: str) -> None:
    if result["verdict"] != UNEXPLAINED:
        return
    proposed = [r for r in result.get("readings", []) if isinstance(r, dict) and r.get("adopted") is False]
    if proposed:
        what = f"the recording is misread ({proposed[0].get('id')}), and a motion would be designed for a wrong model"
        remedy = "first diagnose as its first sentence says: `truewrench diagnose --read ID`, or --as-read"
        raise InputError(what=what, where=where, remedy=remedy)
    what = "the verdict is unexplained, and a motion would be designed for a wrong model"
    remedy = "first find what is missing: `truewrench diagnose` with --effects FILE, or `truewrench discover`"
    raise InputError(what=what, where=where, remedy=remedy)


def _require_same(result: Mapping[str, Any], saved: ModelFile, where: str) -> None:
    """InputError unless the model has the parameters of the result, with their values."""
    stated = result["parameters"]
    values = {name: e.get("value") for name, e in stated.items() if isinstance(e, dict)}
    same = set(values) == set(saved.parameters) and all(
        isinstance(value, int | float) and np.isclose(value, saved.parameters[name].value, rtol=AGREEMENT, atol=1e-12)
        for name, value in values.items()
    )
    if not same:
        what = "the model file is of another fit: its parameters differ"
        raise InputError(what=what, where=where, remedy="give --model MODEL.json of the same diagnosis")


def _rivals(
    request: DesignRequest, model: WrenchModel, effects: Sequence[Mapping[str, Any]]
) -> tuple[tuple[WrenchModel, ...], list[str]]:
    """The model with each supported effect replaced by each that it is not told from, and what is said of them."""
    asked = request.options
    custom = () if asked.effects is None else read_effects(asked.effects)
    given = {effect.id: effect for effect in (*custom, *model.effects)}
    setting = DesignSetting.of(request.rig, series=request.series, samples=asked.samples, noise=request.noise)
    rivals, told, words = [], [], []
    present = {effect.id for effect in model.effects}
    for finding in effects:
        effect_id, others = finding["id"], finding.get("confusable_with") or []
        if finding.get("verdict") != "supported" or effect_id not in present:
            continue
        for other in (other for other in others if other not in present):
            rival = with_effect_replaced(model, effect_id, _effect(str(other), given))
            try:
                setting.require([rival.with_arm(setting.arm)])
            except InputError as error:
                words.append(f"{effect_id} is not told from {other}, for which no motion can be designed: {error.what}")
                continue
            rivals.append(rival)
            told.append(f"{effect_id} from {other}")
    if told:
        words.insert(
            0, f"not told apart in these recordings: {', '.join(told)}; the motion is designed to separate them"
        )
    return tuple(rivals), words


def _effect(effect_id: str, given: Mapping[str, Effect]) -> Effect:
    """An effect of the file of effects, the model or the catalogue."""
    if effect_id in given:
        return given[effect_id]
    try:
        return named(effect_id)
    except InputError:
        what = f"'{effect_id}' is none of the {len(CATALOGUE)} effects of the catalogue"
        remedy = "add --effects FILE, as in the diagnosis"
        raise InputError(what=what, where="--next", remedy=remedy) from None
