"""`truewrench survey`: diagnosis of many recordings, on all cores or on a Dask cluster."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from truewrench.options import Subcommands, add_no_period, add_recordings, print_result, worker_count

FOLDER = Path("survey")


def add_to(commands: Subcommands[Any]) -> None:
    """Add the command and its options."""
    text = (
        "Diagnose many recordings of one rig, each by itself. A recording that cannot be diagnosed is a row with its "
        "error; an interrupted survey resumes where it stopped."
    )
    command = commands.add_parser("survey", help="diagnose many recordings, locally or on a cluster", description=text)
    add_recordings(command)
    add_no_period(command)
    place = command.add_mutually_exclusive_group()
    place.add_argument("--scheduler", metavar="tcp://HOST:PORT", help="Dask scheduler")
    place.add_argument(
        "--workers", type=worker_count, metavar="N", help="processes on this machine (default: all cores)"
    )
    out = f"folder for survey.parquet, survey.html and finished outcomes (default: {FOLDER})"
    command.add_argument("--out", type=Path, default=FOLDER, metavar="FOLDER", help=out)
    command.add_argument("--json", action="store_true", help="print the rows as JSON alone")
    command.set_defaults(run=run, result_files=result_files)


def result_files(arguments: argparse.Namespace) -> list[Path]:
    """The files in the folder of --out that have a name of their own."""
    from truewrench.surveying.survey import FILES

    return [arguments.out / name for name in FILES]


def run(arguments: argparse.Namespace) -> None:
    """Diagnose the recordings, write the files, print the survey."""
    from truewrench.files.output import progress_line
    from truewrench.surveying.survey import survey

    with progress_line() as progress:
        found = survey(
            arguments.recordings,
            rig=arguments.rig,
            out=arguments.out,
            scheduler=arguments.scheduler,
            workers=arguments.workers,
            one_run=arguments.no_period,
            progress=progress,
        )
    print_result(arguments, lambda: found, found.to_data, result_files(arguments))
