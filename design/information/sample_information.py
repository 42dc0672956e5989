"""Contribution of each sample to the information, in total and by parameter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modeling.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class SampleInformation:
    """The share of each sample in the information of a trajectory.

    names         of the k parameters
    total         (N,) tr(M^-1 S_t' S_t): the variance function of the equivalence theorem; sums to k
    by_parameter  (N, k) the share of each sample in the variance of each estimate; every column sums to one
    """

    names: tuple[str, ...]
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
        return cls(names=tuple(names), total=total, by_parameter=power / power.sum(axis=0))
