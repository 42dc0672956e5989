"""Row of a survey: one recording with its time and outcome."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from truewrench.surveying.diagnosis_outcome import DiagnosisOutcome
from truewrench.surveying.recording_time import RecordingTime

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
