"""Effects whose only evidence lies in channels where most of the readings is not the tool's."""

from __future__ import annotations

import numpy as np

from diagnosis.comparison.slow_residual import Part, SlowResidual
from diagnosis.selection.subset_search import CandidateModel
from estimation.distributions import chi2_isf
from modeling.chain.effect import Effect
from modeling.significance import LEVELS


def effect_of_foreign_residual(candidate: CandidateModel) -> tuple[str, str] | None:
    """The effect that most lowers the residual in foreign channels and not elsewhere, and the reason to reject it.

    A channel of a single run is foreign where the residual is most of its readings and far above the sensor's noise
    (`Part.FOREIGN`): a hand, another load. The noise model takes that residual for stationary noise, which it is not,
    and so a small correlation with it looks significant. An effect is rejected when it explains no more in all other
    channels together than in the foreign ones, each relative to what remains, or than noise lets expect. A channel of
    which it removes more than remains counts as one of the others.
    """
    numbers = range(len(candidate.fit.recordings))
    foreign = {n: channels for n in numbers if (channels := _foreign_channels(candidate, n))}
    if not foreign:
        return None
    excess = {e.id: _foreign_excess(candidate, e, foreign) for e in candidate.added}
    worst = max(excess, key=lambda effect_id: excess[effect_id])
    if excess[worst] <= 0:
        return None
    number, channels = next(iter(foreign.items()))
    where = f"{', '.join(channels)} of {candidate.fit.recordings[number].name}"
    return worst, f"what it explains is mostly on {where}, where a residual larger than the tool's own wrench remains"


def _foreign_channels(candidate: CandidateModel, number: int) -> tuple[str, ...]:
    slow = SlowResidual.of(candidate.comparisons[number])
    return () if slow is None else tuple(c for c in slow.above_noise if slow.part[c] is Part.FOREIGN)


def _foreign_excess(candidate: CandidateModel, effect: Effect, foreign: dict[int, tuple[str, ...]]) -> float:
    """Log-likelihood ratio of an effect that is foreign or expected of noise, minus that in the other channels.

    In white noise with the variance of each channel's residual.
    """
    smaller = candidate.without(effect.id)
    in_foreign = elsewhere = 0.0
    for number, after in enumerate(candidate.comparisons):
        residuals = (smaller.fit.residuals[number], after.residual)
        before, remains = (np.maximum(r.var(axis=0), 1e-300) for r in residuals)
        explained = np.log(before / remains) * len(after.residual) / 2
        here = np.isin(list(after.space.channel_units), foreign.get(number, ())) & (before <= 2 * remains)
        in_foreign += float(explained[here].sum())
        elsewhere += float(explained[~here].sum())
    coefficients = len(effect.qualified(candidate.fit.model.space))
    return max(in_foreign, float(chi2_isf(LEVELS.effect, coefficients)) / 2) - elsewhere
