"""Derivatives that are kept: the same as derived anew in any unit of time, and never those of another series."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import estimation.recordings.differentiation as differentiation
from estimation.recordings.differentiation import RecentDerivatives, TrueSamples, spline_derivatives
from estimation.recordings.smoothing_spline import SmoothingSpline

Array = NDArray[np.float64]
SAMPLES = 300


class Counted:
    """How often a series was smoothed."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, limit: int = 10_000_000) -> None:
        self.count, derive = 0, differentiation._smoothed
        self.kept = RecentDerivatives(limit)

        def smoothed(*arguments: Any) -> Any:
            self.count += 1
            return derive(*arguments)

        monkeypatch.setattr(differentiation, "_smoothed", smoothed)
        monkeypatch.setattr(differentiation, "RECENT", self.kept)


def series(seed: int, samples: int = SAMPLES) -> Array:
    t = np.linspace(0, 1, samples)[:, None]
    return np.sin(7 * t + seed) + 1e-3 * np.random.default_rng(seed).standard_normal((samples, 2))


def test_a_copy_is_not_smoothed_again(monkeypatch: pytest.MonkeyPatch) -> None:
    counted = Counted(monkeypatch)
    first = spline_derivatives(series(1), 0.01)
    again = spline_derivatives(np.asfortranarray(series(1)), 0.01)
    assert counted.count == 1
    for part in ("value", "first", "second", "score"):
        np.testing.assert_array_equal(getattr(first, part), getattr(again, part))


def test_the_unit_of_time_scales_what_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """At twice the step derivatives are halved and quartered, the cutoff is halved, and nothing is smoothed again."""
    counted = Counted(monkeypatch)
    fast, slow = spline_derivatives(series(1), 0.01), spline_derivatives(series(1), 0.02)
    assert counted.count == 1
    np.testing.assert_allclose(fast.first, np.multiply(2.0, slow.first), rtol=1e-12)
    np.testing.assert_allclose(fast.second, np.multiply(4.0, slow.second), rtol=1e-12)
    assert fast.spline is not None
    assert slow.spline is not None
    assert fast.spline.cutoff == pytest.approx(2 * slow.spline.cutoff)
    assert slow.spline.end == pytest.approx(0.02 * (SAMPLES - 1))
    times: Array = np.linspace(0.0, 0.02 * (SAMPLES - 1), SAMPLES)
    np.testing.assert_allclose(slow.spline.derivative(times, 1), slow.first, rtol=1e-6, atol=1e-9)
    by_differences = np.gradient(slow.value, 0.02, axis=0)[1:-1]  # per s, to the third derivative's part
    np.testing.assert_allclose(slow.first[1:-1], by_differences, atol=3e-3 * np.abs(slow.first).max())
    anew = SmoothingSpline.of(times, series(1))
    assert slow.spline.noise_std == pytest.approx(anew.noise_std, rel=0.05)  # rounding moves the flat optimum a little
    np.testing.assert_allclose(slow.spline.std(times, 2), anew.std(times, 2), rtol=0.2)


def test_every_difference_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """One number, the shape, the rows that are true and their instants."""
    counted = Counted(monkeypatch)
    changed = series(1)
    changed[17, 1] += 1e-9
    held = np.repeat(series(1, SAMPLES // 3), 3, axis=0)
    rows = np.arange(0, SAMPLES, 3)
    true = [TrueSamples(rows=rows, instants=np.multiply(0.01, rows - late), rate=33.3) for late in (0.0, 0.4)]
    spline_derivatives(series(1), 0.01)
    spline_derivatives(changed, 0.01)
    spline_derivatives(changed[:-1], 0.01)
    spline_derivatives(changed.reshape(-1, 1), 0.01)
    late = [spline_derivatives(held, 0.01, each) for each in true]
    spline_derivatives(held, 0.01)
    assert counted.count == 7
    assert np.abs(late[0].value - late[1].value).max() == pytest.approx(7 * 0.4 / SAMPLES, rel=0.1)


def test_what_was_not_used_for_longest_goes_first(monkeypatch: pytest.MonkeyPatch) -> None:
    counted = Counted(monkeypatch)
    spline_derivatives(series(1), 0.01)
    counted.kept.limit = int(2.5 * counted.kept.size)
    for seed in (2, 1, 3):  # the second goes
        spline_derivatives(series(seed), 0.01)
    assert counted.kept.size <= counted.kept.limit
    before = counted.count
    spline_derivatives(series(1), 0.01)
    assert counted.count == before
    spline_derivatives(series(2), 0.01)
    assert counted.count == before + 1


def test_what_is_larger_than_the_limit_is_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    counted = Counted(monkeypatch, limit=1000)
    found = spline_derivatives(series(1), 0.01)
    assert counted.kept.size == 0
    np.testing.assert_array_equal(spline_derivatives(series(1), 0.01).second, found.second)


def test_what_others_have_too_cannot_be_written(monkeypatch: pytest.MonkeyPatch) -> None:
    Counted(monkeypatch)
    found = spline_derivatives(series(1), 0.01)
    with pytest.raises(ValueError, match="read-only"):
        found.value[0] = 0.0
