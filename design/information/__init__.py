"""Fisher information of a model's parameters along a trajectory."""

from __future__ import annotations

from design.information.experiment import Experiment, noise_equivalent_sizes, unidentifiable_combinations
from design.information.sample_information import DiscretePrior
from design.information.sensitivities import Sampling, SensitivityTerm, prediction_terms, sensitivity_terms

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
