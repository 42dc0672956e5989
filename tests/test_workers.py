"""Work shared out over processes: everything is done once, in order, whatever happens to whoever does it."""

from __future__ import annotations

import os
import select
import signal
import socket
import threading
import time
from collections.abc import Callable, Sequence
from functools import cached_property
from itertools import pairwise
from math import inf
from multiprocessing import active_children, get_context
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from diagnosis.parallel.cached_values import CachedValue, compute_by_all
from diagnosis.parallel.workers import MAX_BATCH, Workers, WorkItem, run_spmd

MANY = list(range(40))
Function = Callable[[Any], Any]


def mapped(count: int, function: Function, items: Sequence[Any] = MANY, **options: Any) -> list[Any]:
    """One batch, by so many processes in step."""
    return run_spmd(count, lambda team: team.map(function, items, **options))


@pytest.mark.parametrize("count", [1, 2, 5, 30])
def test_results_come_in_the_order_of_the_items(count: int) -> None:
    assert mapped(count, lambda n: n * n, MANY) == [n * n for n in MANY]


def test_more_items_than_a_batch_takes() -> None:
    items = list(range(MAX_BATCH + 1))
    assert mapped(2, lambda n: -n, items) == [-n for n in items]


def test_several_processes_work_at_the_same_time() -> None:
    """Two items that each wait for the other: one process alone would wait in vain, and break the barrier."""
    barrier = get_context("fork").Barrier(2)

    def meet(_item: int) -> int:
        barrier.wait(timeout=60)
        return os.getpid()

    assert len(set(mapped(2, meet, [0, 1]))) == 2


def test_large_results_hold_nobody_up() -> None:
    """Far more than a pipe holds; the copy goes on to its second item while the original has only begun its first."""
    going_on = get_context("fork").Event()
    original = os.getpid()
    begun: list[int] = []

    def work(item: int) -> bytes:
        begun.append(item)
        if os.getpid() == original:
            assert going_on.wait(timeout=60)
        elif len(begun) == 2:
            going_on.set()
        return bytes(10**6 + item)

    assert [len(found) for found in mapped(2, work, [0, 1, 2])] == [10**6, 10**6 + 1, 10**6 + 2]


def test_large_arrays_arrive_as_they_were_made() -> None:
    """Row by row, column by column, strided, empty, complex, boolean; three processes, so that some are passed on."""
    whole = np.random.default_rng(3).normal(size=(300, 200))
    expected = [whole, whole.T, whole[::2, ::3], whole[:0], whole + 1j, whole > 0, whole.astype(np.float32)]
    going_on = get_context("fork").Event()
    original = os.getpid()

    def work(number: int) -> tuple[int, NDArray[Any]]:
        if os.getpid() == original:
            assert going_on.wait(timeout=60)  # until it has something to receive
        else:
            going_on.set()
        return os.getpid(), expected[number].copy("K")

    def program(team: Workers) -> list[tuple[int, NDArray[Any]]]:
        first = team.map(work, list(range(len(expected))))
        return team.map(lambda number: first[number], list(range(len(expected))))

    found = run_spmd(3, program)
    assert any(maker != original for maker, _ in found)
    for (_, array), array_expected in zip(found, expected, strict=True):
        np.testing.assert_array_equal(array, array_expected)
        assert array.dtype == array_expected.dtype
        array[...] = 0  # it may be written to


def test_a_process_has_the_items_of_a_label_again() -> None:
    """Two items that each wait for the other, and change places: whoever made one makes it again.

    Who comes first waits, and its item takes that much longer: less than five times as long as the other's, or that
    process takes both. It fails where one of two processes begins 0.8 s after the other.
    """
    barrier = get_context("fork").Barrier(2)

    def meet(_label: str) -> int:
        barrier.wait(timeout=60)
        time.sleep(0.2)
        return os.getpid()

    def program(team: Workers) -> tuple[list[int], list[int]]:
        return team.map(meet, ["a", "b"], label=str), team.map(meet, ["b", "a"], label=str)

    first, second = run_spmd(2, program)
    assert second == first[::-1]
    assert len(set(first)) == 2


