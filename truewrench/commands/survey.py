"""`truewrench survey`: diagnosis of many recordings, on all cores or on a Dask cluster."""

from __future__ import annotations

import argparse
from pathlib import Path

from truewrench.commands.results import print_result
from truewrench.files.output import progress_line
from truewrench.surveying.survey import FILES, survey


def result_files(arguments: argparse.Namespace) -> list[Path]:
    """The files in the folder of --out that have a name of their own."""
    return [arguments.out / name for name in FILES]


def run(arguments: argparse.Namespace) -> None:
    """Diagnose the recordings, write the files, print the survey."""
    with progress_line() as progress:
        surveyed = survey(
            arguments.recordings,
            rig=arguments.rig,
            out=arguments.out,
            scheduler=arguments.scheduler,
            workers=arguments.workers,
            one_run=arguments.no_period,
            progress=progress,
        )
    print_result(arguments, lambda: surveyed, surveyed.to_data, lambda: result_files(arguments))
