"""SHA-256 of a recording's readings, by which a file knows the recordings that it was made of."""

from __future__ import annotations

from hashlib import sha256

import numpy as np

from estimation.recordings.recording import Recording


def readings_digest(recording: Recording) -> str:
    """SHA-256 of a recording's readings, by which a calibration or a model file recognises its own."""
    return sha256(np.ascontiguousarray(recording.wrench, dtype="<f8").tobytes()).hexdigest()
