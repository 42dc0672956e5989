"""Information: what readings along a motion say of a model's parameters."""

from __future__ import annotations

from design.information.experiment import Experiment
from design.information.noise import ColouredNoise, SensorNoise, WhiteNoise
from design.information.prior import Prior
from design.information.probe import magnitudes
from design.information.sampling import Sampling
from design.information.term import Term, prediction_terms, sensitivity_terms
from design.information.unseen import UnseenCombination, unseen

__all__ = [
    "ColouredNoise",
    "Experiment",
    "Prior",
    "Sampling",
    "SensorNoise",
    "Term",
    "UnseenCombination",
    "WhiteNoise",
    "magnitudes",
    "prediction_terms",
    "sensitivity_terms",
    "unseen",
]
