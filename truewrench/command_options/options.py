"""Options shared by several commands, and how each prints its result."""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Any

from modeling.kinematics.joint import LARGEST_NUMBER

if TYPE_CHECKING:
    from estimation.recordings.recording import Recording
    from truewrench.reports.provenance import Provenance

Subcommands = argparse._SubParsersAction  # argparse has no public name for what add_subparsers returns


def add_recordings(command: argparse.ArgumentParser) -> None:
    """Add the recordings and the rig file."""
    command.add_argument("recordings", nargs="+", metavar="REC", help="recording (CSV or Parquet), one rig and tool")
    command.add_argument("--rig", metavar="RIG", help="rig file (TOML), required for joint angles")


def add_period(command: argparse.ArgumentParser) -> None:
    """Add the options that say how a recording is cut into repeats."""
    either = command.add_mutually_exclusive_group()
    text = "period of the repeated motion of REC, s (default: repeats as a column counts them, or as a period is found)"
    either.add_argument("--period", type=positive, metavar="SECONDS", help=text)
    add_no_period(either)


def add_no_period(command: argparse._ActionsContainer) -> None:
    """Add the option that takes every recording as one run."""
    command.add_argument("--no-period", action="store_true", help="every recording as one run, whatever repeats")


def add_custom_effects(command: argparse.ArgumentParser) -> None:
    """Add the option for a file of custom effects."""
    command.add_argument("--effects", type=Path, metavar="FILE", help="custom effects, formulas in TOML")


def add_report(command: argparse.ArgumentParser) -> None:
    """Add the folder of a report."""
    text = "folder for report.html, self-contained and zoomable, and report.md, for an issue or a lab book"
    command.add_argument("--report", type=Path, metavar="DIR", help=text)


READ = (
    "sources", "recordings", "recording", "models", "model", "on", "validate", "rig", "map", "effects", "bounds",
    "prior", "calibration",
)  # fmt: skip
"""Arguments of all commands that name files which are read."""


def require_results_apart(arguments: argparse.Namespace) -> None:
    """Check before any work that the results of a command can be written, and that none replaces what it reads.

    Where --out is no file, or not the only one, the command's `result_files` are those that it will write.
    Raises InputError.
    """
    given = vars(arguments)
    written = given["result_files"](arguments) if "result_files" in given else [given.get("out"), given.get("plot")]
    if given.get("report") is not None:
        from truewrench.reports.report_files import REPORT_FILES

        written += [arguments.report / name for name in REPORT_FILES]
    if any(written):
        from truewrench.files.output import require_writable_files

        named = [given.get(name) or [] for name in READ]
        read = [Path(path) for paths in named for path in (paths if isinstance(paths, list) else [paths])]
        require_writable_files(filter(None, written), [*read, *_urdf_of(given.get("rig"))])


def _urdf_of(rig: str | None) -> list[Path]:
    """The URDF that a rig file names; what is wrong with that file is said when it is read."""
    from modeling.errors import InputError
    from modeling.text_file import file_text, toml_data

    if rig is None or not Path(rig).is_file():  # a pipe can be read only once
        return []
    try:
        robot = toml_data(file_text(rig, kind="a rig file"), rig).get("robot")
    except InputError:
        return []
    urdf = robot.get("urdf") if isinstance(robot, dict) else None
    return [Path(rig).parent / urdf] if isinstance(urdf, str) else []


def provenance_of(arguments: argparse.Namespace, *files: str | Path | None) -> Provenance:
    """What a report says about itself: the command as typed, and the files that it read."""
    from truewrench.reports.provenance import Provenance

    return Provenance.now(getattr(arguments, "typed", ""), [file for file in files if file is not None])


MAX_WORKERS = 1000


def available_cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


WORKERS = "number of processes (default: one for each core, under Linux); the result does not depend on N"


def add_workers(command: argparse.ArgumentParser, text: str = WORKERS) -> None:
    """Add the number of processes."""
    command.add_argument("--workers", type=worker_count, metavar="N", help=text)


def worker_count(text: str) -> int:
    """A whole number from 1 to MAX_WORKERS."""
    if not text.isdecimal() or not 1 <= int(text) <= MAX_WORKERS:
        raise argparse.ArgumentTypeError(f"a number of at least one, at most {MAX_WORKERS}, is needed, not {text!r}")
    return int(text)


def positive(text: str) -> float:
    """A number above zero; argparse reports a ValueError in one line."""
    value = finite(text)
    if value <= 0:
        raise ValueError(text)
    return value


def finite(text: str) -> float:
    """A number of plausible size; argparse reports a ValueError in one line."""
    value = float(text)
    if not abs(value) < LARGEST_NUMBER:
        raise ValueError(text)
    return value


def add_repeatable(command: argparse.ArgumentParser, *options: str, metavar: str, text: str) -> argparse.Action:
    """Add an option that may be given several times."""
    help_text = f"{text}; may be given several times"
    return command.add_argument(*options, action="append", default=[], metavar=metavar, help=help_text)


def add_verbosity(command: argparse.ArgumentParser) -> None:
    """Add --quiet and --progress."""
    group = command.add_mutually_exclusive_group()
    text = "print nothing but errors and warnings, and with --json the data; files are written"
    group.add_argument("--quiet", action="store_true", help=text)
    text = "progress as lines on stderr, for a log (default: one line, on a terminal only)"
    group.add_argument("--progress", action="store_true", help=text)


@contextmanager
def verbosity(arguments: argparse.Namespace) -> Iterator[None]:
    """What --quiet and --progress ask for, for the time of one command."""
    quiet, lines = getattr(arguments, "quiet", False), getattr(arguments, "progress", False)
    if not quiet and not lines:
        yield
        return
    from truewrench.files.output import ProgressStyle, progress_style

    with ExitStack() as stack:
        stack.enter_context(progress_style(ProgressStyle.LINES if lines else ProgressStyle.SILENT))
        if quiet and not getattr(arguments, "json", False):
            stack.enter_context(redirect_stdout(stack.enter_context(open(os.devnull, "w", encoding="utf-8"))))
        yield


def print_result(
    arguments: argparse.Namespace,
    text: Callable[[], object],
    data: Callable[[], Mapping[str, Any]],
    written: Sequence[Path] = (),
) -> None:
    """Print a result: with --json its data alone, else its text and the files written."""
    if arguments.json:
        print(json.dumps(data(), indent=2, allow_nan=False))
        return
    print(text())
    if written:
        print("\nWritten: " + ", ".join(map(str, written)))


@contextmanager
def suspicions_named(recordings: Sequence[Recording]) -> Iterator[None]:
    """Name what was suspicious when these recordings were read: a line each on stderr, in an InputError the first."""
    from estimation.recordings.reports.reading_report import StepKind
    from modeling.errors import InputError
    from truewrench.files.output import say

    said = [
        f"{recording.name}: {str(step).removeprefix(f'{step.where}: ')}"
        for recording in recordings
        for step in (() if recording.reading is None else recording.reading.of(StepKind.SUSPICIOUS))
    ]
    try:
        yield
    except InputError as error:
        what = "; ".join([error.what, *(line for line in said[:1] if error.what not in line)])
        raise InputError(what=what, where=error.where, remedy=error.remedy) from None
    for line in said:
        say(f"warning: {line}")
