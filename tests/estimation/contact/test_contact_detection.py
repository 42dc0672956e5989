"""Contacts found in noise: how often where there is none, how well where there is one."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.linalg import toeplitz

from estimation.contact.contact_detection import (
    BlockMeans,
    ContactDetection,
    ContactSearch,
    MeanDifferences,
    VarianceOfMeans,
    WindowSums,
    detect_contacts,
)
from modeling.noise import NoiseModel
from truewrench.simulated_rig import NOISE_MODELS

Array = NDArray[np.float64]

STEP = 0.01
NOTHING = np.zeros(3)


def noise(kind: str, samples: int, seed: int) -> Array:
    return NOISE_MODELS[kind].draw(np.random.default_rng([seed, samples]), samples, 3)


def found_in(residual: Array, zero: Array | None = None) -> ContactDetection:
    return detect_contacts(residual, STEP, floor=np.ones(3), remainder=NOTHING, zero=zero)


def pushed(kind: str, seed: int, *, size: float, first: int, last: int, half_sine: bool = False) -> Array:
    residual = noise(kind, 2000, seed)
    shape = np.sin(np.linspace(0, np.pi, last - first)) if half_sine else np.ones(last - first)
    residual[first:last, 0] += size * shape
    return residual


@pytest.mark.parametrize("kind", NOISE_MODELS)
def test_false_alarms(kind: str) -> None:
    """Stated as 1 % of records at the most; 3 of 20 would happen in 1 of 1000 times at that rate."""
    alarms = sum(bool(found_in(noise(kind, 600, seed)).intervals) for seed in range(20))
    assert alarms < 3


@pytest.mark.parametrize("kind", ["white", "student_t"])
@pytest.mark.parametrize("half_sine", [False, True])
def test_a_push_is_found_where_it_is(kind: str, half_sine: bool) -> None:
    """Three times the noise over 3.5 s; the edges of a rectangle to 50 ms, a half sine where it is above the noise."""
    (interval,) = found_in(pushed(kind, 1, size=3.0, first=800, last=1150, half_sine=half_sine)).intervals
    slack = 80 if half_sine else 5
    assert 800 - 5 <= interval.first <= 800 + slack
    assert 1150 - slack <= interval.last <= 1150 + 5
    assert interval.p_value < 1e-6


def test_a_push_for_more_than_half_of_the_record_does_not_become_the_zero() -> None:
    """As long as it is not steady: the zero is what most stretches agree on."""
    residual = noise("white", 2000, 3)
    residual[300:1500, 0] += 40 + 20 * np.sin(np.linspace(0, 9, 1200))
    found = found_in(residual)
    (interval,) = found.intervals
    assert abs(interval.first - 300) <= 5
    assert abs(interval.last - 1500) <= 5
    assert np.abs(found.zero).max() < 5 / np.sqrt(800)


def test_one_outlier_is_no_contact() -> None:
    residual = noise("white", 2000, 4)
    residual[700] += 60.0
    assert not found_in(residual).intervals


def test_the_zero_and_its_std() -> None:
    """Of 16 records with AR(.98) noise: the zero's error in units of its std has mean square 1 within 6 errors."""
    shift = np.array([3.0, -2.0, 0.5])
    scores = []
    for seed in range(16):
        found = found_in(noise("autoregressive", 2000, seed) + shift)
        scores.append((found.zero - shift) / np.sqrt(np.diag(found.zero_covariance)))
    square = float((np.array(scores) ** 2).mean())
    assert 0.3 < square < 1 + 6 * np.sqrt(2 / 48)


def test_a_given_zero_is_kept() -> None:
    """Twice the noise's std over the whole record is then a contact, which a free zero would have swallowed."""
    residual = noise("white", 2000, 5) + np.array([2.0, 0, 0])
    assert not found_in(residual).intervals
    (interval,) = found_in(residual, zero=NOTHING).intervals
    assert interval.last - interval.first > 1500  # of 2000; the longest window is half of the record


def test_what_the_model_is_known_to_miss_is_no_contact() -> None:
    residual = pushed("white", 6, size=2.0, first=800, last=1300)
    assert found_in(residual).intervals
    assert not detect_contacts(residual, STEP, floor=np.ones(3), remainder=np.array([2.0, 0, 0])).intervals


