"""`truewrench design`: exciting or discriminating trajectory within the limits, and an upper bound on any."""

from __future__ import annotations

import argparse
import signal
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pandas as pd

from design.discrimination import DesignSetting, DiscriminationDesign, discriminate, rival_models
from design.exciting_trajectory import DesignInterrupted, ExcitingTrajectory
from design.information.experiment import Experiment, ParameterValues
from design.limits import tip_path
from design.trajectories.trajectory import Trajectory
from design.trajectory_design import STARTS_WHEN_SLOW, DesignProgress, design
from diagnosis.next_experiment import IntervalDesign, narrowing_motion
from modeling.chain.model import WrenchModel, spatial
from modeling.effects import named
from modeling.errors import InputError
from modeling.kinematics.arm import SpatialArm
from modeling.kinematics.placement import JointKind
from modeling.rig import Convention, Rig
from truewrench.commands.design_request import DesignRequest, NextQuestion, plot_path
from truewrench.commands.results import print_result
from truewrench.files.effects_file import read_effects
from truewrench.files.output import atomic_write, progress_line, say
from truewrench.files.played_motion import write_played

Plan = ExcitingTrajectory | DiscriminationDesign | IntervalDesign
KEYS = ("logdet", "samples", "period", "bound_logdet", "bound_kind", "efficiency", "worst_limit_use", "evaluations")
"""Keys that the JSON always has; null where --tell designs for discrimination."""
BEST_SO_FAR = "this is the best trajectory so far, within its limits"
NOTHING_YET = "no trajectory within the limits was reached yet, and nothing is written"


def result_files(arguments: argparse.Namespace) -> list[Path]:
    """PLAN.csv and its plot, and what robots play."""
    plan = [] if arguments.out is None else [arguments.out, plot_path(arguments.out)]
    return [*plan, *arguments.play]


