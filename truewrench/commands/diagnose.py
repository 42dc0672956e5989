"""`truewrench diagnose`: which physical effect the model of these recordings is missing."""

from __future__ import annotations

import argparse
import json
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from truewrench.commands.options import Subcommands, add_own_effects, add_recordings, add_repeatable, add_workers

if TYPE_CHECKING:
    from diagnosis.diagnosis import Diagnosis
    from modeling.effect import Effect
    from truewrench.case import Case

FILES = ("report.html", "result.json", "model.json")


def add_to(commands: Subcommands[Any]) -> None:
    """Add the command and its options."""
    text = "Fit the rigid tool, see where it fails, and add the physical effects that explain the rest."
    command = commands.add_parser("diagnose", help="find what the model is missing", description=text)
    add_recordings(command)
    add_repeatable(command, "--validate", metavar="REC2", text="recording of another motion, never fitted")
    add_own_effects(command)
    command.add_argument("--out", type=Path, metavar="DIR", help=f"folder for {', '.join(FILES)}")
    add_workers(command)
    command.add_argument("--json", action="store_true", help="print the result as JSON alone")
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Diagnose, write the files, print."""
    from truewrench.case import Case, sign_data, sign_sentence
    from truewrench.output import folder, require_folder

    if arguments.out is not None:
        require_folder(arguments.out)
    case = Case.read(arguments.recordings, validation=arguments.validate, rig=arguments.rig)
    found = diagnosed(case, _own(arguments.effects, case), arguments.workers)
    out = None if arguments.out is None else folder(arguments.out)
    data = found.to_data() | ({} if case.sign is None else {"sign": sign_data(case.sign)})
    if out is not None:
        write(found, data, out)
    if arguments.json:
        print(json.dumps(data, indent=2, allow_nan=False))
        return
    from truewrench.summary import summary

    print(summary(found))
    if case.sign is not None:
        print(f"\n{sign_sentence(case.sign)}")
    if out is not None:
        print("\nWritten: " + ", ".join(str(out / name) for name in FILES))


def _own(path: Path | None, case: Case) -> tuple[Effect, ...]:
    """The effects of the user's file, none without one."""
    if path is None:
        return ()
    from truewrench.own_candidates import own_candidates

    return own_candidates(path, case)


def diagnosed(case: Case, own: tuple[Effect, ...] = (), workers: int | None = 1) -> Diagnosis:
    """The diagnosis of a case; the user's own effects are candidates beside those of the catalogue.

    `workers` processes share the work, None for all cores.
    Raises InputError when the mass comes out negative.
    """
    from diagnosis.diagnosis import diagnose
    from diagnosis.workers import cores
    from modeling.effects import catalogue
    from truewrench.output import progress_line

    with progress_line() as progress:
        return diagnose(
            case.model,
            case.training,
            validate=case.validation,
            effects=(*catalogue(case.model.space), *own),
            progress=progress,
            workers=cores() if workers is None else workers,
        )


def write(found: Diagnosis, data: dict[str, Any], out: Path) -> None:
    """Write report, result and model into a folder: all of them, or none."""
    from truewrench.model_file import ModelFile
    from truewrench.output import progress_line, replacing
    from truewrench.report import write_report

    with progress_line() as progress, ExitStack() as files:
        progress("write the report")
        report, result, model = (files.enter_context(replacing(out / name)) for name in FILES)
        result.write_text(json.dumps(data, indent=2, allow_nan=False) + "\n", encoding="utf-8")
        model.write_text(ModelFile.of(found.fit).to_text(), encoding="utf-8")
        write_report(found, report)
