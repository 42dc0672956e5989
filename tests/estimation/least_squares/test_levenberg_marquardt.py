"""Levenberg-Marquardt: conditions of optimality within bounds, curved valleys, starts without a prediction."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import least_squares, lsq_linear

from estimation.least_squares.levenberg_marquardt import levenberg_marquardt, levenberg_marquardt_step
from estimation.least_squares.square_root_information import SquareRootInformation
from modeling.errors import InputError

Array = NDArray[np.float64]
Rows = Callable[[Array], tuple[Array, Array]]


class Counted:
    """Information of rows (residual, derivative of the prediction) at theta, and the chi-square of each evaluation."""

    def __init__(self, rows: Rows) -> None:
        self.rows = rows
        self.costs: list[float] = []

    def __call__(self, theta: Array) -> SquareRootInformation:
        residual, derivative = self.rows(theta)
        self.costs.append(float(residual @ residual))
        return SquareRootInformation.of(derivative, residual)


def valley(steepness: float) -> Rows:
    """A curved valley along y = x², with its minimum at (1, 1): Rosenbrock's function for a steepness of 10."""

    def rows(theta: Array) -> tuple[Array, Array]:
        x, y = theta
        residual = np.array([steepness * (x * x - y), 1 - x])
        return residual, np.array([[-2 * steepness * x, steepness], [1.0, 0.0]])

    return rows


@settings(deadline=None)
@given(seed=st.integers(0, 10_000), size=st.integers(2, 12))
def test_the_linear_minimum_within_bounds_takes_two_steps(seed: int, size: int) -> None:
    """Karush-Kuhn-Tucker: the gradient vanishes between the bounds, and at a bound it points outwards.

    Columns are correlated by up to 0.999, where a step clipped to the bounds often goes uphill.
    """
    rng = np.random.default_rng(seed)
    columns = rng.standard_normal((40, size)) + rng.choice([1.0, 10.0]) * rng.standard_normal((40, 1))
    target = columns @ rng.standard_normal(size) + 0.1 * rng.standard_normal(40)
    low = -rng.exponential(0.5, size)
    bounds = (low, low + rng.exponential(1.0, size) + 1e-3)
    information = Counted(lambda theta: (target - columns @ theta, columns))
    found = levenberg_marquardt(information, rng.uniform(*bounds), bounds)
    assert found.converged
    assert len(information.costs) <= 3
    gradient = columns.T @ (target - columns @ found.theta) / np.linalg.norm(columns, axis=0)
    at_low, at_high = found.theta <= bounds[0] + 1e-12, found.theta >= bounds[1] - 1e-12
    tolerance = 1e-8 * np.linalg.norm(target)
    assert (np.abs(gradient[~at_low & ~at_high]) < tolerance).all()
    assert (gradient[at_low] < tolerance).all()
    assert (gradient[at_high] > -tolerance).all()


@settings(deadline=None)
@given(seed=st.integers(0, 10_000))
def test_no_step_leaves_the_bounds_or_goes_uphill_by_the_linear_model(seed: int) -> None:
    """Also of columns without full rank, and with damping."""
    rng = np.random.default_rng(seed)
    columns = rng.standard_normal((30, 6))
    columns[:, 3] = columns[:, 0] - 2 * columns[:, 1]
    columns[:, 4] *= rng.choice([0.0, 1e-8, 1.0])
    here = SquareRootInformation.of(columns, rng.standard_normal(30))
    bounds = (-rng.exponential(0.05, 6), rng.exponential(0.05, 6))
    step = levenberg_marquardt_step(here, np.zeros(6), bounds, float(rng.choice([0.0, 1e-4, 1.0])))
    assert (bounds[0] <= step).all()
    assert (step <= bounds[1]).all()
    assert here.shifted(step).cost <= here.cost


@settings(deadline=None)
@given(seed=st.integers(0, 10_000), difference=st.sampled_from([0.0, 1e-12]))
def test_a_step_within_bounds_is_the_minimum_also_of_collinear_columns(seed: int, difference: float) -> None:
    """A direction that is not seen gives way where a bound presses: SciPy's trust region finds no lower chi-square."""
    rng = np.random.default_rng(seed)
    columns = rng.standard_normal((30, 6))
    columns[:, 3] = columns[:, 0] - 2 * columns[:, 1] + difference * rng.standard_normal(30)
    target = columns @ rng.standard_normal(6) + 0.1 * rng.standard_normal(30)
    bounds = (-rng.exponential(0.3, 6), rng.exponential(0.3, 6))
    here = SquareRootInformation.of(columns, target)
    step = levenberg_marquardt_step(here, np.zeros(6), bounds, 0.0)
    best = lsq_linear(columns, target, bounds, method="trf", tol=1e-14, lsq_solver="exact")
    assert here.shifted(step).cost < 2 * best.cost * (1 + 1e-5)


