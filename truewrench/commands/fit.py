"""`truewrench fit`: parameter estimates of a given model."""

from __future__ import annotations

import argparse
import re
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from diagnosis.comparison.comparison import Comparison
from diagnosis.comparison.model_comparison import compare
from diagnosis.screening.score_test import model_initial_values
from estimation.case import Case
from estimation.fit import Fit, fit_case
from estimation.least_squares.bounds import Bounds
from estimation.least_squares.constraints import Constraints
from estimation.least_squares.prior import Prior
from estimation.load_advice import LoadAdvice
from estimation.reading.log_reader import episode_of
from estimation.reading.log_reading import is_recording
from estimation.readings.doubted_reading import DoubtedReading
from estimation.recordings.column_table import table_file
from estimation.robust_fit import robust_fit_case
from estimation.streaming.chunk_information import linear_regressor_map, required_signals
from estimation.streaming.log_sketch import fit_log, sketch
from estimation.streaming.long_log import read_chunks
from estimation.streaming.streamed_fit import StreamedFit
from modeling.chain.effect import Effect
from modeling.chain.model import planar, spatial
from modeling.chain.pseudo_inertia import Volume
from modeling.errors import InputError
from modeling.noise import NoiseSource
from modeling.rig import PLANAR_CHANNELS, Rig
from modeling.rigid_body import Load
from truewrench.commands.effect_choice import custom_effects, with_effects_changed
from truewrench.commands.results import print_result, provenance_of, suspicions_named
from truewrench.files.case_files import frame_sentences, frames_data, read_case, rigid_tool_case
from truewrench.files.output import atomic_write, progress_line
from truewrench.text.fit_summary import FitSummary
from truewrench.text.tool_text import axes_sentence

if TYPE_CHECKING:
    from estimation.budget import Budget
    from estimation.set_bounds import SetBounds

LOADS_LEFT_OUT = "The std of the loads are in none of these: a budget is of least squares, and of a tool that is known."
"""Said in place of the budget."""
IN_MEMORY_ONLY = (
    *("robust", "bounds", "physical", "inside", "prior", "error_bound"),
    *("runs", "effects", "validate", "period", "read", "budget", "load", "next_load"),
)
"""Options that need the whole recording in memory."""
STREAMED_ROWS = 500_000
"""Rows from which on a log is read in chunks of itself: in memory so many take half a minute and a gigabyte."""


def run(arguments: argparse.Namespace) -> None:
    """Fit, write the model file, print the summary."""
    if arguments.stream:
        require_streamable(arguments)
    if not (arguments.stream or is_long_log(arguments)) or not run_stream(arguments):
        run_in_memory(arguments)


def run_in_memory(arguments: argparse.Namespace) -> None:
    """Fit of whole recordings."""
    constraints, error_bound = constraints_of(arguments), error_bound_of(arguments)
    budget = budget_of(arguments)
    case = read_case(
        arguments.recordings,
        validation=arguments.validate,
        rig=arguments.rig,
        period=arguments.period,
        one_run=arguments.no_period,
        read=arguments.read,
        as_read=arguments.as_read,
        loads=arguments.load,
    )
    custom = custom_effects(arguments.effects, case)
    case = replace(case, model=with_effects_changed(case.model, arguments.add, arguments.drop, custom))
    with suspicions_named((*case.recordings, *case.held_out)), progress_line() as progress:
        progress("fit")
        summary = fit_summary_of(case, constraints, robust=arguments.robust)
        case = case.with_fitted_gravity(summary.fit.model, summary.fit.values)
        if arguments.budget is not None:
            progress("budget")
        budgeted = budget(summary, custom)
    certain = set_bounds_of(error_bound, summary.fit)
    advice = load_advice_of(arguments.next_load, summary)
    further = {"set_bounds": certain, "budget": budgeted, "next_load": advice}
    print_fit(
        arguments,
        summary.fit,
        lambda: summary.to_data(case) | {name: r.to_data() for name, r in further.items() if r is not None},
        lambda: "\n\n".join(
            [
                summary.text(case, runs=arguments.runs, verbose=arguments.verbose),
                *([] if certain is None else [str(certain)]),
                *([LOADS_LEFT_OUT] if budgeted is None and is_uncertain(summary.fit) else []),
                *([] if budgeted is None else [f"Budget, of which the std above have the noise alone:\n{budgeted}"]),
                *([] if advice is None else [f"Next load:\n{advice}"]),
            ]
        ),
        lambda: write_report(arguments, summary, frame_sentences(case)),
        summary.misfitting,
        summary.unknown_tool,
        case.readings,
        budgeted,
    )


