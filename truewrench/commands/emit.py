"""`truewrench emit`: a model as code that leaves the project."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from truewrench.commands.options import Subcommands

if TYPE_CHECKING:
    from modeling.emit.code import Code, Language

LANGUAGES = ("numpy", "casadi", "c", "latex")
BASES = ("planar", "spatial")


def add_to(commands: Subcommands[Any]) -> None:
    """Add the command and its options."""
    text = (
        "Write a model as code: the regressor of a base model, or a fitted model with its effects, to predict and"
        " compensate sample by sample. The operations that it takes are printed, beside the code."
    )
    command = commands.add_parser("emit", help="the regressor and the prediction as code", description=text)
    what = "model file of `fit --out` or `diagnose --out`, or a base model: planar, spatial"
    command.add_argument("model", metavar="MODEL.json|planar|spatial", help=what)
    command.add_argument("--to", required=True, choices=LANGUAGES, help="what to write it in")
    text = "samples per second that the code will see; needed when the fitted sensor lags, delays or has play"
    command.add_argument("--rate", type=rate, metavar="HZ", help=text)
    command.add_argument("--out", type=Path, metavar="FILE", help="file for the code (default: standard output)")
    command.set_defaults(run=run)


def rate(text: str) -> float:
    """A number above zero; argparse turns a ValueError into one line."""
    value = float(text)
    if not 0 < value < float("inf"):
        raise ValueError(text)
    return value


def run(arguments: argparse.Namespace) -> None:
    """Write the code, and what it takes: on standard error where the code itself is on standard output."""
    from modeling.emit.code import Language
    from truewrench.output import replacing, require_folder

    if arguments.out is not None:
        require_folder(arguments.out.parent)
    code = code_of(arguments.model, Language(arguments.to), arguments.rate)
    text = code.text if code.text.endswith("\n") else code.text + "\n"
    if arguments.out is None:
        sys.stdout.write(text)
        print(operations(code), file=sys.stderr)
        return
    with replacing(arguments.out) as path:
        path.write_text(text, encoding="utf-8", newline="\n")
    print(f"{operations(code)}\n\nWritten: {arguments.out}")


def code_of(model: str, language: Language, rate: float | None) -> Code:
    """The code of a base model by its name, or of a model file."""
    from importlib.metadata import version

    from modeling.emit.base import BaseRegressor
    from modeling.emit.code import Code
    from modeling.emit.fitted import FittedModel
    from modeling.errors import InputError
    from modeling.space import Space
    from truewrench.model_file import ModelFile

    source = f"truewrench {version('truewrench')}"
    if model not in BASES and not Path(model).is_file():
        remedy = "give planar, spatial, or the path of a model file"
        raise InputError(what="no base model and no file is called that", where=model or "MODEL", remedy=remedy)
    if model in BASES:
        space = Space.PLANE if model == "planar" else Space.SPACE
        return Code.of_base(BaseRegressor(space), language, source)
    known = ModelFile.read(model).calibration
    fitted = FittedModel.of(known.model, known.theta, None if rate is None else 1 / rate)
    return Code.of_fitted(fitted, language, source)


def operations(code: Code) -> str:
    """What one evaluation of each part takes, as a table."""
    from estimation.fit import table
    from modeling.emit.code import OPERATIONS

    return table(OPERATIONS, code.rows())
