"""Rigid tool and final model, compared on one recording."""

from __future__ import annotations

import numpy as np

from diagnosis.comparison.error_table import systematic_error
from diagnosis.diagnosis import Diagnosis
from diagnosis.verdict.verdict import RecordVerdict
from estimation.noise.recording_noise import NoiseSource
from truewrench.plots.residuals.labelled_comparison import LabelledComparison
from truewrench.plots.residuals.worst_channel_plot import MIN_SIGNAL_TO_NOISE
from truewrench.plots.style import ADEQUATE_COLOUR, MISFIT_COLOUR
from truewrench.text.step_names import base_name


def compared_models(diagnosis: Diagnosis, number: int, *, held_out: bool = False) -> list[LabelledComparison]:
    """The rigid tool and, if effects were added, the final model, on one recording."""
    steps = [diagnosis.steps[0], diagnosis.steps[-1]][: len(diagnosis.added) + 1]
    comparisons = [(s.validation if held_out else s.training)[number] for s in steps]
    adequate = diagnosis.verdict is not RecordVerdict.UNEXPLAINED
    nothing_missing = diagnosis.verdict is RecordVerdict.NOTHING_MISSING
    colours = [ADEQUATE_COLOUR if nothing_missing else MISFIT_COLOUR, ADEQUATE_COLOUR if adequate else MISFIT_COLOUR]
    labels = [base_name(diagnosis), "with " + " + ".join(diagnosis.added)]
    return [LabelledComparison(*parts) for parts in zip(labels, colours, comparisons, strict=False)]


def worst_recording(diagnosis: Diagnosis) -> int:
    """The training recording with the largest error-to-noise ratio of a channel with the rigid tool."""
    first = diagnosis.steps[0].training
    ratios = [max(systematic_error(c)[k] / max(c.noise_floor[k], 1e-300) for k in c.noise_floor) for c in first]
    if max(ratios) < MIN_SIGNAL_TO_NOISE and all(c.noise.source is NoiseSource.RESIDUAL for c in first):
        # The noise was estimated from the residual itself, so that the ratio carries no information.
        return int(np.argmin([c.lack_of_fit for c in first]))
    return int(np.argmax(ratios))
