"""A survey on Dask against the same diagnoses in one process: every row is there and equal, though a worker is killed.

`python -m benchmarks.survey` simulates 40 recordings of a planar rig, one a day (a drag that grows, a tether, a lag, a
crosstalk, nothing), starts a scheduler and two workers of two processes each on this machine, surveys through the
scheduler, and kills one worker with both its processes (kill -9, and nobody starts it again) when a quarter of the rows
is stored. Then one process diagnoses all of them, one after the other. Rows are compared whole, to the last bit, but
for the seconds that they took. `--recordings 4 --only viscous_drag` is a quick look; `--keep FOLDER` keeps the page.

Exit code 1 when a row is missing or differs.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread
from time import perf_counter, sleep
from typing import TYPE_CHECKING

from benchmarks.dask_processes import DaskProcesses, dask_processes

if TYPE_CHECKING:
    from truewrench.simulated_rig import HiddenEffect
    from truewrench.surveying import Survey
    from truewrench.surveying.survey_task import SurveyRow

RECORDINGS = 40
WORKERS, PROCESSES = 2, 2
KILLED_AFTER = 1 / 4
"""Share of the rows stored when a worker is killed."""
REPEATS, SAMPLES = 4, 200
START = datetime(2026, 1, 5, 8)
RIG = "[robot]\nlink_lengths = [1.0, 0.97, 0.4]\n"


def simulated(folder: Path, count: int) -> list[Path]:
    """A rig file and so many recordings, one a day."""
    from truewrench.simulated_rig import PlanarRig, simulate, write_recording

    (folder / "rig.toml").write_text(RIG)
    rig, paths = PlanarRig(), []
    for day in range(count):
        frame = simulate(
            rig,
            rig.random_motion(seed=day, harmonics=3),
            hidden=hidden_on(day, count),
            repeats=REPEATS,
            samples_per_period=SAMPLES,
            seed=day,
        )
        paths.append(write_recording(frame, folder / f"run_{START + timedelta(days=day):%Y-%m-%dT%H-%M-%S}.csv"))
    return paths


def hidden_on(day: int, count: int) -> Sequence[HiddenEffect]:
    """Every second day the drag that grows, between them the others in turn."""
    from truewrench.simulated_rig import HIDDEN_EFFECTS, ViscousDrag

    if day % 2 == 0:
        return [ViscousDrag(c=0.5 * (1 + day / count))]
    others: tuple[list[str], ...] = (["cable_spring"], ["sensor_lag"], ["sensor_crosstalk"], [])
    return [HIDDEN_EFFECTS[effect_id] for effect_id in others[day // 2 % len(others)]]


def surveyed(paths: Sequence[Path], folder: Path, started: DaskProcesses, only: Sequence[str] | None) -> Survey:
    """The survey through the scheduler, one worker killed midway."""
    from truewrench.surveying import survey

    rows = folder / "survey" / "rows"

    def kill() -> None:
        while len(list(rows.glob("*.json"))) < KILLED_AFTER * len(paths):
            sleep(0.05)
        started.kill_worker(0)

    Thread(target=kill, daemon=True).start()
    rig, out = folder / "rig.toml", folder / "survey"
    return survey(paths, rig=rig, out=out, scheduler=started.address, only=only)


def alone(paths: Sequence[Path], folder: Path, only: Sequence[str] | None) -> Survey:
    """The same diagnoses one after the other in this process."""
    from truewrench.surveying import survey

    with ThreadPoolExecutor(1) as executor:
        return survey(paths, rig=folder / "rig.toml", executor=executor, only=only)


def without_seconds(row: SurveyRow) -> SurveyRow:
    """The row less the only part that may differ."""
    return replace(row, outcome=replace(row.outcome, seconds=None))


def compared(folder: Path, count: int, only: Sequence[str] | None) -> bool:
    """Survey both ways, print what came of it; whether all rows are there and equal."""
    paths = simulated(folder, count)
    with dask_processes(folder, workers=WORKERS, processes=PROCESSES) as started:
        began = perf_counter()
        found = surveyed(paths, folder, started, only)
        together = perf_counter() - began
        killed = started.workers[0].wait(timeout=60)
    began = perf_counter()
    one = alone(paths, folder, only)
    wall = perf_counter() - began
    equal = [without_seconds(a) == without_seconds(b) for a, b in zip(found.rows, one.rows, strict=True)]
    complete = sum(not row.outcome.error for row in found.rows)
    print(found)
    print(f"\n{count} recordings, {WORKERS} workers of {PROCESSES} processes, one ended by signal {-killed} midway")
    print(f"rows: {len(found.rows)}, without error: {complete}, equal to one process's: {sum(equal)}")
    print(f"wall: {together:.1f} s on Dask, {wall:.1f} s in one process, {os.cpu_count()} cores")
    print(f"{(folder / 'survey' / 'survey.html').stat().st_size / 1000:.0f} kB of page")
    return len(found.rows) == count == complete == sum(equal)


def main() -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description="Survey on Dask with a worker killed, against one process.")
    parser.add_argument("--recordings", type=int, default=RECORDINGS, help="how many to simulate")
    parser.add_argument("--only", action="append", help="candidate effect; the whole catalogue by default")
    parser.add_argument("--keep", type=Path, help="folder for everything; else it is thrown away")
    arguments = parser.parse_args()
    for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(variable, "1")  # before NumPy is loaded: one thread for all
    if arguments.keep is not None:
        arguments.keep.mkdir(parents=True)  # an old one would hold rows that are finished
    with nullcontext(arguments.keep) if arguments.keep else TemporaryDirectory() as folder:
        return 0 if compared(Path(folder), arguments.recordings, arguments.only) else 1


if __name__ == "__main__":
    sys.exit(main())
