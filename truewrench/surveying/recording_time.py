"""Time of a recording, from its file name, else the modification time."""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from enum import Enum
from pathlib import Path

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
    for found in _STAMP.finditer(name):
        for left_out in ({}, {"zone": ""}, {"hour": ""}):
            with suppress(OverflowError, ValueError):  # 20261399 is no date, and 0061 after a date no time of day
                return _moment(found.groupdict(default="") | left_out)
    return None


def _moment(part: Mapping[str, str]) -> datetime:
    text = f"{part['year']}-{part['month']}-{part['day']}"
    if part["hour"]:
        text += f"T{part['hour']}:{part['minute']}:{part['second'] or '00'}"
        text += f".{part['fraction']:0<6}" if part["fraction"] else ""
        text += part["zone"]
    moment = datetime.fromisoformat(text)
    return moment if moment.tzinfo is None else moment.astimezone().replace(tzinfo=None)
