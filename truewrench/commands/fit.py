"""`truewrench fit`: the parameters of one given model."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from truewrench.commands.options import Subcommands, add_own_effects, add_recordings, add_repeatable

if TYPE_CHECKING:
    from estimation.constrained import Constraints
    from estimation.fit import Fit
    from estimation.recording import Recording
    from estimation.stream.streaming import StreamedFit
    from modeling.effect import Effect
    from modeling.model import WrenchModel
    from truewrench.fit_summary import FitSummary


def add_to(commands: Subcommands[Any]) -> None:
    """Add the command and its options."""
    text = "Estimate the rigid tool, with the effects that you add, from recordings of one rig and tool."
    command = commands.add_parser("fit", help="estimate one given model", description=text)
    add_recordings(command)
    add_repeatable(command, "--add", metavar="ID", text="effect to add")
    add_repeatable(command, "--drop", metavar="ID", text="effect to leave out again")
    add_own_effects(command)
    command.add_argument("--robust", action="store_true", help="let outliers count less (Huber's loss)")
    command.add_argument("--bounds", type=Path, metavar="FILE", help="TOML with intervals, m = [0.1, 3.0]")
    command.add_argument("--physical", action="store_true", help="only tools that some distribution of mass can be")
    command.add_argument("--prior", type=Path, metavar="FILE", help="TOML with a reference tool, and its weight")
    text = "read one long log piece by piece, with the derivatives and the noise that log and rig state"
    command.add_argument("--stream", action="store_true", help=text)
    command.add_argument("--runs", action="store_true", help="print mean error and variance of every repeat")
    command.add_argument("--out", type=Path, metavar="MODEL.json", help="file for the model")
    command.add_argument("--json", action="store_true", help="print the model and its errors as JSON alone")
    command.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Fit, write the model, print."""
    from truewrench.output import progress_line, require_folder

    if arguments.out is not None:
        require_folder(arguments.out.parent)
    if arguments.stream:
        run_stream(arguments)
        return
    from truewrench.case import Case
    from truewrench.own_candidates import own_candidates

    constraints = constraints_of(arguments)
    case = Case.read(arguments.recordings, rig=arguments.rig)
    model = changed(case.model, arguments.add, arguments.drop, own_candidates(arguments.effects, case))
    with progress_line() as progress:
        progress("fit")
        found = estimated(model, case.training, constraints, robust=arguments.robust)
    told(arguments, found.fit, lambda: found.to_data(case.sign), lambda: found.text(case.sign, runs=arguments.runs))


def run_stream(arguments: argparse.Namespace) -> None:
    """Fit one log that need not fit into memory, write the model, print.

    Raises InputError for what cannot be had of a log that passes by.
    """
    from estimation.stream.log_fit import log_fit
    from modeling.errors import InputError
    from modeling.rig import Rig

    for option in ("robust", "bounds", "physical", "prior", "runs", "effects"):
        if getattr(arguments, option):
            what = "a log that passes by cannot be fitted so"
            raise InputError(what=what, where=f"--{option}", remedy="leave it out, or fit without --stream")
    if len(arguments.recordings) > 1:
        what = "several logs were given"
        raise InputError(what=what, where="--stream", remedy="stream one log; `tw.fit` takes the chunks of many")
    rig = None if arguments.rig is None else Rig.read(arguments.rig)
    found = log_fit(Path(arguments.recordings[0]), rig, lambda model: changed(model, arguments.add, arguments.drop))
    samples = found.information.rows // len(found.model.channels)
    data = {
        "samples": samples,
        "misfit": found.misfit,
        "condition": found.condition,
        "unseen": [*map(str, found.unseen)],
    }
    words = f"{found}\n\n{found.where}: {samples} samples, reduced chi-square {found.misfit:.4g}"
    told(arguments, found, lambda: data, lambda: words)


def told(
    arguments: argparse.Namespace,
    found: Fit | StreamedFit,
    data: Callable[[], dict[str, Any]],
    words: Callable[[], str],
) -> None:
    """Write the model where it is asked for, and print it with what else there is to say, as words or as JSON."""
    saved = None
    if arguments.out is not None or arguments.json:
        from truewrench.model_file import ModelFile
        from truewrench.output import replacing

        saved = ModelFile.of(found)
        if arguments.out is not None:
            with replacing(arguments.out) as path:
                path.write_text(saved.to_text(), encoding="utf-8")
    if arguments.json and saved is not None:
        print(json.dumps(saved.to_data() | data(), indent=2, allow_nan=False))
        return
    print(words())
    if arguments.out is not None:
        print(f"\nWritten: {arguments.out}")


def estimated(
    model: WrenchModel, recordings: tuple[Recording, ...], constraints: Constraints | None, *, robust: bool
) -> FitSummary:
    """The fit by least squares, or by Huber's loss.

    Raises InputError when both a loss and constraints are asked for.
    """
    from diagnosis.start import start_values
    from estimation.fit import fit
    from estimation.robust.robust_fit import robust_fit
    from modeling.errors import InputError
    from truewrench.fit_summary import FitSummary

    if not robust:
        fitted = fit(model, recordings, start=start_values(model, recordings), constraints=constraints)
        return FitSummary(fitted, fitted.intervals())
    if constraints is not None:
        what = "a robust loss and constraints cannot be had together"
        raise InputError(what=what, where="--robust", remedy="leave out --robust, or --bounds, --physical and --prior")
    found = robust_fit(model, recordings)
    return FitSummary(found.fit, found.intervals(), found)


def constraints_of(arguments: argparse.Namespace) -> Constraints | None:
    """What the options say of the parameters, None when they say nothing."""
    from estimation.constrained import Bounds, Constraints, Prior

    if arguments.bounds is None and arguments.prior is None and not arguments.physical:
        return None
    return Constraints(
        bounds=None if arguments.bounds is None else Bounds.read(arguments.bounds),
        physical=arguments.physical,
        prior=None if arguments.prior is None else Prior.read(arguments.prior),
    )


def wanted(effect_id: str, own: tuple[Effect, ...] = ()) -> Effect:
    """The effect of that id, one of the user's own or of the catalogue.

    Raises InputError, naming both, when there is none.
    """
    from modeling.effects import named
    from modeling.errors import InputError

    for effect in own:
        if effect.id == effect_id:
            return effect
    try:
        return named(effect_id)
    except InputError as error:
        also = f", or of your own {', '.join(effect.id for effect in own)}" if own else ""
        raise InputError(what=error.what, where=error.where, remedy=error.remedy + also) from None


def changed(model: WrenchModel, add: list[str], drop: list[str], own: tuple[Effect, ...] = ()) -> WrenchModel:
    """The model with and without the effects of these ids, of the catalogue or the user's own.

    Raises InputError for ids that are unknown, added twice, or dropped without being in the model.
    """
    from modeling.errors import InputError

    for effect_id in add:
        model = model + wanted(effect_id, own)
    for effect_id in drop:
        if effect_id not in [effect.id for effect in model.effects]:
            remedy = "drop only what --add has added"
            raise InputError(what=f"'{effect_id}' is not in the model", where="--drop", remedy=remedy)
        model = model.without(effect_id)
    return model
