"""Survey: diagnosis of many recordings of one rig, one row each, in the given order."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from pydantic import TypeAdapter, ValidationError

from diagnosis.progress import Progress, count_progress, silent
from estimation.recordings.column_table import arrow
from modeling.compiled.cache import verified, with_checksum
from modeling.effects import named
from modeling.errors import InputError
from modeling.rig import Rig
from modeling.table import Column, Table, Tabular
from truewrench.files.output import atomic_write, require_writable_folder
from truewrench.surveying.dask_executor import Work, local_executor, remote_executor, run_tasks
from truewrench.surveying.survey_html import significant_changes, write_survey
from truewrench.surveying.survey_task import DiagnosisOutcome, SurveyRow, SurveyTask, diagnosed_outcome, parquet_table

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class OutcomeStore:
    """Folder of outcomes, one file each, named by its fingerprint: JSON below a checksum."""

    folder: Path

    def get(self, key: str | None) -> DiagnosisOutcome | None:
        """Outcome of a fingerprint; None where there is none, or its file is damaged."""
        if key is None:
            return None
        try:
            text = verified(self._path(key).read_bytes())
            return None if text is None else _outcome_adapter().validate_json(text)
        except (OSError, ValidationError):
            return None

    def put(self, key: str, outcome: DiagnosisOutcome) -> None:
        """Store an outcome, atomically.

        Raises InputError when it cannot be written.
        """
        with atomic_write(self._path(key)) as path:
            path.write_bytes(with_checksum(_outcome_adapter().dump_json(outcome)))

    def _path(self, key: str) -> Path:
        return self.folder / f"{key}.json"


@cache
def _outcome_adapter() -> TypeAdapter[DiagnosisOutcome]:
    return TypeAdapter(DiagnosisOutcome)


OUTCOME_FOLDER = "rows"
"""Folder of the stored outcomes within that of the survey."""
FILES = ("survey.parquet", "survey.html")
ERROR = "error"
"""Label of recordings without a verdict."""


class DaskClient(Protocol):
    """The interface used of a `distributed.Client`."""

    def get_executor(self) -> Executor:
        """The client as an executor."""


@dataclass(frozen=True, eq=False)
class Survey(Tabular):
    """Rows of a survey in the order of its recordings; `diagnosed` of them are new, the others from an earlier run."""

    rows: tuple[SurveyRow, ...]
    diagnosed: int

    @property
    def verdicts(self) -> Mapping[str, int]:
        """How many recordings have each verdict; `error` counts those without."""
        return Counter(row.outcome.verdict or ERROR for row in self.rows)

    def to_frame(self) -> pd.DataFrame:
        """The columns of survey.parquet."""
        frame: pd.DataFrame = parquet_table(self.rows).to_pandas(maps_as_pydicts="strict")
        return frame

    def to_data(self) -> dict[str, Any]:
        """Counts of verdicts and the rows, as plain data."""
        return {
            "recordings": len(self.rows),
            "diagnosed": self.diagnosed,
            "verdicts": dict(self.verdicts),
            "rows": [row.to_data() for row in self.rows],
        }

    def write(self, out: Path) -> None:
        """Write survey.parquet and survey.html into a folder, both or neither.

        Raises InputError when they cannot be written.
        """
        write_survey(self.rows, *(out / name for name in FILES))

    @property
    def table(self) -> Table:
        """How many recordings have each verdict."""
        return Table.of(("verdict", Column("recordings", format="d")), self.verdicts.items())

    def remarks(self) -> list[str]:
        """Significant changes, and errors."""
        changes = [f"{change}." for change in significant_changes(self.rows)]
        return [*changes, *(f"{row.file}: {row.outcome.error}" for row in self.rows if row.outcome.error)]

    def printed(self) -> list[Table | str]:
        """Counts of recordings, of verdicts and of effects added, then the remarks."""
        count, stored = len(self.rows), len(self.rows) - self.diagnosed
        again = f", {stored} of them by an earlier run" if stored else ""
        parts: list[Table | str] = [f"{count} recording{'' if count == 1 else 's'}{again}", self.table]
        added = Counter(effect for row in self.rows for effect in row.outcome.added).most_common()
        parts += [Table.of(("effect", Column("added to", format="d")), added)] if added else []
        return [text for paragraph in (*parts, *self.remarks()) for text in (paragraph, "")][:-1]


def survey(
    recordings: Iterable[str | Path],
    *,
    rig: Rig | str | Path | None = None,
    out: str | Path | None = None,
    executor: Executor | DaskClient | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    only: Sequence[str] | None = None,
    one_run: bool = False,
    progress: Progress = silent,
    work: Work = diagnosed_outcome,
) -> Survey:
    """Diagnose many recordings of one rig and tool, each by itself.

    Parameters
    ----------
    recordings : iterable of str or Path
        Files of the recordings.
    rig : Rig, str or Path, optional
        The rig, or its file; required for joint angles.
    out : str or Path, optional
        Folder for survey.parquet, survey.html and the outcomes, from which an interrupted survey resumes; by default
        nothing is stored.
    executor : Executor or DaskClient, optional
        A Dask client or any executor of `concurrent.futures`; workers read the recordings by absolute path.
    scheduler : str, optional
        Instead, the address of a Dask scheduler; without either, a local cluster.
    workers : int, optional
        Processes of the local cluster; by default one for each core, at most one for each recording.
    only : sequence of str, optional
        Ids of the candidate effects; by default the whole catalogue.
    one_run : bool, optional
        Take every recording as one run: no period is looked for, and a column that counts repeats is left out.
    progress : callable, optional
        Called with one line of text; by default silent.
    work : callable, optional
        Function of a task that returns its outcome; by default the diagnosis.

    Returns
    -------
    Survey
        One row for each recording in their order. A recording that cannot be diagnosed is a row with its error.
        Outcomes that an earlier survey stored in `out` for the same recording, rig and version are reused.

    Raises
    ------
    InputError
        For a rig or an effect that cannot be used, a folder that cannot be written, a scheduler that does not answer,
        or more than one of executor, scheduler and workers.

    Examples
    --------
    >>> import truewrench as tw
    >>> from concurrent.futures import ThreadPoolExecutor
    >>> with ThreadPoolExecutor(1) as executor:
    ...     found = tw.survey(["train.csv"], rig="rig.toml", only=["viscous_drag"], executor=executor)
    >>> dict(found.verdicts), found.rows[0].outcome.added
    ({'explained': 1}, ('viscous_drag',))
    """
    _require_one_executor(executor, scheduler, workers)
    paths = [Path(recording) for recording in recordings]
    candidates = None if only is None else tuple(only)
    _require_known(candidates)
    described = rig if isinstance(rig, Rig) or rig is None else Rig.read(rig)
    store = None if out is None else _store(Path(out))
    progress("read the recordings")
    data = None if described is None else described.to_data()
    tasks = [SurveyTask.of(path, data, candidates, one_run=one_run) for path in paths]
    outcomes = _stored_outcomes(tasks, store)
    missing = list(dict.fromkeys(task.recording for task in tasks if task.recording not in outcomes))
    if missing:
        by_path = {task.recording: task for task in tasks}
        with _executor(executor, scheduler, workers, most=len(missing)) as running:
            if out is not None:
                arrow()  # which writes the table, at the end
            outcomes |= _run_and_store([by_path[path] for path in missing], running, work, store, progress)
    surveyed = Survey(
        tuple(SurveyRow.of(p, outcomes[t.recording]) for p, t in zip(paths, tasks, strict=True)), len(missing)
    )
    if out is not None:
        progress("write the survey")
        surveyed.write(Path(out))
    return surveyed


def _require_one_executor(executor: Executor | DaskClient | None, scheduler: str | None, workers: int | None) -> None:
    if sum(choice is not None for choice in (executor, scheduler, workers)) > 1:
        what = "an executor, a scheduler and a number of local workers exclude one another"
        raise InputError(what=what, where="survey", remedy="give one of them")
    if workers is not None and workers < 1:
        raise InputError(what=f"workers = {workers} is too few", where="survey", remedy="give one worker or more")


def _require_known(only: tuple[str, ...] | None) -> None:
    for effect_id in only or ():
        named(effect_id)


def _store(out: Path) -> OutcomeStore:
    require_writable_folder(out)
    return OutcomeStore(out / OUTCOME_FOLDER)


def _stored_outcomes(tasks: Sequence[SurveyTask], store: OutcomeStore | None) -> dict[str, DiagnosisOutcome]:
    """Outcomes by recording, stored by an earlier survey."""
    stored = {} if store is None else {task.recording: store.get(task.key) for task in tasks}
    return {recording: outcome for recording, outcome in stored.items() if outcome is not None}


def _run_and_store(
    tasks: Sequence[SurveyTask], executor: Executor, work: Work, store: OutcomeStore | None, progress: Progress
) -> dict[str, DiagnosisOutcome]:
    """Outcomes by recording; each final one is stored as soon as it is available."""
    by_recording: dict[str, DiagnosisOutcome] = {}
    count = count_progress(progress, "recordings")
    count(0, len(tasks))
    with closing(run_tasks(tasks, executor, work)) as outcomes:  # pending tasks are cancelled on an exception
        for task, outcome in outcomes:
            by_recording[task.recording] = outcome
            if store is not None and task.key is not None and outcome.final:
                store.put(task.key, outcome)
            count(len(by_recording), len(tasks))
    return by_recording


@contextmanager
def _executor(
    executor: Executor | DaskClient | None, scheduler: str | None, workers: int | None, *, most: int
) -> Iterator[Executor]:
    """The given executor, or one at the scheduler, or a local one."""
    if executor is not None:
        yield executor if isinstance(executor, Executor) else executor.get_executor()
    elif scheduler is not None:
        with remote_executor(scheduler) as remote:
            yield remote
    else:
        with local_executor(workers, most=most) as local:
            yield local
