"""`python -m benchmarks`: every benchmark, one table."""

from __future__ import annotations

import os
import sys

for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(variable, "1")  # before NumPy is loaded: one thread for all


def main() -> None:
    """Run every benchmark and print its table; progress goes to a terminal's stderr."""
    from benchmarks import design_race, long_fit, refit, regressor, startup
    from benchmarks.row import table

    rows = []
    for benchmark in (startup, regressor, refit, long_fit, design_race):
        if sys.stderr.isatty():
            print(f"{benchmark.__name__} ...", file=sys.stderr, flush=True)
        rows += benchmark.run()
    print(table(rows))


if __name__ == "__main__":
    main()
