"""Smoothing by likelihood against analytic motions: derivatives, their stated uncertainty, and held samples."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from estimation.recordings.differentiation import TrueSamples, spline_derivatives
from estimation.recordings.smoothing_spline import SmoothingSpline, Smoothness, _Problem

Array = NDArray[np.float64]
Motion = Callable[[Array], tuple[Array, Array, Array]]
SECONDS = 20.0


def sines(t: Array) -> tuple[Array, Array, Array]:
    """Tones up to 2.3 Hz: value and two derivatives (n, 1)."""
    size, rate = np.array([0.2, 0.1, 0.05, 0.02]), 2 * np.pi * np.array([0.2, 0.5, 1.1, 2.3])
    angle = rate * t[:, None] + [0.3, 1.0, 2.0, 4.0]
    value, first = size * np.sin(angle), size * rate * np.cos(angle)
    return value.sum(1)[:, None], first.sum(1)[:, None], (-(rate**2) * value).sum(1)[:, None]


def points(t: Array) -> tuple[Array, Array, Array]:
    """Minimum-jerk moves of 0.9 s with dwells of 0.7 s between them."""
    value, first, second = np.zeros_like(t), np.zeros_like(t), np.zeros_like(t)
    steps = np.random.default_rng(3).uniform(-0.8, 0.8, int(t[-1] / 1.6) + 1)
    for number, step in enumerate(steps):
        s = np.clip((t - 0.3 - 1.6 * number) / 0.9, 0, 1)
        value += step * (10 * s**3 - 15 * s**4 + 6 * s**5)
        first += step * (30 * s**2 - 60 * s**3 + 30 * s**4) / 0.9
        second += step * (60 * s - 180 * s**2 + 120 * s**3) / 0.9**2
    return value[:, None], first[:, None], second[:, None]


def relative(error: Array, truth: Array) -> float:
    return float(np.sqrt(np.mean((error - truth) ** 2) / np.mean(truth**2)))


@pytest.mark.parametrize("rate", [10.0, 25.0, 125.0, 1000.0])
@pytest.mark.parametrize("motion", [sines, points])
def test_derivatives_at_any_rate(motion: Motion, rate: float) -> None:
    """Bounds are twice what a study of other seeds and motions gave; a lost motion has an error of one."""
    t = np.arange(0.0, SECONDS, 1 / rate)
    value, first, second = motion(t)
    noise = 1e-4 * np.random.default_rng(4).standard_normal(value.shape)
    found = spline_derivatives(value + noise, 1 / rate)
    assert relative(found.first, first) < 0.03
    assert relative(found.second, second) < (0.2 if rate < 20 else 0.1)


@pytest.mark.parametrize("motion", [sines, points])
def test_stated_uncertainty_is_that_of_the_error(motion: Motion) -> None:
    """One process for moves and dwells alike: within a factor of two, from some hundred independent errors."""
    t = np.arange(0.0, SECONDS, 0.01)
    value, _, second = motion(t)
    spline = SmoothingSpline.of(t, value + 3e-4 * np.random.default_rng(5).standard_normal(value.shape))
    assert spline.noise_std == pytest.approx(3e-4, rel=0.1)  # 2000 samples: 1.6 %, and what is taken for motion
    error = np.sqrt(np.mean((spline.derivative(t, 2) - second) ** 2))
    stated = np.sqrt(np.mean(spline.std(t[::10], 2) ** 2))
    assert 0.5 < error / stated < 2


def drawn_derivatives(spline: SmoothingSpline, t: Array, rng: np.random.Generator, count: int) -> list[Array]:
    """The second derivative (n, k) of each of several draws."""
    return np.hsplit(spline.drawn(*(spline.innovations(rng) for _ in range(count))).derivative(t, 2), count)


@pytest.mark.parametrize("order", [0, 1, 2, 3])
@pytest.mark.parametrize("count", [30, 700])
def test_stated_uncertainty_is_that_of_the_dense_covariance(count: int, order: int) -> None:
    """Through the whole factor in long doubles; rounding takes a millionth of a derivative at the most."""
    t = 0.01 * np.linspace(0.0, 0.01 * (count - 1), count)
    spline = SmoothingSpline.of(t, sines(t)[0] + 1e-4 * np.random.default_rng(6).standard_normal((count, 1)))
    places = np.random.default_rng(7).uniform(t[0], t[-1], 50)
    identity = replace(spline.spline, coefficients=np.eye(len(spline.spline.coefficients)))
    solved = replace(spline, spline=identity).derivative(places, order).T.astype(np.longdouble)
    for row in range(len(solved)):
        for offset in range(1, min(row, len(spline.factor) - 1) + 1):
            solved[row] -= spline.factor[offset, row - offset] * solved[row - offset]
        solved[row] /= spline.factor[0, row]
    expected = np.sqrt(spline.variance * (solved**2).sum(axis=0)).astype(float)
    np.testing.assert_allclose(spline.std(places, order), expected, rtol=1e-6)


def test_memory_of_the_uncertainty_grows_with_the_rows() -> None:
    """Of a minute at 1 kHz: far below one matrix of all coefficients, and of a few vectors of the rows."""
    t = np.linspace(0.0, 60.0, 60_000)
    spline = SmoothingSpline.of(t, sines(t)[0] + 1e-4 * np.random.default_rng(6).standard_normal((60_000, 1)))
    tracemalloc.start()
    try:
        spline.std(np.linspace(t[0], t[-1], 60), 2)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 100 * t.nbytes < len(spline.spline.coefficients) ** 2 * 8


def test_draws_have_the_stated_uncertainty() -> None:
    t = np.arange(0.0, 5.0, 0.02)
    value = sines(t)[0]
    rng = np.random.default_rng(6)
    spline = SmoothingSpline.of(t, value + 1e-3 * rng.standard_normal(value.shape))
    draws = np.stack(drawn_derivatives(spline, t, rng, 200)) - spline.derivative(t, 2)
    ratio = draws.std(axis=0)[:, 0] / spline.std(t, 2)
    # 200 draws give a std within 5 %; the largest deviation of some tens of independent ones is below 20 %. Where the
    # tones are rougher than on average it is more.
    assert ratio.min() > 0.8
    assert np.median(ratio) == pytest.approx(1, abs=0.2)


def test_draws_at_the_ends_of_moves_hold_what_smoothing_takes() -> None:
    """Jumps of the jerk are flattened, always in one direction: over 2.5 std of a motion as rough as everywhere.

    The draws know where it is rougher. Each of the twelve ends, of four seeds, counts for itself.
    """
    t = np.arange(0.0, SECONDS, 0.01)
    value, _, second = points(t)
    since = np.abs(t[:, None] - 0.3 - 1.6 * np.arange(12) - [[[0.0]], [[0.9]]]).min(axis=(0, 2))
    ends, stated, drawn = since < 0.03, [], []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        spline = SmoothingSpline.of(t, value + 1e-4 * rng.standard_normal(value.shape))
        found = spline.derivative(t, 2)
        std = np.std([draw - found for draw in drawn_derivatives(spline, t, rng, 40)], axis=0)
        error = (found - second)[ends]
        stated.append(float(np.mean((error / spline.std(t, 2)[ends, None]) ** 2)) ** 0.5)
        drawn.append(float(np.mean((error / std[ends]) ** 2)) ** 0.5)
    assert min(stated) > 2.5
    assert max(drawn) < 2.5  # of a jump in one place, of which a smoothed estimate knows the size but not the place


def test_solution_is_that_of_dense_equations() -> None:
    """Posterior mean and restricted likelihood of c, by dense matrices; the score's differences are what matters."""
    t = np.linspace(0.0, 1.0, 60)
    y = np.random.default_rng(7).normal(size=(60, 2))
    problem = _Problem.of(t, y, 40)
    scores, dense = [], []
    for smoothness in (
        Smoothness(order=4, log_penalty=1.0),
        Smoothness(order=4, log_penalty=-2.0, correlation=0.5),
    ):
        found = problem.solution(smoothness, problem.solution(smoothness))  # refined, as that of a spline is
        m, rho, penalty = problem.count, smoothness.correlation, np.exp(smoothness.log_penalty)
        rows = np.zeros((60, m))
        for j, weights in enumerate(problem.basis):
            rows[np.arange(60), problem.first + j] = weights
        covariance = rho ** np.abs(np.subtract.outer(np.arange(60), np.arange(60))) / (1 - rho**2)
        precision, differences = np.linalg.inv(covariance), np.diff(np.eye(m), 4, axis=0)
        matrix = rows.T @ precision @ rows + penalty * differences.T @ differences
        expected = np.linalg.solve(matrix, rows.T @ precision @ y)
        np.testing.assert_allclose(found.coefficients + problem.offset, expected, atol=1e-9)
        # The differences' part as data of covariance 1 / penalty, the polynomials free (a flat prior).
        polynomials = np.linalg.qr(np.vander(np.linspace(-1, 1, m), 4))[0]
        spread = rows @ np.linalg.pinv(penalty * differences.T @ differences) @ rows.T + covariance
        free = rows @ polynomials
        inverse = np.linalg.inv(spread)
        information = free.T @ inverse @ free
        contrast = inverse - inverse @ free @ np.linalg.solve(information, free.T @ inverse)
        squares = float(np.sum(y * (contrast @ y)))
        assert squares == pytest.approx(found.squares, rel=1e-6)
        logs = np.linalg.slogdet(spread)[1] + np.linalg.slogdet(information)[1]
        logs -= np.linalg.slogdet(free.T @ precision @ free)[1]
        scores.append(problem.score(smoothness))
        dense.append(y.size * np.log(squares) + 2 * logs)
    assert scores[0] - scores[1] == pytest.approx(dense[0] - dense[1], abs=1e-5)


