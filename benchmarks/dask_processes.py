"""A Dask scheduler and workers as programs of their own, as on a cluster, on the loopback interface of this machine."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from time import monotonic, sleep

PATIENCE = 60.0
"""Seconds in which the scheduler has to write down its address."""
LOOPBACK = ("--host", "127.0.0.1", "--dashboard-address", "127.0.0.1:0", "--no-dashboard")
"""Without the dashboard a server of health pages remains, which would listen everywhere."""
WORKER = ("--nthreads", "1", "--memory-limit", "0")


@dataclass(frozen=True)
class DaskProcesses:
    """A scheduler and its workers, each the leader of a process group."""

    address: str
    scheduler: subprocess.Popen[bytes]
    workers: tuple[subprocess.Popen[bytes], ...]

    def kill_worker(self, number: int) -> None:
        """kill -9 of a worker with everything that it started, so that nobody can start it again."""
        os.killpg(self.workers[number].pid, signal.SIGKILL)


@contextmanager
def dask_processes(folder: Path, *, workers: int, processes: int) -> Iterator[DaskProcesses]:
    """So many workers of so many processes at a scheduler; `folder` takes the address and the logs."""
    place = folder / "scheduler.json"
    started: list[subprocess.Popen[bytes]] = []
    try:
        arguments = [*LOOPBACK, "--port", "0"]
        started.append(_started(["scheduler", *arguments, "--scheduler-file", str(place)], folder / "scheduler.log"))
        address = _address(place, started[0])
        for number in range(workers):
            place_of_worker = ["--local-directory", str(folder / f"worker{number}")]
            command = ["worker", address, *LOOPBACK, *WORKER, "--nworkers", str(processes), *place_of_worker]
            started.append(_started(command, folder / f"worker{number}.log"))
        yield DaskProcesses(address, started[0], tuple(started[1:]))
    finally:
        for process in reversed(started):
            _end(process)


def _started(arguments: Sequence[str], log: Path) -> subprocess.Popen[bytes]:
    threads = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    with log.open("wb") as stream:
        command = [sys.executable, "-m", "dask", *arguments]
        return subprocess.Popen(command, stdout=stream, stderr=stream, start_new_session=True, env=os.environ | threads)


def _address(place: Path, scheduler: subprocess.Popen[bytes]) -> str:
    limit = monotonic() + PATIENCE
    while monotonic() < limit and scheduler.poll() is None:
        try:
            return str(json.loads(place.read_text())["address"])
        except (OSError, ValueError):
            sleep(0.1)  # not yet written
    raise RuntimeError("the Dask scheduler did not start")


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a process group that this module started, softly if it lets itself."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        try:
            os.killpg(process.pid, number)
        except ProcessLookupError:
            break
        try:
            process.wait(timeout=10)
        except subprocess.TimeoutExpired:
            continue
    process.wait()