def error_bound_of(arguments: argparse.Namespace) -> dict[str, float]:
    """The errors of --error-bound; InputError, before any work, where one is stated twice."""
    stated = dict(arguments.error_bound)
    if len(stated) < len(arguments.error_bound):
        raise InputError(what="a channel is stated twice", where="--error-bound", remedy="state each channel once")
    return stated


def set_bounds_of(stated: Mapping[str, float], fitted: Fit) -> SetBounds | None:
    """The intervals that hold for the errors of --error-bound; None without any."""
    if not stated:
        return None
    from estimation.set_bounds import set_bounds  # loads scipy.optimize

    return set_bounds(fitted, stated)


def load_advice_of(loads: Sequence[Load], summary: FitSummary) -> LoadAdvice | None:
    """Which of the loads of --next-load to hang next; None without any. InputError where no tool is known."""
    if not loads:
        return None
    if summary.unknown_tool:
        what = f"no load is advised of a tool that is not known, as {summary.unknown_tool}"
        raise InputError(what=what, where="--next-load", remedy="leave out --next-load to see the fit")
    return LoadAdvice.of(summary.fit, loads)


def is_uncertain(fitted: Fit) -> bool:
    """Whether a known load that its recordings carried is stated with a std."""
    loads = [load for recording in fitted.recordings for load in recording.loads]
    return any(load.known and (load.mass_std or load.at_std) for load in loads)


def budget_of(arguments: argparse.Namespace) -> Callable[[FitSummary, Sequence[Effect]], Budget | None]:
    """What makes the budget of --budget and of the recordings' loads, of a fit and custom effects; None without any.

    Raises InputError, before any work, for a budget that cannot be.
    """
    unstated = arguments.budget is None and arguments.monte_carlo is not None
    remedy = "give --budget FILE, or the std of the loads: 2.000+-0.001@0,0,0.05+-0.001"
    nothing = InputError(what="there is no budget to check", where="--monte-carlo", remedy=remedy)
    if unstated and not arguments.load and arguments.rig is None:
        raise nothing
    if arguments.budget is not None and arguments.robust:
        what = "a budget is propagated by the derivatives of least squares"
        raise InputError(what=what, where="--budget", remedy="leave out --robust")
    trials, statement = arguments.monte_carlo or 0, None
    if arguments.budget is not None:
        from estimation.budget import stated_budget  # with the schema of its file

        statement = stated_budget(arguments.budget, trials)

    def of(summary: FitSummary, custom: Sequence[Effect]) -> Budget | None:
        if statement is None and (not is_uncertain(summary.fit) or arguments.robust or summary.unknown_tool):
            if unstated:
                raise nothing
            return None
        if summary.unknown_tool:
            what = f"there is no budget of a tool that is not known, as {summary.unknown_tool}"
            raise InputError(what=what, where="--budget", remedy="leave out --budget to see the fit")
        from estimation.budget import budget

        return budget(summary.fit, statement, effects=custom, monte_carlo=trials)

    return of


def write_report(arguments: argparse.Namespace, summary: FitSummary, frames: Sequence[str]) -> list[Path]:
    """Write the report of --report, if any; return its files."""
    if arguments.report is None:
        return []
    from truewrench.reports.fit_report import fit_report

    inputs = (arguments.rig, arguments.effects, arguments.bounds, arguments.prior)
    provenance = provenance_of(arguments, *arguments.recordings, *arguments.validate, *inputs)
    return fit_report(summary, provenance, frames).write(arguments.report)


def require_streamable(arguments: argparse.Namespace) -> None:
    """Raise InputError for options that need the whole recording in memory, and for several logs."""
    for option in IN_MEMORY_ONLY:
        if getattr(arguments, option):
            what = "not available for a streamed log"
            raise InputError(
                what=what, where=f"--{option.replace('_', '-')}", remedy="leave it out, or fit without --stream"
            )
    for log in arguments.recordings:
        if episode_of(Path(log)) is not None:
            remedy = f"leave --stream out, or write it first: `{shlex.join(['truewrench', 'import', log])} --out REC`"
            raise InputError(what="an episode of a data set is read as a whole", where=log, remedy=remedy)
    if len(arguments.recordings) > 1:
        what = "several logs were given"
        raise InputError(what=what, where="--stream", remedy="stream one log; `tw.fit` takes the chunks of many")