@pytest.mark.parametrize("rate", [25.0, 47.1, 50.0])
@pytest.mark.parametrize("motion", [sines, points])
def test_held_samples_are_left_out(motion: Motion, rate: float) -> None:
    """At a tenth of the error, and more, that a hold of 10 ms on average makes."""
    t = np.arange(0.0, SECONDS, 0.01)
    _, first, second = motion(t)
    instants = np.floor(t * rate + 1e-9) / rate
    held = np.round(motion(instants)[0], 7)
    true = TrueSamples.of(held.T, 0.01, len(t))
    assert true is not None
    assert true.rate == pytest.approx(rate, rel=0.01)
    found = spline_derivatives(held, 0.01, true)
    assert relative(found.first, first) < 0.01
    assert relative(found.second, second) < 0.05


@pytest.mark.parametrize("step", [1e-3, 1e-4, 1e-5])
@pytest.mark.parametrize("rate", [100.0, 1000.0])
@pytest.mark.parametrize("motion", [sines, points])
def test_a_coarse_encoder_is_not_held(motion: Motion, rate: float, step: float) -> None:
    t = np.arange(0.0, SECONDS, 1 / rate)
    coarse = np.round(motion(t)[0] / step) * step
    assert TrueSamples.of(coarse.T, 1 / rate, len(t)) is None


