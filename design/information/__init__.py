"""Fisher information of a model's parameters along a trajectory."""

from __future__ import annotations

from design.information.discrete_prior import DiscretePrior
from design.information.experiment import Experiment
from design.information.random_sensitivities import noise_equivalent_sizes, unidentifiable_combinations
from design.information.sampling import Sampling
from design.information.sensitivity_term import SensitivityTerm, prediction_terms, sensitivity_terms

__all__ = [
    "DiscretePrior",
    "Experiment",
    "Sampling",
    "SensitivityTerm",
    "noise_equivalent_sizes",
    "prediction_terms",
    "sensitivity_terms",
    "unidentifiable_combinations",
]
