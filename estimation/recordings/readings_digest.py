"""SHA-256 of a recording's readings, by which a file knows the recordings that it was made of."""

from __future__ import annotations

from collections.abc import Sequence
from hashlib import sha256

import numpy as np

from estimation.recordings.recording import Recording
from modeling.errors import InputError


def readings_digest(recording: Recording) -> str:
    """SHA-256 of a recording's readings, by which a calibration or a model file recognises its own."""
    return sha256(np.ascontiguousarray(recording.wrench, dtype="<f8").tobytes()).hexdigest()


def require_different_readings(recordings: Sequence[Recording], where: str) -> None:
    """InputError for readings that were given twice: their agreement with themselves would count as evidence."""
    known: dict[str, str] = {}
    for recording in recordings:
        digest = readings_digest(recording)
        if digest in known:
            what = f"{recording.name} has the same readings as {known[digest]}: one recording given twice"
            raise InputError(what=what, where=where, remedy="give each recording once; validate with another motion")
        known[digest] = recording.name
