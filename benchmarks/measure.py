"""Measure: time and peak memory of calls and processes made in turn, so that a busy machine is busy for all of them."""

from __future__ import annotations

import gc
import os
import resource
import sys
import tracemalloc
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import inf
from pathlib import Path
from subprocess import PIPE, CalledProcessError, Popen
from time import perf_counter, process_time
from typing import Any

Call = Callable[[], Any]

PATIENCE = 0.03
"""How long short calls are repeated in a round, s."""


def seconds(call: Call) -> float:
    """Wall-clock time of the quickest of several calls, as many as fit in `PATIENCE`: the one least disturbed."""
    begin = perf_counter()
    best = inf
    while True:
        start = perf_counter()
        call()
        end = perf_counter()
        best = min(best, end - start)
        if end - begin > PATIENCE:
            return best


def rounds(calls: Mapping[str, Call], count: int) -> dict[str, list[float]]:
    """Seconds of each call in each of `count` rounds, after one that warms up and is not counted.

    Garbage is collected before each round and not during it.
    """
    for call in calls.values():
        call()
    found: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(count):
        gc.collect()
        gc.disable()
        try:
            for name, call in calls.items():
                found[name].append(seconds(call))
        finally:
            gc.enable()
    return found


def peak_bytes(call: Call) -> int:
    """Peak memory of one call above what there was before it, the result included.

    It is what Python and NumPy allocate; compiled code that allocates for itself is not seen.
    """
    gc.collect()
    tracemalloc.start()
    try:
        call()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def peak_resident() -> float:
    """Peak resident memory of this process in MiB: Linux's own mark, which a process does not inherit, else rusage."""
    status = Path("/proc/self/status")
    if status.exists():
        marks = dict(line.split(":", 1) for line in status.read_text().splitlines())
        return float(marks["VmHWM"].split()[0]) / 1024
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 2**20


@dataclass(frozen=True)
class Cost:
    """What something took: seconds of CPU, user's and system's, and seconds on the clock."""

    cpu: float
    wall: float


def cost(call: Call) -> Cost:
    """Of one call, made once; for those that take long."""
    gc.collect()
    wall, cpu = perf_counter(), process_time()
    call()
    return Cost(process_time() - cpu, perf_counter() - wall)


@dataclass(frozen=True)
class Run:
    """A process from its start to its end: its cost, and the text that it printed."""

    cost: Cost
    printed: str


def process(command: Sequence[str], environment: Mapping[str, str]) -> Run:
    """Run a command. Raises CalledProcessError when it fails."""
    begin = perf_counter()
    with Popen(command, stdout=PIPE, text=True, env=dict(environment)) as child:
        assert child.stdout is not None
        printed = child.stdout.read()
        _, status, usage = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        raise CalledProcessError(child.returncode, command, printed)
    return Run(Cost(usage.ru_utime + usage.ru_stime, perf_counter() - begin), printed)
