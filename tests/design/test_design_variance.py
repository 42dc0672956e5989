"""Estimates along a designed motion scatter as its information promised: a small, seeded `benchmarks.design_variance`.

Every random test is seeded, so that it fails always or never; the probabilities are those of another seed's failing.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.stats import chi2

from benchmarks.design_variance import NAMES, compared, promised, report, silent
from benchmarks.rivals import finite_differences
from benchmarks.rivals.reference import LIMITS, SAMPLES
from benchmarks.rivals.unoptimised import chapter_optimum
from benchmarks.scatter import Scatter
from design.limits import LimitUse
from design.trajectories.trajectory import Trajectory
from estimation.recordings.recording import Recording

DRAWS = 60
CERTAIN = 1e-4
"""The share of other seeds with which one of these tests fails, for each comparison."""


@cache
def good() -> Trajectory:
    """A motion much better than x_opt: that of a short search, made to keep its limits."""
    found = finite_differences.penalised(0, 15_000).motion
    assert found is not None
    return found.scaled(1 / LimitUse.of(found, LIMITS).worst.use)


@cache
def scatters() -> tuple[Scatter, Scatter]:
    good_one, chapter = compared({"good": good(), "x_opt": chapter_optimum()}, draws=DRAWS, seed=3)
    return good_one, chapter


@pytest.mark.parametrize("place", [0, 1], ids=["good", "x_opt"])
def test_scatter_is_that_promised(place: int) -> None:
    """Chi-square of n - 1 for each parameter (1 in 1e4 for each) and of (n - 1) k for all of them (1 in 1e4)."""
    scatter = scatters()[place]
    for size, freedom in ((scatter.variance, scatter.freedom), (scatter.trace, scatter.freedom * len(NAMES))):
        low, high = (float(chi2.ppf(tail, freedom)) / freedom for tail in (CERTAIN / 2, 1 - CERTAIN / 2))
        assert (np.asarray(size) > low).all()
        assert (np.asarray(size) < high).all()


@pytest.mark.parametrize("place", [0, 1], ids=["good", "x_opt"])
def test_estimates_are_not_off(place: int) -> None:
    """n d' M d is chi-square of k for the mean error d: 1 in 1e4."""
    scatter = scatters()[place]
    off = scatter.theta.mean(axis=0) - (15.0, 0.25, -1.33, 0.9, 0.063, 0.0129)
    assert DRAWS * off @ scatter.information @ off < chi2.isf(CERTAIN, len(NAMES))


def test_better_design_is_better_in_estimates() -> None:
    """ln det of a scatter has the variance sum_i psi'((n - i) / 2) = 0.21, the difference of two a std of 0.65: five
    of them, which the difference exceeds, are 1 in 1e6. A ratio of variances of the tool's parameters falls below a
    third of the promised one 1 in 5e4 times (F of n - 1, n - 1) for each of three.
    """
    better, chapter = scatters()
    promise = np.linalg.slogdet(better.information)[1] - np.linalg.slogdet(chapter.information)[1]
    gained = np.linalg.slogdet(chapter.measured)[1] - np.linalg.slogdet(better.measured)[1]
    assert promise > 4
    assert gained == pytest.approx(promise, abs=5 * 0.65)
    ratio = np.diag(chapter.measured) / np.diag(better.measured)
    assert (ratio[3:] > np.diag(chapter.promise)[3:] / np.diag(better.promise)[3:] / 3).all()
    assert (np.diag(chapter.promise) > np.diag(better.promise))[3:].all()


def test_intervals_of_the_summaries_hold_their_share() -> None:
    """Normal estimates with a covariance that is known: 95 % of 400 lie inside; fewer than 363 or more than 394 do so
    1 in 1000 times for each of the three."""
    rng = np.random.default_rng(1)
    root = np.tril(rng.standard_normal((6, 6))) + 3 * np.eye(6)
    inside = np.zeros(3)
    for _ in range(400):
        s = Scatter("", rng.standard_normal((30, 6)) @ np.linalg.inv(root), root @ root.T)
        for i, (value, (low, high)) in enumerate(
            ((s.variance[0], s.variance_interval), (s.trace, s.trace_interval), (s.logdet, s.logdet_interval))
        ):
            inside[i] += low < value < high
    assert (inside > 362).all()
    assert (inside < 395).all()


def test_information_promised_is_that_of_the_motion_that_was_simulated() -> None:
    """The recording's own signals, from angles that were read and differentiated, give the regressor's M."""
    recording: Recording = silent(good())
    assert recording.samples == SAMPLES
    from estimation.model_response import model_response
    from modeling.chain.model import planar

    rows = model_response(planar(), recording, np.zeros(6)).derivative.reshape(-1, 6) / 0.1
    own = rows.T @ rows
    scale = np.sqrt(np.outer(np.diag(own), np.diag(own)))
    # resolver steps of 7.4e-6 rad, twice differentiated at harmonics up to 5 (6.3 rad/s), over 0.5 rad of motion
    np.testing.assert_allclose(promised(good()) / scale, own / scale, rtol=0, atol=1e-3)


def test_report_shows_every_motion_and_parameter() -> None:
    text = report(scatters())
    assert all(name in text for name in (*NAMES, "good", "x_opt"))
