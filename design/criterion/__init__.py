"""Criteria: what makes one information matrix better than another."""

from __future__ import annotations

from design.criterion.a_optimal import AOptimal
from design.criterion.averaged import Averaged
from design.criterion.criterion import Criterion
from design.criterion.d_optimal import DOptimal
from design.criterion.e_optimal import EOptimal
from design.criterion.smallest import Smallest
from design.criterion.subset import Subset

__all__ = ["AOptimal", "Averaged", "Criterion", "DOptimal", "EOptimal", "Smallest", "Subset"]
