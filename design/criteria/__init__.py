"""Optimality criteria of an information matrix: D, A, E, D_s, Bayesian and maximin."""

from __future__ import annotations

from design.criteria.a_optimal import AOptimal
from design.criteria.bayesian import BayesianCriterion
from design.criteria.criterion import Criterion
from design.criteria.d_optimal import DOptimal
from design.criteria.ds_optimal import Subset
from design.criteria.e_optimal import EOptimal
from design.criteria.maximin import MaximinCriterion

__all__ = ["AOptimal", "BayesianCriterion", "Criterion", "DOptimal", "EOptimal", "MaximinCriterion", "Subset"]
