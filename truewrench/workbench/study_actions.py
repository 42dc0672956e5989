"""What the page can ask for, in the process of its study: each request by its name, with what it changes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import isfinite
from pathlib import Path
from typing import Any

from diagnosis.diagnosis import Diagnosis
from diagnosis.discovery.discovery import Discovery
from diagnosis.screening.suspects import Suspects
from diagnosis.study import Study, StudyStep, study_case
from estimation.case import Case
from estimation.contact.contact_wrench import ContactWrench, compensate
from estimation.reading.column_map import ColumnMap
from estimation.reading.log_reading import read_with_rig
from modeling.errors import InputError, quoted
from truewrench.emitted import emit
from truewrench.files.case_files import frame_sentences
from truewrench.files.model_file import as_model_file
from truewrench.plots.chart import Chart
from truewrench.plots.result_figure import result_chart
from truewrench.reports.discovery_report import discovery_report
from truewrench.reports.fit_report import fit_report
from truewrench.reports.report_files import InputFile, Provenance, ReportTexts
from truewrench.reports.report_html import diagnosis_report
from truewrench.text.fit_summary import FitSummary
from truewrench.workbench.custom_form import checked_words, effect_of_form
from truewrench.workbench.page_update import Download, PageUpdate
from truewrench.workbench.reading import (
    Columns,
    Puzzle,
    ReadingForm,
    case_of,
    first_estimates,
    hidden_effect_of,
    map_data,
    map_text,
)
from truewrench.workbench.separation import Separation, rig_template, separation_of
from truewrench.workbench.study_charts import view_at_cell, view_of
from truewrench.workbench.study_words import (
    StepLine,
    columns_words,
    comparison_words,
    contact_words,
    discovery_words,
    estimates_words,
    reading_words,
    separation_words,
    steps_words,
    style_words,
    suspects_words,
    title_words,
    trajectory_words,
    verdict_words,
    vocabulary_words,
)
from truewrench.workbench.view import View

# Contact in another recording, by the current model of a study.


def contact_of(study: Study, file: str) -> tuple[ContactWrench, Chart]:
    """The contact wrench in a recording of the same rig and tool, with its chart.

    Raises InputError for what cannot be read, or is of another sensor.
    """
    rig = study.fit.recordings[0].rig
    contact = compensate(study.fit, read_with_rig(file, rig=rig, every_row=True))
    return contact, replace(result_chart(contact, kind="contact"), row_height=150)


# Files to take away: report, model, code, payload, trajectory.


CODE = {"numpy": "model.py", "casadi": "model_casadi.py", "c": "model.c", "latex": "model.tex"}
PAYLOADS = {"urdf": "tool.urdf", "sdf": "tool.sdf", "mjcf": "tool.xml", "ur": "payload_ur.script",
            "franka": "payload_franka.cpp", "ros2": "payload_ros2.yaml"}  # fmt: skip


def download_of(
    asked: str,
    step: StudyStep,
    case: Case | None,
    diagnosis: Diagnosis | None,
    files: Sequence[str],
    separation: Separation | None,
    sensor_pose: str = "",
    discovery: Discovery | None = None,
) -> Download:
    """The file asked for: report, model, trajectory, equation, or what `emit` writes.

    `sensor_pose` is that of the sensor in the flange, for a payload: x, y, z in m, roll, pitch, yaw in rad; or empty.

    Raises InputError for another name, and what the model cannot be written as.
    """
    makers: dict[str, Callable[[], Download]] = {
        "report": lambda: Download("report.html", "text/html", _report(step, case, diagnosis, files).html.encode()),
        "report_md": lambda: Download(
            "report.md", "text/markdown", _report(step, case, diagnosis, files).markdown.encode()
        ),
        "model": lambda: Download("model.json", "application/json", as_model_file(step.fit, "save").to_text().encode()),
        "trajectory": lambda: _trajectory(separation),
        "effects": lambda: Download("effect.toml", "application/toml", _found(discovery).effects_toml.encode()),
        "equation": lambda: Download(
            "equation.html", "text/html", discovery_report(_found(discovery), _provenance(files)).html.encode()
        ),
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


def _report(step: StudyStep, case: Case | None, diagnosis: Diagnosis | None, files: Sequence[str]) -> ReportTexts:
    """Of the diagnosis where there is one of this model, else of the fit."""
    provenance = _provenance(files)
    if diagnosis is not None:
        return diagnosis_report(diagnosis, provenance)
    summary = FitSummary(step.fit, step.fit.intervals(), validation=step.validation)
    return fit_report(summary, provenance, [] if case is None else frame_sentences(case))


def _provenance(files: Sequence[str]) -> Provenance:
    inputs = tuple(replace(InputFile.of(file), path=Path(file).name) for file in files)
    return replace(Provenance.now("truewrench workbench"), inputs=inputs)


def _found(discovery: Discovery | None) -> Discovery:
    """What was looked for and found, or not; InputError before that."""
    if discovery is None:
        remedy = "look for an equation first"
        raise InputError(what="no equation of the current model was looked for", where="equation", remedy=remedy)
    return discovery


def _trajectory(separation: Separation | None) -> Download:
    table = "" if separation is None else separation.table()
    if separation is None or not table:
        remedy = "ask for the trajectory that separates two suspects first"
        raise InputError(what="there is no trajectory", where="download", remedy=remedy)
    return Download(f"separate_{separation.first}_{separation.second}.csv", "text/csv", table.encode())


NO_STUDY = {"what": "no recording is open", "where": "workbench", "remedy": "choose a recording first"}


NO_FILES = {
    "what": "a notebook gave the recordings, not their files",
    "where": "workbench",
    "remedy": "read them another way there, or open the files by truewrench workbench",
}


class StudyActions:
    """The study of a page, and what was learnt of its current model.

    Parameters
    ----------
    progress : callable
        Called with one line of text at each stage.
    study : Study, optional
        A study that is there already, as a notebook's; by default none until a recording is opened.
    """

    def __init__(self, progress: Callable[[str], None], study: Study | None = None) -> None:
        self._progress = progress
        self._study = study
        self._case = None if study is None else study.case
        self._puzzle: Puzzle | None = None
        self._form = ReadingForm()
        self._suspects: dict[int, Suspects] = {}
        self._diagnosis: Diagnosis | None = None
        self._discovery: Discovery | None = None
        self._view = View() if study is None else View.first(study)
        self._files: tuple[Sequence[str], Sequence[str], str | None] | None = None
        self._separation: Separation | None = None
        self._unread: tuple[Sequence[str], Sequence[str], str | None, ReadingForm, Columns] | None = None
        self._line = StepLine()

    def answer(self, request: Mapping[str, Any]) -> PageUpdate:
        """The answer to a request; InputError for one that cannot be answered."""
        name = str(request.get("do"))
        if name not in ACTIONS:
            raise InputError(what=f"there is no request {quoted(name)}", where="workbench", remedy="reload the page")
        return ACTIONS[name](self, request)

    @property
    def study(self) -> Study:
        """The study; InputError before a recording is open."""
        if self._study is None:
            raise InputError(**NO_STUDY)
        return self._study

    # ---------------------------------------------------------------------------------- what to open

    def open(self, request: Mapping[str, Any]) -> PageUpdate:
        """Read recordings, and begin a study of the rigid tool."""
        files = request["recordings"], request.get("validate", ()), request.get("rig")
        form = ReadingForm.of(request)
        try:
            return self._begin(*files, form, None)
        except InputError as error:
            of_training = any(Path(path).name in error.where for path in files[0])  # one map is of all files
            asked_for = of_training and "recognised" in error.what and not (form.map or form.preset)
            columns = Columns.of(files[0], error) if asked_for else None
            if columns is None:
                raise
            self._unread = (*files, form, columns)
            return PageUpdate({"columns": columns_words(columns)})

    def pick(self, request: Mapping[str, Any]) -> PageUpdate:
        """Open the files whose columns the page's form names, or with `only` say what a rigid tool says of them."""
        training, validation, rig, form, _ = self._not_recognised()
        data = map_data(request)
        if request.get("only"):
            self._progress("fit the rigid tool to each form")
            return PageUpdate({"estimates": estimates_words(first_estimates(training, rig, form, data))})
        stated = ColumnMap.of(data, "columns")
        return self._begin(training, validation, rig, replace(form, map=stated), None)

    def _not_recognised(self) -> tuple[Sequence[str], Sequence[str], str | None, ReadingForm, Columns]:
        if self._unread is None:
            raise InputError(**NO_STUDY)
        return self._unread

    def read(self, request: Mapping[str, Any]) -> PageUpdate:
        """Read the same recordings as a reading that is proposed has it; with an empty one, take them as they are."""
        form = replace(self._form, read=str(request.get("reading") or ""))
        return self._begin(*self._opened(), form, self._puzzle)

    def _opened(self) -> tuple[Sequence[str], Sequence[str], str | None]:
        if self._files is None:
            raise InputError(**(NO_STUDY if self._study is None else NO_FILES))
        return self._files

    def shown(self, _request: Mapping[str, Any]) -> PageUpdate:
        """Show the study that is there, at the step that it is at."""
        return self._changed("as in the notebook", self._words_of_study())

    def puzzle(self, request: Mapping[str, Any]) -> PageUpdate:
        """Simulate a rig with a hidden effect, and begin a study of its recordings."""
        hidden = hidden_effect_of(str(request.get("effect", "")))
        self._progress("simulate a rig")
        puzzle = Puzzle.simulated(hidden, str(request["folder"]))
        return self._begin([puzzle.training], [puzzle.validation], puzzle.rig, ReadingForm(), puzzle)

    def reveal(self, _request: Mapping[str, Any]) -> PageUpdate:
        """Say what the simulated rig hides."""
        if self._puzzle is None:
            raise InputError(what="this recording is no puzzle", where="workbench", remedy="take a simulated rig")
        return PageUpdate({"answer": self._puzzle.solution(self.study.effects)})

    def _begin(
        self,
        training: Sequence[str],
        validation: Sequence[str],
        rig: str | None,
        form: ReadingForm,
        puzzle: Puzzle | None,
    ) -> PageUpdate:
        """Begin a study; the one before remains where its files cannot be read or fitted."""
        self._progress("read")
        case = case_of(training, validation, rig, form)
        self._progress("fit the rigid tool")
        begun = study_case(case, progress=self._progress)
        self._case, self._study, self._puzzle = case, begun, puzzle
        self._suspects, self._diagnosis, self._view, self._separation = {}, None, View.first(begun), None
        self._files, self._form = (tuple(training), tuple(validation), rig), form
        self._line = StepLine()
        return self._changed("rigid tool", self._words_of_study())

    def _words_of_study(self) -> dict[str, str]:
        return {
            "columns": "",
            "estimates": "",
            "sketch-style": style_words(),
            "reading": "" if self._case is None else reading_words(self._case),
            "vocabulary": vocabulary_words(self.study),
            "custom-result": "",
        }

    # ------------------------------------------------------------------------------------ what to see

    def view(self, request: Mapping[str, Any]) -> PageUpdate:
        """Show another figure, recording or channel, or the trajectory that was designed."""
        if request.get("view") == "trajectory" and self._separation is not None:
            return separation_update(self._separation)
        self._view = self._view.asked(request, self.study)
        return self._shown()

    def cell(self, request: Mapping[str, Any]) -> PageUpdate:
        """Show the samples of a cell of a residual map in time."""
        self._view = view_at_cell(self._view, self.study, int(request["panel"]), float(request["x"]))
        return self._shown()

    def suspects(self, _request: Mapping[str, Any]) -> PageUpdate:
        """Rank the suspects."""
        self._progress("test the suspects")
        return PageUpdate({"suspects": suspects_words(self.study, self._ranked(), self._diagnosis)})

    def _ranked(self) -> Suspects:
        step = id(self.study.steps[-1])
        if step not in self._suspects:
            self._suspects[step] = self.study.suspects()
        return self._suspects[step]

    def _shown(self) -> PageUpdate:
        return view_of(self._view, self.study)

    # ------------------------------------------------------------------------------------- what to do

    def add(self, request: Mapping[str, Any]) -> PageUpdate:
        """Add an effect."""
        self._progress(f"fit with {request['effect']}")
        self.study.add(str(request["effect"]))
        return self._changed(f"added {request['effect']}")

    def custom(self, request: Mapping[str, Any]) -> PageUpdate:
        """Add the custom effect of the form."""
        effect = effect_of_form(request, self.study)
        self.study.add(effect)
        return self._changed(f"added {effect.id}", {"custom-result": ""})

    def check(self, request: Mapping[str, Any]) -> PageUpdate:
        """Say what is wrong with the custom effect of the form."""
        return PageUpdate({"custom-result": checked_words(request, self._study)})

    def drop(self, request: Mapping[str, Any]) -> PageUpdate:
        """Drop an effect."""
        self._progress(f"fit without {request['effect']}")
        self.study.drop(str(request["effect"]))
        return self._changed(f"dropped {request['effect']}")

    def undo(self, _request: Mapping[str, Any]) -> PageUpdate:
        """Go back one step."""
        last = self.study.steps[-1].change
        self.study.undo()
        return self._changed(f"undone {last}")

    def redo(self, _request: Mapping[str, Any]) -> PageUpdate:
        """Go forward again by the step last undone."""
        again = self.study.redo()
        return self._changed(f"redone {again.change}")

    def diagnose(self, _request: Mapping[str, Any]) -> PageUpdate:
        """Let the diagnosis go on from the current model."""
        self._diagnosis = self.study.diagnose()
        if self._case is not None and self._case.gravity is not None:
            self._diagnosis = replace(self._diagnosis, gravity=self._case.gravity)
        return self._changed("diagnosed", {"verdict": verdict_words(self._diagnosis)}, keep_verdict=True)

    def discover(self, _request: Mapping[str, Any]) -> PageUpdate:
        """Look for an equation of what the current model leaves, tested on the recordings held out."""
        self._discovery = self.study.discover()
        said = "" if self._diagnosis is None else verdict_words(self._diagnosis, looked=True)
        return PageUpdate({"verdict": said + discovery_words(self._discovery)})

    def adopt(self, _request: Mapping[str, Any]) -> PageUpdate:
        """Add the terms that were found, as custom effects."""
        effects = [equation.effect for equation in _found(self._discovery).equations]
        if not effects:
            raise InputError(what="no equation was found", where="equation", remedy="add an effect, or write one")
        for effect in effects:
            self.study.add(effect)
        return self._changed(f"added {', '.join(effect.id for effect in effects)}")

    def _changed(self, done: str, words: Mapping[str, str] | None = None, *, keep_verdict: bool = False) -> PageUpdate:
        """The page after a step of the study; the suspects follow, if they are not known already."""
        self._line = self._line.then(done, self.study)
        self._discovery = None
        stale = {"answer": ""} if keep_verdict else {"verdict": "", "answer": ""}
        if not keep_verdict:
            self._diagnosis = None
        self._view = self._view.of_step(self.study)
        shown = self._shown()
        suspects = self._suspects.get(id(self.study.steps[-1]))
        ranked = {"suspects": suspects_words(self.study, suspects, self._diagnosis)}
        steps = {"steps": steps_words(self.study, puzzle=self._puzzle is not None), "last-step": self._line.words()}
        return replace(
            shown,
            words={**shown.words, **stale, **steps, **ranked, **(words or {})},
            follow=None if suspects else {"do": "suspects"},
        )

    # --------------------------------------------------------------------------------- what to take away

    def compare(self, request: Mapping[str, Any]) -> PageUpdate:
        """Compare two steps."""
        first, second = int(request["first"]), int(request["second"])
        comparison = self.study.compare(first, second)
        self._view = self._view.comparing(first, second)
        shown = self._shown()
        return replace(shown, words={**shown.words, "table": comparison_words(comparison)})

    def contact(self, request: Mapping[str, Any]) -> PageUpdate:
        """The contact in another recording, by the current model."""
        file = str(request["recordings"][0]) if request.get("recordings") else self._contact_file()
        contact, chart = contact_of(self.study, file)
        return PageUpdate(
            {"view": title_words(f"Contact in {contact.recording.name}"), "table": contact_words(contact)},
            {"plots": chart},
        )

    def _contact_file(self) -> str:
        if self._puzzle is None:
            raise InputError(what="no recording with a contact was given", where="contact", remedy="choose a file")
        return self._puzzle.contact

    def separate(self, request: Mapping[str, Any]) -> PageUpdate:
        """The trajectory that separates two suspects."""
        separation = separation_of(self.study, str(request["first"]), str(request["second"]), self._progress)
        self._separation = separation
        return separation_update(separation)

    def download(self, request: Mapping[str, Any]) -> PageUpdate:
        """A file to save."""
        if request.get("file") == "map":
            return PageUpdate(download=Download("map.toml", "application/toml", map_text(map_data(request)).encode()))
        step: StudyStep = self.study.steps[-1]
        asked, pose = str(request.get("file")), str(request.get("sensor_pose") or "")
        if asked.startswith(("report", "equation")):
            self._progress("write the report")
        training, validation, rig = self._files or ((), (), None)
        files = [*training, *validation, *([] if rig is None else [rig])]
        download = download_of(asked, step, self._case, self._diagnosis, files, self._separation, pose, self._discovery)
        return PageUpdate(download=download)


def separation_update(separation: Separation) -> PageUpdate:
    """A designed trajectory, drawn, and how well it separates."""
    charts = {} if separation.chart is None else {"plots": separation.chart}
    return PageUpdate({"view": trajectory_words(separation), "table": separation_words(separation)}, charts)


ACTIONS: Mapping[str, Callable[[StudyActions, Mapping[str, Any]], PageUpdate]] = {
    name: getattr(StudyActions, name)
    for name in (
        "open", "pick", "shown", "read", "puzzle", "reveal", "view", "cell", "suspects", "add", "custom", "check",
        "drop", "undo", "redo", "diagnose", "discover", "adopt", "compare", "contact", "separate", "download",
    )
}  # fmt: skip
"""What the page can ask for."""
