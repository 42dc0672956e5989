"""Peak memory of the commands against the rows of a long run, each in a process of its own."""

from __future__ import annotations

import pytest

from benchmarks.long_runs import measured

pytest.importorskip("mujoco")

ROWS = (2000, 8000)
KILOBYTES = 20
"""For each row of ten columns that is added: a matrix of rows by rows would take 80, and one with channels more."""


@pytest.mark.long(27)
def test_memory_is_in_proportion_to_the_rows() -> None:
    """`calibrate` diagnoses one surrogate after another, each as `diagnose` a recording."""
    commands = ("read", "fit", "diagnose", "compare", "compensate")
    peaks = {(one.command, one.rows): one.peak for one in measured(["joints"], ROWS, commands)}
    assert len(peaks) == len(ROWS) * len(commands)
    for command in commands:
        added = (peaks[command, ROWS[1]] - peaks[command, ROWS[0]]) * 2**20 / (ROWS[1] - ROWS[0])
        assert added < KILOBYTES * 1000, command
