"""Arguments shared by several commands, with the types of their values; no numerical library is imported here."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, redirect_stdout
from pathlib import Path
from typing import Any

from modeling.effects import catalogue
from modeling.errors import InputError, file_text, quoted, toml_data
from modeling.kinematics.placement import LARGEST_NUMBER
from modeling.rigid_body import Load
from truewrench.files.output import REPORT_FILES, ProgressStyle, progress_style, require_writable_files

PRESETS = (
    *("ur_rtde", "franka", "ros_csv", "ros_bag", "plotjuggler", "orocos", "kinova"),
    *("xyz_quaternion_wrench", "joints_deg_wrench"),
)
"""Names of the layouts of logs, for the options of commands and the workbench's form; none is read here."""


Subcommands = argparse._SubParsersAction  # argparse has no public name for what add_subparsers returns


def add_recordings(command: argparse.ArgumentParser) -> None:
    """Add the recordings and the rig file."""
    command.add_argument("recordings", nargs="+", metavar="REC", help="recording (CSV or Parquet), one rig and tool")
    command.add_argument("--rig", metavar="RIG", help="rig file (TOML), required for joint angles")


def add_loads(command: argparse.ArgumentParser) -> None:
    """Add --load."""
    text = (
        "what REC carried beside the tool: its mass and centre, 2.000+-0.001@0,0,0.05 (kg, m, std behind +-), or a name"
    )
    text += " of a body of unknown mass"
    add_repeatable(command, "--load", metavar="REC=LOAD", text=text, value=load_of)


def load_of(text: str) -> tuple[str, Load]:
    """A recording and a load, as `two_kg.csv=2.0@0,0,0.05`; argparse reports its error in one line."""
    name, _, load = text.rpartition("=")
    if not Path(name).parts:
        raise argparse.ArgumentTypeError(f"{quoted(text)} names no recording; write REC=LOAD")
    return name, body_of(load)


def body_of(text: str) -> Load:
    """A load, as `2.0@0,0,0.05`; argparse reports its error in one line."""
    try:
        return Load.of(text)
    except InputError as error:
        raise argparse.ArgumentTypeError(f"{error.what}; {error.remedy}") from None


def add_period(command: argparse.ArgumentParser) -> None:
    """Add the options that say how a recording is cut into repeats."""
    either = command.add_mutually_exclusive_group()
    text = "period of the repeated motion of REC, s (default: repeats as a column counts them, or as a period is found)"
    either.add_argument("--period", type=positive, metavar="SECONDS", help=text)
    add_no_period(either)


def add_no_period(command: argparse._ActionsContainer) -> None:
    """Add the option that takes every recording as one run."""
    command.add_argument("--no-period", action="store_true", help="every recording as one run, whatever repeats")


def add_readings(command: argparse.ArgumentParser) -> None:
    """Add --read and --as-read."""
    either = command.add_mutually_exclusive_group()
    text = "read the recordings otherwise, as was proposed by this id, such as torque_sign; may be given several times"
    either.add_argument("--read", action="append", default=[], metavar="READING", help=text)
    text = "take the recordings as they are, whatever their readings show of signs, axes and gravity's direction"
    either.add_argument("--as-read", action="store_true", help=text)


def add_custom_effects(command: argparse.ArgumentParser) -> None:
    """Add the option for a file of custom effects."""
    command.add_argument("--effects", type=Path, metavar="FILE", help="custom effects, formulas in TOML")


def add_report(command: argparse.ArgumentParser) -> None:
    """Add the folder of a report."""
    text = "folder for report.html, self-contained and zoomable, and report.md, for an issue or a lab book"
    command.add_argument("--report", type=Path, metavar="DIR", help=text)


READ = (
    "sources", "recordings", "recording", "models", "model", "on", "validate", "rig", "map", "effects", "bounds",
    "prior", "budget", "calibration", "monitor", "next", "sheet",
)  # fmt: skip
"""Arguments of all commands that name files which are read."""


def require_results_apart(
    arguments: argparse.Namespace, files: Callable[[argparse.Namespace], list[Path]] | None
) -> None:
    """Check before any work that the results of a command can be written, and that none replaces what it reads.

    `files` are those that the command will write, None for those of --out and --plot. Raises InputError.
    """
    given = vars(arguments)
    written = [given.get("out"), given.get("plot")] if files is None else files(arguments)
    if given.get("report") is not None:
        written += [arguments.report / name for name in REPORT_FILES]
    if any(written):
        named = [given.get(name) or [] for name in READ]
        read = [Path(path) for paths in named for path in (paths if isinstance(paths, list) else [paths])]
        beside = [] if given.get("next") is None else [model_beside(given["next"])]
        require_writable_files(filter(None, written), [*read, *_urdf_of(given.get("rig")), *beside])


def model_beside(result: Path) -> Path:
    """The model file that `diagnose --out` writes beside result.json."""
    return result.parent / "model.json"


