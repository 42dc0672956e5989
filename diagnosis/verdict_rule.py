"""Verdict rule: a condition over evidence, the verdict that it leads to, and the sentence that says why."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Generic, TypeVar

from modeling.errors import InputError

# Verdicts on the recordings, and on each effect.


class RecordVerdict(Enum):
    """Verdict on the recordings as a whole.

    NOTHING_MISSING   no effect added, and lack of fit p >= 0.01
    EXPLAINED         effects added, and then p >= 0.01 or the systematic error within tolerance in every channel; and
                      no repeat deviates from the others any more
    PARTLY_EXPLAINED  effects added, systematic power at least halved, lack of fit remains
    UNEXPLAINED       lack of fit, and no effect accepted
    """

    NOTHING_MISSING = "nothing_missing"
    EXPLAINED = "explained"
    PARTLY_EXPLAINED = "partly_explained"
    UNEXPLAINED = "unexplained"


class EffectVerdict(Enum):
    """Verdict on an effect.

    SUPPORTED      added to the model
    CONFUSABLE     alias of an added effect, and not the simpler model
    NEGLIGIBLE     upper 95 % limit of its contribution below tolerance
    NOT_EXCITED    not identifiable, detectable only beyond its physical range, or an input is missing
    NOT_SUPPORTED  rejected: not significant, or not accepted
    """

    SUPPORTED = "supported"
    CONFUSABLE = "confusable"
    NEGLIGIBLE = "negligible"
    NOT_EXCITED = "not_excited"
    NOT_SUPPORTED = "not_supported"


Evidence = TypeVar("Evidence")
Verdict = TypeVar("Verdict")


@dataclass(frozen=True)
class VerdictRule(Generic[Evidence, Verdict]):
    """A rule of an ordered list, of which the first whose condition holds decides.

    name       the condition in words
    condition  whether the rule applies to the evidence
    verdict    the verdict when it does
    sentence   the reason printed with it, in which {e.name} stands for an attribute of the evidence
    """

    name: str
    condition: Callable[[Evidence], bool]
    verdict: Verdict
    sentence: str = ""


def judge(rules: Sequence[VerdictRule[Evidence, Verdict]], evidence: Evidence) -> tuple[Verdict, str]:
    """Verdict and sentence of the first rule that applies; InputError when none does."""
    for rule in rules:
        if rule.condition(evidence):
            return rule.verdict, rule.sentence.format(e=evidence)
    remedy = "end the list with a rule that always applies"
    raise InputError(what=f"none of {len(rules)} rules applies", where="verdict rules", remedy=remedy)
