"""`truewrench fit`: the parameters of one given model."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from truewrench.commands.options import Subcommands, add_recordings, add_repeatable

if TYPE_CHECKING:
    from diagnosis.comparison import Comparison
    from modeling.model import WrenchModel


def add_to(commands: Subcommands[Any]) -> None:
    """Add the command and its options."""
    text = "Estimate the rigid tool, with the effects that you add, from recordings of one rig and tool."
    command = commands.add_parser("fit", help="estimate one given model", description=text)
    add_recordings(command)
    add_repeatable(command, "--add", metavar="ID", text="effect to add")
    add_repeatable(command, "--drop", metavar="ID", text="effect to leave out again")
    command.add_argument("--out", type=Path, metavar="MODEL.json", help="file for the model")
    command.add_argument("--json", action="store_true", help="print the model and its errors as JSON alone")
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Fit, write the model, print."""
    from diagnosis.comparison import comparison_of
    from estimation.fit import fit
    from truewrench.case import Case, sign_data, sign_sentence
    from truewrench.model_file import ModelFile
    from truewrench.output import progress_line, replacing
    from truewrench.summary import table_of

    case = Case.read(arguments.recordings, rig=arguments.rig)
    model = changed(case.model, arguments.add, arguments.drop)
    with progress_line() as progress:
        progress("fit")
        fitted = fit(model, case.training)
        comparisons = [comparison_of(fitted, i) for i in range(len(case.training))]
    saved = ModelFile.of(fitted)
    if arguments.out is not None:
        with replacing(arguments.out) as path:
            path.write_text(saved.to_text(), encoding="utf-8")
    if arguments.json:
        data = saved.to_data() | {"recordings": [comparison_data(c) for c in comparisons]}
        data |= {} if case.sign is None else {"sign": sign_data(case.sign)}
        print(json.dumps(data, indent=2, allow_nan=False))
        return
    parts = [] if case.sign is None else [sign_sentence(case.sign)]
    parts += [table_of(fitted.parameters), *(f"{c.recording.name}:\n{c}" for c in comparisons)]
    parts += [] if arguments.out is None else [f"Written: {arguments.out}"]
    print("\n\n".join(parts))


def changed(model: WrenchModel, add: list[str], drop: list[str]) -> WrenchModel:
    """The model with and without the effects of these ids.

    Raises InputError for ids that are unknown, added twice, or dropped without being in the model.
    """
    from modeling.effects import named
    from modeling.errors import InputError

    for effect_id in add:
        model = model + named(effect_id)
    for effect_id in drop:
        effect = named(effect_id)
        if effect not in model.effects:
            remedy = "drop only what --add has added"
            raise InputError(what=f"'{effect_id}' is not in the model", where="--drop", remedy=remedy)
        model = model.without(effect_id)
    return model


def comparison_data(comparison: Comparison) -> dict[str, Any]:
    """How well a recording is explained, as in `result.json`: numbers finite or None."""
    explainable = comparison.explainable_rms
    return {
        "name": comparison.recording.name,
        "noise_floor": dict(comparison.noise_floor),
        "noise_source": comparison.noise.source.value,
        "misfit": comparison.misfit,
        "lack_of_fit_p": comparison.lack_of_fit,
        "rms": dict(comparison.rms),
        "explainable_rms": None if explainable is None else dict(explainable),
    }
