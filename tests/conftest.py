"""Settings of all tests: one thread of linear algebra per process, as two processes share two cores."""

import os

for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(variable, "1")
