"""Pair: two models, each taken for true and imitated by the other one, and what that says of telling them apart."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from math import ceil, inf, isfinite
from typing import Any

import numpy as np
from scipy.stats import norm

CONFUSABLE, SEPARATED = 10.8, 21.6
"""lambda at which two models are mistaken for one another 1 time in 20, and 1 time in 100: Phi(-sqrt(lambda) / 2)."""


class Verdict(Enum):
    """Whether two models can be told apart; the value says it."""

    SEPARATED = "separated"
    REPEATS = "confusable at these sizes, separated by more runs"
    NEVER = "no motion of this arm separates them"


@dataclass(frozen=True, kw_only=True)
class Separation:
    """lambda of a truth from its best imitation by a rival, in all runs of a motion together.

    before     along the motion that was there before
    after      along the designed one
    noticed    lambda of the truth from itself without its own effects, along the designed one
    imitated   whether the rival imitates the truth exactly, along any motion
    """

    truth: str
    rival: str
    before: float
    after: float
    noticed: float
    imitated: bool


@dataclass(frozen=True, kw_only=True)
class Pair:
    """Two models, each taken for true and imitated by the other one; they are judged by the smaller lambda.

    Where one of them imitates the other exactly and not the other way round, the one contains the other: the smaller
    model is held until the larger one shows (parsimony), so that only the larger one's lambda counts, and there is no
    chance of mistaking them but that of the test. Nor does a truth count that nobody would notice: the best imitation
    by an effect of quite another kind is next to none of it.
    """

    directions: tuple[Separation, Separation]
    runs: int

    @property
    def names(self) -> tuple[str, str]:
        """The truth of the model given, and the rival."""
        return self.directions[0].truth, self.directions[0].rival

    @property
    def nested(self) -> bool:
        """Whether one model contains the other."""
        return self.directions[0].imitated != self.directions[1].imitated

    @property
    def before(self) -> float:
        """The lambda that counts, along the motion before."""
        return min((d.before for d in self._counted), default=0.0)

    @property
    def after(self) -> float:
        """The lambda that counts, along the designed motion."""
        return min((d.after for d in self._counted), default=0.0)

    @property
    def verdict(self) -> Verdict:
        """Separated is 1 mistake in 100, in as many runs as are planned."""
        if not self._counted:
            return Verdict.NEVER
        return Verdict.SEPARATED if self.after >= SEPARATED else Verdict.REPEATS

    def chance(self, separation: float) -> float | None:
        """Chance of mistaking the two, Phi(-sqrt(lambda) / 2); None when one contains the other."""
        return None if self.nested else float(norm.cdf(-np.sqrt(separation) / 2))

    def runs_for(self, separation: float) -> int | None:
        """Runs of the designed motion until lambda, which grows with them, is `separation`; None when none are enough.

        Each run has noise of its own, so that their lambdas add.
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
            "runs_for_5_percent": self.runs_for(CONFUSABLE),
            "runs_for_1_percent": self.runs_for(SEPARATED),
            "directions": [vars(direction) for direction in self.directions],
        }

    @property
    def _counted(self) -> list[Separation]:
        different = [d for d in self.directions if not d.imitated]
        return [d for d in different if d.noticed >= CONFUSABLE] or different
