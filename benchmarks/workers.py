"""`python -m benchmarks.workers`: `diagnose` with two workers against one, and what two processes gain here at all.

Whole processes in turn, wall time, the median of the rounds. Two cores of a shared machine do less than twice the work
of one, and by how much changes from hour to hour: each round also takes two diagnoses with one worker each, side by
side, which share nothing. Their gain, twice the time alone over the time side by side, is what two workers could reach.

Every second round takes the ways in reverse order, so that one worker never comes right after the two side by side: it
would find their memory ready on a machine that gives freed memory back to its host.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from statistics import median
from time import perf_counter

from benchmarks.diagnosis import Files, files_of, line, run_once
from benchmarks.diagnosis_cases import GROUPS

REPOSITORY = Path(__file__).parents[1]
ONE, TWO, ONE_REPORTED, TWO_REPORTED, PAIR = "1 worker", "2 workers", "1 reported", "2 reported", "side by side"
HEADER = ("recording", ONE, TWO, "gain", "with a report", "of two processes")
WIDTHS = (30, 9, 9, 6, 14, 17)

Walls = Mapping[str, float]


def wall_of(files: Files, count: int, options: Sequence[str] = ()) -> float:
    """Seconds that `diagnose` takes with a number of workers."""
    return run_once(REPOSITORY, files, ("--workers", str(count), *options)).wall


def side_by_side(files: Files) -> float:
    """Seconds until the second of two diagnoses with one worker each is done, started together."""
    start = perf_counter()
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(partial(wall_of, files), (1, 1)))
    return perf_counter() - start


def walls_of(files: Files, report: Path, rounds: int) -> Walls:
    """The median wall time of each way; a first run, which derives the models, is not counted."""
    out = ("--out", str(report))
    wall_of(files, 1, out)
    ways: dict[str, Callable[[], float]] = {
        ONE: partial(wall_of, files, 1),
        TWO: partial(wall_of, files, 2),
        ONE_REPORTED: partial(wall_of, files, 1, out),
        TWO_REPORTED: partial(wall_of, files, 2, out),
        PAIR: partial(side_by_side, files),
    }
    measured = [{way: ways[way]() for way in (ways, reversed(ways))[turn % 2]} for turn in range(rounds)]
    return {way: median(found[way] for found in measured) for way in ways}


def row(name: str, walls: Walls) -> tuple[str, ...]:
    """A row of the table."""
    gains = (walls[ONE] / walls[TWO], walls[ONE_REPORTED] / walls[TWO_REPORTED], 2 * walls[ONE] / walls[PAIR])
    return (name, f"{walls[ONE]:.2f} s", f"{walls[TWO]:.2f} s", *(f"{gain:.2f}" for gain in gains))


def main() -> None:
    """Run the groups and print a row for each recording, and one for all of a group."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--group", action="append", choices=["planar", *GROUPS], help="default: all")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--data", type=Path, default=Path(tempfile.gettempdir()) / "truewrench_benchmark")
    arguments = parser.parse_args()
    for group in arguments.group or ["planar", *GROUPS]:
        print(line(HEADER, WIDTHS))
        measured: list[Walls] = []
        for files in files_of(group, arguments.data):
            measured.append(walls_of(files, arguments.data / "report", arguments.rounds))
            print(line(row(files.name, measured[-1]), WIDTHS), flush=True)
        total = {way: sum(walls[way] for walls in measured) for way in measured[0]}
        print(line(row(f"{group}, all", total), WIDTHS), "\n", flush=True)


if __name__ == "__main__":
    main()
