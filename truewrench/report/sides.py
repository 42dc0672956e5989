"""Sides: the rigid tool and the final model, to stand side by side on one recording."""

from __future__ import annotations

import numpy as np

from diagnosis.diagnosis import Diagnosis
from diagnosis.verdict import RecordVerdict
from estimation.noise import NoiseSource
from truewrench.plots.opening_plot import STANDS_OUT
from truewrench.plots.side import Side
from truewrench.plots.staircase_plot import size_of
from truewrench.plots.style import FAILING, HOLDING


def sides_of(diagnosis: Diagnosis, number: int, *, held_out: bool = False) -> list[Side]:
    """The rigid tool and, when anything was added, the final model, on one recording."""
    steps = [diagnosis.steps[0], diagnosis.steps[-1]][: len(diagnosis.added) + 1]
    comparisons = [(s.validation if held_out else s.training)[number] for s in steps]
    holds = diagnosis.verdict is not RecordVerdict.UNEXPLAINED
    nothing = diagnosis.verdict is RecordVerdict.NOTHING_MISSING
    colours = [HOLDING if nothing else FAILING, HOLDING if holds else FAILING]
    labels = ["rigid tool", "with " + " + ".join(i.replace("_", " ") for i in diagnosis.added)]
    return [Side(*parts) for parts in zip(labels, colours, comparisons, strict=False)]


def loudest_recording(diagnosis: Diagnosis) -> int:
    """The training recording in which a channel of the rigid tool stands out most from its noise."""
    first = diagnosis.steps[0].training
    powers = [max(size_of(c)[k] / max(c.noise_floor[k], 1e-300) for k in c.noise_floor) for c in first]
    if max(powers) < STANDS_OUT and all(c.noise.source is NoiseSource.RESIDUAL for c in first):
        # Each is its own noise, and no size tells.
        return int(np.argmin([c.lack_of_fit for c in first]))
    return int(np.argmax(powers))
