"""Tail probabilities and quantiles of test distributions, by `scipy.special`: it loads ten times as fast as `stats`.

`sf` is the survival function P(X > x), `isf` its inverse, as `scipy.stats` calls them; arrays broadcast.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.special import (
    chdtrc,
    chdtri,
    chndtrinc,
    fdtrc,
    gammainccinv,
    ndtr,
    ndtri,
    stdtr,
    stdtrit,
)

Numbers = Any
"""A number, or an array of them."""


def chi2_sf(statistic: Numbers, freedom: Numbers) -> Numbers:
    """P(X > statistic) of chi-square with `freedom` degrees of freedom."""
    return chdtrc(freedom, statistic)


def chi2_isf(probability: Numbers, freedom: Numbers) -> Numbers:
    """The value that chi-square exceeds with that probability."""
    return chdtri(freedom, probability)


def noncentrality(statistic: Numbers, freedom: Numbers, probability: Numbers) -> Numbers:
    """The noncentrality with which noncentral chi-square exceeds `statistic` with that probability."""
    return chndtrinc(statistic, freedom, 1.0 - probability)


def f_sf(ratio: Numbers, above: Numbers, below: Numbers) -> Numbers:
    """P(X > ratio) of Fisher's F with `above` (numerator) and `below` (denominator) degrees of freedom."""
    return fdtrc(above, below, ratio)


def gamma_isf(probability: Numbers, shape: Numbers) -> Numbers:
    """The value that a Gamma variable of unit scale exceeds with that probability."""
    return gammainccinv(shape, probability)


def normal_cdf(value: Numbers) -> Numbers:
    """P(X < value) of the standard normal."""
    return ndtr(value)


def normal_isf(probability: Numbers) -> Numbers:
    """The value that a standard normal exceeds with that probability."""
    return -ndtri(probability)


def student_sf(value: Numbers, freedom: Numbers) -> Numbers:
    """P(X > value) of Student's t."""
    return stdtr(freedom, -np.asarray(value))


def student_isf(probability: Numbers, freedom: Numbers) -> Numbers:
    """The value that Student's t exceeds with that probability."""
    return -stdtrit(freedom, probability)
