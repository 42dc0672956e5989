"""Orthonormal basis of recording-specific disturbances (drift, auxiliary signals, transient events, tones).

Their part that is periodic with the motion is subtracted.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from estimation.noise.disturbances.tones import sinusoids
from estimation.noise.recording_noise import sample_step
from estimation.recordings.recording import Recording
from modeling.effects import BiasDrift

Array = NDArray[np.float64]

DRIFT_DEGREE = BiasDrift().degree
"""Degree of the polynomials that count as drift, not noise: four half-waves over the record to 0.1 % of power."""


def disturbance_basis(
    recording: Recording, events: Sequence[tuple[float, float]], tones: Sequence[float] = ()
) -> Array:
    """Orthonormal basis (n, k) of drift, auxiliary signals, events (s) and tones (Hz), less their mean over repeats."""
    n = recording.samples
    columns = list(np.polynomial.legendre.legvander(np.linspace(-1, 1, n), DRIFT_DEGREE)[:, 1:].T)
    columns += [recording.signals[name] for name in recording.auxiliary]
    columns += list(pulses(recording, events).T)
    columns += list(sinusoids(recording, tones).T)
    series = np.stack(columns, axis=1)
    nonperiodic = series - recording.averaged(series)
    scale = np.linalg.norm(nonperiodic, axis=0)
    nonperiodic = nonperiodic[:, scale > 1e-12 * max(scale.max(), 1e-300)]
    left, singular, _ = np.linalg.svd(nonperiodic / np.linalg.norm(nonperiodic, axis=0), full_matrices=False)
    return np.asarray(left[:, singular > 1e-9 * singular[0]])


def pulses(recording: Recording, events: Sequence[tuple[float, float]]) -> Array:
    """Series (n, k) that are 1 during each of the events (s), else 0."""
    time = np.arange(recording.samples) * sample_step(recording)
    within = [(time >= start) & (time < end) for start, end in events]
    return np.stack(within, axis=1).astype(np.float64) if within else np.zeros((len(time), 0))
