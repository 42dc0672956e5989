"""Optimality criteria of an information matrix: D, A, E, D_s, Bayesian and maximin."""

from __future__ import annotations

from design.criteria.criterion import Criterion
from design.criteria.optimality import AOptimal, BayesianCriterion, DOptimal, EOptimal, MaximinCriterion, Subset

__all__ = ["AOptimal", "BayesianCriterion", "Criterion", "DOptimal", "EOptimal", "MaximinCriterion", "Subset"]
