"""Verdict rules on an effect."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from diagnosis.screening.score_test import ScoreTest
from diagnosis.selection.subset_search import MAX_REFITS
from diagnosis.verdict.aliasing import Alias
from diagnosis.verdict.effect_refits import EffectRefits, FinalRefit
from diagnosis.verdict.verdict import EffectVerdict
from diagnosis.verdict_rule import VerdictRule
from estimation.distributions import chi2_sf
from modeling.significance import LEVELS
from modeling.space import Space

ALIAS_SENTENCE = (
    "indistinguishable from {e.alias[0]} (separation {e.alias[1].noncentrality:.2g}, "
    "probability of confusion {e.alias[1].error_probability:.0%})"
)
REPLACEMENT_SENTENCE = (
    "rejected, because in the place of {e.replacement[0]} it fits worse: the chi-square is higher by"
    " {e.replacement[1].excess_in_words}; beside it, it is collinear"
)
RANGE_SENTENCE = "{e.beyond_range} is not excited: detectable only beyond its physical range"
NOT_SIGNIFICANT_SENTENCE = "rejected, because it is not significant: what it would explain is within the noise"
LIMIT_SENTENCE = "the upper 95 % limit of its contribution is below tolerance"
NOT_AFTER_REFIT_SENTENCE = "rejected, because it is significant in the score test, but not after the exact refit"
REFIT_UNCONVERGED_SENTENCE = (
    "rejected, because it is significant in the score test, but its exact refit has not converged"
)
LEFT_OUT_SENTENCE = "rejected, because it was below tolerance beside the effects with which the search chose it"
EXPLAINS_NOTHING_SENTENCE = (
    "rejected, because no set that it was refitted in explains the residual{e.refits.place}{e.refits.early_end}"
)
PREFERRED_SENTENCE = (
    "rejected, because the search preferred {e.refits.chosen} to every set that it was refitted in{e.refits.place}"
)
UNSOLVED_SENTENCE = "rejected, because {e.refits.unsolved} has no solution at the initial values of its exact refit"
UNCONVERGED_SENTENCE = (
    "not tried, because the search does not go on from {e.refits.unconverged}, whose refit has not converged: exclude"
    " effects of that set by --without{e.refits.limited}"
)
PASSED_OVER_SENTENCE = (
    f"not tried, because the search refits at most {MAX_REFITS} effects beside each set, and others had larger scores:"
    " give it fewer candidates by --only"
)
ADEQUATE_SENTENCE = (
    "not tried, because the search had ended at {e.refits.chosen}, which explains the residual: go on from there by"
    " --given"
)
LATER_SENTENCE = "not tried, because it was not significant beside any set that the search extended{e.refits.later}"


@dataclass(frozen=True, eq=False, kw_only=True)
class EffectEvidence:
    """Evidence on an effect, with the final model.

    screening   its score test given the model without it
    added       whether the final model has it
    alias       the added effect's id and itself as an alias of that, None unless indistinguishable from one
    replacement the added effect's id and itself fitted in its place, where it is separated from that one
    rejection   why it was not accepted, None unless it was tried for acceptance
    negligible  whether the upper 95 % limit of its contribution is within tolerance
    one_run     whether no recording has repeats
    adjusted_p_value  of its score test, Holm over the effects that the final model lacks, as in the search
    refits      what the search has refitted with it
    """

    screening: ScoreTest
    space: Space
    added: bool = False
    alias: tuple[str, Alias] | None = None
    replacement: tuple[str, Alias] | None = None
    rejection: str | None = None
    negligible: bool = False
    one_run: bool = False
    adjusted_p_value: float = 1.0
    refits: EffectRefits = field(default_factory=EffectRefits)

    @property
    def significant(self) -> bool:
        """Whether the search would refit it beside the final model: its absence has another reason than its p-value."""
        return self.adjusted_p_value < LEVELS.effect

    @property
    def beyond_range(self) -> str | None:
        """The first of its amplitudes, when all are detectable only beyond their physical range, else None."""
        return beyond_range(self.screening, self.space)

    @property
    def chi_square_p_value(self) -> float:
        """P-value of its score by chi-square, as if the noise were known, corrected for the grid points tested."""
        alone = float(chi2_sf(self.screening.statistic, max(1, len(self.screening.amounts))))
        return min(1.0, self.screening.searched * alone)

    @property
    def unknown_noise(self) -> str:
        """What does not suffice to know the noise at low frequencies."""
        if self.one_run:
            return "one run does not tell the low-frequency noise well enough"
        return "there are too few repeats to know the low-frequency noise"


def beyond_range(screening: ScoreTest, space: Space) -> str | None:
    """The first amplitude of an effect, when all are detectable only beyond their physical range, else None."""
    bounds = {p.name: p.bounds for p in screening.effect.qualified(space)}
    wide = [n for n, amount in screening.detectable.items() if amount > max(np.abs(bounds[n]))]
    return wide[0].split(".", 1)[1] if wide and len(wide) == len(screening.detectable) else None


EffectRule = VerdictRule[EffectEvidence, EffectVerdict]
V = EffectVerdict
EFFECT_RULES: tuple[EffectRule, ...] = (
    VerdictRule("added to the model", lambda e: e.added, V.SUPPORTED),
    VerdictRule("alias of an added effect", lambda e: e.alias is not None, V.CONFUSABLE, ALIAS_SENTENCE),
    VerdictRule("not accepted", lambda e: e.rejection is not None, V.NOT_SUPPORTED, "rejected, because {e.rejection}"),
    VerdictRule(
        "not identifiable beside an effect in whose place it fits worse",
        lambda e: e.replacement is not None and not e.screening.excited,
        V.NOT_SUPPORTED,
        REPLACEMENT_SENTENCE,
    ),
    VerdictRule("not identifiable", lambda e: not e.screening.excited, V.NOT_EXCITED, "{e.screening.reason}"),
    VerdictRule("only beyond its physical range", lambda e: e.beyond_range is not None, V.NOT_EXCITED, RANGE_SENTENCE),
    VerdictRule("upper limit within tolerance", lambda e: e.negligible, V.NEGLIGIBLE, LIMIT_SENTENCE),
    VerdictRule(
        "not significant after the exact refit",
        lambda e: e.significant and e.refits.final is FinalRefit.NOT_SIGNIFICANT,
        V.NOT_SUPPORTED,
        NOT_AFTER_REFIT_SENTENCE,
    ),
    VerdictRule(
        "exact refit not converged",
        lambda e: e.significant and e.refits.final is FinalRefit.UNCONVERGED,
        V.NOT_SUPPORTED,
        REFIT_UNCONVERGED_SENTENCE,
    ),
    VerdictRule(
        "left out of the chosen set as within tolerance",
        lambda e: e.significant and e.refits.left_out,
        V.NOT_SUPPORTED,
        LEFT_OUT_SENTENCE,
    ),
    VerdictRule(
        "refitted in sets that do not explain the residual",
        lambda e: e.significant and e.refits.explains_nothing,
        V.NOT_SUPPORTED,
        EXPLAINS_NOTHING_SENTENCE,
    ),
    VerdictRule(
        "refitted in sets to which the search preferred another",
        lambda e: e.significant and bool(e.refits.smallest),
        V.NOT_SUPPORTED,
        PREFERRED_SENTENCE,
    ),
    VerdictRule(
        "exact refit without a solution",
        lambda e: e.significant and bool(e.refits.unsolved),
        V.NOT_SUPPORTED,
        UNSOLVED_SENTENCE,
    ),
    VerdictRule(
        "not refitted, as the search ended without convergence",
        lambda e: e.significant and bool(e.refits.unconverged),
        V.NOT_SUPPORTED,
        UNCONVERGED_SENTENCE,
    ),
    VerdictRule(
        "not refitted, as refits are limited",
        lambda e: e.significant and e.refits.passed_over,
        V.NOT_SUPPORTED,
        PASSED_OVER_SENTENCE,
    ),
    VerdictRule(
        "not refitted, as the search ended at an adequate model",
        lambda e: e.significant and e.refits.ended_adequate,
        V.NOT_SUPPORTED,
        ADEQUATE_SENTENCE,
    ),
    VerdictRule(
        "not refitted, as it was not significant in the search",
        lambda e: e.significant,
        V.NOT_SUPPORTED,
        LATER_SENTENCE,
    ),
    VerdictRule(
        "significant only in noise that is known",
        lambda e: e.chi_square_p_value < LEVELS.poorly_known_noise,
        V.NOT_SUPPORTED,
        "rejected, because {e.unknown_noise}",
    ),
    VerdictRule("not significant", lambda e: True, V.NOT_SUPPORTED, NOT_SIGNIFICANT_SENTENCE),
)
"""In order; `diagnose(..., effect_rules=(rule, *EFFECT_RULES))` asks another one first."""
