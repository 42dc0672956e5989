"""Contribution of each sample to the information, in total and by parameter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from design.information.experiment import ParameterValues, nonlinear_parameters, parameter_vector
from modeling.chain.model import WrenchModel
from modeling.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True)
class DiscretePrior:
    """m sets of values (m, k) of a model's parameters, in its order and units, with weights (m,) that add up to 1.

    An experiment takes the sets (`Experiment.prior`), a criterion the weights (`BayesianCriterion`).
    """

    sets: tuple[Array, ...]
    weights: tuple[float, ...]

    @classmethod
    def around(cls, model: WrenchModel, theta: ParameterValues | Array, covariance: Array) -> Self:
        """2 r sets of equal weight with mean theta and `covariance` (k, k) in the r parameters of the information.

        Those are the parameters that the information depends on. With L L' their covariance the sets are
        theta +- sqrt(r) L_i, which integrates polynomials up to the third degree exactly over a Gaussian (Stroud 1957).
        A value beyond its physical bound is moved to it. One set, theta, where r = 0; InputError where `covariance` is
        not one, or not finite for one of the r parameters.
        """
        centre, which = parameter_vector(model, theta), list(nonlinear_parameters(model))
        block = np.asarray(covariance, dtype=float)[np.ix_(which, which)]
        if not which:
            return cls(sets=(centre,), weights=(1.0,))
        count = 2 * len(which)
        steps = np.zeros((count, len(centre)))
        steps[:, which] = np.sqrt(len(which)) * np.hstack([_root(block), -_root(block)]).T
        low, high = (np.array([p.bounds[side] for p in model.parameters]) for side in (0, 1))
        return cls(sets=tuple(np.clip(centre + steps, low, high)), weights=(1 / count,) * count)


def _root(covariance: Array) -> Array:
    """L with L L' = covariance, which may be singular: std times the root of the correlation, whatever the units."""
    variance = np.diag(covariance)
    if not np.isfinite(covariance).all() or not np.allclose(covariance, covariance.T) or (variance < 0).any():
        raise _unusable("it is not symmetric and finite: a parameter that the information depends on has no variance")
    std = np.sqrt(variance)
    scale = np.where(std > 0, std, 1.0)
    shares, axes = np.linalg.eigh(covariance / scale / scale[:, None])
    if shares.min() < -1e-6:  # a covariance rounded to six digits
        raise _unusable("it is not positive semidefinite")
    return np.asarray(scale[:, None] * axes * np.sqrt(np.maximum(shares, 0.0)))


def _unusable(what: str) -> InputError:
    return InputError(
        what=what, where="prior covariance", remedy="give sets of values instead, or design at nominal ones"
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class SampleInformation:
    """The share of each sample in the information of a trajectory.

    names         of the k parameters
    columns       (N, p, k) the whitened sensitivities
    total         (N,) tr(M^-1 S_t' S_t): the variance function of the equivalence theorem; sums to k
    by_parameter  (N, k) the share of each sample in the variance of each estimate; every column sums to one
    """

    names: tuple[str, ...]
    columns: Array
    total: Array
    by_parameter: Array

    @classmethod
    def of(cls, columns: Array, names: Sequence[str]) -> SampleInformation:
        """From the whitened sensitivities S_t of all samples, `columns` (N, p, k).

        The efficient estimate is theta = M^-1 sum_t S_t' y_t, so that its variances (M^-1)_ii are the sums of
        |S_t M^-1 e_i|² over the samples: their shares are `by_parameter`, none of them negative. With the columns
        stacked, A = Q R: the rows of Q give the total, and A M^-1 = Q R^-T.

        Raises InputError when not all parameters are identifiable along the trajectory.
        """
        samples, _, k = columns.shape
        scale = np.linalg.norm(columns, axis=(0, 1))
        q, r = np.linalg.qr((columns / np.where(scale > 0, scale, 1.0)).reshape(-1, k))
        if np.linalg.svd(r, compute_uv=False)[-1] < k * np.finfo(float).eps:
            what = "not all parameters are identifiable along the trajectory, and its information is singular"
            remedy = "take a more exciting trajectory, or estimate fewer parameters"
            raise InputError(what=what, where="information", remedy=remedy)
        influence = (q @ np.linalg.inv(r).T).reshape(samples, -1, k)
        power = (influence**2).sum(axis=1)
        total = (q.reshape(samples, -1, k) ** 2).sum(axis=(1, 2))
        return cls(names=tuple(names), columns=columns, total=total, by_parameter=power / power.sum(axis=0))

    @cached_property
    def accumulated(self) -> tuple[Array, Array]:
        """(N,), (N,): of the samples up to each, ln det of the information, and the condition of the sensitivities.

        For the condition each column is scaled to norm 1 over all samples, so that no unit matters. Minus infinity, and
        infinity, until all parameters are identifiable.
        """
        scale = np.linalg.norm(self.columns, axis=(0, 1))
        scaled = self.columns / scale
        values = np.linalg.eigvalsh(np.cumsum(np.swapaxes(scaled, 1, 2) @ scaled, axis=0))
        known = values[:, 0] > values.shape[1] * np.finfo(float).eps * values[:, -1]
        least = np.where(known[:, None], values, 1.0)
        logdet = np.log(least).sum(axis=1) + 2 * np.log(scale).sum()
        condition = np.sqrt(least[:, -1] / least[:, 0])
        return np.where(known, logdet, -np.inf), np.where(known, condition, np.inf)
