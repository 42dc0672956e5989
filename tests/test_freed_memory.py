"""Freed memory is reused instead of being returned to the system."""

from __future__ import annotations

import subprocess
import sys

import pytest

PROGRAM = """
import resource
import numpy as np
from diagnosis.parallel.freed_memory import keep_freed_memory

keep_freed_memory()
faults = []
for _ in range(3):
    arrays = [np.ones(400_000) for _ in range(20)]
    del arrays
    faults.append(resource.getrusage(resource.RUSAGE_SELF).ru_minflt)
print(faults[-1] - faults[0])
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="a setting of the GNU C library")
def test_freed_arrays_are_allocated_again_without_page_faults() -> None:
    """Two rounds of 64 MB are 31 250 pages of 4 KiB, each a fault if the memory had been returned meanwhile."""
    found = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True)
    assert int(found.stdout) < 1000
