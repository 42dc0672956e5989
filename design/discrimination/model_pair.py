"""Separation of two models in both directions, error probability, runs needed."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from math import ceil, inf, isfinite
from typing import Any

from modeling.rival_fit import error_probability
from modeling.significance import LEVELS


class Separability(Enum):
    """Whether two models can be discriminated; the value describes it."""

    SEPARATED = "separated"
    REPEATS = "confusable at these sizes, separated by more runs"
    NEVER = "no trajectory of this arm discriminates them"


@dataclass(frozen=True, kw_only=True)
class Separation:
    """Noncentrality lambda of a truth with respect to the fitted rival, in all runs of a trajectory together.

    before             along the reference trajectory
    after              along the designed one
    detection          lambda of the truth from itself without its distinguishing effects, along the designed one
    indistinguishable  whether the rival is indistinguishable from the truth, along any trajectory
    """

    truth: str
    rival: str
    before: float
    after: float
    detection: float
    indistinguishable: bool

    def to_data(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "truth": self.truth,
            "rival": self.rival,
            "before": self.before,
            "after": self.after,
            "noticed": self.detection,
            "imitated": self.indistinguishable,
        }


@dataclass(frozen=True, kw_only=True)
class ModelPair:
    """Two models, each taken as true with the other as rival; their separation is the smaller lambda.

    Where only one of them is indistinguishable from the other, they are nested: the smaller model is preferred until
    it is rejected (parsimony), so that only the larger one's lambda counts, and the error probability is that of the
    test. Nor does a truth count that is undetectable: a rival of quite another kind is fitted with almost no amplitude.
    """

    directions: tuple[Separation, Separation]
    runs: int

    @property
    def names(self) -> tuple[str, str]:
        """Names of the given model and of the rival."""
        return self.directions[0].truth, self.directions[0].rival

    @property
    def nested(self) -> bool:
        """Whether one model is nested in the other."""
        return self.directions[0].indistinguishable != self.directions[1].indistinguishable

    @property
    def before(self) -> float:
        """The lambda that counts, along the reference trajectory."""
        return min((d.before for d in self._counted), default=0.0)

    @property
    def after(self) -> float:
        """The lambda that counts, along the designed trajectory."""
        return min((d.after for d in self._counted), default=0.0)

    @property
    def verdict(self) -> Separability:
        """Separated: an error probability of 1 % at most, in the planned runs."""
        if not self._counted:
            return Separability.NEVER
        return Separability.SEPARATED if self.after >= LEVELS.separated else Separability.REPEATS

    def error_probability(self, noncentrality: float) -> float | None:
        """Error probability of choosing between the two at a lambda; None when they are nested."""
        return None if self.nested else error_probability(noncentrality)

    def runs_for(self, noncentrality: float) -> int | None:
        """Runs of the designed trajectory for a lambda of `noncentrality`; None when no number is enough.

        Noise is independent between runs, so that their lambdas add.
        """
        runs = self.runs * noncentrality / self.after if self.after > 0 else inf
        return ceil(runs) if isfinite(runs) else None

    def to_data(self) -> dict[str, Any]:
        """Plain data: numbers are finite, or None."""
        return {
            "truth": self.names[0],
            "rival": self.names[1],
            "verdict": self.verdict.name.lower(),
            "nested": self.nested,
            "separation_before": self.before,
            "separation_after": self.after,
            "chance_before": self.error_probability(self.before),
            "chance_after": self.error_probability(self.after),
            "runs_for_5_percent": self.runs_for(LEVELS.confusable),
            "runs_for_1_percent": self.runs_for(LEVELS.separated),
            "directions": [direction.to_data() for direction in self.directions],
        }

    @property
    def _counted(self) -> list[Separation]:
        distinct = [d for d in self.directions if not d.indistinguishable]
        return [d for d in distinct if d.detection >= LEVELS.confusable] or distinct
