"""A fit carried over to another recording: everything kept but the zero of the sensor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from estimation.fit import Fit, Problem, first_noise
from estimation.layout import layout
from estimation.noise import Noise
from estimation.recording import Recording
from modeling.model import WrenchModel


def lasting(model: WrenchModel) -> WrenchModel:
    """The model less the effects that belong to one recording."""
    return replace(model, effects=tuple(e for e in model.effects if not e.per_recording))


def transferred(fit: Fit, recording: Recording, noise: Noise | None = None) -> Fit:
    """The fit's parameters on another recording, only its biases estimated there.

    Effects that belong to one recording stay behind.
    """
    model = lasting(fit.model)
    known = (noise,) if noise is not None else first_noise(model, (recording,))
    unknowns = layout(model, (recording,))
    values = fit.values
    theta = np.array([values[p.name] for p in unknowns.parameters])
    biases = [p.name for p in model.biases]
    free = np.array([p.name in biases for p in unknowns.parameters])
    residual, derivative = Problem(unknowns, (recording,), known).evaluate(theta)
    theta[free] += np.linalg.lstsq(derivative[:, free], residual, rcond=None)[0]
    covariance = np.zeros((len(theta), len(theta)))
    covariance[np.ix_(free, free)] = np.linalg.pinv(derivative[:, free].T @ derivative[:, free])
    return Fit(model, (recording,), known, unknowns, theta, covariance, free)


def zero_shift(fit: Fit, carried: Fit) -> Mapping[str, float]:
    """How far the zero of each channel moved from the fit's first recording to the other."""
    return {c: carried.values[f"bias_{c}"] - fit.values[f"bias_{c}"] for c in fit.recordings[0].channels}
