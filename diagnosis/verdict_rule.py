"""Verdict rule: a condition over evidence, the verdict that it leads to, and the sentence that says why."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from modeling.errors import InputError

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
