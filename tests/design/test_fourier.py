"""The Fourier motions: exact peaks, 22.10 as printed, the chapter's own optimum, random motions within limits."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from design.trajectories.fourier import (
    CHAPTER_OPTIMUM_DEGREES,
    FreeSeries,
    PaperSeries,
    fourier_trajectory,
    random_periodic_trajectory,
)
from design.trajectories.trajectory import Trajectory
from modeling.errors import InputError

LIMITS: dict[str, Any] = {
    "position": [1.2, 0.8, 1.0],
    "velocity": [2.5, 2.5, 3.5],
    "acceleration": [12.0, 12.0, 15.0],
}


def a_motion(seed: int = 3) -> Trajectory:
    return random_periodic_trajectory(joints=3, harmonics=6, period=4.0, seed=seed, **LIMITS)


def test_enclosure_of_a_single_wave() -> None:
    wave = fourier_trajectory(offset=[0.5], sine=[[0.0, 3.0]], cosine=[[0.0, 4.0]], period=2.0)
    rate = 2 * np.pi  # the second harmonic of 2 s
    for order, (middle, half) in enumerate([(0.5, 5.0), (0.0, 5 * rate), (0.0, 5 * rate**2), (0.0, 5 * rate**3)]):
        low, high = wave.enclosure(order)
        # the bound may be wide by 1 / cos(pi/256) - 1 = 8e-5, and never short
        assert middle - half * (1 + 8e-5) <= float(low[0]) <= middle - half
        assert middle + half <= float(high[0]) <= middle + half * (1 + 8e-5)


def test_enclosure_is_exact_for_a_peak_halfway_between_grid_points() -> None:
    """Nothing less than the factor of Ehlich and Zeller would hold: their extremal polynomial."""
    series = FreeSeries(joints=1, harmonics=(3,), period=1.0)
    phase = np.pi / 256  # half a step of 2 pi / 256
    motion = Trajectory(series, np.array([2.0, 5 * np.sin(phase), 5 * np.cos(phase)]))
    low, high = motion.enclosure(0)
    assert motion.derivative(series.grid(), 0).max() < 7 - 3e-4
    assert (float(low[0]), float(high[0])) == pytest.approx((-3.0, 7.0), abs=1e-12)  # rounding


def test_enclosure_has_the_exact_extremes_of_a_trigonometric_polynomial() -> None:
    """dq = 0 as a polynomial in z = exp(i w t), its roots on the unit circle by the companion matrix."""
    series = FreeSeries(joints=1, harmonics=(1, 2, 3, 4), period=2 * np.pi)
    for seed in range(20):
        z = np.random.default_rng(seed).standard_normal(series.size)
        sine, cosine = z[1:5], z[5:]
        slope = np.arange(1, 5) * (sine + 1j * cosine) / 2  # of exp(i h t); of exp(-i h t) the conjugate
        roots = np.roots([*slope[::-1], 0.0, *slope.conj()])
        at = np.angle(roots[np.abs(np.abs(roots) - 1) < 1e-6])
        reached = series.evaluate(z, at, 0)
        half = float(np.ptp(reached)) / 2
        low, high = series.enclosure(z, 0)
        assert -1e-9 * half <= reached.min() - low[0] <= 8e-5 * half
        assert -1e-9 * half <= high[0] - reached.max() <= 8e-5 * half


def test_paper_series_is_equation_22_10() -> None:
    x, w = np.random.default_rng(1).standard_normal(15), 2 * np.pi / 5.0
    time = np.linspace(0, 5, 40)
    shared = sum(x[i - 1] * np.sin(i * w * time) + x[i + 2] * np.cos(i * w * time) for i in (1, 2, 3))
    own = [sum(x[6 + 3 * j + i - 4] * np.sin(i * w * time) for i in (4, 5, 6)) for j in range(3)]
    q = Trajectory(PaperSeries(period=5.0), x).evaluate(time)[0]
    np.testing.assert_allclose(q, np.stack([shared + each for each in own], axis=1), atol=1e-13)


def test_chapter_optimum_has_peaks_of_42_44_and_35_degrees() -> None:
    low, high = Trajectory(PaperSeries(period=5.0), np.radians(CHAPTER_OPTIMUM_DEGREES)).enclosure(0)
    assert np.degrees(np.maximum(-low, high)).round().tolist() == [42, 44, 35]


def test_scaled() -> None:
    motion, time = a_motion(), np.linspace(0.0, 1.0, 7)
    for scaled, plain in zip(motion.scaled(-0.5).evaluate(time), motion.evaluate(time), strict=True):
        np.testing.assert_allclose(scaled, -0.5 * plain, rtol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_random_motion_touches_its_nearest_limit_and_keeps_all(seed: int) -> None:
    motion = a_motion(seed)
    fine = np.linspace(0.0, motion.period, 20_001)
    peaks = np.array([np.abs(x).max(axis=0) for x in motion.evaluate(fine)])
    use = (peaks / np.array([LIMITS[k] for k in ("position", "velocity", "acceleration")])).max(axis=0)
    assert (use <= 1).all()
    assert (use > 1 - 2e-4).all()  # the bound between grid points and the grid's own error, 8e-5 each


def test_random_motion_between_asymmetric_limits() -> None:
    motion = random_periodic_trajectory(joints=1, position=[[0.2, 1.0]], velocity=100.0, acceleration=1000.0, seed=1)
    q = motion.evaluate(np.linspace(0, motion.period, 5000))[0]
    assert q.min() >= 0.2
    assert q.max() <= 1.0
    assert q[:-1].mean() == pytest.approx(0.6)


def test_random_motion_is_reproducible() -> None:
    assert np.array_equal(a_motion(7).coefficients, a_motion(7).coefficients)
    assert not np.array_equal(a_motion(7).coefficients, a_motion(8).coefficients)


def test_random_motion_of_a_seed_stays_what_it_was() -> None:
    """Recordings of the tests are made with these; the figures are those of commit 00c371c."""
    motion = random_periodic_trajectory(
        joints=2, position=1.0, velocity=2.0, acceleration=9.0, harmonics=2, period=3.0, seed=1
    )
    q, dq, ddq = motion.evaluate([0.0, 0.4])
    known = [
        [[0.6116810644995071, -0.12392219157342219], [0.6763462965383631, -0.39838612342084656]],
        [[1.3249870324308552, -1.0246255065618155], [-1.1026945658966736, 0.1879427018845955]],
        [[-4.275029786508327, -1.3794706484167811], [-5.714456627909556, 6.237355611512786]],
    ]
    np.testing.assert_allclose([q, dq, ddq], known, rtol=1e-12)


@pytest.mark.parametrize("bad", [{"velocity": 0.0}, {"position": [1.0, 1.0]}, {"position": [[1.0, 2.0]]}])
def test_bad_limits_are_refused(bad: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="limit"):
        random_periodic_trajectory(joints=3, seed=0, **{**LIMITS, **bad})


def test_bad_shapes_are_refused() -> None:
    with pytest.raises(InputError, match="15 coefficients"):
        Trajectory(PaperSeries(period=5.0), np.array([1.0, 2.0]))
    with pytest.raises(InputError, match="shapes"):
        fourier_trajectory(offset=np.zeros(2), sine=np.zeros((3, 1)), cosine=np.zeros((3, 1)), period=1.0)
    with pytest.raises(InputError, match="period"):
        fourier_trajectory(offset=np.zeros(1), sine=np.zeros((1, 1)), cosine=np.zeros((1, 1)), period=0.0)
