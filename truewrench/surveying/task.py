"""Task: the diagnosis of one recording as a function of paths and plain data, which any process can run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

from modeling.errors import InputError
from truewrench.surveying.fingerprint import fingerprint
from truewrench.surveying.outcome import Outcome

if TYPE_CHECKING:
    from diagnosis.diagnosis import Diagnosis


@dataclass(frozen=True, kw_only=True)
class Task:
    """One recording to diagnose.

    recording  absolute path, the same for whoever runs the task
    rig        as `Rig.to_data` gives it, None without a rig
    only       ids of the candidate effects; None is the whole catalogue
    key        fingerprint of what was found at that path, None where nothing could be read
    """

    recording: str
    rig: Mapping[str, Any] | None
    only: tuple[str, ...] | None
    key: str | None

    @classmethod
    def of(cls, recording: Path, rig: Mapping[str, Any] | None, only: tuple[str, ...] | None) -> Task:
        """The task of a recording as it is now."""
        place = recording.absolute()
        return cls(recording=str(place), rig=rig, only=only, key=_key(place, rig, only))


def diagnosed_outcome(task: Task) -> Outcome:
    """What the diagnosis of a task's recording comes to; an error becomes the outcome's line, none is raised.

    The outcome is final only if it was made from what the task's fingerprint says.
    """
    began = perf_counter()
    try:
        if _key(Path(task.recording), task.rig, task.only) != task.key:
            what = "is another file, or read by another version of truewrench, where it was diagnosed"
            remedy = "survey it again, with one version and one file system for all workers"
            return Outcome(error=f"{what}; {remedy}", final=False)
        return Outcome.of(_diagnosis(task), seconds=perf_counter() - began)
    except InputError as error:
        return Outcome(error=_line(error, task), seconds=perf_counter() - began, final=task.key is not None)
    except Exception as error:
        return failed_outcome(error)


def failed_outcome(error: BaseException) -> Outcome:
    """The outcome where something failed that is not the recording's fault: it may be tried again."""
    message = " ".join(f"{type(error).__name__}: {error}".split())
    return Outcome(error=f"internal error: {message}", final=False)


def _line(error: InputError, task: Task) -> str:
    """The error without the name of the recording: a row has that already, and another name is the same recording."""
    where = error.where.removeprefix(task.recording).removeprefix(Path(task.recording).name).lstrip(" ,:")
    return f"{where}: {error.what}; {error.remedy}" if where else f"{error.what}; {error.remedy}"


def _key(recording: Path, rig: Mapping[str, Any] | None, only: tuple[str, ...] | None) -> str | None:
    try:
        return fingerprint(recording, rig, only)
    except OSError:
        return None


def _diagnosis(task: Task) -> Diagnosis:
    from diagnosis.diagnosis import diagnose
    from modeling.effects import catalogue, named
    from modeling.rig import Rig
    from truewrench.case import Case

    case = Case.read([task.recording], rig=None if task.rig is None else Rig.from_data(task.rig))
    candidates = catalogue(case.model.space) if task.only is None else [named(i) for i in task.only]
    return diagnose(case.model, case.training, effects=candidates)