def is_long_log(arguments: argparse.Namespace) -> bool:
    """Whether the recording is one long run with its derivatives recorded, and nothing asks for all of it at once."""
    path = Path(arguments.recordings[0])
    if len(arguments.recordings) > 1 or any(getattr(arguments, option) for option in IN_MEMORY_ONLY):
        return False
    if not path.is_file() or not is_recording(path) or "repeat" in table_file(path).names:
        return False
    rig = None if arguments.rig is None else Rig.read(arguments.rig)
    try:
        return (rig is None or not rig.columns) and read_chunks(path, rig=rig).rows > STREAMED_ROWS
    except InputError:  # it lacks what streaming needs
        return False


def run_stream(arguments: argparse.Namespace) -> bool:
    """Fit one log chunk by chunk, write the model file, print the estimates; False where it is to be read as a whole.

    Frames, and whether the model fits, are judged by a sketch of the log. A reading that it proposes is said first of
    a fit as read, as of a log in memory; where one is adopted, or the model is not linear, a log is streamed only if
    that was asked for. InputError as `sketch` and `fit_log`, and for readings that --stream does not apply.
    """
    log = read_chunks(arguments.recordings[0], rig=None if arguments.rig is None else Rig.read(arguments.rig))
    try:
        tool = (planar if log.channels == PLANAR_CHANNELS else spatial)(log.rig)
        inputs = required_signals(with_effects_changed(tool, arguments.add, arguments.drop))
        case = rigid_tool_case([sketch(log, inputs)], [], log.rig, as_read=arguments.as_read)
    except InputError:
        if arguments.stream:
            raise
        return False  # which says it with the row in the file
    case = replace(case, model=with_effects_changed(case.model, arguments.add, arguments.drop))
    adopted = any(reading.adopted for reading in case.readings)
    if not arguments.stream and (adopted or linear_regressor_map(case.model) is None):
        return False
    if adopted:
        what = case.readings[0].sentence.rstrip(".")
        raise InputError(what=what, where=str(log.path), remedy="fit without --stream")
    with suspicions_named(case.recordings), progress_line() as progress:
        progress("fit of a sketch")
        summary = fit_summary_of(case, None, robust=False)
        if summary.fit.noise[0].left_out and not arguments.stream:
            return False
        progress("fit")
        sketched = summary.fit
        # Of a model that fits, all rows tell more; what another lacks is in the spectrum of the sketch's residual.
        least = [estimate.std if summary.misfitting else 0.0 for estimate in sketched.parameters.values()]
        fit = fit_log(log, sketched, np.array(least))
        case = case.with_fitted_gravity(fit.model, fit.values)
    print_fit(
        arguments,
        fit,
        lambda: streamed_data(fit, summary) | frames_data(case),
        lambda: streamed_text(fit, summary, case),
        lambda: write_report(arguments, summary, [*frame_sentences(case), sketched_sentence(fit, summary)]),
        misfitting=summary.misfitting,
        tool_unknown=summary.unknown_tool,
        readings=case.readings,
    )
    return True


def streamed_data(fit: StreamedFit, summary: FitSummary) -> dict[str, Any]:
    """JSON data in addition to the model."""
    (comparison,) = summary.comparisons
    return {
        "samples": fit.information.rows // len(fit.model.channels),
        "sketched": comparison.recording.samples,
        "misfit": fit.misfit,
        "noise_source": comparison.noise.source.value,
        "fits": not summary.misfitting,
        "tool_unknown": summary.unknown_tool or None,
        "converged": fit.converged,
        "condition": fit.condition if isfinite(fit.condition) else None,
        "unseen": [direction.whole for direction in fit.unidentifiable],
    }


def sketched_sentence(fit: StreamedFit, summary: FitSummary) -> str:
    """What a report of a streamed fit shows."""
    (recording,), samples = summary.fit.recordings, fit.information.rows // len(fit.model.channels)
    return (
        f"What is shown here is of {recording.samples} rows of {samples}, evenly spaced, the estimates too; those of"
        " all rows are printed, and written by --out."
    )


def streamed_text(fit: StreamedFit, summary: FitSummary, case: Case) -> str:
    """Whether the model fits, by the sketch, then the estimates of all rows; the sketch's where no tool is known."""
    (recording,), samples = case.recordings, fit.information.rows // len(fit.model.channels)
    stated = summary.fit.noise[0].source is NoiseSource.RIG
    size = f", reduced chi-square {fit.misfit:.4g}" if stated else "; channels weighted by the noise of their residual"
    origin = "the std are not below what its stretches scatter by" if fit.blocks else "the std are those of the noise"
    read = f"{fit.where}: {samples} samples{size}. Read in chunks as one run; {origin}."
    if summary.unknown_tool:
        return "\n\n".join([summary.text(case), read] if case.misread else [read, summary.text(case)])
    judged = [read, f"By {recording.samples} of them, evenly spaced: {summary.headline()}"]
    frames = frame_sentences(case)
    parts = [*frames, *judged] if case.misread else [*judged, *frames]
    return "\n\n".join([*parts, f"{fit}\n{axes_sentence(fit)}"])


