"""The design over seeds against an earlier commit's: ln det, the bound and CPU seconds, in one run.

    python -m benchmarks.design_seeds --before WORKTREE [--seeds 10] [--bounds 3]

WORKTREE is a checkout of the earlier commit. Each seed is one `truewrench design RIG --json` with one worker in a
process of its own, start-up included, first here and then there, so that a busy machine is busy for both. CPU seconds
are those of the process, user and system.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

HERE = Path(__file__).parent.parent
RIG = """[robot]
name = "reference problem"
link_lengths = [1.0, 0.97, 0.4]
tip_length = 0.2
[limits]
position = [1.0471975512, 1.2217304764, 1.3962634016]
velocity = [2.0, 2.2, 3.5]
acceleration = [10.0, 10.0, 15.0]
"""
COMMAND = "import sys; from truewrench.command_line import main; sys.exit(main())"
TASKS = {
    "paper": (["--series", "paper", "--no-bound"], "logdet"),
    "free": (["--no-bound"], "logdet"),
    "bound": (["--series", "paper", "--starts", "1"], "bound_logdet"),
}
"""Options, and which figure of the JSON is looked at; the bound comes with one start of the chapter's series."""


@dataclass(frozen=True)
class Outcome:
    """The figure of one seed, and the CPU seconds that it took."""

    figure: float
    seconds: float


def outcome(worktree: Path, rig: Path, task: str, seed: int) -> Outcome:
    """One design by the code in a worktree."""
    options, key = TASKS[task]
    alone = {"PYTHONPATH": str(worktree), "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, "-c", COMMAND, "design", rig, *options, "--seed", str(seed), "--workers", "1", "--json"],
        cwd=worktree,
        env=os.environ | alone,
        capture_output=True,
        text=True,
        check=True,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Outcome(float(json.loads(done.stdout)[key]), spent)


def line(task: str, ours: Sequence[Outcome], theirs: Sequence[Outcome]) -> str:
    """Smallest, median and largest figure of both, median seconds of both, and their ratio."""
    cells = [task.ljust(6)]
    for found in (ours, theirs):
        figures = [one.figure for one in found]
        cells += [f"{value:9.4f}" for value in (min(figures), median(figures), max(figures))]
        cells.append(f"{median(one.seconds for one in found):8.2f}")
    ratio = median(t.seconds / o.seconds for o, t in zip(ours, theirs, strict=True))
    return "  ".join([*cells, f"{ratio:6.2f}"])


def main() -> None:
    """Print the table, and each seed as it is done."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--before", type=Path, required=True, metavar="WORKTREE")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--bounds", type=int, default=3, help="seeds of the bound")
    asked = parser.parse_args()
    lines = []
    with TemporaryDirectory() as folder:
        rig = Path(folder) / "reference.toml"
        rig.write_text(RIG)
        for task in TASKS:
            ours, theirs = list[Outcome](), list[Outcome]()
            for seed in range(asked.bounds if task == "bound" else asked.seeds):
                for found, worktree in ((ours, HERE), (theirs, asked.before.resolve())):
                    found.append(outcome(worktree, rig, task, seed))
                here, there = ours[-1], theirs[-1]
                print(
                    f"{task} seed {seed}: {here.figure:.4f} in {here.seconds:.1f} s, before {there.figure:.4f} in "
                    f"{there.seconds:.1f} s",
                    flush=True,
                )
            lines.append(line(task, ours, theirs))
    print("\n          least     median       most     CPU s   before: the same                        CPU s   ratio")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
