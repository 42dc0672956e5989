"""The same motion with other readings: what cleaning and resampling make of a recording."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from estimation.recording import Recording


def reread(recording: Recording, wrench: NDArray[np.float64]) -> Recording:
    """The recording with the readings `wrench` (n, p) in the place of its own; its signals are not derived again."""
    other = replace(recording, wrench=wrench)
    # The cache of `signals`: they depend on the motion alone, and deriving them costs more than a fit.
    vars(other)["signals"] = recording.signals
    return other
