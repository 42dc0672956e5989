# PYTHON_ARGCOMPLETE_OK
"""Command line `truewrench COMMAND`: exit code 0 on success, 2 with one error line for bad input, 130 interrupted.

No numerical library is imported here or by the options of the commands, so that `--help` answers at once.
"""

from __future__ import annotations

import argparse
import os
import shlex
import sys
import traceback
import warnings
from collections.abc import Sequence
from importlib import import_module
from io import TextIOWrapper
from pathlib import Path
from typing import Any, NoReturn

from modeling.errors import InputError, TruewrenchError, missing_package
from modeling.plugins import FOUND
from truewrench import command_parsers
from truewrench.files.output import say
from truewrench.options import add_verbosity, ids_apart, require_results_apart, verbosity

COMMANDS = {
    "demo": command_parsers.demo,
    "import": command_parsers.import_recording,
    "diagnose": command_parsers.diagnose,
    "discover": command_parsers.discover,
    "calibrate": command_parsers.calibrate,
    "fit": command_parsers.fit,
    "compare": command_parsers.compare,
    "survey": command_parsers.survey,
    "design": command_parsers.design,
    "compensate": command_parsers.compensate,
    "emit": command_parsers.emit,
    "effects": command_parsers.effects,
    "workbench": command_parsers.workbench,
}
"""Arguments of each command; what it does is `run` of the module in `truewrench.commands` that is called alike."""
PRINTING = ("emit", "effects")
"""Commands whose text is what was asked for: --quiet has no meaning there."""
EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130
"""128 + SIGINT, as shells count."""
EXIT_CODES = (
    f"Exit code: 0 done, {EXIT_BAD_INPUT} bad input (one line on stderr, nothing half-written),"
    f" {EXIT_INTERRUPTED} interrupted."
)
COMPLETED_BY = 'eval "$(register-python-argcomplete truewrench)" completes commands, options and effects in the shell.'
COMPLETION = "_ARGCOMPLETE"
"""Variable of the environment in which a shell asks for completions."""


class Parser(argparse.ArgumentParser):
    """Argument parser whose errors are InputErrors: no usage text, no exit from within."""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse, each option of effects by as many ids as follow it."""
        options = {option for action in self._actions if action.metavar == "ID" for option in action.option_strings}
        return super().parse_known_args(ids_apart(list(sys.argv[1:] if args is None else args), options), namespace)

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse; InputError, with the help of the subcommand, for what it does not know."""
        options, unknown = self.parse_known_args(args, namespace)
        if unknown:
            prog = getattr(options, "prog", self.prog)
            what = f"unrecognized arguments: {' '.join(unknown)}"
            raise InputError(what=what, where=prog, remedy=f"see `{prog} --help`")
        return options

    def error(self, message: str) -> NoReturn:
        """Raise InputError with argparse's message."""
        raise InputError(what=message, where=self.prog, remedy=f"see `{self.prog} --help`")


class Version(argparse.Action):
    """Print the version and exit; the metadata are read only then."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        """Print the version and exit."""
        from truewrench import __version__

        print(f"truewrench {__version__}")
        parser.exit()


def parser() -> Parser:
    """The parser of every command."""
    top = Parser(
        prog="truewrench",
        description="Identification, residual diagnosis and experiment design for force/torque sensors of robots.",
        epilog=f"See `truewrench COMMAND --help` for the options of a command. {COMPLETED_BY} {EXIT_CODES}",
        allow_abbrev=False,
    )
    top.add_argument("--version", action=Version, nargs=0, help="print the version and exit")
    commands = top.add_subparsers(metavar="COMMAND", required=True, parser_class=Parser)
    for name, add_arguments in COMMANDS.items():
        command = add_arguments(commands)
        command.set_defaults(command=add_arguments.__name__, prog=command.prog)
        command.epilog = " ".join(filter(None, (command.epilog, EXIT_CODES)))
        if name not in PRINTING:
            add_verbosity(command)
    return top


def completed(top: Parser) -> Parser:
    """The parser; when a shell asks for completions it is given them, and the program ends here."""
    if COMPLETION in os.environ:
        import argcomplete

        argcomplete.autocomplete(top)
    return top


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code: 0 done, 2 bad input or usage (one line on stderr), 130 interrupted."""
    _prepare(as_program=argv is None)
    try:
        arguments = _parsed(argv)
        arguments.typed = shlex.join(["truewrench", *(sys.argv[1:] if argv is None else argv)])
        command = import_module(f"truewrench.commands.{arguments.command}")
        require_results_apart(arguments, getattr(command, "result_files", None))
        with verbosity(arguments):
            command.run(arguments)
            for plugin in FOUND:
                if plugin.fault:
                    say(f"warning: {plugin}")
            FOUND.clear()
        sys.stdout.flush()
    except TruewrenchError as error:
        return _print_error(str(error))
    except BrokenPipeError:
        # The reader closed the pipe; the work is done. Nothing may be flushed into it at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except OSError as error:
        where = error.filename or "output"
        return _print_error(f"{where}: {error.strerror or error}; give a place that can be read and written")
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    except Exception as error:
        if isinstance(error, ModuleNotFoundError) and (missing := missing_package(error)) is not None:
            return _print_error(str(missing))
        if argv is not None:
            raise
        return _print_error(_internal_error_text(error))
    return 0


def _parsed(argv: Sequence[str] | None) -> argparse.Namespace:
    """The arguments; --help and --version end here, and what they printed is written out first."""
    try:
        arguments: argparse.Namespace = completed(parser()).parse_args(argv)
    except SystemExit:
        sys.stdout.flush()
        raise
    return arguments


def _open_closed_streams() -> None:
    """Standard streams that whoever started the program has closed lead nowhere, and no file takes their numbers."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the lowest number that is free
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115  as long as the program


def _prepare(*, as_program: bool) -> None:
    """Escape characters that the terminal cannot encode; as a program: no library warnings, and one BLAS thread."""
    if as_program:
        _open_closed_streams()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    if as_program and not sys.warnoptions:
        warnings.simplefilter("ignore")
    if as_program:
        for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
            os.environ.setdefault(variable, "1")  # matrices are tall and thin: threads only wait for one another


def _internal_error_text(error: Exception) -> str:
    """Message of an unexpected exception; a caller in Python gets the exception itself."""
    place = traceback.extract_tb(error.__traceback__)[-1]
    where = f"{Path(place.filename).name}, line {place.lineno}"
    return f"{where}: {type(error).__name__}: {error}; internal error of truewrench; report it with the recording"


def _print_error(message: str) -> int:
    say(f"error: {' '.join(message.split())}")
    return EXIT_BAD_INPUT
