"""Survey task and its fingerprint (recording, rig, candidates, code)."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shlex
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from datetime import datetime
from enum import Enum
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

from diagnosis.diagnosis import diagnose_case
from estimation.recordings.column_table import arrow
from modeling.compiled.cache import LOADED_AT, source_digest
from modeling.effects import catalogue, named
from modeling.errors import InputError
from modeling.number_format import finite
from modeling.rig import Rig
from truewrench.files.case_files import read_case

if TYPE_CHECKING:
    import pyarrow as pa

    from diagnosis.comparison.comparison import Comparison
    from diagnosis.diagnosis import Diagnosis
    from estimation.least_squares.estimates import Estimate


# Outcome of one diagnosis as plain data.


BIAS_PREFIX = "bias_"
"""Prefix of the bias parameters."""


@dataclass(frozen=True)
class StoredEstimate:
    """One parameter of an effect, or of the tool where `effect` is empty; None for a number that is not finite."""

    effect: str
    parameter: str
    value: float | None
    std: float | None
    unit: str

    @property
    def name(self) -> str:
        """`viscous_drag.c`, or `m` for the tool's."""
        return f"{self.effect}.{self.parameter}" if self.effect else self.parameter


@dataclass(frozen=True, kw_only=True)
class ChannelError:
    """Error of one channel with the rigid tool (before) and with the effects added (after), in `unit`.

    rms         of the residual over all raw samples
    systematic  the part that repeats with the motion or is slow, `explainable_rms` of result.json; None without repeats
    noise_floor std of one sample
    """

    channel: str
    unit: str
    noise_floor: float | None
    rms_before: float | None
    rms_after: float | None
    systematic_before: float | None
    systematic_after: float | None

    @property
    def before(self) -> float | None:
        """Systematic error with the rigid tool; the total RMS without repeats."""
        return self.rms_before if self.systematic_before is None else self.systematic_before

    @property
    def after(self) -> float | None:
        """The same with the effects added."""
        return self.rms_after if self.systematic_after is None else self.systematic_after


@dataclass(frozen=True, kw_only=True)
class DiagnosisOutcome:
    """Outcome of the diagnosis of one recording.

    verdict     of the record; None where there is an error
    sizes       of the effects added, each with its std
    parameters  of the tool with these effects, without biases; without std where it is not known
    tool_unknown  why the recording does not say what the tool weighs, empty where it does
    misfit      reduced chi-square with the effects added, `misfit_before` with the rigid tool; None where the noise
                was estimated from the residual
    seconds     duration of the diagnosis
    error       error message where there is no verdict; else empty
    final       whether a rerun would give the same outcome
    """

    verdict: str | None = None
    added: tuple[str, ...] = ()
    sizes: tuple[StoredEstimate, ...] = ()
    parameters: tuple[StoredEstimate, ...] = ()
    tool_unknown: str = ""
    misfit_before: float | None = None
    misfit: float | None = None
    channels: tuple[ChannelError, ...] = ()
    seconds: float | None = None
    error: str = ""
    final: bool = True

    @classmethod
    def of(cls, diagnosis: Diagnosis, *, seconds: float) -> DiagnosisOutcome:
        """The outcome of a diagnosis of one recording."""
        first, last = diagnosis.steps[0].training[0], diagnosis.steps[-1].training[0]
        findings = {f.effect.id: f for f in diagnosis.findings}
        tool = {n: e for n, e in diagnosis.fit.parameters.items() if "." not in n and not n.startswith(BIAS_PREFIX)}
        return cls(
            verdict=diagnosis.verdict.value,
            added=diagnosis.added,
            sizes=tuple(size for i in diagnosis.added for size in _stored_estimates(i, findings[i].parameters)),
            parameters=tuple(
                replace(e, std=None) if diagnosis.tool_unknown else e for e in _stored_estimates("", tool)
            ),
            tool_unknown=diagnosis.tool_unknown,
            misfit_before=finite(first.misfit),
            misfit=finite(last.misfit),
            channels=tuple(_channels(first, last)),
            seconds=seconds,
        )

    @property
    def loudest(self) -> ChannelError | None:
        """Channel with the largest error-to-noise ratio with the rigid tool."""
        compared = [c for c in self.channels if c.before is not None and c.noise_floor]
        return max(compared, key=lambda c: (c.before or 0.0) / (c.noise_floor or 1.0), default=None)


def _stored_estimates(effect: str, estimates: Mapping[str, Estimate]) -> list[StoredEstimate]:
    return [StoredEstimate(effect, name, finite(e.value), finite(e.std), e.unit) for name, e in estimates.items()]


def _channels(first: Comparison, last: Comparison) -> list[ChannelError]:
    systematic = [c.explainable_rms or {} for c in (first, last)]
    return [
        ChannelError(
            channel=channel,
            unit=unit,
            noise_floor=finite(last.noise_floor[channel]),
            rms_before=finite(first.rms[channel]),
            rms_after=finite(last.rms[channel]),
            systematic_before=finite(systematic[0].get(channel)),
            systematic_after=finite(systematic[1].get(channel)),
        )
        for channel, unit in first.space.channel_units.items()
    ]


# Time of a recording, from its file name, else the modification time.


