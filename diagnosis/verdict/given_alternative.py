"""Alternatives to the effects that a model was given with: others that fit as well, or better, in their place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from diagnosis.screening.score_test import ScoreTest
from diagnosis.selection.subset_search import MAX_REFITS, CandidateModel
from diagnosis.verdict.aliasing import most_significant
from estimation.fit import refit
from modeling.chain.effect import Effect
from modeling.errors import InputError
from modeling.significance import LEVELS


@dataclass(frozen=True, eq=False)
class GivenAlternative:
    """An effect that fits about as well, or better, in the place of one that was given.

    given  id of the one given
    gain   by how much the chi-square with its Bonferroni thresholds is lower with the other, negative where higher
    """

    given: str
    effect: Effect
    gain: float

    @property
    def sentence(self) -> str:
        """Both effects, and how their fits compare."""
        fits = "fits better" if self.gain > 0 else "fits nearly as well"
        size = f"chi-square {abs(self.gain):.2g} {'lower' if self.gain > 0 else 'higher'}, thresholds included"
        return f"{self.effect.id} {fits} in the place of {self.given}, which was given ({size})"

    def to_data(self) -> dict[str, Any]:
        """The alternative in result.json."""
        return {"given": self.given, "id": self.effect.id, "gain": float(self.gain)}


def given_alternatives(final: CandidateModel, candidates: Sequence[Effect]) -> tuple[GivenAlternative, ...]:
    """Of each effect given: the best other one in its place, unless that is clearly worse (`LEVELS.confusable`).

    Those that are significant without it are refitted exactly, all in the noise of the final model.
    """
    found = [_best(final, given, candidates) for given in final.given]
    return tuple(best for best in found if best is not None and best.gain > -LEVELS.confusable)


def _best(final: CandidateModel, given: Effect, candidates: Sequence[Effect]) -> GivenAlternative | None:
    before = final.fit
    rest = tuple(e for e in final.given if e.id != given.id)
    without = CandidateModel(
        refit(before.model.without(given.id), before.recordings, noise=before.noise, start=before.values),
        final.candidates, final.cache, rest,
    )  # fmt: skip
    tests = most_significant(without.screened(candidates))[:MAX_REFITS]
    gains = [
        GivenAlternative(given.id, test.effect, final.criterion - new.criterion)
        for test in tests
        if (new := _refitted(without, test)) is not None
    ]
    return max(gains, key=lambda alternative: alternative.gain, default=None)


def _refitted(without: CandidateModel, test: ScoreTest) -> CandidateModel | None:
    """With the effect, in the same noise; None where the score test's initial values have no solution."""
    before = without.fit
    try:
        after = refit(before.model + test.effect, before.recordings, noise=before.noise,
                      start={**before.values, **test.start})  # fmt: skip
    except InputError:
        return None
    return CandidateModel(after, without.candidates, without.cache, without.given)
