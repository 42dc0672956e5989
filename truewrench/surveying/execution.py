"""Execution: tasks on an executor, their outcomes as they come, whoever dies on the way."""

from __future__ import annotations

import sys
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Executor, Future, as_completed
from contextlib import contextmanager

from modeling.errors import InputError
from truewrench.surveying.outcome import Outcome
from truewrench.surveying.task import Task, failed_outcome

Work = Callable[[Task], Outcome]


def executed(tasks: Sequence[Task], executor: Executor, work: Work) -> Generator[tuple[Task, Outcome], None, None]:
    """Each task and its outcome, in the order in which they finish.

    Dask runs what a dying worker had begun on another one, and gives up what has been on several that died. What it
    gave up may only have shared its workers with a recording that kills them (for want of memory, say): it is run again
    at the end, one at a time, and what then still kills is the recording.
    Raises InputError when the scheduler is lost. Whatever ends the iteration, tasks not begun are cancelled.
    """
    with _submitted(tasks, executor, work) as futures:
        suspects = []
        for future in as_completed(futures):
            outcome = _outcome(future)
            if outcome is None:
                suspects.append(futures[future])
            else:
                yield futures[future], outcome
    for task in suspects:
        with _submitted([task], executor, work) as (future,):
            yield task, _outcome(next(as_completed([future]))) or failed_outcome(future.exception() or RuntimeError())


@contextmanager
def _submitted(tasks: Sequence[Task], executor: Executor, work: Work) -> Iterator[dict[Future[Outcome], Task]]:
    futures: dict[Future[Outcome], Task] = {}
    try:
        for task in tasks:
            futures[executor.submit(work, task)] = task
        yield futures
    finally:
        for future in futures:
            future.cancel()


def _outcome(future: Future[Outcome]) -> Outcome | None:
    """What a finished future holds; None where every worker that began it died."""
    if future.cancelled():
        raise scheduler_lost()
    error = future.exception()
    if error is None:
        return future.result()
    return None if _killed_worker(error) else failed_outcome(error)


def scheduler_lost() -> InputError:
    """That the scheduler is gone; what was finished is stored."""
    what = "the scheduler does not answer any more"
    return InputError(what=what, where="survey", remedy="start it and survey again: it goes on where it stopped")


def _killed_worker(error: BaseException) -> bool:
    distributed = sys.modules.get("distributed")  # without it no error can be its
    return distributed is not None and isinstance(error, distributed.KilledWorker)
