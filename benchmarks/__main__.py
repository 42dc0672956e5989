"""`python -m benchmarks`: every benchmark, one table."""

from __future__ import annotations

import sys


def main() -> None:
    """Run every benchmark and print its table; progress goes to a terminal's stderr."""
    from benchmarks import design_race, fits_of_millions, long_fit, refit, regressor, startup
    from benchmarks.row import table

    rows = []
    for benchmark in (startup, regressor, refit, long_fit, fits_of_millions, design_race):
        if sys.stderr.isatty():
            print(f"{benchmark.__name__} ...", file=sys.stderr, flush=True)
        rows += benchmark.run()
    print(table(rows))


if __name__ == "__main__":
    main()
