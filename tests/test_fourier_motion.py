"""The periodic motions: derivatives, peaks, limits, and the chapter's own optimum."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from design.fourier import CHAPTER_OPTIMUM_DEGREES, FourierMotion, chapter_series, random_motion

LIMITS: dict[str, Any] = {
    "position": [1.2, 0.8, 1.0],
    "velocity": [2.5, 2.5, 3.5],
    "acceleration": [12.0, 12.0, 15.0],
}


def a_motion(seed: int = 3) -> FourierMotion:
    return random_motion(joints=3, harmonics=6, period=4.0, seed=seed, **LIMITS)


def test_derivatives_are_those_of_the_position() -> None:
    motion, step = a_motion(), 1e-5
    time = np.linspace(0.0, 4.0, 101)
    q, dq, ddq = motion.evaluate(time)
    ahead, behind = motion.evaluate(time + step), motion.evaluate(time - step)
    assert q.shape == dq.shape == ddq.shape == (101, 3)
    # central difference: h² w³/6 of truncation (w = 9.4 rad/s) and 2e-16/h of rounding, both below 1e-7
    np.testing.assert_allclose((ahead[0] - behind[0]) / (2 * step), dq, atol=1e-7)
    np.testing.assert_allclose((ahead[1] - behind[1]) / (2 * step), ddq, atol=1e-6)


def test_motion_is_periodic() -> None:
    motion, time = a_motion(), np.linspace(0.0, 4.0, 50)
    for now, later in zip(motion.evaluate(time), motion.evaluate(time + motion.period), strict=True):
        np.testing.assert_allclose(now, later, atol=1e-11)  # rounding of the angle, times h² w²


def test_peak_of_a_single_wave() -> None:
    wave = FourierMotion(offset=np.array([0.5]), sine=np.array([[0.0, 3.0]]), cosine=np.array([[0.0, 4.0]]), period=2.0)
    rate = 2 * np.pi  # the second harmonic of 2 s
    q, dq, ddq = (float(x[0]) for x in wave.peak())
    # amplitude 5; the grid may miss the top by 1 - cos(pi/256) = 8e-5
    assert (q, dq, ddq) == pytest.approx((5.5, 5 * rate, 5 * rate**2), rel=1e-4)


def test_scaled_per_joint() -> None:
    motion, factor, time = a_motion(), np.array([0.5, 2.0, -1.0]), np.linspace(0.0, 1.0, 7)
    for scaled, plain in zip(motion.scaled(factor).evaluate(time), motion.evaluate(time), strict=True):
        np.testing.assert_allclose(scaled, plain * factor, rtol=1e-12)


def test_chapter_optimum_has_peaks_of_42_44_and_35_degrees() -> None:
    motion = chapter_series(np.radians(CHAPTER_OPTIMUM_DEGREES), period=5.0)
    assert np.degrees(motion.peak()[0]).round().tolist() == [42, 44, 35]


def test_shared_harmonics_are_the_same_for_all_joints() -> None:
    shared = np.concatenate([np.arange(1.0, 7.0), np.zeros(9)])
    q = chapter_series(shared, period=5.0).evaluate(np.linspace(0.0, 5.0, 20))[0]
    np.testing.assert_allclose(q, q[:, :1].repeat(3, axis=1), atol=1e-13)


@pytest.mark.parametrize("seed", range(5))
def test_random_motion_touches_its_nearest_limit_and_keeps_all(seed: int) -> None:
    motion = a_motion(seed)
    fine = np.linspace(0.0, motion.period, 20_001)
    peaks = np.array([np.abs(x).max(axis=0) for x in motion.evaluate(fine)])
    use = (peaks / np.array([LIMITS[k] for k in ("position", "velocity", "acceleration")])).max(axis=0)
    assert (use <= 1).all()
    assert (use > 1 - 2e-4).all()  # the bound between grid points and the grid's own error, 8e-5 each


def test_random_motion_between_asymmetric_limits() -> None:
    motion = random_motion(joints=1, position=[[0.2, 1.0]], velocity=100.0, acceleration=1000.0, seed=1)
    q = motion.evaluate(motion.grid())[0]
    assert q.min() >= 0.2
    assert q.max() <= 1.0
    assert float(motion.offset[0]) == pytest.approx(0.6)


def test_random_motion_is_reproducible() -> None:
    assert np.array_equal(a_motion(7).sine, a_motion(7).sine)
    assert not np.array_equal(a_motion(7).sine, a_motion(8).sine)


@pytest.mark.parametrize("bad", [{"velocity": 0.0}, {"position": [1.0, 1.0]}, {"position": [[1.0, 2.0]]}])
def test_bad_limits_are_refused(bad: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="limit"):
        random_motion(joints=3, seed=0, **{**LIMITS, **bad})


def test_bad_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match="15 coefficients"):
        chapter_series([1.0, 2.0], period=5.0)
    with pytest.raises(ValueError, match="shapes"):
        FourierMotion(offset=np.zeros(2), sine=np.zeros((3, 1)), cosine=np.zeros((3, 1)), period=1.0)
    with pytest.raises(ValueError, match="period"):
        FourierMotion(offset=np.zeros(1), sine=np.zeros((1, 1)), cosine=np.zeros((1, 1)), period=0.0)
