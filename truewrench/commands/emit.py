"""`truewrench emit`: generated code of a base model's regressor or of a fitted model."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from modeling.codegen.code_target import code_target, target_names
from truewrench.commands.options import Subcommands, positive

if TYPE_CHECKING:
    from modeling.codegen.generated_code import GeneratedCode

BASES = ("planar", "spatial")


def add_to(commands: Subcommands[Any]) -> None:
    """Add the command and its options."""
    text = (
        "Generate code: the regressor of a base model, or prediction and contact wrench of a fitted model, sample by"
        " sample. The operation counts are printed."
    )
    command = commands.add_parser("emit", help="generate code of a model", description=text)
    what = "model file of `fit --out` or `diagnose --out`, or a base model: planar, spatial"
    command.add_argument("model", metavar="MODEL.json|planar|spatial", help=what)
    command.add_argument("--to", required=True, choices=target_names(), help="target language")
    text = "sampling rate of the code; needed for a model with lag, delay, hysteresis or a flexible tip"
    command.add_argument("--rate", type=positive, metavar="HZ", help=text)
    command.add_argument("--out", type=Path, metavar="FILE", help="file for the code (default: standard output)")
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Write the code, print its operation counts (on standard error if the code is on standard output)."""
    from truewrench.files.output import atomic_write, require_writable_folder

    if arguments.out is not None:
        require_writable_folder(arguments.out.parent)
    code = code_of(arguments.model, arguments.to, arguments.rate)
    text = code.text if code.text.endswith("\n") else code.text + "\n"
    if arguments.out is None:
        sys.stdout.write(text)
        print(code.table, file=sys.stderr)
        return
    with atomic_write(arguments.out) as path:
        path.write_text(text, encoding="utf-8", newline="\n")
    print(f"{code.table}\n\nWritten: {arguments.out}")


def code_of(model: str, target: str, rate: float | None) -> GeneratedCode:
    """Generated code of a base model by its name, or of a model file; `target` as in `target_names`."""
    from importlib.metadata import version

    from modeling.codegen.fitted_model import FittedModel
    from modeling.codegen.generated_code import GeneratedCode
    from modeling.codegen.rigid_tool_regressor import RigidToolRegressor
    from modeling.errors import InputError
    from modeling.space import Space
    from truewrench.files.model_file import ModelFile

    source = f"truewrench {version('truewrench')}"
    if model not in BASES and not Path(model).is_file():
        remedy = "give planar, spatial, or the path of a model file"
        raise InputError(what="neither a base model nor a model file", where=model or "MODEL", remedy=remedy)
    if model in BASES:
        space = Space.PLANE if model == "planar" else Space.SPACE
        return GeneratedCode.of_base(RigidToolRegressor(space), code_target(target), source)
    known = ModelFile.read(model).calibration
    fitted = FittedModel.of(known.model, known.theta, None if rate is None else 1 / rate)
    return GeneratedCode.of_fitted(fitted, code_target(target), source)
