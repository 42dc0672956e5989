"""A fit carried over to another recording: kept are the tool, the mounting and the sensor, but not the zero."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.part import between
from estimation.fit import Fit, first_noise, start_of
from estimation.layout import Layout, layout
from estimation.linear.descent import Minimum
from estimation.noise import Noise
from estimation.problem import Linearised, Problem
from estimation.recording import Recording
from modeling.effect import Effect
from modeling.parameter import Parameter

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PartlyFree(Problem):
    """A least-squares problem in some of its unknowns only, `free` (k,); the others stay where they start."""

    free: NDArray[np.bool_]

    def linearised(self, theta: Array) -> Linearised:
        """The whitened rows, their derivative vanishing in the unknowns that are kept."""
        whole = super().linearised(theta)
        return replace(whole, derivative=whole.derivative * self.free)

    def minimise(self, start: Array) -> Minimum:
        """The least-squares minimum in the free unknowns; the others are the same to the last digit."""
        found = super().minimise(start)
        return replace(found, theta=np.where(self.free, found.theta, start))


def transferred(
    fit: Fit,
    recording: Recording,
    noise: Noise | None = None,
    own: Sequence[Effect] = (),
    start: Mapping[str, float] | None = None,
) -> Fit:
    """The fit's parameters on another recording, only its biases and the effects of its `own` estimated there.

    Effects that belonged to the fit's recordings stay behind. The recording's own effects are estimated from the
    parameter values `start`, and between the motion's lines where there are such: on those lines they would make
    good what the fit misses of everything that repeats.
    """
    kept = fit.model.lasting
    model = kept + own
    known = noise if noise is not None else first_noise(kept, (recording,))[0]
    unknowns = layout(model, (recording,))
    values = {n: v for n, v in fit.values.items() if n in {p.name for p in kept.parameters}}
    theta = start_of(unknowns, {**values, **(start or {})})
    biases = _named(unknowns, model.biases)
    added = _named(unknowns, [p for e in own for p in e.qualified(model.space)])
    passing = PartlyFree(unknowns, (recording,), (between(known) or known,), biases | added).minimise(theta)
    zeroed = PartlyFree(unknowns, (recording,), (known,), biases).minimise(passing.theta)
    covariance = zeroed.covariance + passing.covariance * np.outer(added, added)
    shown = zeroed.shown | (passing.shown & added)
    return Fit(model, (recording,), (known,), unknowns, zeroed.theta, covariance, shown)


def _named(unknowns: Layout, parameters: Sequence[Parameter]) -> NDArray[np.bool_]:
    names = {p.name for p in parameters}
    return np.array([p.name in names for p in unknowns.parameters])


def zero_shift(fit: Fit, carried: Fit) -> Mapping[str, float]:
    """How far the zero of each channel moved from the fit's first recording to the other."""
    return {c: carried.values[f"bias_{c}"] - fit.values[f"bias_{c}"] for c in fit.recordings[0].channels}
