"""Survey: many recordings of one rig diagnosed, one row each, in the order in which they were given."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

from modeling.errors import InputError
from modeling.rig import Rig
from truewrench.output import require_folder
from truewrench.surveying.cluster import local_executor, remote_executor
from truewrench.surveying.execution import Work, executed
from truewrench.surveying.outcome import Outcome
from truewrench.surveying.row import Row
from truewrench.surveying.store import OutcomeStore
from truewrench.surveying.task import Task, diagnosed_outcome

if TYPE_CHECKING:
    import pandas as pd

ROWS = "rows"
"""Folder of the stored outcomes, within the survey's."""
FILES = ("survey.parquet", "survey.html")
ERROR = "error"
"""Counted as a verdict where there is none."""

Progress: TypeAlias = Callable[[str], None]


class DaskClient(Protocol):
    """What is asked of a `distributed.Client`."""

    def get_executor(self) -> Executor:
        """The client as an executor."""


@dataclass(frozen=True, eq=False)
class Survey:
    """The rows of a survey in the order of its recordings; `diagnosed` of them were not known from an earlier run."""

    rows: tuple[Row, ...]
    diagnosed: int

    @property
    def verdicts(self) -> Mapping[str, int]:
        """How many recordings have each verdict; `error` counts those without."""
        return Counter(row.outcome.verdict or ERROR for row in self.rows)

    def to_frame(self) -> pd.DataFrame:
        """The columns of survey.parquet."""
        from truewrench.surveying.table import table_of

        frame: pd.DataFrame = table_of(self.rows).to_pandas(maps_as_pydicts="strict")
        return frame

    def to_data(self) -> dict[str, Any]:
        """Numbers of recordings by verdict and the rows, as plain data."""
        return {
            "recordings": len(self.rows),
            "diagnosed": self.diagnosed,
            "verdicts": dict(self.verdicts),
            "rows": [row.to_data() for row in self.rows],
        }

    def write(self, out: Path) -> None:
        """Write survey.parquet and survey.html into a folder: both, or none.

        Raises InputError when they cannot be written.
        """
        from truewrench.surveying.page import write_survey

        write_survey(self.rows, *(out / name for name in FILES))

    def __str__(self) -> str:
        from truewrench.surveying.summary import survey_text

        return survey_text(self)


def silent(_message: str) -> None:
    """No progress."""


def survey(
    recordings: Iterable[str | Path],
    *,
    rig: Rig | str | Path | None = None,
    out: str | Path | None = None,
    executor: Executor | DaskClient | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    only: Sequence[str] | None = None,
    progress: Progress = silent,
    work: Work = diagnosed_outcome,
) -> Survey:
    """Diagnose many recordings of one rig and tool, each by itself.

    rig        the rig, or its file; joint angles need one
    out        folder for survey.parquet, survey.html and the outcomes as they come, from which an interrupted survey
               goes on; None keeps nothing
    executor   a Dask client or any executor of `concurrent.futures`; workers read the recordings by absolute path
    scheduler  instead, the address of a Dask scheduler; without either, a local cluster of `workers` processes
    only       ids of the candidate effects; None is the whole catalogue
    work       what is done with a task

    A recording that cannot be diagnosed is a row with its error. What an earlier survey stored in `out` of the same
    recording, rig and version is not diagnosed again.
    Raises InputError for a rig or an effect that cannot be used, a folder that cannot be written, a scheduler that does
    not answer.
    """
    _require_one_place(executor, scheduler, workers)
    paths = [Path(recording) for recording in recordings]
    candidates = None if only is None else tuple(only)
    _require_known(candidates)
    described = rig if isinstance(rig, Rig) or rig is None else Rig.read(rig)
    store = None if out is None else _store(Path(out))
    progress("read the recordings")
    data = None if described is None else described.to_data()
    tasks = [Task.of(path, data, candidates) for path in paths]
    found = _stored(tasks, store)
    missing = list(dict.fromkeys(task.recording for task in tasks if task.recording not in found))
    if missing:
        by_path = {task.recording: task for task in tasks}
        with _executor(executor, scheduler, workers, most=len(missing)) as running:
            found |= _finished([by_path[path] for path in missing], running, work, store, progress)
    surveyed = Survey(tuple(Row.of(p, found[t.recording]) for p, t in zip(paths, tasks, strict=True)), len(missing))
    if out is not None:
        progress("write the survey")
        surveyed.write(Path(out))
    return surveyed


def _require_one_place(executor: Executor | DaskClient | None, scheduler: str | None, workers: int | None) -> None:
    if sum(choice is not None for choice in (executor, scheduler, workers)) > 1:
        what = "an executor, a scheduler and a number of local workers exclude one another"
        raise InputError(what=what, where="survey", remedy="give one of them")
    if workers is not None and workers < 1:
        raise InputError(what=f"{workers} workers cannot do it", where="survey", remedy="give one worker or more")


def _require_known(only: tuple[str, ...] | None) -> None:
    from modeling.effects import named

    for effect_id in only or ():
        named(effect_id)


def _store(out: Path) -> OutcomeStore:
    require_folder(out)
    return OutcomeStore(out / ROWS)


def _stored(tasks: Sequence[Task], store: OutcomeStore | None) -> dict[str, Outcome]:
    """Outcomes by recording, of those that an earlier survey finished."""
    known = {} if store is None else {task.recording: store.get(task.key) for task in tasks}
    return {recording: outcome for recording, outcome in known.items() if outcome is not None}


def _finished(
    tasks: Sequence[Task], executor: Executor, work: Work, store: OutcomeStore | None, progress: Progress
) -> dict[str, Outcome]:
    """Outcomes by recording; each final one is stored when it comes."""
    found: dict[str, Outcome] = {}
    began = monotonic()
    progress(f"0 of {len(tasks)} recordings")
    with closing(executed(tasks, executor, work)) as outcomes:  # what is not begun is cancelled, whatever happens here
        for task, outcome in outcomes:
            found[task.recording] = outcome
            if store is not None and task.key is not None and outcome.final:
                store.put(task.key, outcome)
            progress(_done(len(found), len(tasks), monotonic() - began))
    return found


def _done(count: int, total: int, seconds: float) -> str:
    left = seconds / count * (total - count)
    ahead = f"{left:.0f} s" if left < 100 else f"{left / 60:.0f} min"
    return f"{count} of {total} recordings, about {ahead} left"


@contextmanager
def _executor(
    executor: Executor | DaskClient | None, scheduler: str | None, workers: int | None, *, most: int
) -> Iterator[Executor]:
    """The executor that was given, or one at the scheduler, or on this machine."""
    if executor is not None:
        yield executor if isinstance(executor, Executor) else executor.get_executor()
    elif scheduler is not None:
        with remote_executor(scheduler) as remote:
            yield remote
    else:
        with local_executor(workers, most=most) as local:
            yield local
