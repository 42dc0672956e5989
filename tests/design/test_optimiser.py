"""The optimiser: exact derivatives, local optima, limits that hold, and processes that find the same."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import linprog

from design.criteria import AOptimal
from design.information import noise_equivalent_sizes
from design.optimiser.design_task import contracted_into_limits
from design.optimiser.interior_point import TerminationStatus
from design.optimiser.local_optimum import local_optimum, optimise
from design.optimiser.objective import Objective
from design.trajectories.fourier import PaperSeries
from design.trajectories.spline import RestToRest, SplineSeries
from design.trajectories.trajectory import Trajectory, TrajectorySeries
from modeling.errors import InputError
from modeling.rig import Limits, Workspace
from tests.shared.design_cases import BASE, CASES, FREE, LIMITS, functions, objective, of_model, task

Array = NDArray[np.float64]


# --------------------------------------------------------------------------------------- derivatives


@pytest.mark.parametrize("name", CASES)
def test_graph_is_the_criterion_and_its_hessian_the_gradients_slope(name: str) -> None:
    of = CASES[name]
    z = task(of.series).random((1,)).coefficients
    value, gradient, hessian = functions(of)
    assert of.exact
    # Two routes to one number through sums of 60 x 3 products: rounding of 1e-13, times the condition of M.
    assert float(value(z)) == pytest.approx(of.value(z), abs=1e-7)
    direction, step = np.random.default_rng(0).standard_normal(len(z)), 1e-5  # eps^(1/3) of coefficients of a tenth
    slope = np.array(gradient(z + step * direction) - gradient(z - step * direction)).ravel() / (2 * step)
    along = np.array(hessian(z)) @ direction
    np.testing.assert_allclose(along, slope, rtol=0, atol=1e-5 * np.abs(slope).max())


def test_memory_leaves_a_gradient() -> None:
    of = objective(experiment=of_model("sensor_lag"))
    z = task().random((1,)).coefficients
    assert not of.exact
    value, gradient, _ = functions(of)
    assert float(value(z)) == pytest.approx(of.value(z), abs=1e-6)
    rng = np.random.default_rng(0)
    direction, step = rng.standard_normal(len(z)), 1e-5  # eps^(1/3) of coefficients of a tenth
    slope = (of.value(z + step * direction) - of.value(z - step * direction)) / (2 * step)
    assert float(np.array(gradient(z)).ravel() @ direction) == pytest.approx(slope, rel=1e-5)


# ------------------------------------------------------------------------------------ what is found


def stationarity(of: Objective, motion: Trajectory, limits: Limits) -> float:
    """How much could be gained per unit of motion, to first order: max g'd over |d| <= 1 that keep the limits touched.

    A linear program with the limits at a dense grid; zero at a local optimum.
    """
    gradient = np.array(functions(of)[1](motion.coefficients)).ravel()
    time = np.linspace(0.0, motion.period, 4000, endpoint=False)
    rows, room = [], []
    for order, pairs in enumerate((limits.position, limits.velocity, limits.acceleration)):
        value, basis = motion.derivative(time, order), motion.series.basis(time, order)
        half = np.ptp(pairs, axis=1) / 2
        for j in range(motion.joints):
            for sign, limit in ((1, pairs[j, 1]), (-1, -pairs[j, 0])):
                near = limit - sign * value[:, j] < 0.2 * half[j]
                rows.append(sign * basis[near, j] / half[j])
                room.append(np.maximum(limit - sign * value[near, j], 0) / half[j])
    step = 0.01  # small enough to be first order, large against what is contracted
    found = linprog(-gradient, A_ub=np.vstack(rows), b_ub=np.concatenate(room), bounds=(-step, step))
    assert found.fun is not None
    return -float(found.fun)


@pytest.mark.parametrize("series", [FREE, PaperSeries(period=5.0)], ids=["free", "paper"])
def test_it_finds_a_local_optimum_within_the_limits(series: TrajectorySeries) -> None:
    asked = task(series)
    start = asked.random((3,))
    found = local_optimum(asked, start)
    assert found.outcome is TerminationStatus.CONVERGED
    assert found.value == asked.objective.value(found.motion.coefficients)
    assert asked.use(found.motion).worst.use <= 1
    # What contraction costs (LOSS = 0.01) may be left; the start could gain a hundred times as much.
    left, before = stationarity(asked.objective, found.motion, LIMITS), stationarity(asked.objective, start, LIMITS)
    assert left < 0.03
    assert before > 10 * left


@pytest.mark.parametrize(
    "series",
    [SplineSeries(joints=3, knots=16, degree=4, period=4.0), RestToRest(inner=FREE, ramp=0.5)],
    ids=["spline", "rest"],
)
def test_every_series_gains_and_keeps_its_limits(series: TrajectorySeries) -> None:
    asked = task(series)
    start = contracted_into_limits(asked, asked.random((1,)))
    assert start is not None
    found = local_optimum(asked, start)
    assert found.value > asked.objective.value(start.coefficients) + 1
    assert asked.use(found.motion).worst.use <= 1
    fine = np.linspace(0, series.duration, 20001)
    for order, pairs in enumerate((LIMITS.position, LIMITS.velocity, LIMITS.acceleration)):
        values = found.motion.derivative(fine, order)
        assert (values >= pairs[:, 0] - 1e-12).all()
        assert (values <= pairs[:, 1] + 1e-12).all()


def test_a_criterion_wins_in_its_own() -> None:
    d = task(PaperSeries(period=5.0))
    picky = noise_equivalent_sizes(BASE) * [1, 1, 1, 0.1, 1, 1]  # a tenth of an error in m counts as much
    a = replace(d, objective=replace(d.objective, criterion=AOptimal(picky)))
    best_d = local_optimum(d, d.random((3,))).motion
    best_a = local_optimum(a, best_d).motion
    assert a.objective.value(best_a.coefficients) > a.objective.value(best_d.coefficients) + 0.01
    assert d.objective.value(best_a.coefficients) < d.objective.value(best_d.coefficients)


def test_infeasible_starts_are_taken() -> None:
    asked = task()
    start = asked.random((5,)).scaled(4.0)
    assert asked.use(start).worst.use > 2
    assert asked.use(local_optimum(asked, start).motion).worst.use <= 1


@pytest.mark.long
def test_jerk_and_the_workspace_are_kept() -> None:
    jerk = np.array([[-60.0, 60.0]] * 3)
    asked = replace(
        task(), limits=replace(LIMITS, jerk=jerk), workspace=Workspace(x=(-1.2, 1.5), y=(0.8, 2.5)), tip_length=0.2
    )
    free = local_optimum(task(), task().random((2,)))
    found = local_optimum(asked, asked.random((2,)))
    use = asked.use(found.motion).to_data()
    assert set(use) == {"position", "velocity", "acceleration", "jerk", "workspace"}
    assert max(use.values()) <= 1
    assert max(use["jerk"], use["workspace"]) > 0.9, "the limits that were added decide"
    assert asked.use(free.motion).worst.use > 1, "or there would be nothing to keep"


@pytest.mark.long
def test_nothing_is_found_where_nothing_can_stand() -> None:
    asked = replace(task(), workspace=Workspace(y=(5.0, 6.0)), tip_length=0.2)
    with pytest.raises(InputError, match="no trajectory within the limits"):
        local_optimum(asked, task().random((2,)))


def test_an_unfinished_optimisation_says_so() -> None:
    found = local_optimum(replace(task(), iterations=2), task().random((1,)))
    assert found.outcome is TerminationStatus.ITERATIONS
    assert "allow more" in found.outcome.value


@pytest.mark.long
def test_processes_find_the_same() -> None:
    asked = task()
    starts = [asked.random((number,)) for number in range(2)]
    asked = replace(asked, iterations=25)
    told: list[float] = []
    alone = optimise(asked, starts)
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        together = optimise(asked, starts, executor=pool, progress=lambda attempt: told.append(attempt.value))
    assert sorted(told) == sorted(a.value for a in together)
    assert [a.value for a in together] == sorted((a.value for a in together), reverse=True)
    # The same arithmetic in another process: equal but for the order of sums.
    np.testing.assert_allclose([a.value for a in together], [a.value for a in alone], rtol=1e-9)
