"""Model discrimination: T-optimal trajectories for rival models."""

from __future__ import annotations

from design.discrimination.design_setting import DesignSetting
from design.discrimination.directed_pair import DirectedPair
from design.discrimination.discriminating_trajectory import discriminate
from design.discrimination.discrimination_design import DiscriminationDesign
from design.discrimination.exchange_algorithm import ExchangeRound
from design.discrimination.hypothesis import Hypothesis, rival_models, with_effect_replaced
from design.discrimination.model_pair import ModelPair, Separability, Separation
from design.discrimination.rival_along_trajectories import RivalAlongTrajectories
from design.discrimination.whitened_prediction import WhitenedPrediction
from modeling.rival_fit import RivalFit, fit_rival

__all__ = [
    "DesignSetting",
    "DirectedPair",
    "DiscriminationDesign",
    "ExchangeRound",
    "Hypothesis",
    "ModelPair",
    "RivalAlongTrajectories",
    "RivalFit",
    "Separability",
    "Separation",
    "WhitenedPrediction",
    "discriminate",
    "fit_rival",
    "rival_models",
    "with_effect_replaced",
]
