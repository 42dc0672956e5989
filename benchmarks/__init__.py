"""Speed and accuracy of the library on fixed problems: python -m benchmarks."""

import os

for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(variable, "1")  # before NumPy is loaded: one thread for all
