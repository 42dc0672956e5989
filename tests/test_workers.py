"""Work shared out over processes: everything is done once, in order, whatever happens to whoever does it."""

from __future__ import annotations

import os
import signal
from multiprocessing import get_context

import numpy as np
import pytest

from diagnosis.workers import Workers

MANY = list(range(40))


@pytest.mark.parametrize("count", [1, 2, 5, 100])
def test_results_come_in_the_order_of_the_items(count: int) -> None:
    assert Workers(count).map(lambda n: n * n, MANY) == [n * n for n in MANY]


def test_more_items_than_a_batch_takes() -> None:
    items = list(range(1000))
    assert Workers(2).map(lambda n: -n, items) == [-n for n in items]


def test_several_processes_work_at_the_same_time() -> None:
    """Two items that each wait for the other: one process alone would wait in vain, and break the barrier."""
    barrier = get_context("fork").Barrier(2)

    def meet(_item: int) -> int:
        barrier.wait(timeout=60)
        return os.getpid()

    assert len(set(Workers(2).map(meet, [0, 1]))) == 2


@pytest.mark.parametrize("count", [1, 3])
def test_the_first_exception_comes_back(count: int) -> None:
    def refuse(n: int) -> int:
        if n >= 5:
            raise ValueError(f"no {n}")
        return n

    with pytest.raises(ValueError, match="no 5"):
        Workers(count).map(refuse, MANY)


def test_a_killed_worker_costs_no_result() -> None:
    own = os.getpid()

    def fragile(n: int) -> int:
        if os.getpid() != own:
            os.kill(os.getpid(), signal.SIGKILL)
        return n

    assert Workers(4).map(fragile, MANY) == MANY


def test_shared_objects_come_back_as_themselves() -> None:
    shared, other = np.arange(3.0), np.arange(2.0)
    for first, second in Workers(3).map(lambda _n: (shared, other), MANY, shared=[shared]):
        assert first is shared
        np.testing.assert_array_equal(second, other)


def test_work_within_work_is_done_there() -> None:
    inner = Workers(3)
    assert Workers(3).map(lambda n: sum(inner.map(lambda m: m, range(n))), [2, 3, 4]) == [1, 3, 6]
