"""Verdicts on the recordings, and on each effect."""

from __future__ import annotations

from enum import Enum


class RecordVerdict(Enum):
    """Verdict on the recordings as a whole.

    NOTHING_MISSING   no effect added, and lack of fit p >= 0.01
    EXPLAINED         effects added, and then p >= 0.01 or the systematic error within tolerance in every channel
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
