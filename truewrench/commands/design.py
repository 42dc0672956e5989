"""`truewrench design`: exciting or discriminating trajectory within the limits, and an upper bound on any."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from truewrench.options import Subcommands, add_workers, positive, print_result

if TYPE_CHECKING:
    from design.discrimination import DiscriminationDesign
    from design.exciting_trajectory import ExcitingTrajectory
    from truewrench.commands.design_request import DesignRequest

SERIES = ("free", "paper", "spline", "rest")
CRITERIA = ("d", "a", "e")
KEYS = ("logdet", "samples", "period", "bound_logdet", "bound_kind", "efficiency", "worst_limit_use", "evaluations")
"""Keys that the JSON always has; null where --tell designs for discrimination."""
BEST_SO_FAR = "this is the best trajectory so far, within its limits"
NOTHING_YET = "no trajectory within the limits was reached yet, and nothing is written"
MAX_COUNT = 1_000_000
"""Limit of counted options: more does not fit into memory."""


def add_to(commands: Subcommands[Any]) -> None:
    """Add the command and its options."""
    text = (
        "Optimise an exciting trajectory within the rig's limits, with an upper bound over all periodic trajectories. "
        "Interrupted (Ctrl-C, SIGTERM) it writes the best so far."
    )
    command = commands.add_parser("design", help="exciting trajectory within the limits", description=text)
    command.add_argument("rig", metavar="RIG", help="rig file (TOML) with an arm and limits")
    command.add_argument("--model", metavar="MODEL.json", help="design for this fitted model instead of the rigid tool")
    text = "d: volume of the confidence ellipsoid; a: mean variance; e: largest variance (default: %(default)s)"
    command.add_argument("--criterion", choices=CRITERIA, default="d", help=text)
    text = "free: a Fourier series for each joint; paper: equation 22.10 of chapter 22; spline: piecewise polynomial;"
    text += " rest: free, starting and ending at standstill (default: %(default)s)"
    command.add_argument("--series", choices=SERIES, default="free", help=text)
    command.add_argument("--harmonics", type=count, default=12, metavar="H", help="of free and rest (default: 12)")
    command.add_argument("--knots", type=count, default=100, metavar="K", help="of spline (default: 100)")
    text = "of spline: 2 has discontinuous acceleration and comes closest to the bound, 3 is continuous (default: 3)"
    command.add_argument("--degree", type=count, default=3, metavar="D", help=text)
    command.add_argument("--ramp", type=positive, metavar="S", help="of rest, s (default: a tenth of the period)")
    command.add_argument("--period", type=positive, default=5.0, metavar="T", help="s (default: 5)")
    command.add_argument("--samples", type=count, default=200, metavar="N", help="of one period (default: 200)")
    command.add_argument("--tell", nargs=2, metavar=("A", "B"), help="discriminate between these two effects")
    command.add_argument(
        "--runs", type=count, default=1, metavar="R", help="repeats of the motion, for --tell (default: 1)"
    )
    text = "weight the readings by the noise of MODEL.json or the rig file; always on with --tell"
    command.add_argument("--weighted", action="store_true", help=text)
    text = "Bayesian design: average over the parameter covariance of MODEL.json, where the information depends on it"
    command.add_argument("--averaged", action="store_true", help=text)
    text = "random starts (default: 24; 48 for few harmonics; 6 for --tell, a workspace, dynamics, six axes)"
    command.add_argument("--starts", type=count, metavar="S", help=text)
    command.add_argument("--seed", type=seed, default=0, metavar="S", help="of the random starts (default: 0)")
    add_workers(command)
    command.add_argument("--no-bound", action="store_true", help="skip the upper bound")
    command.add_argument(
        "--out", type=Path, metavar="PLAN.csv", help="file for the trajectory; its plot is written beside it (.png)"
    )
    command.add_argument("--json", action="store_true", help="print the figures of merit as JSON alone")
    command.set_defaults(run=run, result_files=result_files)


def result_files(arguments: argparse.Namespace) -> list[Path]:
    """PLAN.csv and its plot."""
    from truewrench.commands.design_request import plot_path

    return [] if arguments.out is None else [arguments.out, plot_path(arguments.out)]


def count(text: str) -> int:
    """A whole number above zero; argparse reports a ValueError in one line."""
    value = int(text)
    if not 1 <= value <= MAX_COUNT:
        raise ValueError(text)
    return value


def seed(text: str) -> int:
    """A whole number from zero on."""
    value = int(text)
    if value < 0:
        raise ValueError(text)
    return value


def run(arguments: argparse.Namespace) -> None:
    """Design the trajectory, write and print it; where interrupted, the best so far, and exit as interrupted.

    The first signal ends the search. Further ones, and all after the search, are ignored until its result is written.
    """
    import signal

    from design.exciting_trajectory import DesignInterrupted
    from truewrench.commands.design_request import DesignRequest
    from truewrench.files.output import say

    request = DesignRequest.of(arguments)
    received: list[int] = []
    reached: ExcitingTrajectory | DiscriminationDesign | None

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
            reached = exciting_plan(request) if arguments.tell is None else discriminating_plan(request)
            ignore_signals()
        except KeyboardInterrupt as interruption:
            reached = interruption.best if isinstance(interruption, DesignInterrupted) else None
        if reached is not None:
            show(request, reached)
        if received:
            say(f"interrupted: {NOTHING_YET if reached is None else BEST_SO_FAR}")
            raise SystemExit(128 + received[0])
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def show(request: DesignRequest, found: ExcitingTrajectory | DiscriminationDesign) -> None:
    """Write and print a result."""
    arguments = request.options
    files = [] if found.motion is None else result_files(arguments)
    if files:
        write(request, found, arguments.out)
    excluded = f"\nexcluded, because no trajectory can be designed for them: {', '.join(request.left_out)}"
    print_result(
        arguments,
        lambda: f"{found}{excluded if request.left_out else ''}",
        lambda: dict.fromkeys(KEYS) | found.to_data(),
        files,
    )


def exciting_plan(request: DesignRequest) -> ExcitingTrajectory:
    """The exciting trajectory of the criterion."""
    from design.trajectory_design import design
    from truewrench.files.output import progress_line

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
    from design.discrimination import discriminate, rival_models
    from design.trajectory_design import STARTS_WHEN_SLOW
    from modeling.effects import named
    from modeling.errors import InputError
    from truewrench.files.output import progress_line

    asked, values = request.options, request.values
    known = {effect.id: effect for effect in request.model.effects}  # custom effects among them
    one, other = (known.get(effect_id) or named(effect_id) for effect_id in asked.tell)
    if asked.averaged or asked.criterion != "d":
        what = "--criterion and --averaged do not apply to --tell, which has its own criterion"
        raise InputError(what=what, where="--tell", remedy="leave them out")
    if values is None:
        remedy = f"add --model MODEL.json, of `truewrench fit REC --add {one.id} --out MODEL.json`"
        raise InputError(what="the size of the effects is unknown", where="--tell", remedy=remedy)
    truth, rival = rival_models(request.model, one, other)
    with request.pool() as executor, progress_line() as progress:
        return discriminate(
            request.rig,
            truth,
            values,
            [rival],
            series=request.series,
            samples=asked.samples,
            noise=request.noise,
            runs=asked.runs,
            starts=asked.starts or STARTS_WHEN_SLOW,
            seed=asked.seed,
            executor=executor,
            progress=lambda step: progress(str(step)),
        )


def write(request: DesignRequest, found: ExcitingTrajectory | DiscriminationDesign, path: Path) -> None:
    """Write PLAN.csv and its plot."""
    import pandas as pd

    from design.exciting_trajectory import ExcitingTrajectory
    from truewrench.commands.design_request import plot_path
    from truewrench.files.output import atomic_write
    from truewrench.plots.trajectory_plot import trajectory_figure

    rig, motion = request.rig, found.motion
    if motion is None or rig.limits is None:
        return
    with atomic_write(path) as temporary:
        pd.DataFrame(motion.to_columns(request.options.samples)).to_csv(temporary, index=False, float_format="%.12g")
    figure = trajectory_figure(
        motion,
        rig.limits,
        arm=rig.arm,
        tip_length=rig.tip_length,
        workspace=rig.workspace,
        information=found.sample_information if isinstance(found, ExcitingTrajectory) else None,
    )
    with atomic_write(plot_path(path)) as temporary:
        figure.savefig(temporary, format="png", dpi=160, facecolor="white", bbox_inches="tight")
