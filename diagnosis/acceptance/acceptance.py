"""Acceptance of effects: held-out error, coefficient consistency, physical bounds, confounding with tool parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from diagnosis.acceptance.acceptance_rules import ACCEPTANCE_RULES, AcceptanceEvidence
from diagnosis.acceptance.held_out import HeldOut
from diagnosis.acceptance.recording_disturbance import with_disturbances
from diagnosis.selection.subset_search import CandidateModel
from diagnosis.verdict_rule import judge
from modeling.chain.effect import Effect
from modeling.errors import InputError


@dataclass(frozen=True, eq=False)
class Acceptance:
    """The accepted candidate, reasons for rejecting other effects, and held-out recordings with their disturbances."""

    candidate: CandidateModel
    reasons: dict[str, str]
    held_out: tuple[HeldOut, ...]


def accept(
    candidate: CandidateModel, base: CandidateModel, held_out: Sequence[HeldOut], effects: Sequence[Effect]
) -> Acceptance:
    """Reject effects of a candidate, one by one, until `ACCEPTANCE_RULES` accept the remaining set.

    Recording-specific disturbances (drift, contact, those among `effects`) of held-out recordings are re-estimated for
    each model, also for the base.
    """
    reasons: dict[str, str] = {}
    while True:
        known: tuple[HeldOut, ...] = ()
        try:
            known = tuple(with_disturbances(h, candidate.fit, effects, candidate.cache) for h in held_out)
            evidence = AcceptanceEvidence(candidate, base, known)
            rejected, reason = judge(ACCEPTANCE_RULES, evidence)
            effect_id = rejected(evidence)
        except InputError:
            # the tip's spring is too soft for the held-out motion
            effect_id = AcceptanceEvidence(candidate, base).least_significant
            reason = "its prediction for the held-out motion has no solution"
        if effect_id is None:
            return Acceptance(candidate, reasons, known)
        reasons[effect_id] = reason
        candidate = candidate.without(effect_id)