_STAMP = re.compile(
    r"(?<!\d)(?P<year>(?:19|20)\d\d)(?P<dash>[-_.]?)(?P<month>\d\d)(?P=dash)(?P<day>\d\d)"
    r"(?:[T _-]{0,2}(?P<hour>\d\d)(?P<colon>[-:_.h]?)(?P<minute>\d\d)"
    r"(?:(?P=colon)(?P<second>\d\d)(?:[.,](?P<fraction>\d{1,6}))?)?(?P<zone>Z|[+-]\d\d:?\d\d)?)?(?!\d)"
)


class TimeSource(Enum):
    """Source of a recording's time."""

    FILE_NAME = "file name"
    MODIFICATION = "modification time"


@dataclass(frozen=True)
class RecordingTime:
    """Time of a recording, local without a zone."""

    moment: datetime
    source: TimeSource

    @classmethod
    def of(cls, path: Path) -> RecordingTime | None:
        """The time in the file's name if it has one, else the file's modification time; None without a file.

        In the name: year, month and day, with or without dashes, then optionally hour, minute, second; local time
        unless a zone is given.
        """
        named = time_in(path.name)
        if named is not None:
            return cls(named, TimeSource.FILE_NAME)
        try:
            return cls(datetime.fromtimestamp(path.stat().st_mtime), TimeSource.MODIFICATION)
        except (OSError, OverflowError, ValueError):
            return None


def time_in(name: str) -> datetime | None:
    """The first date, with its time of day if there is one, in a file's name, in local time; None without."""
    for stamp in _STAMP.finditer(name):
        for left_out in ({}, {"zone": ""}, {"hour": ""}):
            with suppress(OverflowError, ValueError):  # 20261399 is no date, and 0061 after a date no time of day
                return _moment(stamp.groupdict(default="") | left_out)
    return None


def _moment(stamp: Mapping[str, str]) -> datetime:
    text = f"{stamp['year']}-{stamp['month']}-{stamp['day']}"
    if stamp["hour"]:
        text += f"T{stamp['hour']}:{stamp['minute']}:{stamp['second'] or '00'}"
        text += f".{stamp['fraction']:0<6}" if stamp["fraction"] else ""
        text += stamp["zone"]
    moment = datetime.fromisoformat(text)
    return moment if moment.tzinfo is None else moment.astimezone().replace(tzinfo=None)


BY_CHANNEL = ("noise_floor", "rms_before", "rms_after", "systematic_before", "systematic_after")
"""Quantities of `ChannelError` that a row has by channel."""


@dataclass(frozen=True)
class SurveyRow:
    """One recording of a survey; `file` is the path as given, `time` None where there is no such file."""

    file: str
    time: RecordingTime | None
    outcome: DiagnosisOutcome

    @classmethod
    def of(cls, recording: Path, outcome: DiagnosisOutcome) -> SurveyRow:
        """The row of a recording; bytes of its name that are not UTF-8 are written as `\\xe9`."""
        file = os.fsencode(recording).decode("utf-8", "backslashreplace")
        return cls(file, RecordingTime.of(recording), outcome)

    @property
    def moment(self) -> datetime:
        """Local time of a recording that has one."""
        assert self.time is not None
        return self.time.moment

    def to_data(self) -> dict[str, Any]:
        """The row as in survey.parquet, the time in ISO 8601: plain numbers, text, lists, None."""
        outcome, time = asdict(self.outcome), self.time
        return {
            "file": self.file,
            "recorded": None if time is None else time.moment.isoformat(),
            "recorded_from": None if time is None else time.source.value,
            "verdict": outcome["verdict"],
            **{name: list(outcome[name]) for name in ("added", "sizes", "parameters")},
            "tool_unknown": outcome["tool_unknown"] or None,
            **{name: outcome[name] for name in ("misfit_before", "misfit")},
            **{name: {c["channel"]: c[name] for c in outcome["channels"]} for name in BY_CHANNEL},
            "seconds": outcome["seconds"],
            "error": outcome["error"] or None,
        }


# Rows of a survey as a Parquet table.


def parquet_table(rows: Sequence[SurveyRow]) -> pa.Table:
    """The table, one row per recording: errors by channel and local times without a zone."""
    types = arrow()
    text, number = types.string(), types.float64()
    size = {"effect": text, "parameter": text, "value": number, "std": number, "unit": text}
    sizes = types.list_(types.struct(size.items()))
    schema = {
        "file": text, "recorded": types.timestamp("us"), "recorded_from": text, "verdict": text,
        "added": types.list_(text), "sizes": sizes, "parameters": sizes, "tool_unknown": text,
        "misfit_before": number, "misfit": number,
        **dict.fromkeys(BY_CHANNEL, types.map_(text, number)), "seconds": number, "error": text,
    }  # fmt: skip
    data = [row.to_data() for row in rows]
    for line, row in zip(data, rows, strict=True):
        line["recorded"] = None if row.time is None else row.time.moment
        line |= {name: list(line[name].items()) for name in BY_CHANNEL}
    return types.Table.from_pylist(data, schema=types.schema(schema.items()))


def write_parquet(rows: Sequence[SurveyRow], path: Path) -> None:
    """Write the table as Parquet."""
    arrow().parquet.write_table(parquet_table(rows), path)


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
            problem = "is another file, or read by another version of truewrench, on the worker"
            remedy = "survey it again, with one version and one file system for all workers"
            return DiagnosisOutcome(error=f"{problem}; {remedy}", final=False)
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
    rig = None if task.rig is None else Rig.from_data(task.rig)
    case = read_case([task.recording], rig=rig, one_run=task.one_run)
    candidates = catalogue(case.model.space) if task.only is None else [named(i) for i in task.only]
    return diagnose_case(case, effects=candidates)