@pytest.mark.parametrize("coefficient", [0.0, 0.9, -0.5])
def test_variance_of_means_of_an_autoregression(coefficient: float) -> None:
    """Against the sum over the whole covariance matrix, to the tail that the grid leaves out."""
    covariance = toeplitz(coefficient ** np.arange(300) / (1 - coefficient**2))
    noise = NoiseModel(np.diag([1.0, 4.0]), np.full((1, 2), coefficient))
    found = VarianceOfMeans.of_autoregression(noise, 300, np.zeros(2))
    for length in (1, 2, 17, 300):
        exact = covariance[:length, :length].sum() / length**2
        assert found.variance[length - 1] == pytest.approx([exact, 4 * exact], rel=1e-9)


@pytest.mark.parametrize("robust", [False, True])
def test_variance_of_means_from_differences(robust: bool) -> None:
    """White noise of 50 000 samples: means over up to 100 are known to 15 % (quartile: 30 %), a 6 sigma bound."""
    series = np.random.default_rng(7).standard_normal((50_000, 1))
    quiet = None if robust else np.ones(len(series), dtype=bool)
    found = MeanDifferences.of(series, quiet).variance_of_means(np.zeros(1))
    for length in (1, 10, 100):
        assert found.variance[length - 1, 0] * length == pytest.approx(1.0, rel=0.3 if robust else 0.15)


@given(st.lists(st.floats(-10, 10), min_size=1, max_size=40), st.data())
def test_largest_sample_of_each_window(values: list[float], data: st.DataObject) -> None:
    length = data.draw(st.integers(1, len(values)))
    series = np.array(values)[:, None]
    zero = np.array([data.draw(st.floats(-10, 10))])
    sums = WindowSums.of(series, np.append(0.0, np.cumsum(series))[:, None], length)
    found = sums.largest(zero)
    assert found.shape == sums.total.shape == (1, len(values) - length + 1)
    for first, (value, total) in enumerate(zip(found[0], sums.total[0], strict=True)):
        window = series[first : first + length, 0]
        assert value in window - zero
        assert abs(value) == np.abs(window - zero).max()
        assert total == pytest.approx(window.sum(), rel=1e-12, abs=1e-12 * (1 + np.abs(series).sum()))


@given(st.integers(4, 9), st.integers(0, 1000))
def test_the_best_disjoint_windows_are_the_best(blocks: int, seed: int) -> None:
    """Against every subset of the windows; of no gain, none."""
    windows = ContactSearch(np.zeros((blocks, 1)), np.zeros(1), 0.01).windows
    gain = np.random.default_rng(seed).standard_normal(len(windows.first))
    chosen = windows.best_disjoint(gain)
    spans = sorted((windows.first[i], windows.last[i]) for i in chosen)
    assert all(a[1] <= b[0] for a, b in pairwise(spans))

    def best(start: int) -> float:
        if start >= blocks:
            return 0.0
        options = [gain[i] + best(int(windows.last[i])) for i in np.flatnonzero(windows.first == start)]
        return float(max(best(start + 1), *options)) if options else best(start + 1)

    assert gain[chosen].sum() == pytest.approx(best(0))
    assert windows.best_disjoint(-np.abs(gain)) == []


def test_blocks_cover_every_sample() -> None:
    residual = np.random.default_rng(1).standard_normal((4364, 6))
    blocks = BlockMeans.of(residual, 1 / 698)
    assert len(blocks.samples(np.ones(len(blocks.means), dtype=bool))) == 4364


def test_a_push_on_top_of_a_known_offset_does_not_become_noise() -> None:
    """With the zero given, all of an offset record is contact, and the noise is still that of its calm part."""
    residual = pushed("white", 8, size=30.0, first=800, last=1100) + np.array([5.0, -3.0, 0.0])
    found = found_in(residual, zero=NOTHING)
    assert sum(i.last - i.first for i in found.intervals) > 1900
    assert np.sqrt(np.diag(found.covariance)) == pytest.approx(np.ones(3), rel=0.1)  # 1700 samples: 1.7 %
