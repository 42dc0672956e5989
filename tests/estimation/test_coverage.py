"""Intervals hold the truth as often as they say: a small `benchmarks.coverage`, and the arithmetic of its intervals.

Every random test is seeded, so that it fails always or never; the probabilities are those of another seed's failing.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cache
from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import polygamma
from scipy.stats import binomtest, norm, t

from benchmarks.coverage import NOISES, Coverage, LeastSquares, Setting, Silence, covered, share_interval
from estimation.case import Case
from estimation.confidence_intervals import (
    MAX_DEGREES_OF_FREEDOM,
    MIN_DEGREES_OF_FREEDOM,
    Intervals,
    degrees_of_freedom_of,
    intervals,
)
from estimation.fit import fit, unchecked_fit
from estimation.recordings.recording import Recording
from modeling.chain.model import planar
from truewrench.simulated_rig import ViscousDrag

Array = NDArray[np.float64]

SMALL = {
    "3 repeats": (Setting(repeats=3, samples=60), "white"),
    "single run": (Setting(repeats=1, samples=200), "AR 0.95"),
    "single run, std stated": (Setting(repeats=1, samples=200, stated=True), "AR 0.95"),
    "8 poses": (Setting(repeats=1, samples=8, rest=True), "white"),
}
DRAWS = 40


@dataclass(frozen=True)
class Kept(LeastSquares):
    """Least squares that keep the intervals of every draw."""

    found: list[Intervals] = field(default_factory=list)

    def __call__(self, setting: Setting, recording: Recording) -> tuple[Intervals, Array]:
        found, std = super().__call__(setting, recording)
        self.found.append(found)
        return found, std


@cache
def study(name: str) -> tuple[dict[str, Coverage], list[Intervals]]:
    """Coverage of every kind of parameter, and the intervals that it comes from."""
    (setting, noise), kept = SMALL[name], Kept()
    return {c.kind: c for c in covered(name, setting, NOISES[noise], kept, range(DRAWS))}, kept.found


@pytest.mark.parametrize("name", SMALL)
def test_intervals_hold_the_truth(name: str) -> None:
    """Of 40 draws 5 % miss, 2: 9 or more are 2 in 1e4 for one kind of parameter, 1 in 450 for all of the table's;
    biases are three that may miss together, on average over the three no more often than one."""
    for kind, found in study(name)[0].items():
        missed = (~found.student).mean(axis=1).sum()
        assert missed < 9, (kind, missed)


@pytest.mark.long(8)
@pytest.mark.parametrize("repeats", [2, 6])
def test_intervals_of_repeats_behind_a_filter_hold_the_truth(repeats: int) -> None:
    """Of order 8. Of 30 draws 5 % miss, 1.5: 8 or more are 2 in 1e4 for one kind of parameter."""
    for kind in covered("", Setting(repeats=repeats, samples=250), NOISES["order 8"], LeastSquares(), range(30)):
        missed = (~kind.student).mean(axis=1).sum()
        assert missed < 8, (kind.kind, missed)


def test_normal_intervals_of_few_poses_do_not() -> None:
    """Student's quantile with 5 degrees of freedom is 2.57: errors between 1.96 and that are one in 16, of 40 draws
    and three kinds 7; none at all is 1 in 1000."""
    found = study("8 poses")[0].values()
    assert all((c.normal <= c.student).all() for c in found)
    assert sum(float((~c.normal).mean()) for c in found) > sum(float((~c.student).mean()) for c in found)


def test_they_are_not_merely_wide() -> None:
    """A 50 % interval misses half of 40 masses, 20 ± 3.2: fewer than 8 or more than 32 are 2 in 1e5."""
    (setting, _), found = SMALL["single run"], study("single run")[1]
    mass = [p.name for p in found[0].fit.unknowns].index("m")
    half = [replace(own, level=0.5) for own in found]
    missed = sum(not own.low[mass] <= setting.truth["m"] <= own.high[mass] for own in half)
    assert 8 <= missed <= 32


# ---------------------------------------------------------------------------------------- arithmetic


@pytest.mark.parametrize("freedom", [2.5, 7.0, 100.0])
def test_freedom_is_that_of_a_chi_square_with_that_doubt(freedom: float) -> None:
    assert degrees_of_freedom_of(float(polygamma(1, freedom / 2))) == pytest.approx(freedom, rel=1e-9)  # brentq's


def test_freedom_ends() -> None:
    assert degrees_of_freedom_of(0.0) == MAX_DEGREES_OF_FREEDOM
    assert degrees_of_freedom_of(1e-9) == MAX_DEGREES_OF_FREEDOM
    assert degrees_of_freedom_of(50.0) == MIN_DEGREES_OF_FREEDOM
    assert t.ppf(0.975, MAX_DEGREES_OF_FREEDOM) == pytest.approx(norm.ppf(0.975), abs=3e-4)


def test_poses_of_a_stated_std_take_the_normal_quantile() -> None:
    setting = Setting(repeats=1, samples=24, rest=True, stated=True)
    found = intervals(fit(planar(), setting.drawn(NOISES["white"], 1)))
    seen = found.fit.identifiable
    np.testing.assert_allclose(found.std[seen], np.sqrt(np.diag(found.fit.covariance))[seen], rtol=1e-8)
    np.testing.assert_allclose(found.freedom[seen], MAX_DEGREES_OF_FREEDOM)
    np.testing.assert_allclose(((found.high - found.low) / 2 / found.std)[seen], 1.96, atol=1e-3)


def test_a_stated_std_leaves_the_colour_to_the_readings() -> None:
    """About as wide as where nothing is stated: a std says nothing of colour, and white weights alone make biases six
    times too certain."""
    std, white = {}, np.zeros(0)
    for stated, noise in product((True, False), ("white", "AR 0.95")):
        recording = Setting(repeats=1, samples=600, stated=stated).drawn(NOISES[noise], 1)
        std[stated, noise] = fit(planar(), recording).intervals().std
        if (stated, noise) == (True, "white"):
            white = np.sqrt(np.diag(unchecked_fit(Case.of(planar(), [recording])).covariance))
    assert (std[True, "white"] <= 1.15 * np.maximum(white, std[False, "white"])).all()
    ratio = std[True, "AR 0.95"] / std[False, "AR 0.95"]
    assert ratio.min() > 0.5
    assert ratio.max() < 2
    assert (std[True, "AR 0.95"][:3] > 3 * std[True, "white"][:3]).all()  # of a mean, sqrt((1 + rho) / (1 - rho)) = 6


@pytest.mark.parametrize("way", ["alone", "bounded", "noise given"])
def test_std_and_intervals_are_the_same_however_it_was_fitted(way: str) -> None:
    """A bound that does not bind, or the noise of another fit, makes nothing more certain."""
    recording = Setting(repeats=1, samples=400, stated=True).drawn(NOISES["AR 0.95"], 1)
    alone = fit(planar(), recording)
    noise, bounds = (alone.noise if way == "noise given" else None), ({"m": (0, 5)} if way == "bounded" else None)
    found = fit(planar(), recording, noise=noise, constraints=bounds)
    np.testing.assert_allclose(found.intervals().std, np.sqrt(np.diag(found.covariance)), rtol=1e-6)
    np.testing.assert_allclose(found.intervals().std, alone.intervals().std, rtol=1e-3)


def test_no_interval_of_a_stated_std_is_narrower_than_of_white_noise() -> None:
    """In few lines a spectrum may come out low by chance where a bias is, or as that of a channel that is silent."""
    setting = Setting(repeats=1, samples=30, stated=True)
    for seed in range(20):
        recording = setting.drawn(NOISES["white"] if seed else Silence(), seed)
        found = fit(planar(), recording)
        white = np.sqrt(np.diag(unchecked_fit(Case.of(planar(), [recording])).covariance))
        assert (found.intervals().std >= (1 - 1e-6) * white).all()


def test_a_stated_std_holds_for_what_is_missing() -> None:
    """A drag that the model lacks is in the residual, and so in the intervals: above the size of the noise by far."""
    setting = Setting(repeats=1, samples=600, stated=True, hidden=(ViscousDrag(),))
    found = fit(planar(), setting.drawn(NOISES["white"], 1))
    plain = fit(planar(), replace(setting, hidden=()).drawn(NOISES["white"], 1))
    assert found.reduced_chi_square is not None
    assert found.reduced_chi_square > 2
    assert (found.intervals().std > 1.2 * plain.intervals().std).all()


def test_repeats_count_the_error_of_their_weights() -> None:
    """They are whitened by a spectrum from other lines, whose doubt alone is added: more repeats, more freedom, and std
    nearer those of known weights. The fit tells the same std as its intervals."""
    fits = [fit(planar(), Setting(repeats=r, samples=60).drawn(NOISES["white"], 1)) for r in (3, 12)]
    few, many = (each.intervals() for each in fits)
    np.testing.assert_allclose(few.std, np.sqrt(np.diag(fits[0].covariance)), rtol=1e-6)
    assert (few.freedom[3:] < many.freedom[3:]).all()
    assert (few.freedom >= MIN_DEGREES_OF_FREEDOM).all()
    of_few, of_many = (own.std / np.sqrt(np.diag(own.fit.covariance)) for own in (few, many))
    assert (of_few >= 1 - 1e-9).all()  # rounding
    assert (of_many[3:] < of_few[3:]).all()


def test_poses_have_the_freedom_of_their_readings() -> None:
    """24 poses of three channels have 72 readings less 5 unknowns, a third of them for each channel's noise; the noise
    counts its own parameters instead, six of 72: half as many degrees of freedom as a channel's 22, never more."""
    setting = Setting(repeats=1, samples=24, rest=True)
    found = intervals(fit(planar(), setting.drawn(NOISES["white"], 1)))
    assert (found.freedom[found.fit.identifiable] < 23).all()
    assert (found.freedom[found.fit.identifiable] > 10).all()


