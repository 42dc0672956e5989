"""`truewrench diagnose`: physical effects missing from the model of recordings."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from diagnosis.calibration import Calibration
from diagnosis.diagnosis import Diagnosis, diagnose_case
from estimation.case import Case
from modeling.chain.effect import Effect
from modeling.effects.geometry import GravityTilt
from truewrench.commands.effect_choice import candidate_effects, custom_effects, with_effects_changed
from truewrench.commands.results import print_result, provenance_of, suspicions_named
from truewrench.files.case_files import frame_sentences, frames_data, read_case
from truewrench.files.output import atomic_write, make_folder, progress_line
from truewrench.text.diagnosis_text import diagnosis_text

if TYPE_CHECKING:
    from truewrench.reports.report_files import Provenance, ReportTexts

FILES = ("report.html", "result.json", "model.json")


def result_files(arguments: argparse.Namespace) -> list[Path]:
    """The files in the folder of --out."""
    return [] if arguments.out is None else [arguments.out / name for name in FILES]


def run(arguments: argparse.Namespace) -> None:
    """Diagnose, write the report files, print the summary."""
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
    calibration = None if arguments.calibration is None else _calibration_of(case, arguments.calibration)
    custom = custom_effects(arguments.effects, case)
    model = with_effects_changed(case.model, arguments.given, [], custom)
    case = replace(case, model=model, tilt_fitted=case.tilt_fitted and GravityTilt.id not in arguments.given)
    candidates = candidate_effects(case, arguments.only, arguments.without, custom)
    with suspicions_named((*case.recordings, *case.held_out)):
        diagnosis = diagnosed(case, candidates)
    diagnosis = diagnosis if calibration is None else diagnosis.calibrated(calibration)
    case = case.with_fitted_gravity(diagnosis.fit.model, diagnosis.fit.values)
    data = diagnosis.to_data() | frames_data(replace(case, readings=diagnosis.readings))

    def written() -> list[Path]:
        if arguments.out is None and arguments.report is None:
            return []
        inputs = (arguments.rig, arguments.effects, arguments.calibration)
        provenance = provenance_of(arguments, *arguments.recordings, *arguments.validate, *inputs)
        return write(diagnosis, data, report_texts(diagnosis, provenance), arguments.out, arguments.report)

    frames = "".join(f"\n\n{sentence}" for sentence in frame_sentences(replace(case, readings=())))
    print_result(arguments, lambda: diagnosis_text(diagnosis) + frames, lambda: data, written)


def _calibration_of(case: Case, path: Path) -> Calibration:
    """The calibration in a file; InputError, before any work, unless it is of one of the training recordings."""
    from truewrench.files.calibration_file import read_calibration  # with pydantic

    calibration = read_calibration(path)
    calibration.require_of(case.recordings)
    return calibration


def diagnosed(case: Case, candidates: Sequence[Effect] | None = None) -> Diagnosis:
    """Diagnosis of a data set with these candidate effects, None for the catalogue.

    Raises InputError when the mass comes out negative.
    """
    with progress_line() as progress:
        return diagnose_case(case, effects=candidates, progress=progress)


def report_texts(diagnosis: Diagnosis, provenance: Provenance) -> ReportTexts:
    """The report as HTML and as Markdown."""
    from truewrench.reports.report_html import diagnosis_report  # with its templates and figures

    with progress_line() as progress:
        progress("write the report")
        return diagnosis_report(diagnosis, provenance)


def write(
    diagnosis: Diagnosis, data: dict[str, Any], texts: ReportTexts, out: Path | None, report: Path | None = None
) -> list[Path]:
    """Write report, result and model into folder `out`, and the report into folder `report`; return the files.

    Of each folder all files are written, or none.
    """
    from truewrench.files.model_file import as_model_file  # with the parser of formulas

    written = [] if report is None else texts.write(report)
    if out is None:
        return written
    make_folder(out)
    contents = (
        texts.html,
        json.dumps(data, indent=2, allow_nan=False) + "\n",
        as_model_file(diagnosis, "diagnose").to_text(),
    )
    with ExitStack() as files:
        for name, text in zip(FILES, contents, strict=True):
            files.enter_context(atomic_write(out / name)).write_text(text, encoding="utf-8")
    return [*(out / name for name in FILES), *written]
