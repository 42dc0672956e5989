"""Separation of two models in both directions, error probability, runs needed."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from math import ceil, inf, isfinite
from typing import Any

import numpy as np
from scipy.stats import norm

CONFUSABLE_SEPARATION, CLEAR_SEPARATION = 10.8, 21.6
"""lambda at which the error probability Phi(-sqrt(lambda) / 2) of choosing between two models is 5 %, and 1 %."""


class Separability(Enum):
    """Whether two models can be discriminated; the value describes it."""

    SEPARATED = "separated"
    REPEATS = "confusable at these sizes, separated by more runs"
    NEVER = "no trajectory of this arm discriminates them"


@dataclass(frozen=True, kw_only=True)
class Separation:
    """Noncentrality lambda of a truth with respect to the fitted rival, in all runs of a trajectory together.

    before     along the reference trajectory
    after      along the designed one
    noticed    lambda of the truth from itself without its distinguishing effects, along the designed one
    imitated   whether the rival is indistinguishable from the truth, along any trajectory
    """

    truth: str
    rival: str
    before: float
    after: float
    noticed: float
    imitated: bool


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
        return self.directions[0].imitated != self.directions[1].imitated

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
        return Separability.SEPARATED if self.after >= CLEAR_SEPARATION else Separability.REPEATS

    def chance(self, separation: float) -> float | None:
        """Error probability of choosing between the two, Phi(-sqrt(lambda) / 2); None when they are nested."""
        return None if self.nested else float(norm.cdf(-np.sqrt(separation) / 2))

    def runs_for(self, separation: float) -> int | None:
        """Runs of the designed trajectory for a lambda of `separation`; None when no number is enough.

        Noise is independent between runs, so that their lambdas add.
        """
        runs = self.runs * separation / self.after if self.after > 0 else inf
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
            "chance_before": self.chance(self.before),
            "chance_after": self.chance(self.after),
            "runs_for_5_percent": self.runs_for(CONFUSABLE_SEPARATION),
            "runs_for_1_percent": self.runs_for(CLEAR_SEPARATION),
            "directions": [vars(direction) for direction in self.directions],
        }

    @property
    def _counted(self) -> list[Separation]:
        distinct = [d for d in self.directions if not d.imitated]
        return [d for d in distinct if d.noticed >= CONFUSABLE_SEPARATION] or distinct
