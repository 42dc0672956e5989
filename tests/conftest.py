"""Settings of all tests: one thread of linear algebra per process, as two processes share two cores."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
