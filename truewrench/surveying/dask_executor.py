"""Local Dask cluster or remote scheduler as an executor."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from typing import TYPE_CHECKING

from modeling.errors import InputError

if TYPE_CHECKING:
    from distributed import Client

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
    with (
        _quiet(),
        LocalCluster(
            n_workers=count,
            threads_per_worker=1,
            processes=True,
            host=LOOPBACK,
            dashboard_address=None,
            scheduler_kwargs={"dashboard_address": f"{LOOPBACK}:0"},  # health pages remain: two surveys, two ports
            memory_limit=0,
            preload=IGNORE_INTERRUPTS,
            silence_logs=logging.CRITICAL,
        ) as cluster,
        Client(cluster) as client,
    ):
        yield _executor(client)


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
