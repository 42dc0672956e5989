"""`truewrench fit`: parameter estimates of a given model."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from diagnosis.comparison.comparison import Comparison
from diagnosis.comparison.model_comparison import compare
from diagnosis.screening.score_test import model_initial_values
from estimation.case import Case
from estimation.fit import Fit, fit_case
from estimation.least_squares.bounds import Bounds
from estimation.least_squares.constraints import Constraints
from estimation.least_squares.prior import Prior
from estimation.readings.doubted_reading import DoubtedReading
from estimation.robust_fit import robust_fit_case
from estimation.streaming.streamed_fit import StreamedFit, fit_long_log
from modeling.errors import InputError
from modeling.rig import Rig
from truewrench.commands.effect_choice import custom_effects, with_effects_changed
from truewrench.commands.results import print_result, provenance_of, suspicions_named
from truewrench.files.case_files import frame_sentences, read_case
from truewrench.files.output import atomic_write, progress_line
from truewrench.text.fit_summary import FitSummary
from truewrench.text.tool_text import axes_sentence


def run(arguments: argparse.Namespace) -> None:
    """Fit, write the model file, print the summary."""
    if arguments.stream:
        run_stream(arguments)
        return
    constraints = constraints_of(arguments)
    case = read_case(
        arguments.recordings,
        validation=arguments.validate,
        rig=arguments.rig,
        period=arguments.period,
        one_run=arguments.no_period,
        read=arguments.read,
        as_read=arguments.as_read,
    )
    custom = custom_effects(arguments.effects, case)
    case = replace(case, model=with_effects_changed(case.model, arguments.add, arguments.drop, custom))
    with suspicions_named((*case.recordings, *case.held_out)), progress_line() as progress:
        progress("fit")
        summary = fit_summary_of(case, constraints, robust=arguments.robust)
        case = case.with_fitted_gravity(summary.fit.model, summary.fit.values)
    print_fit(
        arguments,
        summary.fit,
        lambda: summary.to_data(case),
        lambda: summary.text(case, runs=arguments.runs, verbose=arguments.verbose),
        lambda: [] if arguments.report is None else write_report(arguments, summary, case),
        summary.misfitting,
        summary.unknown_tool,
        case.readings,
    )


def write_report(arguments: argparse.Namespace, summary: FitSummary, case: Case) -> list[Path]:
    """Write the report of --report; return its files."""
    from truewrench.reports.fit_report import fit_report
    from truewrench.reports.report_files import write_report_files

    inputs = (arguments.rig, arguments.effects, arguments.bounds, arguments.prior)
    provenance = provenance_of(arguments, *arguments.recordings, *arguments.validate, *inputs)
    texts = fit_report(summary, provenance, frame_sentences(case))
    return write_report_files(texts, arguments.report)


def run_stream(arguments: argparse.Namespace) -> None:
    """Fit one log chunk by chunk, write the model file, print the estimates.

    Raises InputError for options that need the whole recording in memory.
    """
    for option in ("robust", "bounds", "physical", "prior", "runs", "effects", "validate", "report", "period"):
        if getattr(arguments, option):
            what = "not available for a streamed log"
            raise InputError(what=what, where=f"--{option}", remedy="leave it out, or fit without --stream")
    if len(arguments.recordings) > 1:
        what = "several logs were given"
        raise InputError(what=what, where="--stream", remedy="stream one log; `tw.fit` takes the chunks of many")
    rig = None if arguments.rig is None else Rig.read(arguments.rig)
    fit = fit_long_log(
        Path(arguments.recordings[0]), rig, lambda model: with_effects_changed(model, arguments.add, arguments.drop)
    )
    samples = fit.information.rows // len(fit.model.channels)
    data = {
        "samples": samples,
        "misfit": fit.misfit,
        "condition": fit.condition,
        "unseen": [*map(str, fit.unidentifiable)],
    }
    text = f"{fit.where}: {samples} samples, reduced chi-square {fit.misfit:.4g}\n\n{fit}\n{axes_sentence(fit)}"
    print_fit(arguments, fit, lambda: data, lambda: text)


def print_fit(
    arguments: argparse.Namespace,
    fit: Fit | StreamedFit,
    data: Callable[[], dict[str, Any]],
    text: Callable[[], str],
    report: Callable[[], Sequence[Path]] = tuple,
    misfitting: Sequence[str] | None = None,
    tool_unknown: str = "",
    readings: Sequence[DoubtedReading] = (),
) -> None:
    """Write the model file of --out, and print the fit as text or as JSON."""
    saved = None
    if arguments.out is not None or arguments.json:
        from truewrench.files.model_file import ModelFile  # with the parser of formulas

        saved = ModelFile.of(fit, misfitting, tool_unknown, readings)

    def written() -> list[Path]:
        files = [*report()]
        if arguments.out is not None and saved is not None:
            with atomic_write(arguments.out) as path:
                path.write_text(saved.to_text(), encoding="utf-8")
            files.append(arguments.out)
        return files

    print_result(arguments, text, lambda: (saved.to_data() if saved else {}) | data(), written)


def fit_summary_of(case: Case, constraints: Constraints | None, *, robust: bool) -> FitSummary:
    """Summary of the fit by least squares, or with the Huber loss, compared with the validation recordings too.

    Raises InputError for a robust loss together with constraints.
    """
    if not robust:
        fitted = fit_case(case, start=model_initial_values(case), constraints=constraints)
        return FitSummary(fitted, fitted.intervals(), validation=_compared(fitted, case))
    if constraints is not None:
        what = "a robust loss and constraints cannot be combined"
        raise InputError(what=what, where="--robust", remedy="leave out --robust, or --bounds, --physical and --prior")
    robust_fit = robust_fit_case(case)
    return FitSummary(robust_fit.fit, robust_fit.intervals(), robust_fit, _compared(robust_fit.fit, case))


def _compared(fitted: Fit, case: Case) -> tuple[Comparison, ...]:
    return tuple(compare(fitted, recording) for recording in case.held_out)


def constraints_of(arguments: argparse.Namespace) -> Constraints | None:
    """Constraints of --bounds, --physical and --prior; None without any."""
    if arguments.bounds is None and arguments.prior is None and not arguments.physical:
        return None
    return Constraints(
        bounds=None if arguments.bounds is None else Bounds.read(arguments.bounds),
        physical=arguments.physical,
        prior=None if arguments.prior is None else Prior.read(arguments.prior),
    )
