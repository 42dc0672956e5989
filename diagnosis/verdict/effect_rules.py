"""Verdict rules on an effect."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from diagnosis.screening.score_test import ScoreTest
from diagnosis.verdict.aliasing import Alias
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
    " {e.replacement[1].excess:.3g}; beside it, it is collinear"
)
RANGE_SENTENCE = "{e.beyond_range} is not excited: detectable only beyond its physical range"
NOT_SIGNIFICANT_SENTENCE = "rejected, because it is not significant: what it would explain is within the noise"
LIMIT_SENTENCE = "the upper 95 % limit of its contribution is below tolerance"


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
    untried     whether effects beside the added ones were not refitted, as the refit of those has not converged
    """

    screening: ScoreTest
    space: Space
    added: bool = False
    alias: tuple[str, Alias] | None = None
    replacement: tuple[str, Alias] | None = None
    rejection: str | None = None
    negligible: bool = False
    one_run: bool = False
    untried: bool = False

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
        "significant beside a model that has not converged",
        lambda e: e.untried and e.screening.p_value < LEVELS.refuted,
        V.NOT_SUPPORTED,
        "not tried, because the refit of the final model has not converged: give it fewer candidates by --only",
    ),
    VerdictRule(
        "significant only in the score test",
        lambda e: e.screening.p_value < LEVELS.refuted,
        V.NOT_SUPPORTED,
        "rejected, because it is significant in the score test, but not after the exact refit",
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
