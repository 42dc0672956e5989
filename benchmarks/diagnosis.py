"""`python -m benchmarks.diagnosis BEFORE`: `diagnose` against an earlier commit's, in a worktree of its own.

CPU seconds and wall time of whole processes in turn, the median of the rounds, and the peak memory; checked in the same
run: the same verdict, the same effects, parameters within a tenth of their standard deviation.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any

from benchmarks.diagnosis_cases import GROUPS

SHARED = Path(os.environ.get("TRUEWRENCH_DATA", Path(__file__).parents[2] / "shared" / "data"))
MAIN = "import sys; from truewrench.command_line import main; sys.exit(main())"
HEADER = ("recording", "CPU s", "before", "ratio", "wall s", "before", "MB", "before", "same")
ONE_WORKER = ("--workers", "1")
"""Earlier commits shared a diagnosis out among processes."""
AGREEMENT = 0.1
"""Of a parameter's standard deviation."""


@dataclass(frozen=True)
class Files:
    """What is diagnosed."""

    name: str
    train: Path
    validate: Path | None
    rig: Path | None

    def arguments(self) -> list[str]:
        """For the command line."""
        found = ["diagnose", str(self.train), "--json"]
        found += ["--validate", str(self.validate)] if self.validate else []
        return found + (["--rig", str(self.rig)] if self.rig else [])


@dataclass(frozen=True)
class Run:
    """One process: CPU and wall seconds, peak memory in MB, and what it printed."""

    cpu: float
    wall: float
    memory: float
    result: dict[str, Any]


def files_of(group: str, folder: Path) -> list[Files]:
    """The recordings of a group, simulated unless they are there; `planar` are the shared ones."""
    if group == "planar":
        places = sorted(p for p in (SHARED / "planar").iterdir() if p.is_dir())
        return [Files(f"planar {p.name}", p / "train.csv", p / "validate.csv", p / "rig.toml") for p in places]
    return [Files(f"{group} {case.name}", *case.written(folder)) for case in GROUPS[group]]


def run_once(repository: Path, files: Files, options: Sequence[str] = ()) -> Run:
    """Diagnose with the code of a repository, on one thread of linear algebra, its bytecode kept as everywhere."""
    environment = {
        **{name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"},
        "PYTHONPATH": str(repository),
        "OPENBLAS_NUM_THREADS": "1",
        "OMP_NUM_THREADS": "1",
    }
    with tempfile.TemporaryFile() as output:
        start = perf_counter()
        command = [sys.executable, "-c", MAIN, *files.arguments(), *options]
        process = subprocess.Popen(command, env=environment, cwd=tempfile.gettempdir(), stdout=output)
        _, status, used = os.wait4(process.pid, 0)
        wall = perf_counter() - start
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            raise RuntimeError(f"{files.name}: exit {process.returncode} of {repository}")
        output.seek(0)
        result = json.load(output)
    return Run(used.ru_utime + used.ru_stime, wall, used.ru_maxrss / 1024, result)


def differences(before: dict[str, Any], after: dict[str, Any]) -> list[str]:
    """What is not the same in two results."""
    found = [key for key in ("verdict", "added") if before[key] != after[key]]
    for name, parameter in before["parameters"].items():
        other = after["parameters"].get(name)
        std = parameter["std"]
        if other is None or (std and abs(parameter["value"] - other["value"]) > AGREEMENT * std):
            found.append(name)
    return found


def compared(files: Files, before: Path, after: Path, rounds: int) -> tuple[tuple[str, ...], float, float]:
    """A row of the table, and the CPU seconds after and before.

    The first run of each derives the models, once for each version of the code and library, and is not counted.
    """
    run_once(before, files, ONE_WORKER)
    run_once(after, files, ONE_WORKER)
    pairs = [(run_once(before, files, ONE_WORKER), run_once(after, files, ONE_WORKER)) for _ in range(rounds)]
    wrong = sorted({name for old, new in pairs for name in differences(old.result, new.result)})
    old_cpu, new_cpu = (median(pair[i].cpu for pair in pairs) for i in (0, 1))
    old_wall, new_wall = (median(pair[i].wall for pair in pairs) for i in (0, 1))
    old_memory, new_memory = (max(pair[i].memory for pair in pairs) for i in (0, 1))
    row = (
        files.name,
        f"{new_cpu:.2f}",
        f"{old_cpu:.1f}",
        f"{old_cpu / new_cpu:.1f}",
        f"{new_wall:.2f}",
        f"{old_wall:.1f}",
        f"{new_memory:.0f}",
        f"{old_memory:.0f}",
        "yes" if not wrong else "no: " + ", ".join(wrong),
    )
    return row, new_cpu, old_cpu


def line(cells: Sequence[str], widths: Sequence[int]) -> str:
    """Cells beside each other, the first to the left."""
    return "  ".join(c.rjust(w) if i else c.ljust(w) for i, (c, w) in enumerate(zip(cells, widths, strict=True)))


def main() -> None:
    """Run the groups and print a row for each recording."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("before", type=Path, help="worktree of the earlier commit")
    parser.add_argument("--group", action="append", choices=["planar", *GROUPS], help="default: all")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--data", type=Path, default=Path(tempfile.gettempdir()) / "truewrench_benchmark")
    arguments = parser.parse_args()
    after = Path(__file__).parents[1]
    widths = (30, 7, 7, 6, 7, 7, 6, 6, 4)
    for group in arguments.group or ["planar", *GROUPS]:
        total = [0.0, 0.0]
        print(line(HEADER, widths))
        for files in files_of(group, arguments.data):
            row, new, old = compared(files, arguments.before, after, arguments.rounds)
            total = [total[0] + new, total[1] + old]
            print(line(row, widths), flush=True)
        if total[0]:
            print(f"{group}: {total[1] / total[0]:.1f} times less CPU in all\n", flush=True)


if __name__ == "__main__":
    main()
