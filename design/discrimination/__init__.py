"""Model discrimination: T-optimal trajectories for rival models."""

from __future__ import annotations

from design.discrimination.discriminating_trajectory import (
    DesignSetting,
    DiscriminationDesign,
    ExchangeRound,
    discriminate,
)
from design.discrimination.model_pair import (
    DirectedPair,
    Hypothesis,
    ModelPair,
    RivalAlongTrajectories,
    Separability,
    Separation,
    WhitenedPrediction,
    rival_models,
    with_effect_replaced,
)
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
