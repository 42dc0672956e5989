"""Start-up: what commands that only describe cost, whole process, against loading NumPy."""

from __future__ import annotations

import resource
import subprocess
import sys
from collections.abc import Mapping, Sequence

from benchmarks.row import Row, table

ROUNDS = 9

PROGRAM = "import sys; from truewrench.command_line import main; sys.exit(main())"

ARGUMENTS: Mapping[str, Sequence[str]] = {
    "--help": ("--help",),
    "--version": ("--version",),
    "effects": ("effects",),
    "effects ID": ("effects", "viscous_drag"),
}


def cpu_seconds(*command: str) -> float:
    """User and system time of a Python process of its own, from its first instruction to its end."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, *command], check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def run() -> list[Row]:
    """One row a command; `import numpy` is timed in every round, as the machine may be busy with something else."""
    ratios: dict[str, list[float]] = {name: [] for name in ARGUMENTS}
    for _ in range(ROUNDS):
        numpy = cpu_seconds("-c", "import numpy")
        for name, argv in ARGUMENTS.items():
            ratios[name].append(numpy / cpu_seconds("-c", PROGRAM, *argv))
    return [
        Row(
            task="start-up",
            ours=f"truewrench {name}",
            instead='python -c "import numpy"',
            quantity="CPU time",
            ratios=tuple(found),
        )
        for name, found in ratios.items()
    ]


if __name__ == "__main__":
    print(table(run()))
