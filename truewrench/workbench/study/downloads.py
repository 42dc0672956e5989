"""Files to take away: report, model, code, payload, trajectory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import isfinite
from pathlib import Path

from diagnosis.diagnosis import Diagnosis
from diagnosis.study import StudyStep
from modeling.errors import InputError, quoted
from truewrench.emitted import emit
from truewrench.files.data_set import DataSet, frame_sentences
from truewrench.files.model_file import ModelFile
from truewrench.reports.provenance import InputFile, Provenance
from truewrench.reports.report_files import ReportTexts
from truewrench.workbench.page_update import Download
from truewrench.workbench.study.separation import Separation, rig_template

CODE = {"numpy": "model.py", "casadi": "model_casadi.py", "c": "model.c", "latex": "model.tex"}
PAYLOADS = {"urdf": "tool.urdf", "sdf": "tool.sdf", "mjcf": "tool.xml", "ur": "payload_ur.script",
            "franka": "payload_franka.cpp", "ros2": "payload_ros2.yaml"}  # fmt: skip


def download_of(
    asked: str,
    step: StudyStep,
    case: DataSet | None,
    diagnosis: Diagnosis | None,
    files: Sequence[str],
    separation: Separation | None,
    sensor_pose: str = "",
) -> Download:
    """The file asked for: report, model, trajectory, or what `emit` writes.

    `sensor_pose` is that of the sensor in the flange, for a payload: x, y, z in m, roll, pitch, yaw in rad; or empty.

    Raises InputError for another name, and what the model cannot be written as.
    """
    makers: dict[str, Callable[[], Download]] = {
        "report": lambda: Download("report.html", "text/html", _report(step, case, diagnosis, files).html.encode()),
        "report_md": lambda: Download(
            "report.md", "text/markdown", _report(step, case, diagnosis, files).markdown.encode()
        ),
        "model": lambda: Download("model.json", "application/json", ModelFile.of(step.fit).to_text().encode()),
        "trajectory": lambda: _trajectory(separation),
        "rig_template": lambda: Download("rig.toml", "application/toml", rig_template(step.fit.model.space).encode()),
    }
    if asked in makers:
        return makers[asked]()
    if asked not in (CODE | PAYLOADS):
        remedy = f"use one of {', '.join((*makers, *CODE, *PAYLOADS))}"
        raise InputError(what="there is no such file", where="download", remedy=remedy)
    rate = 1 / (step.fit.recordings[0].dt or 0.0) if asked in CODE and step.fit.recordings[0].dt else None
    pose = _pose(sensor_pose) if asked in PAYLOADS else None
    text = emit(step.fit, asked, rate=rate, sensor_pose=pose)
    return Download((CODE | PAYLOADS)[asked], "text/plain", text.encode())


def _pose(text: str) -> list[float] | None:
    """The six numbers of a pose, None of an empty text; InputError for anything else."""
    numbers = text.replace(",", " ").split()
    if not numbers:
        return None
    try:
        pose = [float(n) for n in numbers]
    except ValueError:
        pose = []
    if len(pose) != 6 or not all(map(isfinite, pose)):
        remedy = "write x y z in m and roll pitch yaw in rad, such as 0 0 0.04 0 0 1.5708"
        raise InputError(what=f"{quoted(text)} is no pose", where="sensor in the flange", remedy=remedy)
    return pose


def _report(step: StudyStep, case: DataSet | None, diagnosis: Diagnosis | None, files: Sequence[str]) -> ReportTexts:
    """Of the diagnosis where there is one of this model, else of the fit."""
    inputs = tuple(replace(InputFile.of(file), path=Path(file).name) for file in files)
    provenance = replace(Provenance.now("truewrench workbench"), inputs=inputs)
    if diagnosis is not None:
        from truewrench.reports.report_html import diagnosis_report

        return diagnosis_report(diagnosis, provenance)
    from truewrench.reports.fit_report import fit_report
    from truewrench.text.fit_summary import FitSummary

    summary = FitSummary(step.fit, step.fit.intervals(), validation=step.validation)
    return fit_report(summary, provenance, [] if case is None else frame_sentences(case))


def _trajectory(separation: Separation | None) -> Download:
    table = "" if separation is None else separation.table()
    if separation is None or not table:
        remedy = "ask for the trajectory that separates two suspects first"
        raise InputError(what="there is no trajectory", where="download", remedy=remedy)
    return Download(f"separate_{separation.first}_{separation.second}.csv", "text/csv", table.encode())
