"""Verdicts: what is said of a recording, and of each effect."""

from __future__ import annotations

from enum import Enum


class RecordVerdict(Enum):
    """What is said of a recording as a whole.

    NOTHING_MISSING   nothing added, and lack of fit p >= 0.01
    EXPLAINED         something added, and then p >= 0.01 or the explainable error within tolerance in every channel
    PARTLY_EXPLAINED  added, explainable power at least halved, still misfits
    UNEXPLAINED       misfits, and nothing acceptable found
    """

    NOTHING_MISSING = "nothing_missing"
    EXPLAINED = "explained"
    PARTLY_EXPLAINED = "partly_explained"
    UNEXPLAINED = "unexplained"


class EffectVerdict(Enum):
    """What is said of an effect.

    SUPPORTED      added
    CONFUSABLE     as good as an added one, and not the simplest
    NEGLIGIBLE     its upper 95 % limit is below tolerance
    NOT_EXCITED    detectable only beyond its physical range, or an input is missing
    NOT_SUPPORTED  everything else
    """

    SUPPORTED = "supported"
    CONFUSABLE = "confusable"
    NEGLIGIBLE = "negligible"
    NOT_EXCITED = "not_excited"
    NOT_SUPPORTED = "not_supported"
