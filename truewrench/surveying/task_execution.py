"""Tasks on an executor, with retries of those whose workers died."""

from __future__ import annotations

import sys
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, as_completed
from contextlib import contextmanager
from functools import partial

from modeling.errors import InputError
from truewrench.surveying.diagnosis_outcome import DiagnosisOutcome
from truewrench.surveying.survey_task import SurveyTask, failed_outcome

Work = Callable[[SurveyTask], DiagnosisOutcome]


def run_tasks(
    tasks: Sequence[SurveyTask], executor: Executor, work: Work
) -> Generator[tuple[SurveyTask, DiagnosisOutcome], None, None]:
    """Tasks with their outcomes, in order of completion.

    Dask reruns the tasks of a dead worker on another one, and gives up a task after several deaths. Such a task may
    only have shared workers with a recording that kills them (out of memory, say): it is rerun at the end, one at a
    time, and fails only if it then kills its worker again.
    Raises InputError when the scheduler is lost, or all workers of another executor with one of them. Pending tasks
    are cancelled when the iteration ends.
    """
    with _submit(tasks, executor, work) as futures:
        suspects, lost = [], None
        for future in as_completed(futures):
            if not future.cancelled() and isinstance(future.exception(), BrokenExecutor):
                lost = future.exception()  # others may be done
                continue
            outcome = _outcome(future)
            if outcome is None:
                suspects.append(futures[future])
            else:
                yield futures[future], outcome
        if lost is not None:
            raise workers_lost(lost)
    for task in suspects:
        with _submit([task], executor, partial(_again, work)) as (future,):
            yield task, _outcome(next(as_completed([future]))) or failed_outcome(future.exception() or RuntimeError())


@contextmanager
def _submit(
    tasks: Sequence[SurveyTask], executor: Executor, work: Work
) -> Iterator[dict[Future[DiagnosisOutcome], SurveyTask]]:
    futures: dict[Future[DiagnosisOutcome], SurveyTask] = {}
    try:
        try:
            for task in tasks:
                futures[executor.submit(work, task)] = task
        except BrokenExecutor as error:
            raise workers_lost(error) from None
        yield futures
    finally:
        for future in futures:
            future.cancel()


def _again(work: Work, task: SurveyTask) -> DiagnosisOutcome:
    """The work of a task that was given up: Dask takes the same call of the same function for the same failed task."""
    return work(task)


def _outcome(future: Future[DiagnosisOutcome]) -> DiagnosisOutcome | None:
    """Outcome of a finished future; None where every worker that ran it died."""
    if future.cancelled():
        raise scheduler_lost()
    error = future.exception()
    if error is None:
        return future.result()
    return None if _killed_worker(error) else failed_outcome(error)


def scheduler_lost() -> InputError:
    """Error for a lost scheduler; finished outcomes are stored."""
    what = "the scheduler does not answer any more"
    return InputError(
        what=what, where="survey", remedy="start it and run the survey again: it resumes where it stopped"
    )


def workers_lost(error: BaseException) -> InputError:
    """Error for an executor that does nothing any more once one of its workers has died."""
    return InputError(
        what=f"a worker of the executor died, and the others ended with it: {str(error).rstrip('.')}",
        where="survey",
        remedy="run the survey again with a new one, or without one: on Dask a recording that ends its worker is a row",
    )


def _killed_worker(error: BaseException) -> bool:
    distributed = sys.modules.get("distributed")  # not imported: no Dask error
    return distributed is not None and isinstance(error, distributed.KilledWorker)