def test_components_share_their_smoothness_so_that_the_frame_does_not_matter() -> None:
    t = np.arange(0.0, 10.0, 0.02)
    vector = np.concatenate([sines(t)[0], points(t)[0]], axis=1) + 1e-4 * np.random.default_rng(8).normal(size=(500, 2))
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    one, other = (SmoothingSpline.of(t, v).derivative(t, 2) for v in (vector, vector @ turn))
    np.testing.assert_allclose(one @ turn, other, atol=1e-6 * np.abs(one).max())


@pytest.mark.parametrize("value", [0.0, 0.3, -5e6])
def test_what_stands_still_has_no_derivatives(value: float) -> None:
    found = spline_derivatives(np.full((300, 2), value), 0.01)
    np.testing.assert_allclose(found.value, value, atol=1e-12 * max(1.0, abs(value)))
    np.testing.assert_allclose(found.second, 0.0, atol=1e-7 * max(1.0, abs(value)))


@pytest.mark.parametrize("correlation", [0.0, 0.95])
def test_at_rest_a_small_noise_moves_no_more_than_a_large_one(correlation: float) -> None:
    """Values of 1 and 3, with noise from 1e-6 on: what rounding leaves of their offset is no motion."""
    t = np.arange(0.0, SECONDS, 0.01)
    noise = np.random.default_rng(8).standard_normal((len(t), 2))
    for row in range(1, len(t)):
        noise[row] = correlation * noise[row - 1] + np.sqrt(1 - correlation**2) * noise[row]
    small, large = (SmoothingSpline.of(t, [1.0, -3.0] + size * noise) for size in (1e-6, 1e-2))
    assert small.freedom < large.freedom + 5  # which rounding leaves uncertain by as much, where all is polynomial
    assert small.noise_std == pytest.approx(1e-4 * large.noise_std, rel=0.01)


