"""Prior: a reference tool, from CAD or an earlier fit, with its weight."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import isfinite
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from estimation.least_squares.bounds import is_real_number, read_parameter_file, require_known_names
from modeling.chain.pseudo_inertia import PseudoInertia
from modeling.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LogDetDivergence:
    """weight · D(J || J_0), the Bregman divergence of -log det, as a term of the chi-square.

    With J_0 = L L' and the tool in whitened coordinates, X = L^-1 J L^-T,

        D = tr(X) - log det X - n,    0 at J = J_0, infinite at the boundary of physical consistency.

    It is twice the relative entropy of the normal distribution of covariance J to that of J_0. A change of units or of
    frame, J to T J T', leaves the eigenvalues of X unchanged, and so D. For X = 1 + E it is sum_ij E_ij² / 2 to second
    order: a relative std of sqrt(2 / weight) of each of the whitened moments.
    Wensing, Kim, Slotine (2018); Lee, Wensing, Park, "Geometric robot dynamic identification: a convex programming
    approach" (IEEE Transactions on Robotics 36, 2020).

    reference  J_0 (n, n), positive definite
    """

    inertia: PseudoInertia
    reference: Array
    weight: float

    @cached_property
    def whitening(self) -> Array:
        """L^-1 (n, n)."""
        return np.asarray(np.linalg.inv(np.linalg.cholesky(self.reference)))

    def whitened(self, matrix: Array) -> Array:
        """L^-1 (.) L^-T of one matrix (n, n) or several (k, n, n)."""
        return np.asarray(self.whitening @ matrix @ self.whitening.T)

    def value(self, theta: Array) -> float:
        """weight · D at the parameters theta (k,); infinite where J is not positive definite."""
        eigenvalues = np.linalg.eigvalsh(self.whitened(self.inertia.at(theta)))
        if eigenvalues.min() <= 0:
            return np.inf
        excess = eigenvalues - 1
        return float(self.weight * np.sum(excess - np.log1p(excess)))

    def rows(self, theta: Array) -> tuple[Array, Array]:
        """F (n², k) and e (n²,) with weight · D(theta + d) = |F d - e|² + constant to second order in d.

        The gradient of D is <1 - X^-1, X_i> and its Hessian <X^-1/2 X_i X^-1/2, X^-1/2 X_j X^-1/2>, X_i the whitened
        slopes: F_i = sqrt(weight/2) X^-1/2 X_i X^-1/2 and e = sqrt(weight/2) (1 - X) give both.
        """
        eigenvalues, vectors = np.linalg.eigh(self.whitened(self.inertia.at(theta)))
        half = vectors / np.sqrt(eigenvalues) @ vectors.T
        columns = half @ self.whitened(self.inertia.slopes) @ half
        target = np.eye(len(half)) - vectors * eigenvalues @ vectors.T
        factor = np.sqrt(self.weight / 2)
        return factor * columns.reshape(len(columns), -1).T, factor * target.ravel()


@dataclass(frozen=True)
class Prior:
    """The moments of a reference tool, and the weight of its divergence in the chi-square.

    `read` takes them from a TOML file, `from_data` from a dictionary of its layout.

    Parameters
    ----------
    values : mapping of str to float
        Every moment of the reference tool by parameter name, in SI units: `m`, `mlg`, `I` in the plane.
    weight : float
        A precision: the reference counts like an independent measurement of each of the tool's principal moments with a
        relative standard deviation of sqrt(2 / weight): 200 for 10 %, 20 000 for 1 %; 0 disables it.
    where : str, optional
        Their source in an InputError, by default "prior".

    Examples
    --------
    >>> import truewrench as tw
    >>> rig = tw.Rig.read("rig.toml")
    >>> model = tw.planar(rig) + tw.effects.named("viscous_drag")
    >>> prior = tw.Prior({"m": 0.9, "mlg": 0.063, "I": 0.0129}, weight=200)
    >>> fit = tw.fit(model, tw.read("train.csv", rig=rig), constraints=tw.Constraints(prior=prior))
    >>> round(fit.values["I"], 4)
    0.0129
    """

    values: Mapping[str, float]
    weight: float
    where: str = "prior"

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """The prior of a TOML file: `weight = 200`, and the reference as `m = 0.9`, `mlg = 0.063`, `I = 0.0129`.

        Raises InputError, in one line with file and key, for a value that is not a finite number.
        """
        return cls.from_data(read_parameter_file(path), where=str(path))

    @classmethod
    def from_data(cls, data: Mapping[str, object], *, where: str = "prior") -> Self:
        """The prior of a plain dictionary with the file's layout."""
        numbers = {name: _number(name, value, where) for name, value in data.items()}
        if "weight" not in numbers:
            remedy = "add weight = 200 for a relative std of 10 % of the reference, 20000 for 1 %"
            raise InputError(what="weight is missing", where=where, remedy=remedy)
        weight = numbers.pop("weight")
        if weight < 0:
            raise InputError(what=f"weight: {weight:g} is negative", where=where, remedy="give 0 or more")
        return cls(numbers, weight, where)

    def divergence(self, inertia: PseudoInertia, names: Sequence[str]) -> LogDetDivergence:
        """The term that this prior adds to the chi-square, over all parameters `names`.

        Raises InputError when a moment of the tool is missing, a name is not a moment, or the moments are not
        physically consistent.
        """
        require_known_names(self.values, inertia.names, self.where)
        missing = [name for name in inertia.names if name not in self.values]
        if missing:
            remedy = "give every moment of the reference tool"
            raise InputError(what=f"{missing[0]} is missing", where=self.where, remedy=remedy)
        reference = inertia.at(np.array([self.values[name] for name in inertia.names]))
        scale = np.sqrt(np.maximum(np.abs(np.diag(reference)), 1e-300))
        if np.linalg.eigvalsh(reference / np.outer(scale, scale)).min() <= 0:
            what = f"no tool has these moments: {inertia.condition} does not hold strictly"
            raise InputError(
                what=what, where=self.where, remedy="give the moments of a tool with positive mass and extent"
            )
        return LogDetDivergence(inertia.over(names), reference, self.weight)


def _number(name: str, value: object, where: str) -> float:
    if not is_real_number(value) or not isfinite(float(value)):  # type: ignore[arg-type]
        remedy = "write name = value, in the parameter's SI unit"
        raise InputError(what=f"{name}: a number was expected, and {value!r:.60} came", where=where, remedy=remedy)
    return float(value)  # type: ignore[arg-type]
