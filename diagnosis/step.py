"""Step: the model after one more effect, and how it compares in training and on held-out recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from diagnosis.acceptance import HeldOut
from diagnosis.comparison import Comparison, comparison_of
from diagnosis.selection import Candidate, refitted
from diagnosis.validation import transferred
from estimation.fit import Fit


@dataclass(frozen=True, eq=False)
class Step:
    """One step of the staircase: the model after one more effect, on the training and the held-out recordings."""

    effect: str | None
    fit: Fit
    training: tuple[Comparison, ...]
    validation: tuple[Comparison, ...]


def staircase(base: Candidate, final: Candidate, held_out: Sequence[HeldOut]) -> tuple[Step, ...]:
    """From the rigid tip to the last effect added, each model refitted."""
    steps = [_step(None, base.fit, held_out)]
    effects = final.fit.model.effects
    for count in range(1, len(effects) + 1):
        partial = final if count == len(effects) else refitted(final, effects[:count])
        steps.append(_step(effects[count - 1].id, partial.fit, held_out))
    return tuple(steps)


def _step(effect: str | None, fitted: Fit, held_out: Sequence[HeldOut]) -> Step:
    training = tuple(comparison_of(fitted, i) for i in range(len(fitted.recordings)))
    validation = tuple(comparison_of(transferred(fitted, o.recording, o.noise), 0) for o in held_out)
    return Step(effect, fitted, training, validation)


def explainable(step: Step) -> float:
    """Power of the training error that can be explained, in units of the noise floor's, over all recordings."""
    total = 0.0
    for comparison in step.training:
        size = comparison.explainable_rms or comparison.rms
        total += sum((size[c] / max(comparison.noise_floor[c], 1e-300)) ** 2 for c in size)
    return total
