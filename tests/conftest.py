"""Settings of all tests: one thread of linear algebra per process, as two processes share two cores.

What is derived is kept between tests and runs, and away from the user's: entries are named by the source that they
follow from, so that a test of an edited derivation derives.
"""

import os
from pathlib import Path

for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(variable, "1")
KEPT = Path(__file__).resolve().parents[1] / ".pytest_cache" / "derivations"
os.environ.setdefault("TRUEWRENCH_CACHE", str(KEPT))
