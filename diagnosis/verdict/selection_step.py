"""Selection steps: models with 0..n effects compared on training and held-out recordings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from diagnosis.comparison.compared_step import ComparedFit
from diagnosis.comparison.comparison import Comparison
from diagnosis.comparison.slow_residual import Part, SlowResidual, removed_share
from diagnosis.held_out import HeldOut
from diagnosis.subset_search import CandidateModel, SubsetSearch
from estimation.fit import Fit
from modeling.noise import NoiseSource

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SelectionStep(ComparedFit):
    """The model after one more effect, compared with the training and the held-out recordings.

    fit     as `fit` reports it: `with_ordinary_estimate`
    tested  the same model whitened by its noise, whose score tests and lack of fit the search has judged
    """

    effect: str | None
    fit: Fit
    tested: Fit
    training: tuple[Comparison, ...]
    validation: tuple[Comparison, ...]

    @property
    def label(self) -> str:
        """The effect added."""
        return self.effect or "base model"

    def to_data(self) -> dict[str, Any]:
        """The step in result.json."""
        first = self.training[0]
        held_out = self.validation[0] if self.validation else None
        return {
            "effect": self.effect,
            "misfit": first.misfit,
            "rms": dict(first.rms),
            "explainable_rms": _optional(first.explainable_rms),
            "validation_rms": None if held_out is None else dict(held_out.rms),
            "validation_explainable_rms": None if held_out is None else _optional(held_out.explainable_rms),
        }


def _optional(values: Mapping[str, float] | None) -> dict[str, float] | None:
    return None if values is None else dict(values)


def selection_steps(
    selection: SubsetSearch, final: CandidateModel, held_out: Sequence[HeldOut]
) -> tuple[SelectionStep, ...]:
    """The models from the base model to the last effect added, each refitted, with their comparisons."""
    effects = final.added
    models = [selection.base]
    for count in range(1, len(effects) + 1):
        models.append(final if count == len(effects) else selection.refitted(final, effects[:count]))
    steps = []
    for added, model in zip((None, *(effect.id for effect in effects)), models, strict=True):
        validation = tuple(h.prediction(model.reported_fit).comparison for h in held_out)
        steps.append(SelectionStep(added, model.reported_fit, model.fit, model.reported, validation))
    return tuple(steps)


def explainable_power_by_step(steps: Sequence[SelectionStep], final: CandidateModel) -> Array:
    """Systematic power of the training residual after each step, relative to the noise power, over all recordings.

    With repeats it is the power that repeats. In a single run it is the power in excess of a stated noise; without one,
    the power in excess of the last step's residual, plus what of that residual is no noise: the cross-validated gain of
    generic terms, or its slow part in the band of the motion. `final` is the model of the last step.
    """
    powers = [
        _single_run_power(steps, final, number) if last.explainable_rms is None else _repeating_power(steps, number)
        for number, last in enumerate(steps[-1].training)
    ]
    return np.asarray(np.sum(powers, axis=0))


def removed_share_by_steps(steps: Sequence[SelectionStep]) -> float:
    """`removed_share` of all effects added, one where nothing was."""
    return removed_share(steps[0].training, steps[-1].training) if len(steps) > 1 else 1.0


def _repeating_power(steps: Sequence[SelectionStep], number: int) -> Array:
    """Systematic power relative to the noise after each step, of a recording with repeats."""
    sizes = [s.training[number].explainable_rms or {} for s in steps]
    return _relative_to_noise(steps[-1].training[number], [{c: v**2 for c, v in size.items()} for size in sizes])


def _single_run_power(steps: Sequence[SelectionStep], final: CandidateModel, number: int) -> Array:
    """Systematic power relative to the noise after each step, of a recording without repeats."""
    last = steps[-1].training[number]
    power = [{c: v**2 for c, v in s.training[number].rms.items()} for s in steps]
    if last.noise.source is NoiseSource.RIG:
        return _relative_to_noise(last, [{c: v - last.noise_floor[c] ** 2 for c, v in p.items()} for p in power])
    removed = _relative_to_noise(last, [{c: v - power[-1][c] for c, v in p.items()} for p in power])
    found, rows = final.comparisons[number].cross_validated_gain, final.fit.noise[number].whitener.rows
    assert found is not None, "the noise of a run that states none is estimated from its residual"
    unexplained = found.gain * len(final.fit.model.channels) / rows
    return removed + max(unexplained, _slow_power(last))


def _slow_power(last: Comparison) -> float:
    """Power of the slow part of a residual, relative to the noise, summed over the channels where it is significant.

    A change slower than the motion is left out: it is drift as likely, which no effect of the tool could explain.
    """
    slow = SlowResidual.of(last)
    if slow is None:
        return 0.0
    counted = [c for c in slow.above_noise if slow.part[c] is not Part.SLOWEST]
    return float(sum((slow.rms[c] / max(last.noise_floor[c], 1e-300)) ** 2 for c in counted))


def _relative_to_noise(last: Comparison, powers: Sequence[Mapping[str, float]]) -> Array:
    """The positive parts of the powers relative to the last step's noise power, summed over the channels."""
    return np.array([sum(max(v, 0.0) / max(last.noise_floor[c], 1e-300) ** 2 for c, v in p.items()) for p in powers])
