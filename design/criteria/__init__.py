"""Optimality criteria of an information matrix: D, A, E, D_s, Bayesian, maximin, and beside what is known."""

from __future__ import annotations

from design.criteria.criterion import Criterion
from design.criteria.optimality import AOptimal, BayesianCriterion, Beside, DOptimal, EOptimal, MaximinCriterion, Subset

__all__ = ["AOptimal", "BayesianCriterion", "Beside", "Criterion", "DOptimal", "EOptimal", "MaximinCriterion", "Subset"]
