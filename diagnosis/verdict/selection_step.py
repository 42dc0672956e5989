"""Selection steps: models with 0..n effects compared on training and held-out recordings; and what the search has
refitted beside them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from diagnosis.comparison.compared_step import ComparedFit
from diagnosis.comparison.comparison import Comparison
from diagnosis.comparison.slow_residual import Part, SlowResidual, removed_share
from diagnosis.held_out import HeldOut
from diagnosis.subset_search import MAX_REFITS, CandidateModel, SubsetSearch, refit_effects
from estimation.fit import Fit

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SelectionStep(ComparedFit):
    """The model after one more effect, compared with the training and the held-out recordings.

    fit     as `fit` reports it
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
        validation = tuple(h.comparison(model.reported_fit) for h in held_out)
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
    if last.noise.source.is_of_samples:
        return _relative_to_noise(last, [{c: v - last.noise_floor[c] ** 2 for c, v in p.items()} for p in power])
    removed = _relative_to_noise(last, [{c: v - power[-1][c] for c, v in p.items()} for p in power])
    terms, rows = final.comparisons[number].cross_validated_gain, final.fit.noise[number].whitener.rows
    assert terms is not None, "the noise of a run that states none is estimated from its residual"
    unexplained = terms.gain * len(final.fit.model.channels) / rows
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


# What the search has refitted with an effect that the final model lacks, and why no more.


BASE = "the base model"
"""Name of the set without effects."""


class FinalRefit(Enum):
    """Exact refit of the final model with one more effect, judged by the search's criterion."""

    NONE = "not refitted"
    UNCONVERGED = "not converged, and no better so far"
    NOT_SIGNIFICANT = "not significant"
    SIGNIFICANT = "significant"


@dataclass(frozen=True, kw_only=True)
class EffectRefits:
    """What the search has refitted with an effect that the final model lacks. Sets are named by their effects.

    final        the refit of the final model with it
    smallest     the smallest set that it was refitted in, empty where it was refitted in none
    explains     whether a set that it was refitted in explains the residual: lack of fit is not significant
    final_is_base  whether the final model has no added effect
    chosen       the set that the search chose, before acceptance
    left_out     whether it was in that set, and was left out as within tolerance
    unsolved     a set with it that has no solution, empty where there is none
    unconverged  the set from which the search did not go on, as its refit has not converged; empty where it did
    passed_over  whether others had larger scores, to which the refits beside one set were limited
    ended_adequate  whether the chosen set explains the residual, and its extensions were not looked for
    final_extended  whether the extensions of the final model were looked for, be it in another noise
    """

    final: FinalRefit = FinalRefit.NONE
    smallest: str = ""
    explains: bool = False
    final_is_base: bool = False
    chosen: str = BASE
    left_out: bool = False
    unsolved: str = ""
    unconverged: str = ""
    passed_over: bool = False
    ended_adequate: bool = False
    final_extended: bool = False

    @property
    def explains_nothing(self) -> bool:
        """Whether it was refitted, explains the residual in no set, and neither does any set that was accepted."""
        return bool(self.smallest) and not self.explains and self.final_is_base

    @property
    def place(self) -> str:
        """That it was significant where it was refitted beside the final model; else the smallest of other sets."""
        if self.final is FinalRefit.SIGNIFICANT:
            return ", although it is significant after the exact refit"
        return f" (the smallest: {self.smallest}; not beside the final model)"

    @property
    def early_end(self) -> str:
        """That the search ended without convergence; empty where it did not."""
        return f"; the search ended at {self.unconverged}, whose refit has not converged" if self.unconverged else ""

    @property
    def limited(self) -> str:
        """That the number of refits kept it from being tried beside other sets; empty where it did not."""
        if not self.passed_over:
            return ""
        return f"; beside other sets, of which each has at most {MAX_REFITS} refits, others had larger scores"

    @property
    def later(self) -> str:
        """Where it is significant, as it was beside none of the sets whose extensions were looked for."""
        if self.final_extended:
            return ": it is in the noise of the final model only"
        return ": it is beside the final model only; go on from that one by --given"


def effect_refits(selection: SubsetSearch, final: CandidateModel, effect_id: str) -> EffectRefits:
    """What the search has refitted with an effect that the final model lacks."""
    refitted = selection.refits_with(effect_id)
    beside = next((c for c in refitted if c.ids == final.ids | {effect_id}), None)
    return EffectRefits(
        final=FinalRefit.NONE if beside is None else judge_refit(beside, final, effect_id),
        smallest=_name(refitted[0].ids) if refitted else "",
        explains=any(c.adequate for c in refitted),
        final_is_base=not final.ids,
        chosen=_name(selection.chosen.ids),
        left_out=effect_id in selection.chosen.ids,
        unsolved=min((_name(ids) for ids in selection.unsolved if effect_id in ids), default=""),
        unconverged=_unconverged(selection, final),
        passed_over=any(effect_id in ids for ids in selection.passed_over),
        ended_adequate=selection.chosen.adequate and selection.chosen.ids not in selection.extended,
        final_extended=final.ids in selection.extended,
    )


def judge_refit(larger: CandidateModel, final: CandidateModel, effect_id: str) -> FinalRefit:
    """Whether the refit with one more effect is significantly better, as backward elimination judges it.

    Both are in one noise: in that of the larger set where each has a noise of its own.
    """
    smaller = final
    if not larger.fit.is_in_noise_of(final.fit):
        smaller = refit_effects(larger, [e for e in larger.added if e.id != effect_id])
    if larger.criterion < smaller.criterion:
        return FinalRefit.SIGNIFICANT
    return FinalRefit.NOT_SIGNIFICANT if larger.fit.converged else FinalRefit.UNCONVERGED


def _unconverged(selection: SubsetSearch, final: CandidateModel) -> str:
    """The set from which the search did not go on as its refit has not converged: the final one, or where it ended."""
    if not final.fit.converged and final.ids not in selection.extended:
        return _name(final.ids)
    return "" if selection.unconverged is None else _name(selection.unconverged)


def _name(ids: Iterable[str]) -> str:
    return " + ".join(sorted(ids)) or BASE
