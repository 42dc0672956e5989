"""Step: the model after one more effect, and how it compares in training and on held-out recordings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.comparison import Comparison, comparison_of
from diagnosis.generic import predictability
from diagnosis.held_out import HeldOut
from diagnosis.selection import Candidate, Selection
from estimation.fit import Fit
from estimation.noise import NoiseSource

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Step:
    """One step of the staircase: the model after one more effect, on the training and the held-out recordings."""

    effect: str | None
    fit: Fit
    training: tuple[Comparison, ...]
    validation: tuple[Comparison, ...]


def staircase(selection: Selection, final: Candidate, held_out: Sequence[HeldOut]) -> tuple[Step, ...]:
    """From the rigid tip to the last effect added, each model refitted."""
    steps = [_step(None, selection.base.fit, held_out)]
    effects = final.fit.model.effects
    for count in range(1, len(effects) + 1):
        partial = final if count == len(effects) else selection.refitted(final, effects[:count])
        steps.append(_step(effects[count - 1].id, partial.fit, held_out))
    return tuple(steps)


def _step(effect: str | None, fitted: Fit, held_out: Sequence[HeldOut]) -> Step:
    training = tuple(comparison_of(fitted, i) for i in range(len(fitted.recordings)))
    validation = tuple(comparison_of(o.carried(fitted), 0) for o in held_out)
    return Step(effect, fitted, training, validation)


def explainable(steps: Sequence[Step]) -> Array:
    """Power of the training error that can be explained after each step, in units of the noise's, over all recordings.

    With repeats it is the power that repeats. In a single run noise and error are one residual; but what a step leaves
    more than the last is error, and of what the last leaves it is the part that exceeds a stated noise, or else that
    generic terms of the inputs predict of blocks held out.
    """
    powers = [
        _single(steps, number) if last.explainable_rms is None else _repeating(steps, number)
        for number, last in enumerate(steps[-1].training)
    ]
    return np.asarray(np.sum(powers, axis=0))


def _repeating(steps: Sequence[Step], number: int) -> Array:
    """Power over the noise's that each step leaves to be explained in a recording with repeats."""
    sizes = [s.training[number].explainable_rms or {} for s in steps]
    return _over_floor(steps[-1].training[number], [{c: v**2 for c, v in size.items()} for size in sizes])


def _single(steps: Sequence[Step], number: int) -> Array:
    """Power over the noise's that each step leaves to be explained in a recording without repeats."""
    last, fit = steps[-1].training[number], steps[-1].fit
    power = [{c: v**2 for c, v in s.training[number].rms.items()} for s in steps]
    if last.noise.source is NoiseSource.RIG:
        return _over_floor(last, [{c: v - last.noise_floor[c] ** 2 for c, v in p.items()} for p in power])
    gained = _over_floor(last, [{c: v - power[-1][c] for c, v in p.items()} for p in power])
    left = predictability(fit, number).gain * len(fit.model.channels) / fit.noise[number].whitener.rows
    return gained + max(left, 0.0)


def _over_floor(last: Comparison, powers: Sequence[Mapping[str, float]]) -> Array:
    """The powers' positive parts over those of the last step's noise, summed over the channels."""
    return np.array([sum(max(v, 0.0) / max(last.noise_floor[c], 1e-300) ** 2 for c, v in p.items()) for p in powers])
