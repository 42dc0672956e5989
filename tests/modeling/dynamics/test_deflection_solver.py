"""How the bend is found: near a resonance, to the tolerance asked for, and each part of the iteration by itself."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from modeling.dynamics import deflection_solver as bending
from modeling.dynamics.deflection_solver import ANDERSON_DEPTH, AndersonMixing, _OscillatingTool, solve_deflection
from modeling.dynamics.motion_record import TimeBase
from modeling.dynamics.oscillator import (
    Oscillator,
    OscillatorCoefficients,
    SplineSlopes,
    TransientResponse,
    interpolated,
)
from modeling.errors import InputError
from tests.shared.deflection_cases import (
    PERIOD,
    SPATIAL,
    TOOL,
    bent,
    grid,
    integrated,
    solved,
    three_axes,
    turn,
    vector,
)

Array = NDArray[np.float64]


# ------------------------------------------------------------------------------------------------------- the solution


# Bends of 0.8 to 1.9 rad: gravity pulls the tool as strongly as the spring holds it, and hardly anything damps.
@pytest.mark.parametrize(("stiffness", "damping"), [(3.0, 0.01), (3.0, 0.0), (2.5, 0.02), (2.0, 0.01)])
def test_near_a_resonance(stiffness: float, damping: float, monkeypatch: pytest.MonkeyPatch) -> None:
    taken, by_newton = [], bending._by_newton

    def noted(*given: Any) -> Array:
        taken.append(given)
        return by_newton(*given)

    monkeypatch.setattr(bending, "_by_newton", noted)
    times, dt = grid(256)
    values = TOOL | {"stiffness": stiffness, "damping": damping}
    found = solved(values, times, TimeBase(dt, True)).values
    assert taken
    expected = integrated(stiffness, damping, found[0, :2], times)
    # The integrator's 1e-9, which a swing that nothing damps makes a thousand times larger over a period.
    np.testing.assert_allclose(found[:, :2], expected, atol=1e-5 * np.abs(expected).max())


@pytest.mark.parametrize("periodic", [True, False])
@pytest.mark.parametrize("steps", [0, 2, 6])
def test_newton_comes_to_the_same_from_anywhere(steps: int, periodic: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    times, dt = grid(96)
    tool, clock, theta = bent("space"), TimeBase(dt, periodic), vector("space", SPATIAL)
    rows = tool.load.samples(three_axes(times)[0], 96)
    expected = solve_deflection(tool.equation, rows, theta, clock, derivative=False).values
    monkeypatch.setattr(bending, "ANDERSON_STEPS", steps)
    found = solve_deflection(tool.equation, rows, theta, clock, derivative=False).values
    # Both stop where the angles' last correction is 1e-11; rates and accelerations have more at high frequencies.
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize(
    ("space", "samples", "periodic"),
    [("plane", 96, True), ("plane", 97, True), ("space", 48, True), ("plane", 96, False), ("space", 48, False)],
)
def test_derivatives_by_a_factorised_matrix_and_by_gmres(
    space: str, samples: int, periodic: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    times, dt = grid(samples)
    tool, theta = bent(space), vector(space, SPATIAL if space == "space" else TOOL | {"stiffness": 10.0})
    rows = tool.load.samples(turn(times) if space == "plane" else three_axes(times)[0], samples)
    slopes, products, multiplied = [], [], bending._product

    def counted(*given: Array) -> Array:
        products.append(given)
        return multiplied(*given)

    monkeypatch.setattr(bending, "_product", counted)
    for limits in ({}, {"FACTORISED_EQUATIONS": 0, "STORED_NUMBERS": 100}):
        for name, limit in limits.items():
            monkeypatch.setattr(bending, name, limit)
        products.clear()
        found = solve_deflection(tool.equation, rows, theta, TimeBase(dt, periodic)).slopes
        slopes.append(found.reshape(samples, 3, -1, len(theta)))  # angles, rates, accelerations
        # The right side of each parameter, and with a factorisation the check of its solution: nothing is iterated.
        assert (len(products) <= 2 * len(theta)) == (limits == {})
    size = np.abs(slopes[0]).max(axis=(0, 2))
    assert (size[0] > 0).sum() > 3
    # GMRES stops at a relative residual of 1e-10; accelerations have more of it at high frequencies.
    assert (np.abs(slopes[0] - slopes[1]).max(axis=(0, 2)) <= 1e-7 * size).all()


@pytest.mark.parametrize("periodic", [True, False])
@pytest.mark.parametrize("value", [0.0, np.nan])
def test_a_matrix_that_cannot_be_solved_is_refused_in_words(value: float, periodic: bool) -> None:
    times, dt = grid(128)
    tool, theta = bent("plane"), vector("plane", TOOL | {"stiffness": 10.0, "damping": 0.05})
    rows = tool.load.samples(turn(times), 128)
    start = _OscillatingTool.of(tool.equation, rows, theta, TimeBase(dt, periodic))
    with pytest.raises(InputError, match="did not converge"):
        start.derivatives(np.full((128, 1, 3), value), np.ones((2, 1, 128)))


def test_a_long_run_begins_with_some_of_its_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    """It only begins with them: the bend is the same, also behind a jump of the load between two of them."""
    count = bending.COARSENING_FACTOR * bending.LINEARISATION_SAMPLES + 3
    times, dt = grid(count)
    tool, clock, theta = (
        bent("plane"),
        TimeBase(dt, False),
        vector("plane", TOOL | {"stiffness": 10.0, "damping": 0.05}),
    )
    rows = tool.load.samples(turn(times) | {"ax": np.where(times > 1.237, 5.0, 0.0)}, count)
    tried, found = [], []
    for coarser in (bending.COARSENING_FACTOR, count):
        monkeypatch.setattr(bending, "COARSENING_FACTOR", coarser)
        course = bending._OscillatingTool.of(tool.equation, rows, theta, clock)
        tried.append(course.initial_deflection(tool.equation, tool.equation.over(rows, theta), rows, theta)[0])
        found.append(solve_deflection(tool.equation, rows, theta, clock, derivative=False).values)
    size = np.abs(found[0][:, 0]).max()
    assert np.abs(tried[0] - found[0][:, 0]).max() < 0.01 * size
    assert not tried[1].any()
    # Two iterations that stop where their last correction is 1e-11.
    np.testing.assert_allclose(found[0][:, :2], found[1][:, :2], atol=1e-9 * size)


@pytest.mark.parametrize("periodic", [True, False])
@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-8])
def test_the_tolerance_is_kept(tolerance: float, periodic: bool) -> None:
    times, dt = grid(256)
    tool, clock = bent("plane"), TimeBase(dt, periodic)
    rows, theta = tool.load.samples(turn(times), 256), vector("plane", TOOL | {"stiffness": 10.0, "damping": 0.05})
    exact = solve_deflection(tool.equation, rows, theta, clock, derivative=False).values[:, 0]
    found = solve_deflection(tool.equation, rows, theta, clock, derivative=False, tolerance=tolerance).values[:, 0]
    error = np.abs(found - exact).max() / np.abs(exact).max()
    # A step leaves less than it corrects, away from a resonance; and an iteration that stops earlier leaves something.
    assert 0 < error < tolerance


@pytest.mark.parametrize(("space", "bends"), [("plane", 3), ("space", 9)])
def test_balance_is_the_equilibrium(space: str, bends: int) -> None:
    times, _ = grid(33)
    tool = bent(space)
    rows = tool.load.samples(turn(times) if space == "plane" else three_axes(times)[0], 33)
    theta = vector(space, TOOL | {"stiffness": 10.0, "damping": 0.3} if space == "plane" else SPATIAL)
    bend = np.random.default_rng(0).normal(0, 0.1, (33, bends))
    expected, _ = tool.equation.at(rows, bend, theta)
    # The same operations in the same order.
    np.testing.assert_allclose(tool.equation.over(rows, theta).of(np.ascontiguousarray(bend.T)).T, expected, rtol=1e-14)


@pytest.mark.parametrize("space", ["plane", "space"])
def test_change_of_the_mean_by_two_routes(space: str) -> None:
    """By complex steps, and by CasADi's second derivatives."""
    times, _ = grid(33)
    tool = bent(space).equation
    rows = bent(space).load.samples(turn(times) if space == "plane" else three_axes(times)[0], 33)
    theta = vector(space, TOOL | {"stiffness": 10.0, "damping": 0.3} if space == "plane" else SPATIAL)
    found, expected = tool.mean_change(rows, theta), tool._mean_change_by_graph(rows, theta)
    assert np.abs(expected).max() > 0
    np.testing.assert_allclose(found, expected, atol=1e-13 * np.abs(expected).max())


