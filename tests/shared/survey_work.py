"""Stand-ins for a diagnosis that worker processes import: quick, slow, or deadly to the worker."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from time import sleep

from truewrench.surveying.survey import survey
from truewrench.surveying.survey_task import DiagnosisOutcome, StoredEstimate, SurveyTask

SLOW = 0.25
"""Seconds of a slow task: long enough to be killed in."""


def quick(task: SurveyTask) -> DiagnosisOutcome:
    """An outcome that only the recording's content decides, and a line in a log beside it."""
    recording = Path(task.recording)
    with recording.with_suffix(".log").open("a") as log:
        log.write(f"{os.getpid()}\n")
    text = recording.read_text()
    sizes = (StoredEstimate("viscous_drag", "c", float(len(text)), 0.5, "N s/m"),)
    return DiagnosisOutcome(verdict="explained", added=("viscous_drag",), sizes=sizes, misfit=1.0, seconds=0.1)


def explained(_task: SurveyTask) -> DiagnosisOutcome:
    """The same outcome of whatever recording."""
    return DiagnosisOutcome(verdict="explained")


def slow(task: SurveyTask) -> DiagnosisOutcome:
    """The same, after a while."""
    sleep(SLOW)
    return quick(task)


def deadly(task: SurveyTask) -> DiagnosisOutcome:
    """Kills its worker when the recording says so, whoever tries."""
    if "poison" in Path(task.recording).read_text():
        os.kill(os.getpid(), signal.SIGKILL)
    return slow(task)


def failing(task: SurveyTask) -> DiagnosisOutcome:
    """Raises what a task never should."""
    raise ZeroDivisionError(f"in {Path(task.recording).name}")


def main(argv: list[str]) -> None:
    """Survey `*.csv` of a folder slowly on two local workers, as a program of its own that can be killed."""
    (folder,) = argv
    work: Callable[[SurveyTask], DiagnosisOutcome] = slow
    survey(sorted(Path(folder).glob("*.csv")), out=Path(folder) / "out", workers=2, work=work)


if __name__ == "__main__":
    main(sys.argv[1:])
