"""Price: what an effect has to bring to be believed, more the more candidates there are to be wrong with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimation.distributions import chi2_isf, chi2_sf, noncentrality
from modeling.model import WrenchModel

Array = NDArray[np.float64]

SIGNIFICANCE = 0.01
POWER = 0.8


def level(candidates: int) -> float:
    """Significance of one candidate effect of so many: 1 % shared out among all that are screened."""
    return SIGNIFICANCE / max(1, candidates)


def price(model: WrenchModel, candidates: int) -> float:
    """What a model's effects have to lower the whitened chi-square by.

    An effect of k parameters costs the quantile of chi-square with k degrees of freedom at 1 % over the number of
    candidates: the price at which screening accepts one.
    """
    return sum(worth(len(e.parameters(model.space)), candidates) for e in model.effects)


def worth(parameters: int, candidates: int) -> float:
    """The drop of chi-square at which so many parameters of one candidate are believed."""
    return float(chi2_isf(level(candidates), parameters))


def detectable_separation(freedom: int, significance: float) -> float:
    """Noncentrality that a chi-square test of this freedom at this significance shows with 80 % power."""
    return float(noncentrality(chi2_isf(significance, freedom), freedom, POWER))


def independent_trials(noise_scores: Array, rank: int) -> float:
    """Number of independent trials that a search over nuisance values amounts to.

    Draws of pure noise give the supremum's own distribution; beyond their reach its tail is taken as that of one
    chi-square times the number of trials that the draws' upper tenth implies.
    """
    high = float(np.quantile(noise_scores, 0.9))
    return max(1.0, 0.1 / max(float(chi2_sf(high, rank)), 1e-12))


def frequencies_tried(score: float, samples: int) -> float:
    """Number of independent trials that a search over all frequencies of a record amounts to.

    The score at frequency f is a chi-square process; the chance that its supremum exceeds a high value u is that of
    one frequency times W sqrt(u / 2), W = sqrt(4 pi) times the band times the spread of the instants (Davies 1987;
    Baluev 2008), here half the sampling rate and n steps / sqrt(12): about n / 2.
    """
    return float(max(1.0, samples / 2 * np.sqrt(np.pi / 3) * np.sqrt(max(score, 2.0) / 2)))