# ----------------------------------------------------------------------------------------------------------- the parts


def test_mixing_solves_linear_equations_in_as_many_steps_as_unknowns() -> None:
    rng = np.random.default_rng(4)
    matrix, right = np.eye(12) + 0.5 * rng.normal(size=(12, 12)), rng.normal(size=12)
    assert np.abs(np.linalg.eigvals(np.eye(12) - matrix)).max() > 1  # without combining, the steps run away
    mixing, found = AndersonMixing(12), np.zeros(12)
    for _ in range(14):
        found += mixing.step(right - matrix @ found)
    np.testing.assert_allclose(matrix @ found, right, atol=1e-9)


def test_mixing_forgets_what_its_memory_does_not_hold() -> None:
    """A diagonal of more values than it remembers steps: slower than GMRES, but it goes on."""
    diagonal = np.linspace(0.05, 1.9, 3 * ANDERSON_DEPTH)
    mixing, found = AndersonMixing(len(diagonal)), np.zeros(len(diagonal))
    for _ in range(4 * ANDERSON_DEPTH):
        found += mixing.step(1 - diagonal * found)
    np.testing.assert_allclose(diagonal * found, 1, atol=1e-6)


@pytest.mark.parametrize("samples", [4, 5, 50])
def test_slopes_of_a_spline(samples: int) -> None:
    values = np.random.default_rng(1).normal(size=(2, samples))
    expected = CubicSpline(np.arange(samples), values, axis=1)(np.arange(samples), 1)
    np.testing.assert_allclose(SplineSlopes.of(samples).of_values(values), expected, atol=1e-13)


