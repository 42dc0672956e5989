"""Verdict rules on the recordings as a whole."""

from __future__ import annotations

from dataclasses import dataclass

from diagnosis.verdict.verdict import RecordVerdict
from diagnosis.verdict_rule import VerdictRule
from modeling.significance import LEVELS


@dataclass(frozen=True, kw_only=True)
class RecordEvidence:
    """Evidence on the recordings, with the final model.

    lack_of_fit           p-value in training, corrected for the number of recordings
    held_out_lack_of_fit  smallest p-value over the held-out recordings, 1 without any
    effects               number of effects added
    unaccepted            whether, in noise that is estimated from the residual, some effect was significant in the
                          search: the lack-of-fit test has little power there
    slow                  whether a slow part of a single run's residual exceeds the noise: drift or slow physics
    removed_share         what the effects removed of a single run's residual, over that and what remains of it in the
                          band of the motion beyond 1/f noise; 1 where the noise is known
    within_tolerance      whether the systematic error is within tolerance in every channel of every recording, of a
                          held-out one without what errors of the estimates kept explain
    power_share           systematic power of the final model's residual over that of the rigid tool's
    deviates_outside      whether the readings differ from the model outside the whole repeats that were cut from a log
    unrecorded_acceleration  whether a residual looks like mass times an acceleration that was not recorded, which no
                          test shows where the noise is estimated from that residual
    """

    lack_of_fit: float
    held_out_lack_of_fit: float = 1.0
    effects: int = 0
    unaccepted: bool = False
    slow: bool = False
    removed_share: float = 1.0
    within_tolerance: bool = False
    power_share: float = 1.0
    deviates_outside: bool = False
    unrecorded_acceleration: bool = False

    @property
    def adequate(self) -> bool:
        """Whether no lack of fit is significant, neither in training nor on held-out data, and nothing else remains."""
        if self.slow or self.unrecorded_acceleration or self.deviates_outside:
            return False
        return self.lack_of_fit >= LEVELS.effect and self.held_out_lack_of_fit >= LEVELS.held_out

    @property
    def rigid_tool_suffices(self) -> bool:
        """Whether the model without effects is adequate, and none was significant on the way."""
        return self.adequate and not self.effects and not self.unaccepted


RecordRule = VerdictRule[RecordEvidence, RecordVerdict]
V = RecordVerdict
RECORD_RULES: tuple[RecordRule, ...] = (
    VerdictRule(
        "adequate without effects", lambda e: not e.effects and e.adequate and not e.unaccepted, V.NOTHING_MISSING
    ),
    VerdictRule("no effect accepted", lambda e: not e.effects, V.UNEXPLAINED),
    VerdictRule(
        "a single run of which little was removed", lambda e: e.adequate and e.removed_share < 0.5, V.PARTLY_EXPLAINED
    ),
    VerdictRule("no lack of fit", lambda e: e.adequate, V.EXPLAINED),
    VerdictRule("error within tolerance", lambda e: e.within_tolerance and not e.deviates_outside, V.EXPLAINED),
    VerdictRule("systematic power at least halved", lambda e: e.power_share <= 0.5, V.PARTLY_EXPLAINED),
    VerdictRule(
        "more than half of the systematic power remains",
        lambda e: True,
        V.UNEXPLAINED,
        "it removes less than half of the systematic error, and the residual stays significant",
    ),
)
"""In order; a model without effects ends at the second rule."""
