"""`truewrench design`: the motion that tells most, within the limits, and how good any motion could be."""

from __future__ import annotations

import argparse
import json
from concurrent.futures import Executor
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from truewrench.commands.options import Subcommands

if TYPE_CHECKING:
    from collections.abc import Callable

    from design.criterion import Criterion
    from design.information import SensorNoise
    from design.motion.series import Series
    from design.plan import Plan
    from modeling.kinematics import Arm
    from modeling.model import WrenchModel
    from modeling.rig import Rig
    from truewrench.model_file import ModelFile

SERIES = ("free", "paper", "spline", "rest")
CRITERIA = ("d", "a", "e")


def add_to(commands: Subcommands[Any]) -> None:
    """Add the command and its options."""
    text = "Find the motion within the rig's limits that tells most of the parameters, and a bound on any motion."
    command = commands.add_parser("design", help="exciting motion within the limits", description=text)
    command.add_argument("rig", metavar="RIG", help="rig file (TOML) with an arm and limits")
    command.add_argument("--model", metavar="MODEL.json", help="design for this fitted model instead of the rigid tool")
    text = "d: volume of the confidence ellipsoid; a: mean variance; e: worst direction (default: %(default)s)"
    command.add_argument("--criterion", choices=CRITERIA, default="d", help=text)
    text = "free: a Fourier series for each joint; paper: equation 22.10; spline: piecewise, for most information;"
    text += " rest: free, from and to a standstill (default: %(default)s)"
    command.add_argument("--series", choices=SERIES, default="free", help=text)
    command.add_argument("--harmonics", type=count, default=12, metavar="H", help="of free and rest (default: 12)")
    command.add_argument("--knots", type=count, default=100, metavar="K", help="of spline (default: 100)")
    text = "of spline: 2 has steps of acceleration and comes nearest to the bound, 3 is continuous (default: 3)"
    command.add_argument("--degree", type=count, default=3, metavar="D", help=text)
    command.add_argument("--ramp", type=seconds, metavar="S", help="of rest, s (default: a tenth of the period)")
    command.add_argument("--period", type=seconds, default=5.0, metavar="T", help="s (default: 5)")
    command.add_argument("--samples", type=count, default=200, metavar="N", help="of one period (default: 200)")
    command.add_argument("--tell", nargs=2, metavar=("A", "B"), help="design for telling these two effects apart")
    text = "weight the readings by the noise that MODEL.json or the rig states"
    command.add_argument("--weighted", action="store_true", help=text)
    command.add_argument("--starts", type=count, default=6, metavar="S", help="random starts (default: 6)")
    command.add_argument("--seed", type=int, default=0, metavar="S", help="of the starts (default: 0)")
    command.add_argument("--workers", type=count, default=1, metavar="W", help="processes for the starts (default: 1)")
    command.add_argument("--no-bound", action="store_true", help="leave out the bound, which takes a minute or so")
    command.add_argument("--out", type=Path, metavar="PLAN.csv", help="file for the motion; its picture goes beside it")
    command.add_argument("--json", action="store_true", help="print the plan's figures as JSON alone")
    command.set_defaults(run=run)


def count(text: str) -> int:
    """A whole number above zero; argparse turns a ValueError into one line."""
    value = int(text)
    if value < 1:
        raise ValueError(text)
    return value


def seconds(text: str) -> float:
    """A number above zero."""
    value = float(text)
    if not 0 < value < float("inf"):
        raise ValueError(text)
    return value


def run(arguments: argparse.Namespace) -> None:
    """Design, write, print."""
    from modeling.rig import Rig
    from truewrench.model_file import ModelFile

    rig = Rig.read(arguments.rig)
    saved = None if arguments.model is None else ModelFile.read(arguments.model)
    plan = planned(arguments, rig, saved)
    if arguments.out is not None:
        write(plan, arguments.out)
    if arguments.json:
        print(json.dumps(plan.to_data(), indent=2, allow_nan=False))
        return
    print(plan)
    if arguments.out is not None:
        print(f"\nWritten: {arguments.out} and {picture_beside(arguments.out)}")


