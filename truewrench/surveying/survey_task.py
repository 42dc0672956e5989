"""Survey task and its fingerprint (recording, rig, candidates, code)."""

from __future__ import annotations

import hashlib
import json
import os
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

from modeling.errors import InputError
from modeling.evaluation.cache import LOADED_AT, source_digest
from truewrench.surveying.diagnosis_outcome import DiagnosisOutcome

if TYPE_CHECKING:
    from diagnosis.diagnosis import Diagnosis


STORE_VERSION = 3
"""Version of a stored outcome, increased when its fields change."""
FINGERPRINTED_PACKAGES = ("modeling", "design", "estimation", "diagnosis")
"""Packages whose code determines the outcome."""


def fingerprint(
    recording: Path, rig: Mapping[str, Any] | None, only: tuple[str, ...] | None, *, one_run: bool = False
) -> str:
    """SHA-256 of everything that the outcome of a recording depends on, in hexadecimal.

    Of its name only the ending counts, which gives the format: a renamed recording keeps its fingerprint. Of a ROS 2
    bag the files in it count, with their names. Raises OSError when the recording cannot be read, as any other folder.
    """
    settings: dict[str, Any] = {
        "layout": STORE_VERSION,
        "code": code_version(),
        "format": recording.suffix.lower(),
        "rig": rig,
        "only": only,
    }
    if one_run:  # outcomes stored without the option keep their fingerprints
        settings["one_run"] = True
    digest = hashlib.sha256(json.dumps(settings, sort_keys=True).encode("ascii"))
    if (recording / "metadata.yaml").is_file():  # a ROS 2 bag
        for path in sorted(path for path in recording.iterdir() if path.is_file()):
            digest.update(hashlib.sha256(os.fsencode(path.name)).digest() + _content_digest(path))
    else:
        digest.update(_content_digest(recording))
    return digest.hexdigest()


def _content_digest(file: Path) -> bytes:
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").digest()


@cache
def code_version() -> str:
    """Hash of the source files, different for two checkouts of one version."""
    return " ".join(map(source_digest, _code_folders()))


def _code_folders() -> list[Path]:
    specs = [find_spec(package) for package in FINGERPRINTED_PACKAGES]
    return [Path(folder) for spec in specs if spec for folder in spec.submodule_search_locations or []]


def code_is_as_loaded() -> bool:
    """Whether no source file is newer than this process, which may have loaded the one before."""
    try:
        return all(p.stat().st_ctime < LOADED_AT for folder in _code_folders() for p in folder.rglob("*.py"))
    except OSError:  # a module is being replaced
        return False


@dataclass(frozen=True, kw_only=True)
class SurveyTask:
    """One recording to diagnose.

    recording  absolute path, the same for every worker
    rig        as `Rig.to_data` gives it, None without a rig
    only       ids of the candidate effects; None is the whole catalogue
    one_run    no repeats are looked for
    key        fingerprint at the time of submission, None where the recording could not be read
    """

    recording: str
    rig: Mapping[str, Any] | None
    only: tuple[str, ...] | None
    key: str | None
    one_run: bool = False

    @classmethod
    def of(
        cls, recording: Path, rig: Mapping[str, Any] | None, only: tuple[str, ...] | None, *, one_run: bool = False
    ) -> SurveyTask:
        """The task of a recording as it is now."""
        place = recording.absolute()
        key = _fingerprint_or_none(place, rig, only, one_run)
        return cls(recording=str(place), rig=rig, only=only, key=key, one_run=one_run)


def diagnosed_outcome(task: SurveyTask) -> DiagnosisOutcome:
    """Outcome of the diagnosis of a task; an exception becomes the outcome's error message.

    The outcome is final only if the worker's fingerprint is that of the task, and its code that of the fingerprint.
    """
    outcome = _outcome(task)
    return outcome if not outcome.final or code_is_as_loaded() else replace(outcome, final=False)


def _outcome(task: SurveyTask) -> DiagnosisOutcome:
    began = perf_counter()
    try:
        if _fingerprint_or_none(Path(task.recording), task.rig, task.only, task.one_run) != task.key:
            what = "is another file, or read by another version of truewrench, on the worker"
            remedy = "survey it again, with one version and one file system for all workers"
            return DiagnosisOutcome(error=f"{what}; {remedy}", final=False)
        return DiagnosisOutcome.of(_diagnosis(task), seconds=perf_counter() - began)
    except InputError as error:
        final = task.key is not None and not _is_due_to_the_machine(error)
        return DiagnosisOutcome(error=_error_line(error, task), seconds=perf_counter() - began, final=final)
    except Exception as error:
        return failed_outcome(error)


def failed_outcome(error: BaseException) -> DiagnosisOutcome:
    """Outcome of a failure not due to the recording: not final, may be rerun."""
    message = " ".join(f"{type(error).__name__}: {error}".split())
    return DiagnosisOutcome(error=_encodable(f"internal error: {message}"), final=False)


def _is_due_to_the_machine(error: InputError) -> bool:
    """Whether a file was not read for a reason that may be gone tomorrow: a full disk, no memory, a missing library."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, MemoryError | ImportError):
            return True
        if isinstance(cause, OSError) and cause.errno is not None:  # errors of a file's contents have no number
            return True
        cause = cause.__cause__ or cause.__context__
    return False


def _error_line(error: InputError, task: SurveyTask) -> str:
    """Error message without the path of the recording, which is in the row and may change: FILE in a command."""
    path = " ".join(task.recording.split())  # as an InputError has it
    where = error.where.removeprefix(path).removeprefix(Path(task.recording).name).lstrip(" ,:")
    says = f"{error.what}; {error.remedy}".replace(shlex.quote(path), "FILE").replace(path, "FILE")
    return _encodable(f"{where}: {says}" if where else says)


def _encodable(text: str) -> str:
    """The text with what is not Unicode, such as bytes of a file's name that are not UTF-8, escaped."""
    return text.encode("utf-8", "backslashreplace").decode()


def _fingerprint_or_none(
    recording: Path, rig: Mapping[str, Any] | None, only: tuple[str, ...] | None, one_run: bool
) -> str | None:
    try:
        return fingerprint(recording, rig, only, one_run=one_run)
    except OSError:
        return None


def _diagnosis(task: SurveyTask) -> Diagnosis:
    from diagnosis.diagnosis import diagnose
    from modeling.effects import catalogue, named
    from modeling.rig.rig import Rig
    from truewrench.files.data_set import DataSet

    rig = None if task.rig is None else Rig.from_data(task.rig)
    case = DataSet.read([task.recording], rig=rig, one_run=task.one_run)
    candidates = catalogue(case.model.space) if task.only is None else [named(i) for i in task.only]
    return diagnose(case.model, case.training, effects=candidates)