@pytest.mark.parametrize("seed", [58, 78, 89, 129])
def test_where_active_sets_cycle_the_step_is_the_minimum_too(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """One in thirty of such problems, correlated by 0.9, goes to SciPy's method of one bound at a time."""
    asked = []

    def counted(*arguments: Any, **options: Any) -> Any:
        asked.append(options["method"])
        return lsq_linear(*arguments, **options)

    monkeypatch.setattr("scipy.optimize.lsq_linear", counted)
    rng = np.random.default_rng(seed)
    size = int(rng.integers(3, 8))
    columns = rng.standard_normal((size, size)) + 3 * rng.standard_normal((size, 1))
    columns /= np.linalg.norm(columns, axis=0)
    target = 3 * rng.standard_normal(size)
    bounds = (-rng.exponential(0.3, size), rng.exponential(0.3, size))
    here = SquareRootInformation.of(columns, target)
    step = levenberg_marquardt_step(here, np.zeros(size), bounds, 0.0)
    assert asked == ["bvls"]
    best = lsq_linear(columns, target, bounds, method="trf", tol=1e-14, lsq_solver="exact")
    assert here.shifted(step).cost == pytest.approx(2 * best.cost, rel=1e-9)


@pytest.mark.parametrize("steepness", [1.0, 3.0, 10.0])
def test_a_curved_valley_is_followed_to_its_end(steepness: float) -> None:
    """To a hundredth of a std, which is 1 of x and 2 of y."""
    information = Counted(valley(steepness))
    found = levenberg_marquardt(information, np.array([-1.2, 1.0]), (np.full(2, -np.inf), np.full(2, np.inf)))
    assert found.converged
    np.testing.assert_allclose(found.theta, 1, atol=0.01)


def tethered(seed: int, samples: int = 200, std: float = 0.02) -> Rows:
    """The force of a tether (stiffness, anchor, length) in the plane, which goes taut between two samples, in a walk.

    Whitened: where it goes taut the slope jumps, and a difference of two samples sees the whole jump.
    """
    angle = np.linspace(0, 4 * np.pi, samples)
    point = np.stack([0.3 * np.sin(angle), 0.2 * np.sin(2 * angle + 1)], axis=1)

    def force(theta: Array) -> tuple[Array, Array]:
        stiffness, anchor, length = theta[0], theta[1:3], theta[3]
        distance = np.linalg.norm(anchor - point, axis=1)
        along = (anchor - point) / distance[:, None]
        stretch, taut = np.maximum(distance - length, 0), (distance > length).astype(float)
        derivative = np.zeros((samples, 2, 4))
        derivative[:, :, 0] = stretch[:, None] * along
        across = (np.eye(2) - along[:, :, None] * along[:, None, :]) * (stretch / distance)[:, None, None]
        derivative[:, :, 1:3] = stiffness * (taut[:, None, None] * along[:, :, None] * along[:, None, :] + across)
        derivative[:, :, 3] = -stiffness * taut[:, None] * along
        return stiffness * stretch[:, None] * along, derivative

    walk = std * np.cumsum(np.random.default_rng(seed).standard_normal((samples, 2)), axis=0)
    measured = force(np.array([3.0, 0.6, 0.1, 0.5]))[0] + walk

    def rows(theta: Array) -> tuple[Array, Array]:
        value, derivative = force(theta)
        return np.diff(measured - value, axis=0).ravel() / std, np.diff(derivative, axis=0).reshape(-1, 4) / std

    return rows


def test_a_minimum_at_a_kink_is_one() -> None:
    """Of 20 tethers a quarter ends where the slope jumps; from there no start finds a chi-square lower by 0.1."""
    bounds = (np.array([0.0, -2.0, -2.0, 0.0]), np.array([50.0, 2.0, 2.0, 3.0]))
    found = [
        levenberg_marquardt(Counted(tethered(seed)), np.array([2.0, 0.9, -0.1, 0.7]), bounds) for seed in range(20)
    ]
    assert sum(minimum.converged for minimum in found) >= 19
    for seed, minimum in enumerate(found):
        for part in (0.999, 1.001):
            again = levenberg_marquardt(Counted(tethered(seed)), part * minimum.theta, bounds)
            assert again.cost > minimum.cost - 0.1


def test_slow_progress_of_a_smooth_model_is_no_kink() -> None:
    """Two exponentials that almost coincide: what has converged is a minimum by SciPy's, too."""
    rng, t = np.random.default_rng(0), np.linspace(0, 3, 40)
    bounds, converged = (np.zeros(4), np.full(4, 20.0)), 0
    for _ in range(50):
        rates = rng.uniform(0.5, 3, size=2)
        y = np.exp(-rates[0] * t) + np.exp(-rates[1] * t) + 0.01 * rng.standard_normal(40)

        def rows(q: Array, y: Array = y) -> tuple[Array, Array]:
            parts = np.exp(-np.outer(t, q[1::2]))
            columns = np.column_stack([parts[:, 0], -q[0] * t * parts[:, 0], parts[:, 1], -q[2] * t * parts[:, 1]])
            return (y - parts @ q[::2]) / 0.01, columns / 0.01

        found = levenberg_marquardt(Counted(rows), np.array([1.0, 0.1, 1.0, 5.0]), bounds)

        def residual(q: Array, rows: Rows = rows) -> Array:
            return rows(q)[0]

        best = least_squares(residual, found.theta, bounds=bounds, x_scale="jac", xtol=1e-15, ftol=1e-15)
        converged += found.converged
        assert not found.converged or found.cost < 2 * best.cost + 0.05
    assert converged > 30


def test_failed_trials_need_no_derivative() -> None:
    """Given the chi-square alone the path is the same, and damped steps that fail are not linearised."""
    rows = valley(10.0)
    plain, spared = Counted(rows), Counted(rows)
    start, bounds = np.array([-1.2, 1.0]), (np.full(2, -np.inf), np.full(2, np.inf))
    expected = levenberg_marquardt(plain, start, bounds)
    found = levenberg_marquardt(spared, start, bounds, chi_square=lambda theta: float(np.sum(rows(theta)[0] ** 2)))
    np.testing.assert_array_equal(found.theta, expected.theta)
    assert spared.costs == [cost for cost in plain.costs if cost in spared.costs]
    assert len(plain.costs) - len(spared.costs) >= 3


def test_a_bound_across_the_valley_is_where_it_ends() -> None:
    """Of x <= 0.5 the minimum is (0.5, 0.25): y follows x, and the slope in x points outwards."""
    bounds = (np.array([-2.0, -2.0]), np.array([0.5, 2.0]))
    found = levenberg_marquardt(Counted(valley(10.0)), np.array([-1.2, 1.0]), bounds)
    assert found.converged
    np.testing.assert_allclose(found.theta, [0.5, 0.25], atol=1e-6)


@pytest.mark.parametrize("difference", [0.0, 1e-11])
def test_what_is_not_seen_stays_where_it_is_beside_an_active_bound(difference: float) -> None:
    """Of two equal columns only the sum is known: both take half of it, whatever the bounds of another parameter."""
    rng = np.random.default_rng(3)
    columns = rng.standard_normal((50, 4))
    columns[:, 1] = columns[:, 0] + difference * columns[:, 3]
    bounds = (np.array([-np.inf, -np.inf, -0.1, -np.inf]), np.array([np.inf, np.inf, 0.1, np.inf]))
    target = columns @ [0.5, 0.5, 2.0, 1.0]
    found = levenberg_marquardt(Counted(lambda theta: (target - columns @ theta, columns)), np.zeros(4), bounds)
    assert found.theta[2] == 0.1
    assert found.theta[0] == pytest.approx(found.theta[1], abs=1e-6)
    assert 0.2 < found.theta[0] < 1.0


def test_a_trial_that_is_no_number_counts_as_one_without_gain() -> None:
    """4 = ln x from x = 200, where the first steps end below zero."""

    def rows(theta: Array) -> tuple[Array, Array]:
        return 4 - np.log(np.where(theta > 0, theta, np.nan)), (1 / theta)[:, None]

    found = levenberg_marquardt(Counted(rows), np.array([200.0]), (np.array([-np.inf]), np.array([np.inf])))
    assert found.converged
    assert found.theta[0] == pytest.approx(np.exp(4), rel=0.02)


def test_a_trial_without_a_prediction_counts_as_one_without_gain() -> None:
    """1 / x = 4 from x = 0.45, and nothing is predicted below 0.2, where the first step ends."""

    def rows(theta: Array) -> tuple[Array, Array]:
        if theta[0] < 0.2:
            raise InputError(what="no prediction", where="x < 0.2", remedy="none")
        return 4 - 1 / theta, (-1 / theta**2)[:, None]

    found = levenberg_marquardt(Counted(rows), np.array([0.45]), (np.array([-np.inf]), np.array([np.inf])))
    assert found.converged
    assert found.theta[0] == pytest.approx(0.25, rel=1e-4)


def test_what_stays_far_above_a_limit_is_evaluated_once() -> None:
    """Linear, with a minimum of 100 times the limit: the first linear model shows it, and the chi-square is near it."""
    rng = np.random.default_rng(5)
    columns, rest = rng.standard_normal((60, 3)), rng.standard_normal(60)
    rest -= columns @ np.linalg.lstsq(columns, rest)[0]
    target = columns @ np.full(3, 0.1) + 100 * rest / np.linalg.norm(rest)
    free, information = (np.full(3, -np.inf), np.full(3, np.inf)), Counted(lambda x: (target - columns @ x, columns))
    found = levenberg_marquardt(information, np.zeros(3), free, far=100.0)
    assert len(information.costs) == 1
    assert not found.converged
    assert 1e4 < found.cost < 1.1e4


@pytest.mark.parametrize(("steepness", "limit"), [(1.0, 1.0), (1.0, 0.3), (1.0, 0.01), (10.0, 0.3)])
def test_short_damped_steps_do_not_tell_that_a_limit_is_out_of_reach(steepness: float, limit: float) -> None:
    """Along a curved valley from 24 to 0 the damping keeps steps short, while an undamped one is predicted to end at 0.

    A limit that the linear model always has in sight changes nothing.
    """
    start, free = np.array([-1.2, 1.0]), (np.full(2, -np.inf), np.full(2, np.inf))
    expected = levenberg_marquardt(Counted(valley(steepness)), start, free)
    found = levenberg_marquardt(Counted(valley(steepness)), start, free, far=limit)
    assert found.converged
    np.testing.assert_array_equal(found.theta, expected.theta)


def test_a_minimum_far_above_a_limit_has_converged() -> None:
    """Which is no slow progress: `converged` says that the chi-square is that of a minimum."""
    columns, target = np.ones((10, 1)), np.linspace(-1, 1, 10)
    free = (np.full(1, -np.inf), np.full(1, np.inf))
    found = levenberg_marquardt(Counted(lambda x: (target - columns @ x, columns)), np.zeros(1), free, far=0.01)
    assert found.converged


def test_a_start_beside_which_nothing_has_a_prediction_is_no_minimum() -> None:
    """Every step fails, however short: that tells nothing of the chi-square there, whose slope says it could fall."""

    def rows(theta: Array) -> tuple[Array, Array]:
        if theta[0] != 0:
            raise InputError(what="no prediction", where="x != 0", remedy="none")
        return np.array([5.0]), np.array([[1.0]])

    def chi_square(theta: Array) -> float:
        return float(rows(theta)[0] @ rows(theta)[0])

    free = (np.full(1, -np.inf), np.full(1, np.inf))
    assert not levenberg_marquardt(Counted(rows), np.zeros(1), free).converged
    assert not levenberg_marquardt(Counted(rows), np.zeros(1), free, chi_square=chi_square).converged


def test_a_short_damped_step_of_no_gain_is_no_minimum() -> None:
    """Beside a wall at x = 1e-7 every step that has a prediction is so short that it gains next to nothing."""

    def rows(theta: Array) -> tuple[Array, Array]:
        if theta[0] > 1e-7:
            raise InputError(what="no prediction", where="x > 1e-7", remedy="none")
        return 1 - theta, np.array([[1.0]])

    free = (np.full(1, -np.inf), np.full(1, np.inf))
    assert not levenberg_marquardt(Counted(rows), np.zeros(1), free).converged


def test_many_small_kinks_are_a_minimum() -> None:
    """Where the slope turns at every 0.01 std no step ends at a minimum, but within a tenth of a std of it."""
    rest = np.full(900, 2.0)

    def rows(theta: Array) -> tuple[Array, Array]:
        phase = theta[0] / 0.01 + 0.3
        ripple = np.abs(phase - np.round(phase))
        slope = np.sign(phase - np.round(phase)) / 0.01
        residual = np.append(rest * (1 + 1.5e-7 * ripple), 3.0 - theta[0])
        return residual, np.append(-1.5e-7 * slope * rest, 1.0)[:, None]

    information = Counted(rows)
    found = levenberg_marquardt(information, np.zeros(1), (np.array([-np.inf]), np.array([np.inf])))
    assert found.converged
    assert len(information.costs) < 20
    assert found.theta[0] == pytest.approx(3.0, abs=0.1)
