"""`truewrench design`: the motion that tells most, within the limits, and how good any motion could be."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from truewrench.commands.options import Subcommands, worker_count

if TYPE_CHECKING:
    from design.discrimination import Distinction
    from design.plan import Plan
    from truewrench.design_request import DesignRequest

SERIES = ("free", "paper", "spline", "rest")
CRITERIA = ("d", "a", "e")
KEYS = ("logdet", "samples", "period", "bound_logdet", "bound_kind", "efficiency", "worst_limit_use", "evaluations")
"""What the JSON has in any case; null where --tell asks for something else."""
MOST = 1_000_000
"""Of anything that is counted: above it is a slip, and no memory holds it."""


def add_to(commands: Subcommands[Any]) -> None:
    """Add the command and its options."""
    text = "Find the motion within the rig's limits that tells most of the parameters, and a bound on any."
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
    command.add_argument("--runs", type=count, default=1, metavar="R", help="of the motion, for --tell (default: 1)")
    text = "weight the readings by the noise that MODEL.json or the rig states; --tell always does"
    command.add_argument("--weighted", action="store_true", help=text)
    text = "average over the uncertainty of the parameters in MODEL.json, where the information depends on them"
    command.add_argument("--averaged", action="store_true", help=text)
    text = "random starts (default: 24, and 6 for --tell, a workspace, effects that remember, six axes)"
    command.add_argument("--starts", type=count, metavar="S", help=text)
    command.add_argument("--seed", type=seed, default=0, metavar="S", help="of the starts (default: 0)")
    text = "processes for the starts and the bound; any number finds the same (default: one for each core)"
    command.add_argument("--workers", type=worker_count, metavar="N", help=text)
    command.add_argument("--no-bound", action="store_true", help="leave out the bound")
    command.add_argument("--out", type=Path, metavar="PLAN.csv", help="file for the motion; its picture goes beside it")
    command.add_argument("--json", action="store_true", help="print the plan's figures as JSON alone")
    command.set_defaults(run=run)


def count(text: str) -> int:
    """A whole number above zero; argparse turns a ValueError into one line."""
    value = int(text)
    if not 1 <= value <= MOST:
        raise ValueError(text)
    return value


def seed(text: str) -> int:
    """A whole number from zero on."""
    value = int(text)
    if value < 0:
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
    from truewrench.design_request import DesignRequest, picture_beside

    request = DesignRequest.of(arguments)
    found = planned(request) if arguments.tell is None else told_apart(request)
    written = arguments.out is not None and found.motion is not None
    if written:
        write(request, found, arguments.out)
    if arguments.json:
        print(json.dumps(dict.fromkeys(KEYS) | found.to_data(), indent=2, allow_nan=False))
        return
    print(found)
    if request.left_out:
        print(f"left out, because no motion can be designed for them: {', '.join(request.left_out)}")
    if written:
        print(f"\nWritten: {arguments.out} and {picture_beside(arguments.out)}")


def planned(request: DesignRequest) -> Plan:
    """The motion that tells most of the parameters."""
    from design.planning import design
    from truewrench.output import progress_line

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


def told_apart(request: DesignRequest) -> Distinction:
    """The motion that separates the two effects of --tell, at the sizes in the model file."""
    from design.discrimination import opponents, tell_apart
    from design.planning import FEWER
    from modeling.effects import named
    from modeling.errors import InputError
    from truewrench.output import progress_line

    asked, values = request.options, request.values
    known = {effect.id: effect for effect in request.model.effects}  # the user's own among them
    one, other = (known.get(effect_id) or named(effect_id) for effect_id in asked.tell)
    if asked.averaged or asked.criterion != "d":
        what = "--criterion and --averaged are not for --tell, which has a criterion of its own"
        raise InputError(what=what, where="--tell", remedy="leave them out")
    if values is None:
        remedy = f"add --model MODEL.json, of `truewrench fit REC --add {one.id} --out MODEL.json`"
        raise InputError(what="nothing says how large the effects are", where="--tell", remedy=remedy)
    truth, rival = opponents(request.model, one, other)
    with request.pool() as executor, progress_line() as progress:
        return tell_apart(
            request.rig,
            truth,
            values,
            [rival],
            series=request.series,
            samples=asked.samples,
            noise=request.noise,
            runs=asked.runs,
            starts=asked.starts or FEWER,
            seed=asked.seed,
            executor=executor,
            progress=lambda step: progress(str(step)),
        )


def write(request: DesignRequest, found: Plan | Distinction, path: Path) -> None:
    """PLAN.csv, and the picture beside it."""
    import pandas as pd

    from design.plan import Plan
    from truewrench.design_request import picture_beside
    from truewrench.output import replacing
    from truewrench.plots.design_plot import design_figure

    rig, motion = request.rig, found.motion
    if motion is None or rig.limits is None:
        return
    figure = design_figure(
        motion,
        rig.limits,
        arm=rig.arm,
        tip_length=rig.tip_length,
        workspace=rig.workspace,
        information=found.sample_information if isinstance(found, Plan) else None,
    )
    with replacing(path) as beside:
        pd.DataFrame(motion.trajectory(request.options.samples)).to_csv(beside, index=False, float_format="%.12g")
    with replacing(picture_beside(path)) as beside:
        figure.savefig(beside, format="png", dpi=160, facecolor="white", bbox_inches="tight")
