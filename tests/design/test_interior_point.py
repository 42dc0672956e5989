"""The interior point: its pieces against CasADi's, its optima against their conditions and against IPOPT's."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import nnls

from design.optimiser.design_task import DesignTask
from design.optimiser.interior_point import (
    InteriorPoint,
    TerminationStatus,
    limit_constrained_program,
    newton_descent_step,
)
from design.optimiser.limit_constraints import LimitConstraints
from design.optimiser.local_optimum import optimise, refine_optimum, screen_start
from design.optimiser.objective import ObjectiveDerivatives
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


def coarse(of: DesignTask) -> LimitConstraints:
    return LimitConstraints.coarse(of.objective.series, of.limits, arm=ARM, workspace=None, tip_length=None)


@pytest.mark.parametrize("name", CASES)
def test_the_expansion_is_the_graph(name: str) -> None:
    of = CASES[name]
    z = task(of.series).random((1,)).coefficients
    value, gradient, hessian = functions(of)
    slope, bend = ObjectiveDerivatives(of).second_order(z)
    # Two routes to one number through sums of 60 x 3 products: rounding of 1e-13, times the condition of M.
    assert ObjectiveDerivatives(of).value(z) == pytest.approx(float(value(z)), abs=1e-7)
    np.testing.assert_allclose(slope, np.array(gradient(z)).ravel(), rtol=0, atol=1e-8 * np.abs(slope).max())
    np.testing.assert_allclose(bend, np.array(hessian(z)), rtol=0, atol=1e-8 * np.abs(bend).max())


@pytest.mark.parametrize("series", SERIES.values(), ids=SERIES.keys())
def test_the_polytope_is_the_rows(series: TrajectorySeries) -> None:
    asked = task(series)
    rows, rng = coarse(asked), np.random.default_rng(0)
    polytope, z = rows.polytope, asked.random((1,)).coefficients
    symbol = ca.MX.sym("z", series.size)
    graph, low, high = rows.graph(symbol)
    value = np.array(ca.Function("g", [symbol], [graph])(z)).ravel()
    matrix = np.array(ca.Function("A", [symbol], [ca.jacobian(graph, symbol)])(z))
    shares = []
    for (order, j), times in rows.instants.items():
        least, most = (asked.limits.position, asked.limits.velocity, asked.limits.acceleration)[order][j]
        shares.append((series.evaluate(z, times, order)[:, j] - (least + most) / 2) / ((most - least) / 2))
    # The same rows, joint by joint instead of order by order.
    np.testing.assert_allclose(np.sort(value), np.sort(np.concatenate(shares)), atol=1e-12)
    np.testing.assert_allclose(polytope.slack(z), [high - value, value - low], atol=1e-12)
    both = np.ones((2, len(polytope)))
    np.testing.assert_allclose(polytope.gram(both), 2 * matrix.T @ matrix, atol=1e-9 * len(matrix))
    multipliers, step = rng.random((2, len(polytope))), rng.standard_normal(series.size)
    along = (multipliers[0] - multipliers[1]) @ polytope.change(step)
    assert polytope.pushed(multipliers) @ step == pytest.approx(along, rel=1e-9)


def test_reach_stops_where_the_margin_begins() -> None:
    asked = task()
    polytope, motion = coarse(asked).polytope, asked.towards_rest(asked.random((1,)), 3.0)
    still = asked.still(motion)
    share = polytope.reach(still, motion.coefficients, 0.1)
    assert share is not None
    there = polytope.slack(still + share * (motion.coefficients - still))
    assert (there / polytope.slack(still)).min() == pytest.approx(0.1)
    assert polytope.reach(10 * np.ones(FREE.size), motion.coefficients, 0.1) is None


@pytest.mark.parametrize("series", SERIES.values(), ids=SERIES.keys())
def test_an_optimum_meets_its_conditions_and_ipopt_agrees(series: TrajectorySeries) -> None:
    asked = task(series)
    rows, start = coarse(asked), asked.varied((3,), odd=False)
    polytope, derivatives = rows.polytope, ObjectiveDerivatives(asked.objective)
    found = InteriorPoint(derivatives, polytope).solve(start.coefficients, first=1e-3, last=1e-6, iterations=500)
    assert found.outcome is TerminationStatus.CONVERGED
    slack = polytope.slack(found.coefficients)
    assert slack.min() > 0
    gradient, hessian = derivatives.second_order(found.coefficients)
    rows_of_a = np.stack([polytope.change(unit) for unit in np.eye(series.size)])
    # Rows with a multiplier of a thousandth or more are nearer than 1e-6 / 1e-3: those have to balance the gradient.
    pressing = np.hstack([rows_of_a[:, slack[0] < 1e-3], -rows_of_a[:, slack[1] < 1e-3]])
    assert nnls(pressing, gradient)[1] < 1e-2 * np.linalg.norm(gradient)
    assert np.linalg.eigvalsh(polytope.gram(1e-6 / slack**2) - hessian)[0] > 0, "a maximum, not a saddle"
    value = derivatives.value(found.coefficients)
    again = limit_constrained_program(asked.objective, rows, found.coefficients).solve(iterations=200, warm=True)
    # IPOPT may gain what the rows that press leave, about 1e-6 each, and passes limits by 1e-8.
    assert asked.objective.value(again.coefficients) == pytest.approx(value, abs=1e-3)


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
    assert few.value(motion.coefficients) + more == pytest.approx(asked.objective.value(motion.coefficients), abs=1e-4)


def test_what_is_screened_is_polished_into_the_limits() -> None:
    asked = task()
    screened = screen_start(asked, asked.varied((1,), odd=True))
    polished = refine_optimum(asked, screened.motion)
    assert asked.use(polished.motion).worst.use <= 1 < asked.use(screened.motion).worst.use
    # Limits between the screening's instants are passed by 2 % at the most, which is worth a tenth of a nat.
    assert screened.value - 0.3 < polished.value < screened.value


def test_a_workspace_is_left_to_ipopt() -> None:
    assert task().direct
    assert not task(workspace=Workspace(y=(0.4, 2.6)), tip_length=0.2).direct


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
