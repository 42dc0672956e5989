"""Local Dask cluster or remote scheduler as an executor."""

from __future__ import annotations

import asyncio
import logging
import signal
import sys
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor, as_completed
from contextlib import ExitStack, contextmanager
from functools import partial
from multiprocessing import resource_tracker
from typing import TYPE_CHECKING

from modeling.errors import InputError
from truewrench.surveying.survey_task import DiagnosisOutcome, SurveyTask, failed_outcome

if TYPE_CHECKING:
    from distributed import Client


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


CONNECT_TIMEOUT = 5.0
"""Timeout of the connection to a scheduler, s."""
LOOPBACK = "127.0.0.1"
IGNORE_INTERRUPTS = "import signal\nsignal.signal(signal.SIGINT, signal.SIG_IGN)\n"
"""Preload of workers: Ctrl-C reaches every process of a terminal, and the client shuts the workers down."""


@contextmanager
def local_executor(workers: int | None = None, *, most: int | None = None) -> Iterator[Executor]:
    """Executor on local worker processes, by default one for each core, at most `most`.

    A worker that dies is restarted and its task rerun. Ports are local only, and the memory of workers is not
    limited. A program that calls this needs `if __name__ == "__main__":`, as worker processes
    import it.
    """
    from dask.system import CPU_COUNT
    from distributed import Client, LocalCluster

    count = min(workers or CPU_COUNT, most or workers or CPU_COUNT)
    with _quiet(), ExitStack() as stack:
        with _interrupts_held():
            cluster = stack.enter_context(
                LocalCluster(
                    n_workers=count,
                    threads_per_worker=1,
                    processes=True,
                    host=LOOPBACK,
                    dashboard_address=None,
                    # health pages remain: two surveys, two ports
                    scheduler_kwargs={"dashboard_address": f"{LOOPBACK}:0"},
                    memory_limit=0,
                    preload=IGNORE_INTERRUPTS,
                    silence_logs=logging.CRITICAL,
                )
            )
        yield _executor(stack.enter_context(Client(cluster)))


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Hold back Ctrl-C until the workers have started: they inherit that, and are not interrupted before they ignore
    it. Where signals cannot be held, nothing."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # where it starts, it lets interrupts through again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def remote_executor(scheduler: str) -> Iterator[Executor]:
    """Executor on the workers of the scheduler at the address `tcp://HOST:PORT`.

    Raises InputError when no scheduler answers there.
    """
    from distributed import Client

    with _quiet():
        try:
            with ThreadPoolExecutor(1) as thread:  # a notebook's event loop runs in this thread already
                thread.submit(asyncio.run, _check_scheduler(scheduler)).result()
            client = Client(scheduler, timeout=CONNECT_TIMEOUT, set_as_default=False)
        except Exception as error:  # any failure of the connection
            reason = str(error).strip() or f"no answer within {CONNECT_TIMEOUT:.0f} s"
            remedy = "give the address that `dask scheduler` prints, tcp://HOST:PORT"
            raise InputError(what=f"no scheduler answers: {reason}", where=scheduler, remedy=remedy) from None
        with client:
            yield _executor(client)


def _executor(client: Client) -> Executor:
    executor: Executor = client.get_executor()
    return executor


async def _check_scheduler(scheduler: str) -> None:
    """Ask a scheduler for its identity.

    A Dask client without a scheduler may never return, hence this check. Raises Dask's exceptions.
    """
    from distributed.comm.core import connect
    from distributed.core import send_recv
    from distributed.security import Security

    async with asyncio.timeout(CONNECT_TIMEOUT):
        comm = await connect(scheduler, timeout=CONNECT_TIMEOUT, **Security().get_connection_args("client"))
        try:
            identity = await send_recv(comm, op="identity", reply=True)
        finally:
            comm.abort()
    kind = "process without a name" if identity is None else str(identity["type"]).lower()
    if kind != "scheduler":
        raise TypeError(f"a {kind} answers there")


@contextmanager
def _quiet() -> Iterator[None]:
    """Suppress Dask's log messages: errors of recordings are in the rows of the survey."""
    logger = logging.getLogger("distributed")
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(level)
