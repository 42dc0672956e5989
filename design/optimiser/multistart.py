"""Multistart: local optimisation from many starts, best first."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, as_completed
from functools import lru_cache

from design.optimiser.design_task import DesignTask
from design.optimiser.local_optimum import LocalOptimum, local_optimum
from design.trajectories.trajectory import Trajectory
from modeling.errors import InputError

LocalSearch = Callable[[DesignTask, Trajectory], LocalOptimum]
"""A local optimisation from a start."""


def optimise(
    task: DesignTask,
    starts: Iterable[Trajectory],
    *,
    work: LocalSearch = local_optimum,
    executor: Executor | None = None,
    progress: Callable[[LocalOptimum], None] | None = None,
) -> tuple[LocalOptimum, ...]:
    """The result of `work` from each start, best first; equal ones in the order of their starts.

    `executor` (`concurrent.futures.Executor` or its like) runs several starts in parallel, with the same results;
    `progress` is called with each result. Threads take turns where IPOPT is needed, because its linear solver is not
    thread-safe: take processes. Raises InputError when no start leads to a trajectory within the limits.
    """
    local_optima, refused = dict[int, LocalOptimum](), dict[int, InputError]()
    for number, result in _results(task, list(starts), work, executor):
        if isinstance(result, InputError):
            refused[number] = result
            continue
        local_optima[number] = result
        if progress is not None:
            progress(result)
    if refused and not local_optima:
        raise refused[min(refused)]
    return tuple(sorted((local_optima[number] for number in sorted(local_optima)), key=lambda found: -found.value))


def _results(
    task: DesignTask, starts: list[Trajectory], work: LocalSearch, executor: Executor | None
) -> Iterator[tuple[int, LocalOptimum | InputError]]:
    """The number of each start and its result, in the order of completion."""
    if executor is None:
        yield from ((number, _result(task, start, work)) for number, start in enumerate(starts))
        return
    packed = pickle.dumps(task)
    futures: dict[Future[LocalOptimum | InputError], int] = {
        executor.submit(_result_in_worker, packed, start, work): number for number, start in enumerate(starts)
    }
    try:
        for future in as_completed(futures):
            yield futures[future], future.result()
    finally:
        for future in futures:
            future.cancel()


def _result_in_worker(packed: bytes, start: Trajectory, work: LocalSearch) -> LocalOptimum | InputError:
    return _result(_unpacked(packed), start, work)


@lru_cache(maxsize=4)
def _unpacked(packed: bytes) -> DesignTask:
    """The task, unpickled once per process, so that its functions are compiled once."""
    task: DesignTask = pickle.loads(packed)  # noqa: S301 (bytes of the process that submitted it)
    return task


def _result(task: DesignTask, start: Trajectory, work: LocalSearch) -> LocalOptimum | InputError:
    """The result of one start; its error is returned, so that the other starts go on."""
    try:
        return work(task, start)
    except InputError as error:
        return error