def print_fit(
    arguments: argparse.Namespace,
    fit: Fit | StreamedFit,
    data: Callable[[], dict[str, Any]],
    text: Callable[[], str],
    report: Callable[[], Sequence[Path]] = tuple,
    misfitting: Sequence[str] | None = None,
    tool_unknown: str = "",
    readings: Sequence[DoubtedReading] = (),
    budgeted: Budget | None = None,
) -> None:
    """Write the model file of --out, and print the fit as text or as JSON."""
    saved = None
    if arguments.out is not None or arguments.json:
        from truewrench.files.model_file import ModelFile  # with the parser of formulas

        saved = ModelFile.of(fit, misfitting, tool_unknown, readings, budgeted)

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
        raise InputError(
            what=what, where="--robust", remedy="leave out --robust, or --bounds, --physical, --inside and --prior"
        )
    robust_fit = robust_fit_case(case)
    return FitSummary(robust_fit.fit, robust_fit.intervals(), robust_fit, _compared(robust_fit.fit, case))


def _compared(fitted: Fit, case: Case) -> tuple[Comparison, ...]:
    return tuple(compare(fitted, recording) for recording in case.held_out)


def constraints_of(arguments: argparse.Namespace) -> Constraints | None:
    """Constraints of --bounds, --physical, --inside and --prior; None without any."""
    if not (arguments.bounds or arguments.prior or arguments.physical or arguments.inside):
        return None
    return Constraints(
        bounds=None if arguments.bounds is None else Bounds.read(arguments.bounds),
        physical=arguments.physical,
        prior=None if arguments.prior is None else Prior.read(arguments.prior),
        inside=None if arguments.inside is None else read_volume(arguments.inside),
    )


# The volume of --inside: a box in numbers, or the corners of a mesh (STL, OBJ).

STL_HEAD, STL_TRIANGLE = 84, 50
"""Bytes of a binary STL before its triangles, and of each: normal and three corners as floats, two bytes besides."""
LARGEST_MESH = 1 << 28
"""Bytes: millions of triangles, more than any tool's mesh has."""
NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"


def read_volume(given: str) -> Volume:
    """The box XMIN,XMAX,YMIN,YMAX,ZMIN,ZMAX (m), or what is around a mesh; InputError for neither."""
    cells = given.split(",")
    if len(cells) == 6 and all(re.fullmatch(NUMBER, cell.strip()) for cell in cells):
        numbers = [float(cell) for cell in cells]
        return Volume.box(numbers[::2], numbers[1::2])
    path = Path(given)
    if path.suffix.lower() not in (".stl", ".obj"):
        remedy = "give XMIN,XMAX,YMIN,YMAX,ZMIN,ZMAX in m, or a mesh (.stl, .obj)"
        raise InputError(what="neither a box of six numbers nor a mesh", where=f"--inside {given}", remedy=remedy)
    try:
        with path.open("rb") as stream:
            content = stream.read(LARGEST_MESH + 1)
    except OSError as error:
        raise InputError(what=error.strerror or "cannot be read", where=given, remedy="give a mesh") from None
    if len(content) > LARGEST_MESH:
        raise InputError(what="larger than 256 MiB", where=given, remedy="give a coarser mesh, or a box")
    points = _corners(content, obj=path.suffix.lower() == ".obj")
    if not len(points):
        raise InputError(what="no corners of a mesh", where=given, remedy="give a mesh as STL or OBJ, or a box")
    return Volume.around(points, f"the mesh {path.name}")


def _corners(content: bytes, *, obj: bool) -> NDArray[np.float64]:
    """Corners (n, 3) of a mesh; none where it holds none."""
    if not obj and len(content) >= STL_HEAD:
        count = int(np.frombuffer(content, "<u4", 1, STL_HEAD - 4)[0])
        if len(content) == STL_HEAD + STL_TRIANGLE * count:
            kind = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
            return np.asarray(np.frombuffer(content, kind, count, STL_HEAD)["corners"], dtype=float).reshape(-1, 3)
    word = "v" if obj else "vertex"
    lines = re.findall(rf"^\s*{word}\s+({NUMBER})\s+({NUMBER})\s+({NUMBER})", content.decode("latin-1"), re.MULTILINE)
    return np.array(lines, dtype=float).reshape(-1, 3)