def _urdf_of(rig: str | None) -> list[Path]:
    """The URDF that a rig file names; what is wrong with that file is said when it is read."""
    if rig is None or not Path(rig).is_file():  # a pipe can be read only once
        return []
    try:
        robot = toml_data(file_text(rig, kind="a rig file"), rig).get("robot")
    except InputError:
        return []
    urdf = robot.get("urdf") if isinstance(robot, dict) else None
    return [Path(rig).parent / urdf] if isinstance(urdf, str) else []


MAX_WORKERS = 1000
"""More processes than any machine has cores: a typing error."""


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


def duration(text: str) -> float:
    """A time above zero in s, as `20ms`, `0.02s` or a number; argparse reports its error in one line."""
    scale, number = next(((s, text[: -len(u)]) for u, s in (("ms", 1e-3), ("s", 1.0)) if text.endswith(u)), (1.0, text))
    try:
        return positive(number) * scale
    except ValueError:
        raise argparse.ArgumentTypeError(f"{quoted(text)} is no time above zero, such as 20ms or 0.02s") from None


def finite(text: str) -> float:
    """A number of plausible size; argparse reports a ValueError in one line."""
    value = float(text)
    if not abs(value) < LARGEST_NUMBER:
        raise ValueError(text)
    return value


def named_size(text: str) -> tuple[str, float]:
    """A name and a number above zero, as `fx=0.5`; argparse reports its error in one line."""
    name, _, size = text.partition("=")
    try:
        return name, positive(size)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{quoted(text)} is no name with a size above zero, such as fx=0.5") from None


def add_repeatable(
    command: argparse.ArgumentParser, *options: str, metavar: str, text: str, value: Callable[[str], Any] = str
) -> argparse.Action:
    """Add an option that may be given several times."""
    help_text = f"{text}; may be given several times"
    return command.add_argument(*options, action="append", default=[], metavar=metavar, help=help_text, type=value)


def add_verbosity(command: argparse.ArgumentParser) -> None:
    """Add --quiet and --progress."""
    group = command.add_mutually_exclusive_group()
    text = "print nothing but errors and warnings, and with --json the data; files are written"
    group.add_argument("--quiet", action="store_true", help=text)
    text = "each stage as a line on stderr (default: one line on a terminal; in a log after 10 s, then each minute)"
    group.add_argument("--progress", action="store_true", help=text)


@contextmanager
def verbosity(arguments: argparse.Namespace) -> Iterator[None]:
    """What --quiet and --progress ask for, for the time of one command."""
    quiet, lines = getattr(arguments, "quiet", False), getattr(arguments, "progress", False)
    style = ProgressStyle.LINES if lines else ProgressStyle.SILENT if quiet else ProgressStyle.TERMINAL
    with ExitStack() as stack:
        stack.enter_context(progress_style(style))
        if quiet and not getattr(arguments, "json", False):
            stack.enter_context(redirect_stdout(stack.enter_context(open(os.devnull, "w", encoding="utf-8"))))
        yield


def add_effect_changes(command: argparse.ArgumentParser) -> None:
    """Add --add and --drop."""
    add_effect_ids(command, "--add", text="effect to add")
    add_effect_ids(command, "--drop", text="effect to remove again")


def add_candidate_choice(command: argparse.ArgumentParser) -> None:
    """Add --given, --only and --without."""
    add_effect_ids(command, "--given", "--add", text="effect that the model has already")
    add_effect_ids(command, "--only", text="candidate effect, instead of the whole catalogue")
    add_effect_ids(command, "--without", text="effect that is no candidate")


def add_effect_ids(command: argparse.ArgumentParser, *options: str, text: str) -> None:
    """Add an option that takes one id or several, and may be given several times."""
    action = add_repeatable(command, *options, metavar="ID", text=f"{text}, or several")
    action.completer = catalogue_ids  # type: ignore[attr-defined]  # of argcomplete


def catalogue_ids(**_: object) -> list[str]:
    """The ids of the catalogue's effects, for the shell to complete."""
    return [effect.id for effect in catalogue()]


def ids_apart(arguments: list[str], options: set[str]) -> list[str]:
    """Arguments with `--add A B` or `--add A,B` as `--add A --add B`: an id is a name, no option and no file.

    argparse itself would take the recordings that follow for ids too.
    """
    separated: list[str] = []
    option, ids = "", 0
    for text in arguments:
        if text.startswith("-"):
            option, ids = text if text in options else "", 0
        elif option and ids and (not _are_ids(text) or Path(text).exists()):
            option = ""
        elif option:
            names = [name for name in text.split(",") if name] or [text]
            separated += [option] * (ids > 0)
            separated += [argument for name in names[:-1] for argument in (name, option)]
            text, ids = names[-1], ids + 1
        separated.append(text)
    return separated


def _are_ids(text: str) -> bool:
    """Whether these are names, separated by commas where there are several."""
    return all(name.isidentifier() for name in text.rstrip(",").split(","))
