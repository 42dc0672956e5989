"""The process of a page is cancelled wherever it is, also where Python drops exceptions; so is a notebook's thread."""

from __future__ import annotations

import subprocess
import sys
from queue import SimpleQueue
from time import monotonic, sleep
from typing import Any

import numpy as np
import pytest

from truewrench.workbench import study_process
from truewrench.workbench.study_process import Cancelled, Done, Message, StudyThread

BEGINNING = """
import os, signal, time
from truewrench.workbench.study_process import AGAIN, Cancelled, _answer, _cancellable

class Finalised:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGUSR1)
        time.sleep(0.01)
"""
DROPPED = """
class Actions:
    def answer(self, request):
        Finalised()
        deadline = time.monotonic() + 30
        while time.monotonic() < deadline:
            time.sleep(0.01)

busy = _cancellable()
assert isinstance(_answer(Actions(), {}, busy), Cancelled)
time.sleep(3 * AGAIN)  # nothing is under way: no signal comes any more
print("cancelled")
"""
CLEANED_UP = """
class Actions:
    def answer(self, request):
        try:
            os.kill(os.getpid(), signal.SIGUSR1)
            time.sleep(30)
        finally:
            time.sleep(3 * AGAIN)
            print("cleaned up")

assert isinstance(_answer(Actions(), {}, _cancellable()), Cancelled)
"""
FAILED = """
class Slow(Exception):
    def __str__(self):
        time.sleep(3 * AGAIN)
        return "slow to say what is wrong"

class Actions:
    def answer(self, request):
        Finalised()
        raise Slow

print(_answer(Actions(), {}, _cancellable()).what)
"""


def test_a_cancellation_that_python_drops_is_made_again() -> None:
    found = _run(DROPPED)
    assert "Exception ignored" in found.stderr  # the first was dropped
    assert found.stdout.strip() == "cancelled"


def test_what_cleans_up_after_a_cancellation_is_let_finish() -> None:
    assert _run(CLEANED_UP).stdout.strip() == "cleaned up"


def test_work_that_fails_before_it_is_cancelled_says_so() -> None:
    assert _run(FAILED).stdout.strip().endswith("slow to say what is wrong")


def test_a_thread_answers_once_whenever_it_is_cancelled(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cancellations come before and after the end of the work, many within a millisecond of it."""

    class Actions:
        def __init__(self, *_: Any) -> None: ...

        def answer(self, request: dict[str, float]) -> float:
            deadline = monotonic() + request["seconds"]
            while monotonic() < deadline:
                pass
            return request["seconds"]

    monkeypatch.setattr(study_process, "StudyActions", Actions)
    messages: SimpleQueue[Message] = SimpleQueue()
    thread = StudyThread(messages.put, None)  # type: ignore[arg-type]  # the actions have no study
    rng, found = np.random.default_rng(3), []
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-4)
    for _ in range(80):
        thread.ask({"seconds": 0.005})
        sleep(rng.uniform(0.0, 0.01))
        thread.cancel()
        found.append(messages.get(timeout=10))
    sys.setswitchinterval(before)
    thread.ask({"seconds": 0.0})
    assert messages.get(timeout=10) == Done(0.0)
    assert messages.empty()
    assert {type(message) for message in found} == {Done, Cancelled}
    thread.ask({"seconds": 60.0})
    sleep(0.02)
    thread.end().join(10)
    assert isinstance(messages.get(timeout=10), Cancelled)


def _run(program: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", BEGINNING + program]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