def planned(arguments: argparse.Namespace, rig: Rig, saved: ModelFile | None) -> Plan:
    """The plan that the options ask for."""
    from design.planning import design
    from truewrench.output import progress_line

    model, arm = model_for(rig, saved), arm_of(rig)
    values = None if saved is None else {name: estimate.value for name, estimate in saved.parameters.items()}
    noise = noise_of(rig, saved, model) if arguments.weighted else None
    with pool(arguments.workers) as executor, progress_line() as progress:
        return design(
            rig,
            model=model,
            values=values,
            criterion=criterion_of(arguments.criterion, rig, model, values, noise),
            series=series_of(arguments, arm.joints),
            samples=arguments.samples,
            noise=noise,
            starts=arguments.starts,
            seed=arguments.seed,
            bounded=not arguments.no_bound,
            executor=executor,
            progress=lambda step: progress(str(step)),
        )


def arm_of(rig: Rig) -> Arm:
    """The rig's arm, or one line."""
    from modeling.errors import InputError

    if rig.arm is None:
        what = "a motion is designed for an arm, and the rig has none"
        raise InputError(what=what, where="rig", remedy="state robot.link_lengths or robot.urdf")
    return rig.arm


def model_for(rig: Rig, saved: ModelFile | None) -> WrenchModel:
    """The model file's model, else the rigid tool of the rig; a sign that is still open does not matter here."""
    from dataclasses import replace

    from modeling.model import planar, spatial
    from modeling.rig import Convention
    from modeling.space import Space

    if saved is not None:
        return saved.model.lasting
    model = (planar if arm_of(rig).space is Space.PLANE else spatial)(rig)
    return replace(model, convention=Convention.ON_TOOL) if model.convention is Convention.AUTO else model


def noise_of(rig: Rig, saved: ModelFile | None, model: WrenchModel) -> SensorNoise:
    """The noise of the model file's recording, else what the rig states."""
    from design.information import WhiteNoise

    if saved is not None:
        return WhiteNoise.of_std([saved.noise_floor[channel] for channel in model.channels])
    return WhiteNoise.of_rig(rig, model.channels)


def criterion_of(
    name: str, rig: Rig, model: WrenchModel, values: dict[str, float] | None, noise: SensorNoise | None
) -> Criterion:
    """D, or A or E with each parameter counted in the size that shows as much as the noise does."""
    from design.criterion import AOptimal, DOptimal, EOptimal
    from design.information import Experiment, magnitudes

    if name == "d":
        return DOptimal()
    known = None if values is None else {p.name: values[p.name] for p in model.parameters}
    scale = magnitudes(Experiment.of(model, arm_of(rig), known, noise=noise), rig.limits)
    return AOptimal(scale) if name == "a" else EOptimal(scale)


def series_of(arguments: argparse.Namespace, joints: int) -> Series:
    """The series that the options name."""
    from design.motion.fourier import FreeSeries, PaperSeries
    from design.motion.rest_to_rest import RestToRest
    from design.motion.spline import SplineSeries

    period, harmonics = arguments.period, tuple(range(1, arguments.harmonics + 1))
    free = FreeSeries(joints=joints, harmonics=harmonics, period=period)
    kinds: dict[str, Callable[[], Series]] = {
        "free": lambda: free,
        "paper": lambda: PaperSeries(joints=joints, period=period),
        "spline": lambda: SplineSeries(joints=joints, knots=arguments.knots, degree=arguments.degree, period=period),
        "rest": lambda: RestToRest(inner=free, ramp=arguments.ramp or period / 10),
    }
    return kinds[arguments.series]()


def pool(workers: int) -> AbstractContextManager[Executor | None]:
    """That many processes, or none for one."""
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import get_context

    return nullcontext() if workers == 1 else ProcessPoolExecutor(workers, mp_context=get_context("spawn"))


def write(plan: Plan, path: Path) -> None:
    """PLAN.csv, and the picture beside it."""
    import pandas as pd

    from truewrench.output import replacing
    from truewrench.plots.design_plot import design_figure

    with replacing(path) as beside:
        pd.DataFrame(plan.trajectory()).to_csv(beside, index=False, float_format="%.12g")
    task = plan.task
    figure = design_figure(
        plan.motion,
        task.limits,
        arm=task.arm,
        tip_length=task.tip_length,
        workspace=task.workspace,
        information=plan.sample_information,
    )
    with replacing(picture_beside(path)) as beside:
        figure.savefig(beside, format="png", dpi=160, facecolor="white", bbox_inches="tight")


def picture_beside(path: Path) -> Path:
    """PLAN.png beside PLAN.csv."""
    return path.with_suffix(".png")
