"""The process of a page is cancelled wherever it is, also where Python drops exceptions."""

from __future__ import annotations

import subprocess
import sys

DROPPED = """
import os, signal, time
from truewrench.workbench import study_process
from truewrench.workbench.study_process import Cancelled, _answer, _cancellable

study_process.AGAIN = 0.2

class Finalised:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGUSR1)
        time.sleep(0.01)

class Actions:
    def answer(self, request):
        Finalised()
        deadline = time.monotonic() + 30
        while time.monotonic() < deadline:
            time.sleep(0.01)

busy = _cancellable()
assert isinstance(_answer(Actions(), {}, busy), Cancelled)
time.sleep(0.5)  # nothing is under way: no signal comes any more
print("cancelled")
"""


def test_a_cancellation_that_python_drops_is_made_again() -> None:
    found = subprocess.run([sys.executable, "-c", DROPPED], capture_output=True, text=True, timeout=60, check=True)
    assert "Exception ignored" in found.stderr  # the first was dropped
    assert found.stdout.strip() == "cancelled"