def test_a_process_begins_with_what_is_known_to_be_long() -> None:
    """Each process has one of the first two items, then one of the last two, which take less time, in pairs."""
    barrier = get_context("fork").Barrier(2)

    def meet(label: str) -> tuple[int, float]:
        begun = time.perf_counter()
        barrier.wait(timeout=60)
        time.sleep(0.05 if label in ("a", "b") else 0.0)
        return os.getpid(), begun

    def program(team: Workers) -> list[tuple[int, float]]:
        team.map(meet, ["a", "b"], label=str)
        team.map(meet, ["c", "d"], label=str)
        return team.map(meet, ["a", "b", "c", "d"], label=str, guess=lambda label: inf if label == "d" else 0)

    made = run_spmd(2, program)
    own = [begun for process, begun in made if process == made[3][0]]
    assert len(own) == 2
    assert made[3][1] == min(own)


def test_of_new_items_those_guessed_to_be_longest_are_begun_first() -> None:
    """Two processes that wait for each other with each item take them in pairs."""
    barrier = get_context("fork").Barrier(2)

    def meet(_item: int) -> float:
        barrier.wait(timeout=60)
        return time.perf_counter()

    order = [5, 2, 7, 0, 4, 1, 6, 3]
    begun = dict(zip(order, mapped(2, meet, order, guess=lambda item: item if item < 7 else inf), strict=True))
    pairs = [{begun[2 * k], begun[2 * k + 1]} for k in (3, 2, 1, 0)]
    assert all(max(earlier) < min(later) for earlier, later in pairwise(pairs))


def test_a_free_process_takes_what_took_another_one_long() -> None:
    """Before its own short items, though the caches are the other's: else that would be left for the end.

    The copy begins with the first item of a batch, the original with the last. In the last one the copy has "busy",
    which waits for "long"; a second is five times the milliseconds that "short" took unless the machine stands still.
    """
    barrier = get_context("fork").Barrier(2)

    def meet(label: str) -> tuple[int, float]:
        begun = time.perf_counter()
        if label != "short" or not began:
            barrier.wait(timeout=60)
        if label == "long" and not began:
            time.sleep(1.0)
        return os.getpid(), begun

    began: list[bool] = []

    def program(team: Workers) -> list[tuple[int, float]]:
        team.map(meet, ["warm", "up"], label=str)
        team.map(meet, ["long", "short"], label=str)
        team.map(meet, ["busy", "quick"], label=str)
        began.append(True)
        return team.map(meet, ["short", "long", "busy"], label=str, guess=lambda label: inf if label == "busy" else 0)

    short, long, busy = run_spmd(2, program)
    assert long[0] != busy[0]
    assert long[1] < short[1]


def test_every_process_has_all_results() -> None:
    """Each of a second batch, whoever makes it, is made of what all had made in the first."""

    def program(team: Workers) -> list[int]:
        squares = team.map(lambda n: n * n, MANY)
        return team.map(lambda n: squares[n] + sum(squares), MANY)

    total = sum(n * n for n in MANY)
    assert run_spmd(4, program) == [n * n + total for n in MANY]


def test_tasks_of_several_kinds_are_one_batch() -> None:
    tasks = [WorkItem("one", lambda: 1), WorkItem("pi", lambda: "3.14"), WorkItem("none", lambda: None)]
    assert run_spmd(2, lambda team: team.run(tasks)) == [1, "3.14", None]


