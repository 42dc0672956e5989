"""What the search has refitted with an effect that the final model lacks, and why no more."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

from diagnosis.selection.subset_search import MAX_REFITS, CandidateModel, SubsetSearch, refit_effects

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


def effect_refits(
    selection: SubsetSearch, final: CandidateModel, effect_id: str, beside: FinalRefit = FinalRefit.NONE
) -> EffectRefits:
    """What the search has refitted with an effect, of which the refit `beside` the final model is judged already."""
    record = selection.record
    refitted = record.refits_with(effect_id)
    return EffectRefits(
        final=beside,
        smallest=_name(refitted[0].ids) if refitted else "",
        explains=any(c.adequate for c in refitted),
        final_is_base=not final.ids,
        chosen=_name(selection.chosen.ids),
        left_out=effect_id in selection.chosen.ids,
        unsolved=min((_name(ids) for ids in record.unsolved if effect_id in ids), default=""),
        unconverged=_unconverged(selection, final),
        passed_over=any(effect_id in ids for ids in record.passed_over),
        ended_adequate=selection.chosen.adequate and selection.chosen.ids not in record.extended,
        final_extended=final.ids in record.extended,
    )


def refit_beside(selection: SubsetSearch, final: CandidateModel, effect_id: str) -> CandidateModel | None:
    """The final model with one more effect, if the search has refitted it."""
    wanted = final.ids | {effect_id}
    return next((c for c in selection.record.refits_with(effect_id) if c.ids == wanted), None)


def judge_refit(larger: CandidateModel, final: CandidateModel, effect_id: str) -> FinalRefit:
    """Whether the refit with one more effect is significantly better, as backward elimination judges it.

    Both are in one noise: in that of the larger set where each has a noise of its own.
    """
    smaller = final
    if larger.fit.noise is not final.fit.noise:
        smaller = refit_effects(larger, [e for e in larger.added if e.id != effect_id])
    if larger.criterion < smaller.criterion:
        return FinalRefit.SIGNIFICANT
    return FinalRefit.NOT_SIGNIFICANT if larger.fit.converged else FinalRefit.UNCONVERGED


def _unconverged(selection: SubsetSearch, final: CandidateModel) -> str:
    """The set from which the search did not go on as its refit has not converged: the final one, or where it ended."""
    record = selection.record
    if not final.fit.converged and final.ids not in record.extended:
        return _name(final.ids)
    return "" if record.unconverged is None else _name(record.unconverged)


def _name(ids: Iterable[str]) -> str:
    return " + ".join(sorted(ids)) or BASE
