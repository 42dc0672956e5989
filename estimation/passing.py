"""What passes over a record and does not repeat: drift, what follows an auxiliary signal, events."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from estimation.noise import step_of
from estimation.recording import Recording
from estimation.tones import sinusoids
from modeling.effects import BiasDrift

Array = NDArray[np.float64]

DRIFT_DEGREE = BiasDrift().degree
"""Degree of the polynomials that are taken for drift, not noise: four half-waves over the record to 0.1 % of power."""


def passing_basis(recording: Recording, events: Sequence[tuple[float, float]], tones: Sequence[float] = ()) -> Array:
    """What drifts, follows an auxiliary signal, belongs to an event or is a tone (Hz), less what repeats.

    Orthonormal, (n, k).
    """
    n, repeats = recording.samples, recording.repeats
    columns = list(np.polynomial.legendre.legvander(np.linspace(-1, 1, n), DRIFT_DEGREE)[:, 1:].T)
    columns += [recording.signals[name] for name in recording.auxiliary]
    time = np.arange(n) * step_of(recording)
    columns += [((time >= start) & (time < end)).astype(float) for start, end in events]
    columns += list(sinusoids(recording, tones).T)
    blocks = np.stack(columns, axis=1).reshape(repeats, n // repeats, -1)
    changing = (blocks - blocks.mean(axis=0)).reshape(n, -1)
    scale = np.linalg.norm(changing, axis=0)
    changing = changing[:, scale > 1e-12 * max(scale.max(), 1e-300)]
    left, singular, _ = np.linalg.svd(changing / np.linalg.norm(changing, axis=0), full_matrices=False)
    return np.asarray(left[:, singular > 1e-9 * singular[0]])
