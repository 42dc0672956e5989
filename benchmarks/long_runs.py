"""What long runs cost: wall-clock time, CPU time and peak memory of the commands, and how they grow with the rows.

Each command is a process of its own on a log on disk, one run at 1 kHz of which only the duration changes: 10 s at
10^4 rows, 17 min at 10^6. MuJoCo simulates it with a viscous drag on the tool. Two kinds of log:

pose      six axes, position and orientation as a robot writes them, in CSV; the motion is smoothed and differentiated
joints    in the plane, joint angles with their recorded derivatives, in Parquet, and a rig that states the noise

`read` is `tw.read`, without a command. Under the table stand the exponents, the slope of log time and log memory
against log rows between the largest two lengths of each command, memory without what the program takes before it
reads (the resident set of `read` of the shortest log): 1 is proportion, 2 a matrix of rows by rows.

`python -m benchmarks.long_runs [--rows 1e4 1e5 ...] [--kinds pose joints] [--commands fit diagnose ...]`
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from subprocess import CalledProcessError
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from benchmarks.measure import process
from modeling.table import Column, Table
from truewrench.simulated_rig import PlanarRig, SpatialRig, ViscousDrag, simulate

Array = NDArray[np.float64]

RATE = 1000.0
"""Hz: the usual rate of a real-time interface."""
ROWS = (10_000, 30_000, 100_000, 300_000, 1_000_000)
FREQUENCIES = np.array([0.071, 0.193, 0.317, 0.521, 0.833])
"""Hz, of every coordinate's sines: no run of these lengths repeats itself."""
DRAWS = 1
"""Surrogates of `calibrate`: each is a diagnosis, side by side on the cores, and costs what a diagnosis does."""
MOST_ROWS = {"diagnose": 300_000, "compare": 300_000, "compensate": 300_000, "calibrate": 100_000}
"""Longer logs of these are not asked for."""
COMMAND = """
import sys
from benchmarks.measure import peak_resident
from truewrench.command_line import main
code = main(sys.argv[1:])
print(); print(peak_resident())
sys.exit(code)
"""
READ = """
import sys
import truewrench as tw
from benchmarks.measure import peak_resident
tw.read(sys.argv[1], **({"rig": tw.Rig.read(sys.argv[2])} if len(sys.argv) > 2 else {}))
print(peak_resident())
"""
FOLDER = Path(__file__).parents[1]


@dataclass(frozen=True, eq=False)
class Sines:
    """Sines of incommensurate frequencies in every coordinate.

    amplitude, phase  (d, f) m or rad, and rad; `period` s, the whole run
    """

    amplitude: Array
    phase: Array
    period: float

    @classmethod
    def of(cls, reach: Sequence[float], period: float) -> Sines:
        """With so much reach in each coordinate, alike for every period."""
        rng = np.random.default_rng(5)
        share = rng.dirichlet(np.full(len(FREQUENCIES), 5.0), len(reach))
        return cls(np.array(reach)[:, None] * share, rng.uniform(0, 2 * np.pi, share.shape), period)

    def evaluate(self, time: Array) -> tuple[Array, Array, Array]:
        """q, dq, ddq, each (n, d), at the times (n,)."""
        rate = 2 * np.pi * FREQUENCIES
        angle = rate[:, None] * np.asarray(time)
        series = [np.empty((angle.shape[1], len(self.amplitude))) for _ in range(3)]
        for j, (amplitude, phase) in enumerate(zip(self.amplitude, self.phase, strict=True)):
            sine, cosine = np.sin(angle + phase[:, None]), np.cos(angle + phase[:, None])
            series[0][:, j], series[1][:, j] = amplitude @ sine, (amplitude * rate) @ cosine
            series[2][:, j] = -(amplitude * rate**2) @ sine
        return series[0], series[1], series[2]


def written(kind: str, rows: int, folder: Path) -> tuple[Path, list[str]]:
    """A log of that kind and the options that it is read with."""
    if kind == "pose":
        motion, space = Sines.of([0.25, 0.25, 0.2, 0.9, 0.9, 1.2], rows / RATE), SpatialRig()
        frame = simulate(space, motion, hidden=[ViscousDrag(c=0.4, d=0.12)], repeats=1, samples_per_period=rows, seed=3)
        path = folder / f"pose{rows}.csv"
        frame.drop(columns=["repeat", "temperature"]).to_csv(path, index=False, float_format="%.9g")
        return path, []
    motion, plane = Sines.of([0.6, 0.9, 1.2], rows / RATE), PlanarRig()
    frame = simulate(plane, motion, hidden=[ViscousDrag()], repeats=1, samples_per_period=rows, seed=3)
    _, rates, accelerations = motion.evaluate(frame["time"].to_numpy())
    for prefix, series in (("d", rates), ("dd", accelerations)):
        frame = frame.assign(**{f"{prefix}q{j + 1}": series[:, j] for j in range(3)})
    path, rig = folder / f"joints{rows}.parquet", folder / "rig.toml"
    frame.drop(columns=["repeat", "temperature"]).to_parquet(path, index=False)
    noise = ", ".join(f"{channel} = {std}" for channel, std in zip(plane.channels, plane.noise, strict=True))
    robot = f"[robot]\ngravity = {plane.gravity}\nlink_lengths = {list(plane.link_lengths)}\n"
    rig.write_text(f'{robot}[sensor]\nconvention = "{plane.convention}"\nnoise = {{ {noise} }}\n', encoding="utf-8")
    return path, ["--rig", str(rig)]


