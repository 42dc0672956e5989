"""The command line: `truewrench <command>`; exit 0 when the work was done, 2 with one line when it could not be.

Nothing heavy is imported here or by the commands' options, so that `--help` answers at once.
"""

from __future__ import annotations

import argparse
import atexit
import gc
import os
import sys
import traceback
import warnings
from collections.abc import Sequence
from io import TextIOWrapper
from pathlib import Path
from typing import NoReturn

from modeling.errors import InputError, TruewrenchError
from truewrench.commands import compensate, demo, design, diagnose, effects, emit, fit, survey

BAD_INPUT = 2
INTERRUPTED = 130  # 128 + SIGINT, as shells count
RARELY = (50_000, 20, 50)
"""When to look for cycles: what a command makes is needed until it ends, and looking takes a thirtieth of its time."""


class Parser(argparse.ArgumentParser):
    """A parser whose errors are InputErrors: no usage dump, no exit from within."""

    def error(self, message: str) -> NoReturn:
        """Raise what is wrong with the arguments, in one line."""
        raise InputError(what=message, where=self.prog, remedy=f"see `{self.prog} --help`")


class Version(argparse.Action):
    """Print the version and end: it is looked up when somebody asks."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        """Print it."""
        from truewrench import __version__

        print(f"truewrench {__version__}")
        parser.exit()


def parser() -> Parser:
    """The parser of every command."""
    top = Parser(
        prog="truewrench",
        description="Find the physics that the model of a robot's force/torque sensor is missing.",
        epilog="`truewrench COMMAND --help` says more.",
        allow_abbrev=False,
    )
    top.add_argument("--version", action=Version, nargs=0, help="print the version and end")
    commands = top.add_subparsers(metavar="COMMAND", required=True, parser_class=Parser)
    for command in (demo, diagnose, fit, survey, design, compensate, emit, effects):
        command.add_to(commands)
    return top


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code: 0 done, 2 bad input or usage (one line on stderr), 130 interrupted."""
    _prepare(as_program=argv is None)
    try:
        arguments = parser().parse_args(argv)
        arguments.run(arguments)
        sys.stdout.flush()
    except TruewrenchError as error:
        return _refused(str(error))
    except BrokenPipeError:
        # Whoever read the output has had enough; the work is done. Nothing may be flushed into it at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except OSError as error:
        where = error.filename or "output"
        return _refused(f"{where}: {error.strerror or error}; give a place that can be read and written")
    except KeyboardInterrupt:
        return INTERRUPTED
    except Exception as error:
        if argv is not None:
            raise
        return _refused(_fault(error))
    return 0


def _prepare(*, as_program: bool) -> None:
    """Let any character through to the terminal, and keep libraries' warnings to those who ask Python for them."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    if as_program and not sys.warnoptions:
        warnings.simplefilter("ignore")
    if as_program:
        for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
            os.environ.setdefault(variable, "1")  # matrices are tall and thin: threads only wait for one another
        gc.set_threshold(*RARELY)
        atexit.register(gc.freeze)  # nothing is left to be found when the process ends


def _fault(error: Exception) -> str:
    """What to say of an exception that nobody foresaw; a caller in Python gets the exception itself."""
    place = traceback.extract_tb(error.__traceback__)[-1]
    where = f"{Path(place.filename).name}, line {place.lineno}"
    return f"{where}: {type(error).__name__}: {error}; a fault of truewrench: report it with the recording"


def _refused(message: str) -> int:
    print("error:", " ".join(message.split()), file=sys.stderr)
    return BAD_INPUT