def run(arguments: argparse.Namespace) -> None:
    """Design the trajectory, write and print it; where interrupted, the best so far, and exit as interrupted.

    The first signal ends the search. Further ones, and all after the search, are ignored until its result is written.
    """
    request = DesignRequest.of(arguments)
    received: list[int] = []
    reasons: list[str] = []
    reached: Plan | None

    def ignore_signals() -> None:
        for number in before:
            signal.signal(number, signal.SIG_IGN)

    def interrupt(number: int, _: object) -> None:
        ignore_signals()
        received.append(number)
        raise KeyboardInterrupt

    before = {number: signal.signal(number, interrupt) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        try:
            if arguments.next is not None:
                reached = next_plan(request, reasons)
            else:
                reached = exciting_plan(request) if arguments.tell is None else discriminating_plan(request)
            ignore_signals()
        except KeyboardInterrupt as interruption:
            reached = interruption.best if isinstance(interruption, DesignInterrupted) else None
        if reached is not None:
            show(request, reached, reasons)
        if received:
            say(f"interrupted: {NOTHING_YET if reached is None else BEST_SO_FAR}")
            raise SystemExit(128 + received[0])
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def show(request: DesignRequest, plan: Plan, reasons: Sequence[str]) -> None:
    """Write and print a result, after the sentences that say why it is designed."""
    arguments = request.options
    if request.not_carried:
        say(request.not_carried)

    def written() -> list[Path]:
        if plan.motion is None or request.rig.limits is None:
            return []
        if arguments.out is not None:
            write(request, plan, arguments.out)
        for path in arguments.play:
            names = request.joint_names
            say(write_played(plan.motion, path, request.rig.limits, names, arguments.samples, request.rig))
        return result_files(arguments)

    excluded = f"\nexcluded, because no trajectory can be designed for them: {', '.join(request.left_out)}"
    head = "".join(f"{sentence}\n" for sentence in reasons) + "\n" * bool(reasons)
    print_result(
        arguments,
        lambda: f"{head}{plan}{excluded if request.left_out else ''}",
        lambda: dict.fromkeys(KEYS) | plan.to_data() | ({"reasons": list(reasons)} if reasons else {}),
        written,
    )


def exciting_plan(request: DesignRequest) -> ExcitingTrajectory:
    """The exciting trajectory of the criterion."""
    asked = request.options
    with request.pool() as executor, progress_line() as progress:
        return design(
            request.rig,
            model=request.model,
            values=request.values,
            prior=request.prior,
            criterion=request.criterion,
            series=request.series,
            samples=asked.samples,
            noise=request.weight,
            starts=asked.starts,
            seed=asked.seed,
            bounded=not asked.no_bound,
            executor=executor,
            progress=lambda step: progress(str(step)),
        )


def discriminating_plan(request: DesignRequest) -> DiscriminationDesign:
    """The trajectory that discriminates between the two effects of --tell, at the parameters of the model file."""
    asked, values = request.options, request.values
    custom = () if asked.effects is None else read_effects(asked.effects)
    effects = {effect.id: effect for effect in (*custom, *request.model.effects)}  # custom effects among them
    one, other = (effects.get(effect_id) or named(effect_id) for effect_id in asked.tell)
    _require_own_criterion(request, "--tell")
    if values is None:
        remedy = f"add --model MODEL.json, of `truewrench fit REC --add {one.id} --out MODEL.json`"
        raise InputError(what="the size of the effects is unknown", where="--tell", remedy=remedy)
    truth, rival = rival_models(request.model, one, other)
    setting = DesignSetting.of(request.rig, series=request.series, samples=asked.samples, noise=request.noise)
    setting.require([truth.with_arm(setting.arm), rival.with_arm(setting.arm)])
    return separating_plan(request, truth, values, [rival])


def _require_own_criterion(request: DesignRequest, option: str) -> None:
    if request.options.averaged or request.options.criterion != "d":
        what = f"--criterion and --averaged do not apply to {option}, which has its own criterion"
        raise InputError(what=what, where=option, remedy="leave them out")


def next_plan(request: DesignRequest, reasons: list[str]) -> Plan:
    """The motion that a diagnosis asks for next; why is added to `reasons`, sentence by sentence."""
    asked = request.options
    if asked.tell is not None:
        what = "--tell names two effects, and --next takes them from the diagnosis"
        raise InputError(what=what, where="--next", remedy="leave one of them out")
    _require_own_criterion(request, "--next")
    question = NextQuestion.of(request, asked.next)
    reasons += question.reasons
    known = question.known
    if question.rivals:
        plan = separating_plan(request, known.designable, known.values, question.rivals)
        if plan.motion is not None:
            reasons.append(question.separation(plan))
            return plan
        reasons.append("no motion of this arm separates them: the simpler one is preferred")
    with request.pool() as executor, progress_line() as progress:
        narrowed = narrowing_motion(
            known,
            request.rig,
            series=request.series,
            samples=asked.samples,
            runs=asked.runs,
            starts=asked.starts,
            seed=asked.seed,
            executor=executor,
            progress=lambda step: progress(str(step)),
        )
    reasons.append(question.narrowing(narrowed))
    return narrowed


def separating_plan(
    request: DesignRequest, truth: WrenchModel, values: ParameterValues, rivals: Sequence[WrenchModel]
) -> DiscriminationDesign:
    """The motion that discriminates a model from its rivals, compared with the D-optimal one of the model."""
    asked = request.options
    with request.pool() as executor, progress_line() as progress:
        exciting, reason = d_optimal_motion(request, truth, executor, lambda step: progress(f"D-optimal, {step}"))
        plan = discriminate(
            request.rig,
            truth,
            values,
            rivals,
            series=request.series,
            samples=asked.samples,
            noise=request.noise,
            exciting=exciting,
            runs=asked.runs,
            starts=asked.starts or STARTS_WHEN_SLOW,
            seed=asked.seed,
            executor=executor,
            progress=lambda step: progress(str(step)),
        )
    if reason:
        say(f"no D-optimal motion to compare with: {reason}")
    return plan


def simulated_repeat(rig: Rig, motion: Trajectory, samples: int) -> str | None:
    """How far the motion repeated in MuJoCo is from the plan, by the tip and by the wrench of a tool at the sensor.

    None of a planar arm, and where MuJoCo is not installed.
    """
    from truewrench.simulated_rig.rigs import SpatialRig, repeat_on_chain

    arm, tip_length = rig.arm, rig.tip_length or 0.0
    if not isinstance(arm, SpatialArm) or find_spec("mujoco") is None:
        return None
    tool, time = SpatialRig(gravity=rig.gravity), motion.series.instants(samples)
    places = [(joint.placement.position, joint.placement.quaternion) for joint in arm.chain]
    chain = [(at, j.axis, j.kind is JointKind.PRISMATIC) for at, j in zip(places, arm.chain, strict=True)]
    states = motion.evaluate(time)
    tip, wrench = repeat_on_chain(tool, chain, (arm.sensor.position, arm.sensor.quaternion), tip_length, states)
    columns = Experiment.of(replace(spatial(rig), convention=Convention.ON_TOOL), arm).columns(*states, motion.period)
    planned = columns @ [*[0.0] * len(tool.channels), tool.mass, *tool.first_moment, *tool.inertia]
    off, apart = (float(np.abs(a).max()) for a in (tip - tip_path(motion, arm, tip_length, time), wrench - planned))
    return (
        f"Simulated repeat (MuJoCo): tip within {off:.1g} m of the plan, wrench of a tool of {tool.mass:g} kg within "
        f"{apart:.1g} N, N m."
    )


def d_optimal_motion(
    request: DesignRequest, model: WrenchModel, executor: Executor, progress: DesignProgress
) -> tuple[Trajectory | None, str]:
    """The D-optimal motion of that model, with which a discriminating one is compared; or None, and why."""
    asked = request.options
    try:
        plan = design(
            request.rig,
            model=model,
            values=request.values,
            series=request.series,
            samples=asked.samples,
            noise=request.noise,
            starts=asked.starts or STARTS_WHEN_SLOW,
            seed=asked.seed,
            bounded=False,
            executor=executor,
            progress=progress,
        )
    except DesignInterrupted:
        raise DesignInterrupted from None  # that motion was designed for something else
    except InputError as error:
        return None, error.what
    return plan.motion, ""


def write(request: DesignRequest, plan: Plan, path: Path) -> None:
    """Write PLAN.csv and its plot."""
    rig, motion = request.rig, plan.motion
    if motion is None or rig.limits is None:
        return
    with atomic_write(path) as temporary:
        pd.DataFrame(motion.to_columns(request.options.samples)).to_csv(temporary, index=False, float_format="%.12g")
    from truewrench.plots.trajectory_plot import trajectory_figure

    repeat = simulated_repeat(rig, motion, request.options.samples)
    if repeat is not None:
        say(repeat)
    figure = trajectory_figure(
        motion,
        rig.limits,
        arm=rig.arm,
        tip_length=rig.tip_length,
        workspace=rig.workspace,
        information=plan.sample_information if isinstance(plan, ExcitingTrajectory) else None,
        notes=[] if repeat is None else [repeat],
    )
    with atomic_write(plot_path(path)) as temporary:
        figure.savefig(temporary, format="png", dpi=160, facecolor="white", bbox_inches="tight")