def test_a_rising_spectrum_below_the_autoregression_widens() -> None:
    """1/f noise of a single run, half of whose power at the slowest lines no autoregression of this length follows."""
    setting = Setting(repeats=1, samples=600)
    wider = []
    for seed in range(3):
        found = intervals(fit(planar(), setting.drawn(NOISES["1/f and lines"], seed)))
        wider.append((found.std / np.sqrt(np.diag(found.fit.covariance)))[3:])
    # Measured over 150 draws: errors are 1.6 to 2.1 times what the autoregression alone says.
    assert np.median(wider) > 1.3


def test_shares_of_single_parameters_have_wilsons_interval() -> None:
    for hits, draws in ((57, 60), (30, 40), (100, 100)):
        column = np.arange(draws)[:, None] < hits
        expected = binomtest(hits, draws).proportion_ci(0.95, method="wilson")
        np.testing.assert_allclose(share_interval(column), (expected.low, expected.high), atol=1e-6)


def test_parameters_that_miss_together_count_once() -> None:
    column = np.random.default_rng(0).random((200, 1)) < 0.9
    together, apart = np.repeat(column, 3, axis=1), np.random.default_rng(1).random((200, 3)) < 0.9
    np.testing.assert_allclose(share_interval(together), share_interval(column), rtol=0.02)  # (n - 1) / n of a variance
    assert np.ptp(share_interval(apart)) < 0.8 * np.ptp(share_interval(column))


def test_intervals_print_every_unknown() -> None:
    found = intervals(fit(planar(), SMALL["single run"][0].drawn(NOISES["white"], 1)))
    lines = str(found).splitlines()
    assert [line.split()[0] for line in lines[1:]] == [p.name for p in planar().parameters]
    assert "95 % from" in lines[0]