@pytest.mark.parametrize(("samples", "count"), [(4, 25), (4, 32), (50, 393)])
def test_a_spline_between_its_values(samples: int, count: int) -> None:
    """Also beyond the last one, by less than an interval."""
    values = np.random.default_rng(4).normal(size=(2, samples))
    expected = CubicSpline(np.arange(samples), values, axis=1)(np.arange(count) / 8)
    np.testing.assert_allclose(interpolated(values, 8, count), expected, atol=1e-12)


@pytest.mark.parametrize("dt", [1e-3, 1e-2])
def test_from_rest_under_a_cubic(dt: float) -> None:
    """A spline is exact there: an integrator has to agree to its own tolerance, also where steps are short."""
    inertias, lag, times = np.array([0.002, 0.01]), 0.08, dt * np.arange(200)
    cubics = np.array([[1.5, -3.0, 2.0, 1.0], [0.7, 2.0, -1.0, 0.3]])
    q, dq, ddq = TransientResponse(inertias, lag, dt).motion(np.stack([np.polyval(c, times) for c in cubics]))
    for i, (inertia, c) in enumerate(zip(inertias, cubics, strict=True)):

        def rate(t: float, x: Array, c: Array = c, inertia: float = inertia) -> list[float]:
            return [x[1], (float(np.polyval(c, t)) - lag * x[1] - x[0]) / inertia]

        expected = solve_ivp(rate, (0, times[-1]), [c[3], 0.0], "DOP853", times, rtol=1e-12, atol=1e-13).y
        np.testing.assert_allclose([q[i], dq[i]], expected, atol=1e-10 * np.abs(expected).max())
        np.testing.assert_allclose(inertia * ddq[i] + lag * dq[i] + q[i], np.polyval(c, times), rtol=1e-12)


def test_a_mode_goes_on_as_a_filter_does() -> None:
    """Without drive but for the first sample's, the motion is that of its characteristic equation."""
    inertia, lag, dt, n = 0.002, 0.08, 5e-3, 300
    motion = np.empty((2, 1, n))
    mode = TransientResponse(np.array([inertia]), lag, dt)
    mode._recurrence(np.array([1.0]), np.zeros((1, 2, n - 1)), motion)
    trace, determinant = np.trace(mode.step), np.linalg.det(mode.step)
    impulse = np.eye(1, n)[0]
    expected = lfilter([1.0, mode.step[0, 0] - trace], [1.0, -trace, determinant], impulse)
    np.testing.assert_allclose(motion[0, 0], expected, atol=1e-12)


@pytest.mark.parametrize("periodic", [True, False])
def test_an_oscillator_obeys_its_equation(periodic: bool) -> None:
    rng = np.random.default_rng(2)
    root = rng.normal(size=(2, 3, 3))
    mass, stiffness = 1e-3 * (root[0] @ root[0].T + np.eye(3)), root[1] @ root[1].T + np.eye(3)
    oscillator = Oscillator.of(OscillatorCoefficients(mass, 0.02, stiffness), TimeBase(PERIOD / 101, periodic))
    drive = rng.normal(size=(3, 101))
    angles, rates, accelerations = np.split(oscillator.response(drive), 3)
    np.testing.assert_allclose(mass @ accelerations + stiffness @ (0.02 * rates + angles), drive, atol=1e-11)


@pytest.mark.parametrize("samples", [4, 5, 60])
@pytest.mark.parametrize("modes", [1, 2, 3])
def test_banded_equations_of_a_transient(modes: int, samples: int) -> None:
    """The response to their inputs solves the equations, whose coefficients differ from sample to sample by a tenth."""
    rng = np.random.default_rng(3)
    oscillator = Oscillator.of(OscillatorCoefficients(1e-3 * np.eye(modes), 0.02, np.eye(modes)), TimeBase(5e-3, False))
    by_each = np.eye(modes) + 0.1 * rng.normal(size=(samples, 3, modes, modes))
    by_response = np.concatenate([size * by_each[:, i] for i, size in enumerate((1.0, 0.02, 1e-3))], axis=2)
    rights = rng.normal(size=(2, modes, samples))
    for right, drive in zip(rights, oscillator.transient_inputs(by_response, rights), strict=True):
        np.testing.assert_allclose(bending._product(by_response, oscillator.response(drive)), right, atol=1e-10)
