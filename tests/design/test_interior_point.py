"""The interior point: its pieces against CasADi's, its optima against their conditions and against IPOPT's."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import nnls

from design.optimiser.design_task import DesignTask
from design.optimiser.interior_point import InteriorPoint, LimitedMemory, TerminationStatus, newton_descent_step
from design.optimiser.limit_constraints import LimitConstraints
from design.optimiser.local_optimum import optimise, refine_optimum, screen_start
from design.optimiser.objective import AdjointDerivatives, Objective, SecondOrderDerivatives
from design.trajectories.fourier import FreeSeries, PaperSeries
from design.trajectories.spline import RestToRest, SplineSeries
from design.trajectories.trajectory import Trajectory, TrajectorySeries
from modeling.rig import Workspace
from tests.shared.design_cases import CASES, FREE, functions, objective, task
from tests.shared.rigs import ARM

Array = NDArray[np.float64]
SERIES = {
    "free": FREE,
    "paper": PaperSeries(period=5.0),
    "spline": SplineSeries(joints=3, knots=12, degree=3, period=5.0),
    "rest": RestToRest(inner=FREE, ramp=0.5),
}


def medium(of: DesignTask) -> LimitConstraints:
    return LimitConstraints.medium(of.objective.series, of.limits)


def of_ipopt(of: Objective, rows: LimitConstraints, start: Array) -> Array:
    """The coefficients to which IPOPT brings the criterion's graph within linear limits."""
    z, polytope = ca.MX.sym("z", of.series.size), rows.polytope
    matrix = np.stack([polytope.change(unit) for unit in np.eye(of.series.size)], axis=1)
    middle = 1 - polytope.slack(np.zeros(of.series.size))[0]
    quiet: dict[str, Any] = {"ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-6, "ipopt.mu_init": 1e-4}
    quiet |= {"ipopt.hessian_approximation": "limited-memory", "print_time": False}
    program = {"x": z, "f": -of.graph(z), "g": ca.DM(matrix) @ z}
    solver = ca.nlpsol("design", "ipopt", program, quiet)
    return np.array(solver(x0=start, lbg=-1 - middle, ubg=1 - middle)["x"]).ravel()


@pytest.mark.parametrize("name", CASES)
def test_the_expansion_is_the_graph(name: str) -> None:
    of = CASES[name]
    z = task(of.series).random((1,)).coefficients
    value, gradient, hessian = functions(of)
    second, first = SecondOrderDerivatives(of).at(z), AdjointDerivatives(of).at(z)
    slope, bend = np.array(gradient(z)).ravel(), np.array(hessian(z))
    for expansion in (second, first):
        # Two routes to one number through sums of 60 x 3 products: rounding of 1e-13, times the condition of M.
        assert expansion.value == pytest.approx(float(value(z)), abs=1e-7)
        np.testing.assert_allclose(expansion.gradient, slope, rtol=0, atol=1e-8 * np.abs(slope).max())
    assert second.hessian is not None
    np.testing.assert_allclose(second.hessian, bend, rtol=0, atol=1e-8 * np.abs(bend).max())
    assert first.hessian is None


@pytest.mark.parametrize("series", SERIES.values(), ids=SERIES.keys())
def test_the_polytope_is_the_rows(series: TrajectorySeries) -> None:
    asked = task(series)
    rows, rng = medium(asked), np.random.default_rng(0)
    polytope, z = rows.polytope, asked.random((1,)).coefficients
    matrix = np.stack([polytope.change(unit) for unit in np.eye(series.size)], axis=1)
    value = 1 - polytope.slack(z)[0]
    shares = []
    for (order, j), times in rows.instants.items():
        least, most = (asked.limits.position, asked.limits.velocity, asked.limits.acceleration)[order][j]
        shares.append((series.evaluate(z, times, order)[:, j] - (least + most) / 2) / ((most - least) / 2))
    # The same rows, joint by joint instead of order by order.
    np.testing.assert_allclose(np.sort(value), np.sort(np.concatenate(shares)), atol=1e-12)
    np.testing.assert_allclose(polytope.slack(z).sum(axis=0), 2.0, atol=1e-12)
    np.testing.assert_allclose(polytope.change(z) - value, 1 - polytope.slack(0 * z)[1], atol=1e-12)
    both = np.ones((2, len(polytope)))
    np.testing.assert_allclose(polytope.gram(both), 2 * matrix.T @ matrix, atol=1e-9 * len(matrix))
    multipliers, step = rng.random((2, len(polytope))), rng.standard_normal(series.size)
    along = (multipliers[0] - multipliers[1]) @ polytope.change(step)
    assert polytope.pushed(multipliers) @ step == pytest.approx(along, rel=1e-9)


def test_reach_stops_where_the_margin_begins() -> None:
    asked = task()
    limits, motion = medium(asked).rows, asked.towards_rest(asked.random((1,)), 3.0)
    still = asked.still(motion)
    share = limits.reach(still, motion.coefficients, 0.1)
    assert share is not None
    there = limits.slack(still + share * (motion.coefficients - still))
    assert (there / limits.slack(still)).min() == pytest.approx(0.1)
    assert limits.reach(10 * np.ones(FREE.size), motion.coefficients, 0.1) is None


@pytest.mark.parametrize("series", SERIES.values(), ids=SERIES.keys())
def test_an_optimum_meets_its_conditions_and_ipopt_agrees(series: TrajectorySeries) -> None:
    asked = task(series)
    rows, start = medium(asked), asked.varied((3,), odd=False)
    polytope, derivatives = rows.polytope, SecondOrderDerivatives(asked.objective)
    found = InteriorPoint(derivatives, rows.rows).solve(start.coefficients, first=1e-3, last=1e-6, iterations=500)
    assert found.outcome is TerminationStatus.CONVERGED
    slack = polytope.slack(found.coefficients)
    assert slack.min() > 0
    expansion = derivatives.at(found.coefficients)
    gradient, hessian = expansion.gradient, expansion.hessian
    assert hessian is not None
    rows_of_a = np.stack([polytope.change(unit) for unit in np.eye(series.size)])
    # Rows with a multiplier of a thousandth or more are nearer than 1e-6 / 1e-3: those have to balance the gradient.
    pressing = np.hstack([rows_of_a[:, slack[0] < 1e-3], -rows_of_a[:, slack[1] < 1e-3]])
    assert nnls(pressing, gradient)[1] < 1e-2 * np.linalg.norm(gradient)
    assert np.linalg.eigvalsh(polytope.gram(1e-6 / slack**2) - hessian)[0] > 0, "a maximum, not a saddle"
    again = of_ipopt(asked.objective, rows, found.coefficients)
    # IPOPT may gain what the rows that press leave, about 1e-6 each, and passes limits by 1e-8.
    assert asked.objective.value(again) == pytest.approx(expansion.value, abs=1e-3)


def test_a_step_goes_down_whatever_the_curvature() -> None:
    rng = np.random.default_rng(1)
    for shift in (-2.0, 0.0, 5.0):
        matrix = rng.standard_normal((8, 8))
        matrix, slope = matrix + matrix.T + shift * np.eye(8), rng.standard_normal(8)
        assert slope @ newton_descent_step(matrix, slope) < 0
        definite = matrix @ matrix.T + np.eye(8)
        np.testing.assert_allclose(definite @ newton_descent_step(definite, slope), -slope, atol=1e-10)


@pytest.mark.parametrize("name", ["free", "rest", "spline"])
def test_odd_motions_are_odd_about_their_posture(name: str) -> None:
    series = SERIES[name]
    motion = task(series).random((4,)).odd()
    time = np.linspace(0, series.duration, 101)
    there, back = motion.derivative(time, 0), motion.derivative(series.duration - time, 0)
    posture = (there + back) / 2
    np.testing.assert_allclose(posture, np.broadcast_to(posture[0], posture.shape), atol=1e-9)
    np.testing.assert_allclose(motion.odd().coefficients, motion.coefficients, atol=1e-9)


def test_an_odd_motion_tells_what_its_image_tells() -> None:
    motion = task().random((4,))
    time = FREE.instants(60)
    # Time reversed and the arm mirrored: the same information where gravity's side does not matter to ln det.
    values = -motion.derivative(FREE.duration - time, 0)
    image = np.linalg.lstsq(FREE.basis(time, 0).reshape(-1, FREE.size), values.ravel(), rcond=None)[0]
    of = objective()
    assert of.value(np.asarray(image, dtype=np.float64)) == pytest.approx(of.value(motion.coefficients), abs=1e-8)


def test_few_samples_stand_for_many() -> None:
    asked = replace(task(), objective=objective(samples=400))
    motion, few = asked.random((1,)), asked.thinned
    assert few.objective.samples < 400
    size = asked.objective.experiment.size
    more = asked.objective.criterion.degree(size) * np.log(400 / few.objective.samples)
    assert few.at(motion.coefficients).value + more == pytest.approx(
        asked.objective.value(motion.coefficients), abs=1e-4
    )


def test_what_is_screened_is_polished_into_the_limits() -> None:
    asked = task()
    screened = screen_start(asked, asked.varied((1,), odd=True))
    polished = refine_optimum(asked, screened.motion)
    assert asked.use(polished.motion).worst.use <= 1 < asked.use(screened.motion).worst.use
    # Limits between the screening's instants are passed by 2 % at the most, which is worth a tenth of a nat.
    assert screened.value - 0.3 < polished.value < screened.value


def test_without_second_derivatives_it_comes_to_the_same_optimum() -> None:
    """The quasi-Newton way from a start near it, within what it leaves: a hundredth of a nat and 1e-4 a row."""
    asked = task()
    rows, start = medium(asked), asked.varied((3,), odd=False)
    exact = InteriorPoint(SecondOrderDerivatives(asked.objective), rows.rows)
    found = exact.solve(start.coefficients, first=1e-3, last=1e-4, iterations=500).coefficients
    static = asked.still(Trajectory(FREE, found))
    near = InteriorPoint(AdjointDerivatives(asked.objective), rows.rows)
    again = near.solve(static + 0.95 * (found - static), first=1e-3, last=1e-4, iterations=500)
    assert again.outcome is TerminationStatus.CONVERGED
    assert asked.objective.value(again.coefficients) == pytest.approx(asked.objective.value(found), abs=0.02)


def test_what_the_last_steps_say_of_the_curvature() -> None:
    """Of a quadratic the remembered steps' curvature is exact along the last one, and it is always positive."""
    rng, memory = np.random.default_rng(0), LimitedMemory()
    root = rng.standard_normal((5, 5))
    bent = root @ root.T
    steps = rng.standard_normal((9, 5))
    for step in steps:
        memory.remember(step, bent @ step)
    step = steps[-1]
    memory.remember(step, -bent @ step)  # of no convex curvature: not taken
    matrix = memory.matrix(step)
    np.testing.assert_allclose(matrix @ step, bent @ step, rtol=1e-10)
    assert np.linalg.eigvalsh(matrix)[0] > 0


def test_places_are_expanded_about_a_trajectory() -> None:
    """The tip's rows against its own kinematics, and their slopes against a central difference."""
    asked = task(workspace=Workspace(x=(-1.2, 1.5), y=(0.4, 2.6)), tip_length=0.2)
    motion, rows = asked.random((2,)), asked.ranking_limits
    limits, z, many = rows.rows, motion.coefficients, len(rows.polytope)
    angle = np.cumsum(motion.derivative(rows.bent[0][1], 0), axis=1)
    lengths = np.array([*ARM.link_lengths[:2], ARM.link_lengths[2] + 0.2])
    tip = np.stack([np.sin(angle) @ lengths, np.cos(angle) @ lengths], axis=1)
    margin = 0.01 * np.array([1.35, 1.1])
    use = (tip - [0.15, 1.5]) / (np.array([1.35, 1.1]) - np.minimum(margin, 0.01))
    np.testing.assert_allclose(limits.slack(z)[:, many:], [1 - use.ravel(), 1 + use.ravel()], atol=1e-12)
    step, h = np.random.default_rng(0).standard_normal(len(z)), 1e-6
    slope = (limits.slack(z - h * step)[0] - limits.slack(z + h * step)[0]) / (2 * h)
    np.testing.assert_allclose(limits.about(z, limits.slack(z)).change(step), slope, atol=1e-7)
    np.testing.assert_allclose(limits.about(z, limits.slack(z)).slack(z), limits.slack(z), atol=1e-12)


def test_any_executor_finds_the_same_in_the_same_order() -> None:
    asked = task(FreeSeries(joints=3, harmonics=(1, 2), period=5.0))
    starts = [asked.varied((0, place), odd=False) for place in (0, 1, 0, 2)]
    alone = optimise(asked, starts, work=screen_start)
    with ThreadPoolExecutor(3) as pool:
        together = optimise(asked, starts, work=screen_start, executor=pool)
    assert [a.value for a in together] == [a.value for a in alone]
    for one, other in zip(alone, together, strict=True):
        assert (one.motion.coefficients == other.motion.coefficients).all()
    assert isinstance(alone[0].motion, Trajectory)
