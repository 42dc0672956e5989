"""Cluster: an executor whose tasks run in other processes, on this machine's cores or on a Dask scheduler's workers."""

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

PATIENCE = 5.0
"""Seconds in which a scheduler has to answer."""
LOOPBACK = "127.0.0.1"
DEAF = "import signal\nsignal.signal(signal.SIGINT, signal.SIG_IGN)\n"
"""What a worker runs first: Ctrl-C reaches every process of a terminal, and it is the client that ends the workers."""


@contextmanager
def local_executor(workers: int | None = None, *, most: int | None = None) -> Iterator[Executor]:
    """An executor on worker processes of this machine, as many as it has cores, and `most` at the most.

    A worker that dies is started anew and its task run again. Nothing listens beyond this machine, and nothing limits a
    worker's memory but the machine. A program that calls this needs `if __name__ == "__main__":`, as worker processes
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
            preload=DEAF,
            silence_logs=logging.CRITICAL,
        ) as cluster,
        Client(cluster) as client,
    ):
        yield _executor(client)


@contextmanager
def remote_executor(scheduler: str) -> Iterator[Executor]:
    """An executor on the workers of the scheduler at that address, `tcp://HOST:PORT`.

    Raises InputError when nobody answers there.
    """
    from distributed import Client

    with _quiet():
        try:
            with ThreadPoolExecutor(1) as thread:  # where a notebook's loop does not run already
                thread.submit(asyncio.run, _greet(scheduler)).result()
            client = Client(scheduler, timeout=PATIENCE, set_as_default=False)
        except Exception as error:  # whatever kept Dask from an answer
            reason = str(error).strip() or f"nothing came within {PATIENCE:.0f} s"
            remedy = "give the address that `dask scheduler` prints, tcp://HOST:PORT"
            raise InputError(what=f"no scheduler answers: {reason}", where=scheduler, remedy=remedy) from None
        with client:
            yield _executor(client)


def _executor(client: Client) -> Executor:
    executor: Executor = client.get_executor()
    return executor


async def _greet(scheduler: str) -> None:
    """Ask a scheduler for its identity.

    A Dask client that has no scheduler to talk to may never end: so this comes before it. Raises whatever Dask does.
    """
    from distributed.comm.core import connect
    from distributed.core import send_recv
    from distributed.security import Security

    async with asyncio.timeout(PATIENCE):
        comm = await connect(scheduler, timeout=PATIENCE, **Security().get_connection_args("client"))
        try:
            identity = await send_recv(comm, op="identity", reply=True)
        finally:
            comm.abort()
    if identity["type"] != "Scheduler":
        raise TypeError(f"a {identity['type'].lower()} is there")


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep Dask's log lines to those who ask for them: what concerns the survey stands in its rows."""
    logger = logging.getLogger("distributed")
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(level)