@pytest.mark.parametrize("items", [[], [0], MANY])
def test_the_copies_end_with_the_last_batch(items: list[int]) -> None:
    """What the program does afterwards is done by the original alone, further batches too; nothing waits for a copy."""
    original = os.getpid()
    reached = get_context("fork").Value("i", 0)

    def program(team: Workers) -> list[list[int]]:
        squares = team.map(lambda n: n * n, MANY)
        last = team.map(lambda n: -n, items, last=True)
        reached.value += os.getpid() != original
        for process in active_children():
            process.join(timeout=60)
            assert process.exitcode == 0
        return [squares, last, team.map(lambda _: os.getpid(), MANY)]

    squares, last, processes = run_spmd(3, program)
    assert squares == [n * n for n in MANY]
    assert last == [-n for n in items]
    assert set(processes) == {original}
    assert not reached.value


def test_a_last_batch_within_an_item_ends_no_copy() -> None:
    """The next batch is shared out again: its two items wait for each other."""
    barrier = get_context("fork").Barrier(2)

    def meet(_item: int) -> int:
        barrier.wait(timeout=60)
        return os.getpid()

    def program(team: Workers) -> tuple[list[list[int]], list[int]]:
        def nested(item: int) -> list[int]:
            barrier.wait(timeout=60)  # each process has one
            return team.map(lambda n: item + n, [1, 2], last=True)

        return team.map(nested, [10, 20]), team.map(meet, [0, 1])

    sums, processes = run_spmd(2, program)
    assert sums == [[11, 12], [21, 22]]
    assert len(set(processes)) == 2