@pytest.mark.parametrize(("order", "log_penalty"), [(4, 25.0), (7, 21.5), (8, 22.0)])
def test_score_of_a_large_penalty_keeps_its_digits(order: int, log_penalty: float) -> None:
    """Against 60 digits: the sum of squares, whose logarithm the score takes 80 times, to a thousandth of that."""
    import mpmath  # type: ignore[import-untyped]

    rng = np.random.default_rng(9)
    t = np.sort(rng.uniform(0.0, 1.0, 80))
    y = np.sin(4 * np.pi * t)[:, None] + 1e-3 * rng.standard_normal((80, 1))
    problem = _Problem.of(t, y, 60)
    problem.score(Smoothness(order=order, log_penalty=log_penalty - 2))
    near = problem.solution(Smoothness(order=order, log_penalty=log_penalty), problem._best[-1])
    with mpmath.workdps(60):
        differences = np.diff(np.eye(problem.count), order, axis=0)
        matrix = mpmath.exp(log_penalty) * mpmath.matrix((differences.T @ differences).tolist())  # of whole numbers
        right, power = mpmath.zeros(problem.count, 1), mpmath.mpf(0)
        for first, weights, sample in zip(problem.first, problem.basis.T, problem.series[:, 0], strict=True):
            power += mpmath.mpf(float(sample)) ** 2
            for i, weight in enumerate(map(mpmath.mpf, weights.tolist())):
                right[int(first) + i] += weight * float(sample)
                for j, other in enumerate(weights.tolist()):
                    matrix[int(first) + i, int(first) + j] += weight * other
        # At the minimum c = A^-1 B'y the sum of squares is y'y - y'B c.
        squares = float(power - (right.T * mpmath.cholesky_solve(matrix, right))[0])
    assert near.squares == pytest.approx(squares, rel=1e-3 / 80)


@pytest.mark.parametrize("log_penalty", [-6.0, 2.0, 12.0])
def test_slope_is_that_of_the_score(log_penalty: float) -> None:
    t = np.linspace(0.0, 5.0, 200)
    y = sines(t)[0] + 1e-3 * np.random.default_rng(10).standard_normal((200, 1))
    problem = _Problem.of(t, y, 180)
    at = Smoothness(order=5, log_penalty=log_penalty)
    around = [problem.score(Smoothness(order=5, log_penalty=log_penalty + step)) for step in (-0.05, 0.05)]
    assert problem._slope(at) == pytest.approx(
        (around[1] - around[0]) / 0.1, rel=0.05, abs=0.2
    )  # freedom: a difference over 0.1
