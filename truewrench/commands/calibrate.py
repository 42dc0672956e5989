"""`truewrench calibrate`: the false-alarm rate and the power that one recording gives."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

from truewrench.options import (
    Subcommands,
    add_candidate_choice,
    add_custom_effects,
    add_period,
    add_workers,
    available_cores,
    candidate_effects,
    custom_effects,
    print_result,
    suspicions_named,
    with_effects_changed,
)


def add_to(commands: Subcommands[Any]) -> None:
    """Add the command and its options."""
    text = (
        "Diagnose surrogates of a recording, its fitted model with noise resampled from its residual: how often an"
        " effect is named that is not there, and how often one is found that is hidden at its detectable amount."
    )
    command = commands.add_parser("calibrate", help="false-alarm rate and power of a recording", description=text)
    command.add_argument("recording", metavar="REC", help="recording (CSV or Parquet)")
    command.add_argument("--rig", metavar="RIG", help="rig file (TOML), required for joint angles")
    add_period(command)
    add_candidate_choice(command)
    add_custom_effects(command)
    command.add_argument("--draws", type=_count, metavar="N", help="surrogates in which nothing is missing (100)")
    text = "surrogates for each effect, hidden in them (20; 0 for none)"
    command.add_argument("--power-draws", type=_count_or_none, metavar="N", help=text)
    command.add_argument("--seed", type=_count_or_none, default=0, metavar="S", help="seed of the surrogates (0)")
    command.add_argument("--out", type=Path, metavar="FILE", help="JSON file for `diagnose --calibration`")
    add_workers(command)
    command.add_argument("--json", action="store_true", help="print the result as JSON alone")
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Calibrate, write the file of --out, print rates and powers."""
    from diagnosis.calibrate import DRAWS, POWER_DRAWS, calibrate
    from truewrench.files.calibration_file import write_calibration
    from truewrench.files.data_set import DataSet
    from truewrench.files.output import progress_line

    case = DataSet.read([arguments.recording], rig=arguments.rig, period=arguments.period, one_run=arguments.no_period)
    custom = custom_effects(arguments.effects, case)
    case = replace(case, model=with_effects_changed(case.model, arguments.given, [], custom))
    candidates = candidate_effects(case.model, arguments.only, arguments.without, custom)
    with suspicions_named(case.training), progress_line() as progress:
        found = calibrate(
            case.model,
            case.training[0],
            effects=candidates,
            draws=DRAWS if arguments.draws is None else arguments.draws,
            power_draws=POWER_DRAWS if arguments.power_draws is None else arguments.power_draws,
            seed=arguments.seed,
            progress=progress,
            workers=available_cores() if arguments.workers is None else arguments.workers,
        )
    if arguments.out is not None:
        write_calibration(found, arguments.out)
    print_result(arguments, lambda: found, found.to_data, [] if arguments.out is None else [arguments.out])


MAX_DRAWS = 4096


def _count(text: str) -> int:
    """A whole number of surrogates, at least one."""
    if _count_or_none(text) == 0:
        raise argparse.ArgumentTypeError("at least one surrogate is needed")
    return int(text)


def _count_or_none(text: str) -> int:
    """A whole number from 0 to MAX_DRAWS."""
    if not text.isdecimal() or int(text) > MAX_DRAWS:
        raise argparse.ArgumentTypeError(f"a whole number up to {MAX_DRAWS} is needed, not {text!r}")
    return int(text)
