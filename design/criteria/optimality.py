"""Optimality criteria of an information matrix: D, D_s, A, E, Bayesian, maximin, and beside what is known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from design.criteria.criterion import Array, Criterion, diagonal_blocks, symbolic_inverse, symbolic_pivots
from modeling.errors import InputError


@dataclass(frozen=True, eq=False)
class ScaledCriterion(Criterion):
    """A criterion of C = Z^-1 M^-1 Z^-1 with Z = diag(scale): the covariance of theta_i / scale_i.

    scale (k,), positive, each in its parameter's unit: errors of that size matter equally. It makes the criterion
    independent of units, and it has to be given: A and E depend on it.
    """

    scale: Array

    def __post_init__(self) -> None:
        scale = np.array(self.scale, dtype=float)
        if scale.ndim != 1 or not (np.isfinite(scale) & (scale > 0)).all():
            raise InputError(
                what="a positive magnitude of each parameter was expected",
                where=f"scale of {self.name}",
                remedy="give for each parameter the size of error that matters equally, in its unit",
            )
        scale.flags.writeable = False
        object.__setattr__(self, "scale", scale)

    def degree(self, size: int) -> float:
        """1: the value is the logarithm of a mean that grows as M."""
        return 1.0

    def _covariance(self, information: Any) -> Any:
        """C as a CasADi expression of M."""
        size = information.shape[0]
        if size != len(self.scale):
            raise ValueError(f"{len(self.scale)} magnitudes were given for an information of {size} parameters")
        return symbolic_inverse(information * np.outer(self.scale, self.scale))


@dataclass(frozen=True, eq=False)
class AOptimal(ScaledCriterion):
    """A-optimality: -ln(tr C / k), C the covariance of theta_i / scale_i.

    The RMS of the k scaled standard errors is exp(-value / 2).

    Parameters
    ----------
    scale : array (k,)
        Positive, in the parameters' units: errors of that size matter equally.

    Raises
    ------
    InputError
        For a scale that is not positive.

    Notes
    -----
    The logarithm, because 1 / tr M^-1 is concave and positively homogeneous (Pukelsheim 1993, 5.2), and the logarithm
    of such a function is concave too: the optimum is that of -tr C, and differences compare with those of D.

    Examples
    --------
    >>> import numpy as np
    >>> import truewrench as tw
    >>> round(tw.AOptimal(scale=[1.0, 2.0]).value(np.diag([4.0, 1.0])), 4)
    1.3863
    """

    name = "-ln mean variance (A)"

    def expression(self, information: Any) -> Any:
        """-ln of the mean variance."""
        return -ca.log(ca.trace(self._covariance(information)) / information.shape[0])


@dataclass(frozen=True, eq=False)
class EOptimal(ScaledCriterion):
    """E-optimality, smooth: -(1/p) ln tr C^p, C the covariance of theta_i / scale_i.

    A lower bound on the logarithm of the information in the least determined direction.

    Parameters
    ----------
    scale : array (k,)
        Positive, in the parameters' units: errors of that size matter equally.
    power : int, optional
        The p above, a power of two, by default 16.

    Raises
    ------
    InputError
        For a scale that is not positive, and a power that is not 2, 4, 8, ...

    Notes
    -----
    The information in the least determined direction is lambda = 1 / largest eigenvalue of C. From max^p <= sum of k
    p-th powers <= k max^p: value <= ln lambda <= value + ln(k) / p. So the value is too low by 0.17 at most for k = 16
    and p = 16 (8 % in standard error); it is infinitely often differentiable where the eigenvalue itself is not. (tr
    M^-p)^(-1/p) is a matrix mean: concave (Pukelsheim 1993, chapter 6). Powers are taken of N = C / tr C, whose
    eigenvalues are at most 1, so that nothing overflows.

    Examples
    --------
    >>> import numpy as np
    >>> import truewrench as tw
    >>> round(tw.EOptimal(scale=[1.0, 1.0]).value(np.diag([4.0, 9.0])), 4)
    1.3863
    """

    power: int = 16

    name = "ln smallest eigenvalue (E)"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.power < 2 or self.power & (self.power - 1):
            raise InputError(
                what=f"the power {self.power} is not 2, 4, 8, ...", where="E criterion", remedy="give a power of two"
            )

    def expression(self, information: Any) -> Any:
        """-(1/p) ln tr C^p = -ln tr C - (1/p) ln tr N^p, by repeated squaring of N."""
        covariance = self._covariance(information)
        total = ca.trace(covariance)
        power = covariance / total
        for _ in range(self.power.bit_length() - 1):
            power = power @ power
        return -ca.log(total) - ca.log(ca.trace(power)) / self.power


@dataclass(frozen=True)
class BayesianCriterion(Criterion):
    """sum_i w_i criterion(M_ii), M_ii the i-th of the m diagonal blocks of M: the expectation over a prior.

    The information of a model that is not linear depends on the parameters. With rows [S(theta_1) .. S(theta_m)] of
    sensitivities (`Experiment.prior`) the blocks are M(theta_i), and this is E[criterion(M(theta))] for a prior with
    weights w_i (Chaloner and Verdinelli 1995, section 4.2): concave and monotone in M, as the criterion is in a block.
    """

    criterion: Criterion
    weights: tuple[float, ...]

    name = "Bayesian"

    def __post_init__(self) -> None:
        if not self.weights or min(self.weights) <= 0 or abs(sum(self.weights) - 1) > 1e-9:  # rounding of decimals
            raise InputError(
                what=f"the weights {self.weights} are not positive numbers that add up to 1",
                where="prior",
                remedy="leave out sets of no weight and divide the others by their sum",
            )

    def blocks(self, information: Any) -> list[Any]:
        """The m blocks; ValueError when M has not as many."""
        return diagonal_blocks(information, [information.shape[0] // len(self.weights)] * len(self.weights))

    def expression(self, information: Any) -> Any:
        """The mean of the blocks' expressions."""
        blocks = zip(self.weights, self.blocks(information), strict=True)
        return sum(w * self.criterion.expression(block) for w, block in blocks)

    def degree(self, size: int) -> float:
        """The degree of the criterion of one block."""
        return self.criterion.degree(size // len(self.weights))

    def __str__(self) -> str:
        return f"Bayesian {self.criterion} over {len(self.weights)} sets of parameter values"


@dataclass(frozen=True)
class MaximinCriterion(Criterion):
    """-(1/p) ln sum_i exp(-p criterion_i(M_ii)), p = `power`, M_ii the diagonal blocks of M: a smooth minimum.

    Block i has sizes[i] rows. From max <= sum of m <= m max: value <= smallest <= value + ln(m) / p, so that the value
    is a lower bound (0.09 less at most for 4 blocks and p = 16: a lambda 8 % smaller). It is concave and
    monotone in M as its members are, because the logarithm of a sum of exponentials is convex and monotone (Boyd and
    Vandenberghe 2004, section 3.1.5), and grows with ln M as they do when they all have one degree.
    """

    criteria: tuple[Criterion, ...]
    sizes: tuple[int, ...]
    power: float = 16.0

    name = "maximin"

    def __post_init__(self) -> None:
        if not self.criteria or len(self.criteria) != len(self.sizes) or min(self.sizes) < 1 or self.power <= 0:
            raise InputError(
                what=f"{len(self.criteria)} criteria of blocks of {self.sizes} rows, power {self.power}",
                where="maximin criterion",
                remedy="give each criterion the number of rows of its block, and a power above zero",
            )

    def blocks(self, information: Any) -> list[Any]:
        """A block for each criterion; ValueError when M is not of their rows."""
        return diagonal_blocks(information, self.sizes)

    def expression(self, information: Any) -> Any:
        """The smooth minimum, with the smallest factored out of the sum so that nothing overflows."""
        members = zip(self.criteria, self.blocks(information), strict=True)
        values = ca.vertcat(*[criterion.expression(block) for criterion, block in members])
        least = ca.mmin(values)
        return least - ca.log(ca.sum1(ca.exp(-self.power * (values - least)))) / self.power

    def degree(self, size: int) -> float:
        """The degree of the members; ValueError unless they agree."""
        degrees = {c.degree(rows) for c, rows in zip(self.criteria, self.sizes, strict=True)}
        if len(degrees) > 1:
            raise ValueError(f"members of one degree were expected, and {sorted(degrees)} came")
        return degrees.pop()

    def __str__(self) -> str:
        return f"maximin of {len(self.criteria)} x {self.criteria[0]}"


@dataclass(frozen=True, eq=False)
class Beside(Criterion):
    """criterion(r M_kk + P): of r runs of a trajectory beside the information P (k, k) that is already gathered.

    kept  indices in M of the k parameters; the others are fixed

    Concave and monotone in M, as the criterion is. The degree is the criterion's, which holds where P is small: a
    search over fewer samples gives P too much weight, its refinement over all does not.
    """

    criterion: Criterion
    kept: tuple[int, ...]
    gathered: Array
    runs: int = 1

    name = "beside what is known"

    def blocks(self, information: Any) -> list[Any]:
        """The sum."""
        index = list(self.kept)
        block = information[np.ix_(index, index)] if isinstance(information, np.ndarray) else information[index, index]
        return [self.runs * block + self.gathered]

    def expression(self, information: Any) -> Any:
        """The criterion of the sum."""
        return self.criterion.expression(self.blocks(information)[0])

    def degree(self, size: int) -> float:
        """The criterion's."""
        return self.criterion.degree(len(self.kept))

    def __str__(self) -> str:
        return f"{self.criterion} {self.name}"


@dataclass(frozen=True)
class DOptimal(Criterion):
    """D-optimality: ln det M, M the information on all k parameters.

    The volume of their confidence ellipsoid is exp(-value / 2) times a constant.

    Notes
    -----
    A change of parameters theta = A eta adds 2 ln |det A| to every design alike, so that neither units nor the choice
    of parameters matters. The efficiency of a design is exp((value - best) / k). Gradient M^-1.

    Examples
    --------
    >>> import numpy as np
    >>> import truewrench as tw
    >>> round(tw.DOptimal().value(np.diag([4.0, 1.0])), 4)
    1.3863
    """

    name = "ln det M"

    def expression(self, information: Any) -> Any:
        """Sum of the logarithms of the pivots."""
        return ca.sum1(ca.log(symbolic_pivots(information)[1]))

    def degree(self, size: int) -> float:
        """k: det(c M) = c^k det M."""
        return float(size)


@dataclass(frozen=True)
class Subset(Criterion):
    """Ds-optimality: ln det of the information on some parameters with all others free.

    Parameters
    ----------
    indices : tuple of int
        Positions, from 0, of the s parameters of interest; all others are nuisance parameters.

    Raises
    ------
    InputError
        When there is no position, or one is negative or given twice.

    Notes
    -----
    ln det M - ln det M_nn = ln det of the Schur complement M_ss - M_sn M_nn^-1 M_ns, n the nuisance parameters
    (Atkinson, Donev and Tobias 2007, section 10.3). It is invariant, up to a constant, under regular linear maps of the
    nuisance parameters and of the parameters of interest among themselves. Gradient M^-1 - diag(0, M_nn^-1).

    Examples
    --------
    >>> import numpy as np
    >>> import truewrench as tw
    >>> round(tw.Subset(indices=(0,)).value(np.array([[4.0, 1.0], [1.0, 1.0]])), 4)
    1.0986
    """

    indices: tuple[int, ...]

    name = "ln det of a subset (D_s)"

    def __post_init__(self) -> None:
        if not self.indices or len(set(self.indices)) < len(self.indices) or min(self.indices) < 0:
            raise InputError(
                what=f"{self.indices} are not indices of different parameters",
                where="subset",
                remedy="give at least one index, from 0, and each once",
            )

    def expression(self, information: Any) -> Any:
        """Sum of the logarithms of the last s pivots."""
        order = self._order(information.shape[0])
        pivots = symbolic_pivots(information[order, order])[1]
        return ca.sum1(ca.log(pivots[-len(self.indices) :, 0]))

    def degree(self, size: int) -> float:
        """The number s of parameters of interest."""
        return float(len(self.indices))

    def _order(self, size: int) -> list[int]:
        """The nuisance parameters, then those of interest."""
        if max(self.indices) >= size:
            raise ValueError(f"indices below {size} were expected, and {max(self.indices)} came")
        return [i for i in range(size) if i not in self.indices] + list(self.indices)