def test_an_exception_leaves_the_processes_in_step() -> None:
    """Who catches it goes on with all the others."""

    def program(team: Workers) -> list[int]:
        with pytest.raises(ZeroDivisionError):
            team.map(lambda n: 1 // n, MANY)
        barrier.wait(timeout=60)
        return team.map(lambda n: -n, MANY)

    barrier = get_context("fork").Barrier(3)
    assert run_spmd(3, program) == [-n for n in MANY]


def test_a_copy_out_of_step_is_let_go() -> None:
    """It would hand in results of other items."""

    def program(team: Workers) -> list[int]:
        own = [n + 100 for n in MANY] if team.rank == 1 else MANY
        return [sum(team.map(lambda n: n, own, label=str)), sum(team.map(lambda n: 2 * n, MANY))]

    assert run_spmd(3, program) == [sum(MANY), 2 * sum(MANY)]


def test_copies_are_not_heard(capfd: pytest.CaptureFixture[str]) -> None:
    def program(team: Workers) -> int:
        print("at", team.rank)
        return sum(team.map(lambda n: n, MANY))

    assert run_spmd(3, program) == sum(MANY)
    assert capfd.readouterr().out == "at 0\n"


@pytest.mark.parametrize("count", [1, 3])
def test_all_items_are_begun_once_and_announced(count: int) -> None:
    announced: list[int] = []
    found = mapped(count, lambda n: n + 1, announce=lambda begun, _total: announced.append(begun))
    assert found == [n + 1 for n in MANY]
    assert announced == sorted(announced)
    assert set(announced) <= set(MANY)


@pytest.mark.parametrize("count", [1, 3])
def test_the_first_exception_comes_back(count: int) -> None:
    def refuse(n: int) -> int:
        if n >= 5:
            raise ValueError(f"no {n}")
        return n

    with pytest.raises(ValueError, match="no 5"):
        mapped(count, refuse, MANY)


def test_a_killed_worker_costs_no_result() -> None:
    own = os.getpid()

    def fragile(n: int) -> int:
        if os.getpid() != own:
            os.kill(os.getpid(), signal.SIGKILL)
        return n

    def program(team: Workers) -> list[list[int]]:
        return [team.map(fragile, MANY) for _ in range(2)]

    assert run_spmd(4, program) == [MANY, MANY]


def test_shared_objects_come_back_as_themselves() -> None:
    shared, other = np.arange(3.0), np.arange(2.0)
    for first, second in mapped(3, lambda _n: (shared, other), MANY, shared=[shared]):
        assert first is shared
        np.testing.assert_array_equal(second, other)


def test_work_within_work_is_done_there() -> None:
    def program(team: Workers) -> list[int]:
        return team.map(lambda n: sum(team.map(lambda m: m, range(n))), [2, 3, 4])

    assert run_spmd(3, program) == [1, 3, 6]


def test_no_copy_outlives_what_ends_the_work() -> None:
    """An interrupt, or an announcement that fails, leaves neither processes nor open pipes."""
    own, descriptors = os.getpid(), set(os.listdir("/proc/self/fd"))

    def interrupted(begun: int, _total: int) -> None:
        if begun:
            raise KeyboardInterrupt

    def wait(n: int) -> int:
        threading.Event().wait(0 if os.getpid() == own else 60)
        return n

    with pytest.raises(KeyboardInterrupt):
        mapped(3, wait, MANY, announce=interrupted)
    assert not active_children()
    assert set(os.listdir("/proc/self/fd")) == descriptors


def test_an_interrupt_is_left_to_the_original(capfd: pytest.CaptureFixture[str]) -> None:
    own = os.getpid()

    def interrupt(n: int) -> int:
        if os.getpid() != own:
            os.kill(os.getpid(), signal.SIGINT)
        return n

    assert mapped(3, interrupt, MANY) == MANY
    assert capfd.readouterr().err == ""


class StubbornError(Exception):
    """One that does not arrive where it is sent."""

    def __init__(self, *, reason: str) -> None:
        super().__init__(reason)


def test_an_exception_that_cannot_be_sent_is_raised_all_the_same() -> None:
    def refuse(n: int) -> int:
        raise StubbornError(reason=f"no {n}")

    with pytest.raises(StubbornError, match="no 0"):
        mapped(3, refuse, MANY)


def test_results_that_cannot_be_sent_are_made_here(capfd: pytest.CaptureFixture[str]) -> None:
    def promised(n: int) -> Callable[[], int]:
        return lambda: n

    made = mapped(3, promised, MANY)
    assert [one() for one in made] == MANY
    assert capfd.readouterr().err == ""


def test_a_copy_killed_while_it_sends_costs_no_result() -> None:
    """What it sends is more than a pipe holds, and nobody reads before the original has nothing else to do."""
    own, begun = os.getpid(), get_context("fork").Event()

    def large(n: int) -> bytes:
        if os.getpid() == own:
            begun.wait(60)
            time.sleep(0.2)
            for child in active_children():
                child.kill()
        else:
            begun.set()
        return bytes([n]) * 1_000_000

    assert mapped(2, large, [1, 2]) == [bytes([n]) * 1_000_000 for n in (1, 2)]


def test_no_copy_waits_for_an_original_that_is_gone() -> None:
    """The original is killed while its copy sends more than a pipe holds."""
    _require_no_process_left(_killed_while_a_copy_sends)


def _require_no_process_left(original: Callable[[int, int], None]) -> None:
    """Run a process that is given a pipe, which its copies hold too, and is killed: soon nobody has the pipe."""
    read, write = os.pipe()
    process = get_context("fork").Process(target=original, args=(read, write))
    process.start()
    os.close(write)
    process.join()
    ready, _, _ = select.select([read], [], [], 60)
    assert ready
    assert os.read(read, 1) == b""  # the last who had it is gone
    os.close(read)


def _killed_while_a_copy_sends(read: int, _write: int) -> None:
    os.close(read)
    own, begun = os.getpid(), get_context("fork").Event()

    def large(_n: int) -> bytes:
        if os.getpid() == own:
            begun.wait(60)
            time.sleep(0.2)
            os.kill(own, signal.SIGKILL)
        begun.set()
        return bytes(1_000_000)

    mapped(3, large, MANY)


def test_copies_are_killed_with_the_original_in_the_midst_of_an_item() -> None:
    """They would compute to the end of the item, five minutes."""
    _require_no_process_left(_killed_while_copies_compute)


def _killed_while_copies_compute(read: int, _write: int) -> None:
    os.close(read)
    own, begun = os.getpid(), get_context("fork").Barrier(3)

    def long(_n: int) -> None:
        begun.wait(60)
        if os.getpid() == own:
            os.kill(own, signal.SIGKILL)
        threading.Event().wait(300)

    mapped(3, long, [1, 2, 3])


def test_a_copy_without_memory_costs_no_result() -> None:
    """The original may have enough; a lack of its own is raised, as with one process."""
    own, begun = os.getpid(), get_context("fork").Event()

    def large(n: int) -> int:
        if os.getpid() != own:
            begun.set()
            raise MemoryError
        assert begun.wait(60)
        return n

    assert mapped(2, large) == MANY

    def larger(n: int) -> int:
        if n == 7:
            raise MemoryError
        return n

    with pytest.raises(MemoryError):
        mapped(2, larger)


class NotUnpickled:
    """Can be pickled, and not unpickled."""

    def __init__(self, number: int) -> None:
        self.number = number

    def __reduce__(self) -> tuple[object, ...]:
        return int, ("no number",)


def test_results_that_do_not_arrive_are_made_here() -> None:
    own, made = os.getpid(), get_context("fork").Event()

    def make(n: int) -> NotUnpickled:
        if os.getpid() != own:
            made.set()
        assert made.wait(60)
        return NotUnpickled(n)

    assert [one.number for one in mapped(2, make)] == MANY


@pytest.mark.parametrize(("place", "name"), [(os, "fork"), (socket, "socketpair")])
@pytest.mark.parametrize("forked", [0, 1])
def test_where_no_copy_can_be_made_one_process_does_all(
    place: ModuleType, name: str, forked: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No memory, or no more open files, for the first copy, or for the second."""
    descriptors, calls = set(os.listdir("/proc/self/fd")), []
    real = getattr(place, name)

    def limited(*given: Any) -> Any:
        calls.append(given)
        if len(calls) > forked:
            raise OSError(12, "Cannot allocate memory")
        return real(*given)

    monkeypatch.setattr(place, name, limited)
    assert set(mapped(3, lambda _: os.getpid())) == {os.getpid()}
    assert not active_children()
    if place is socket:  # multiprocessing leaves four pipe ends of its own open where it cannot fork
        assert set(os.listdir("/proc/self/fd")) == descriptors


class Counted:
    """An object whose cached property says which process computed it, and how often it did."""

    def __init__(self) -> None:
        self.computed = 0

    @cached_property
    def value(self) -> tuple[int, int]:
        self.computed += 1
        return os.getpid(), self.computed


@pytest.mark.parametrize("known", [False, True])
def test_cached_values_are_computed_once_and_every_process_has_them(known: bool) -> None:
    """Each process tells what it has, in a batch of as many items as processes that wait for each other.

    A process that had the values keeps its own.
    """
    barrier = get_context("fork").Barrier(2)

    def program(team: Workers) -> list[tuple[int, list[int], list[tuple[int, int]]]]:
        owners = [Counted() for _ in MANY]
        before = [owner.value for owner in owners] if known else []
        compute_by_all(team, [CachedValue(str(i), owner, "value") for i, owner in enumerate(owners)])

        def told(_item: int) -> tuple[int, list[int], list[tuple[int, int]]]:
            barrier.wait(timeout=60)
            values = [vars(owner).get("value", (0, 0)) for owner in owners]
            assert not known or values == before
            return os.getpid(), [owner.computed for owner in owners], values

        return team.map(told, [0, 1])

    (one, computed, values), (other, computed_there, values_there) = run_spmd(2, program)
    assert one != other
    if known:
        assert {process for process, _ in values} == {one}
        assert {process for process, _ in values_there} == {other}
        assert {*computed, *computed_there} == {1}
    else:
        assert all(process in (one, other) for process, _ in values)
        twice = [a + b > 1 for a, b in zip(computed, computed_there, strict=True)]  # both took it at one instant
        assert all(t or v == w for t, v, w in zip(twice, values, values_there, strict=True))
        assert all(a + b >= 1 for a, b in zip(computed, computed_there, strict=True))