def arguments(command: str, log: Path, options: Sequence[str], folder: Path) -> list[str]:
    """Of Python, to run that command on a log; `fit` writes the model that others take."""
    model = [str(folder / "model.json")]
    if command == "read":
        return ["-c", READ, str(log), *options[1:]]
    of = {
        "fit": ["fit", str(log), *options, "--out", *model],
        "diagnose": ["diagnose", str(log), *options],
        "compare": ["compare", *model, "--on", str(log)],
        "compensate": ["compensate", *model, str(log), "--out", str(folder / "contact.csv")],
        "calibrate": ["calibrate", str(log), *options, "--draws", str(DRAWS), "--power-draws", "0"],
    }
    return ["-c", COMMAND, *of[command]]


@dataclass(frozen=True)
class Measured:
    """What one command took on one log: seconds, and MiB at the most."""

    kind: str
    command: str
    rows: int
    wall: float
    cpu: float
    peak: float


COMMANDS = ("read", "fit", "diagnose", "compare", "compensate", "calibrate")


def measured(kinds: Sequence[str], rows: Sequence[int], commands: Sequence[str]) -> Iterator[Measured]:
    """Each command on each log, the shortest first; each told on stderr as it is known."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        environment = os.environ | {"PYTHONPATH": str(FOLDER), "TRUEWRENCH_CACHE": str(folder / "cache")}
        for kind in kinds:
            for count in sorted(rows):
                log, options = written(kind, count, folder)
                for command in commands:
                    if count > MOST_ROWS.get(command, count):
                        continue
                    try:
                        run = process([sys.executable, *arguments(command, log, options, folder)], environment)
                    except CalledProcessError as error:
                        print(f"{command} of {count} rows failed with {error.returncode}", file=sys.stderr)
                        continue
                    peak = float(run.printed.split()[-1])
                    yield Measured(kind, command, count, run.cost.wall, run.cost.cpu, peak)
                log.unlink()


def exponents(found: Sequence[Measured]) -> list[tuple[str, str, float, float, float]]:
    """Kind, command, and the growth of wall and CPU time and of memory between a command's longest two logs."""
    held = {m.kind: m.peak for m in reversed(found) if m.command == "read"}
    table = []
    for kind, command in dict.fromkeys((m.kind, m.command) for m in found):
        last = [m for m in found if (m.kind, m.command) == (kind, command)][-2:]
        if len(last) < 2:
            continue
        growth = np.log(last[1].rows / last[0].rows)
        pairs = [[m.wall, m.cpu, max(m.peak - held.get(kind, 0.0), 1.0)] for m in last]
        table.append((kind, command, *(np.log(np.divide(pairs[1], pairs[0])) / growth)))
    return table


def told(kinds: Sequence[str], rows: Sequence[int], commands: Sequence[str]) -> Iterable[Table]:
    """What each command took, and the exponents; each run is told on stderr as it ends."""
    found = []
    for one in measured(kinds, rows, commands):
        print(one, file=sys.stderr, flush=True)
        found.append(one)
    figures = (Column(n, format=".3g") for n in ("wall s", "CPU s", "peak MiB"))
    yield Table.of(
        (*map(Column, ("log", "command", "rows")), *figures),
        [(m.kind, m.command, f"{m.rows:_}", m.wall, m.cpu, m.peak) for m in found],
    )
    names = ("exponent of wall", "of CPU", "of peak")
    yield Table.of((Column("log"), Column("command"), *(Column(n, format=".2f") for n in names)), exponents(found))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Time and memory of the commands against the rows of a long run.")
    parser.add_argument("--rows", type=float, nargs="+", default=ROWS)
    parser.add_argument("--kinds", nargs="+", default=("pose", "joints"))
    parser.add_argument("--commands", nargs="+", default=COMMANDS)
    options = parser.parse_args()
    for table in told(options.kinds, [int(count) for count in options.rows], options.commands):
        print(table, end="\n\n")
