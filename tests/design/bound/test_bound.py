"""The upper bound against motions, brute force, dense scans, another solver, and its own optimality conditions."""

from __future__ import annotations

import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize

from design.bound import BoundKind, DualityBound, Effort, PolynomialDegrees, ViableStates, WeakDuality, upper_bound
from design.bound.column_generation import DualCoordinates, RestrictedMaster
from design.bound.dual_function import SignChange
from design.bound.upper_bound import dual_function
from design.information import Experiment
from design.limits import LimitUse
from design.random_feasible import random_feasible_trajectory
from design.trajectories.fourier import FreeSeries
from design.trajectories.trajectory import Trajectory
from modeling.chain.model import planar, spatial
from modeling.effects.geometry import GravityTilt
from modeling.effects.sensor import SensorLag
from modeling.errors import InputError
from modeling.kinematics.arm import PlanarArm
from modeling.noise import NoiseModel
from modeling.rig import Convention
from tests.shared.bound_cases import (
    ARM,
    CASES,
    ONE,
    QUICK,
    SINGLE,
    SKEW,
    SYMMETRIC,
    Array,
    bound_of,
    limits,
    plain_function,
    random_dual,
    random_motion,
    viable_states,
)
from tests.shared.rigs import spatial_arm


@pytest.fixture(scope="module")
def bounds() -> dict[str, DualityBound]:
    return {case: bound_of(case, PolynomialDegrees(each=4, pair=2, more=0)) for case in CASES}


# ------------------------------------------------------------------------------------------- F and the conditions


@pytest.mark.parametrize("seed", range(3))
def test_conditions_vanish_along_every_motion_whatever_their_degree(case: str, seed: int) -> None:
    function = plain_function(case, PolynomialDegrees(each=6, pair=4, more=0))
    along = WeakDuality.of(function, random_dual(function, seed), random_motion(case, seed), 200)
    assert along.conditions < 1e-10  # share of the rms: rounding of a mean


def test_slopes_are_those_of_finite_differences(case: str) -> None:
    function = plain_function(case, PolynomialDegrees(each=4, pair=4, more=0))
    dual, rng = random_dual(function, 1), np.random.default_rng(2)
    points = rng.uniform(-0.9, 0.9, (5, 2 * function.joints))
    ddq = function.viable.vertices[rng.integers(len(function.viable.vertices), size=5)]
    _, slope = function.value_and_gradient(points, ddq, dual)
    step = 1e-5 * np.eye(points.shape[1])  # balances the third derivative against rounding
    for i, along in enumerate(step):
        difference = (
            function.value_and_gradient(points + along, ddq, dual)[0]
            - function.value_and_gradient(points - along, ddq, dual)[0]
        )
        assert np.allclose(slope[:, i], difference / 2e-5, rtol=1e-5, atol=1e-5 * np.abs(slope).max())


def test_the_value_is_what_the_moments_say_and_largest_at_a_vertex_of_the_accelerations(case: str) -> None:
    function = plain_function(case, PolynomialDegrees(each=4, pair=2, more=0))
    dual, rng = random_dual(function, 3), np.random.default_rng(4)
    points = rng.uniform(-1, 1, (300, 2 * function.joints))
    values = function.values(points, dual)
    low, high = function.viable.limits.acceleration.T
    inside = rng.uniform(low, high, (300, function.joints))
    for column, ddq in [*enumerate(function.viable.vertices), (-1, inside)]:
        gram, rates = function.moments(function.states(points, np.broadcast_to(ddq, inside.shape)))
        F = np.einsum("ij,nij->n", dual.D, gram) + rates @ dual.c
        scale = np.abs(values).max()
        if column >= 0:
            assert np.allclose(values[:, column], F, atol=1e-12 * scale)
        else:
            assert (values.max(axis=1) - F).min() >= -1e-12 * scale


def test_symmetries_are_found_where_they_are_and_leave_fewer_conditions() -> None:
    degrees = PolynomialDegrees(each=4, pair=4, more=0)
    both = dual_function(Experiment.of(planar(), ARM), ViableStates(SYMMETRIC), degrees, 0)
    none = dual_function(Experiment.of(planar(), ARM), ViableStates(SKEW), degrees, 0)
    assert [s.change for s in both[1]] == [SignChange.REVERSAL, SignChange.MIRROR]
    assert none[1] == ()
    assert len(both[0].conditions) < len(none[0].conditions) / 2
    assert "T1(q2) T1(dq2)" in both[0].conditions.names


# ------------------------------------------------------------------------------------------- weak duality


@pytest.mark.parametrize("seed", range(10))
def test_no_random_motion_is_above_the_bound(bounds: dict[str, DualityBound], case: str, seed: int) -> None:
    along = bounds[case].weak_duality(random_motion(case, seed))
    assert along.excess <= 1e-12
    assert along.dual <= 6
    assert along.logdet <= along.weak + 1e-9 <= bounds[case].logdet + 2e-9  # rounding of ln det
    assert abs(along.quadrature) < 1e-6, "of 200 samples of at most the 16th harmonic's products"


def climbed(case: str, bound: DualityBound, value: str) -> WeakDuality:
    """A motion that hill climbing makes large in what the bound says along it, never beyond the limits."""
    rng, within = np.random.default_rng(5), CASES[case][1]
    motion = random_motion(case, 0)
    best, rest = bound.weak_duality(motion), motion.series.rest(within.position.mean(axis=1))
    for attempt in range(40):
        step = 0.2 * 0.9**attempt * rng.standard_normal(motion.series.size)
        moving = motion.coefficients + step - rest
        tries = (Trajectory(motion.series, rest + 0.8**i * moving) for i in range(40))
        tried = next(t for t in tries if LimitUse.of(t, within).worst.use <= 1)
        along = bound.weak_duality(tried)
        if getattr(along, value) > getattr(best, value):
            motion, best = tried, along
    return best


@pytest.mark.parametrize("value", ["logdet", "dual"])
@pytest.mark.parametrize("name", ["symmetric", "skew single"])
def test_no_optimised_motion_is_above_the_bound(bounds: dict[str, DualityBound], name: str, value: str) -> None:
    best = climbed(name, bounds[name], value)
    first = bounds[name].weak_duality(random_motion(name, 0))
    assert getattr(best, value) > getattr(first, value), "the climb has gone up"
    assert best.dual <= 6
    assert best.logdet <= best.weak + 1e-9 <= bounds[name].logdet + 2e-9


def test_no_viable_state_of_a_dense_scan_has_a_larger_value(bounds: dict[str, DualityBound], case: str) -> None:
    bound = bounds[case]
    rng = np.random.default_rng(77)
    points = rng.uniform(-1, 1, (5000, 2 * bound.function.joints))
    assert bound.function.values(points, bound.dual).max() <= 6 * (1 + 1e-6)
    gram, rates = bound.function.moments(viable_states(bound.function.viable, 10_000, rng))
    assert (np.einsum("ij,nij->n", bound.dual.D, gram) + rates @ bound.dual.c).max() <= 6 * (1 + 1e-6)


def test_the_measure_meets_the_conditions_and_its_information_is_what_can_be_reached(
    bounds: dict[str, DualityBound],
) -> None:
    for bound in bounds.values():
        gram, rates = bound.function.moments(bound.states)
        mean, scale = bound.weights @ rates, np.sqrt(bound.weights @ rates**2)
        assert bound.weights.sum() == pytest.approx(1)
        # One per cent of the weights, those of the barrier, are left out.
        assert np.abs(mean / scale).max() < 0.1
        logdet = np.linalg.slogdet(200 * np.tensordot(bound.weights, gram, axes=1))[1]
        assert logdet == pytest.approx(bound.primal_value, abs=0.1)
        assert bound.primal_value <= bound.logdet <= bound.primal_value + QUICK.tolerance


def test_more_conditions_never_raise_the_bound() -> None:
    logdets = [bound_of("skew single", PolynomialDegrees(each=each, pair=0, more=0)).logdet for each in (0, 2, 6)]
    # Each is within the tolerance of its own optimum, and the optimum cannot rise.
    assert (np.diff(logdets) <= QUICK.tolerance).all()
    assert logdets[-1] < logdets[0] - 2 * QUICK.tolerance


# ------------------------------------------------------------------------------------------- other routes


def test_the_reference_problem_beats_the_figures_without_viability() -> None:
    # PHYSICS.md: 54.66 without conditions, 54.11 up to degree 2, both over the whole box and rounded to 0.01.
    within = limits(
        np.radians([[-60, 60], [-70, 70], [-80, 80]]),
        [[-2, 2], [-2.2, 2.2], [-3.5, 3.5]],
        [[-10, 10], [-10, 10], [-15, 15]],
    )
    arm = PlanarArm((1.0, 0.97, 0.4))
    effort = Effort(tolerance=0.05, starts=2000)
    for degree, figure in ((2, 54.11),):
        degrees = PolynomialDegrees(each=degree, pair=degree, more=degree)
        bound = upper_bound(planar(), arm, within, samples=200, degrees=degrees, effort=effort)
        assert bound.primal_value < figure - 0.05
        assert bound.logdet <= bound.primal_value + effort.tolerance
        # The best motion seen by the time of writing: a bound below it would be false.
        assert bound.logdet > 52.95
        motion = random_feasible_trajectory(FreeSeries(joints=3, harmonics=(1, 2, 3, 4), period=5.0), within, seed=1)
        assert bound.weak_duality(motion).dual <= 6
        assert "mean of F" in str(bound.weak_duality(motion))


@pytest.mark.parametrize("name", ["single", "skew single"])
def test_one_joint_agrees_with_a_conic_solver_on_a_fine_grid(bounds: dict[str, DualityBound], name: str) -> None:
    cp: Any = pytest.importorskip("cvxpy")

    bound = bounds[name]
    function, viable = bound.function, bound.function.viable
    line = np.linspace(-1, 1, 33)
    points = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    states = np.vstack([function.states(points, np.broadcast_to(a, (len(points), 1))) for a in viable.vertices])
    gram, rates = function.moments(states)
    scale, rates = np.sqrt(np.einsum("nii->i", gram) / len(gram)), rates / np.abs(rates).max(axis=0)
    weights = cp.Variable(len(states), nonneg=True)
    mean = cp.reshape((gram / np.multiply.outer(scale, scale)).reshape(-1, 36).T @ weights, (6, 6), order="C")
    problem = cp.Problem(cp.Maximize(cp.log_det(mean)), [cp.sum(weights) == 1, rates.T @ weights == 0])
    problem.solve(solver=cp.CLARABEL)
    logdet = float(problem.value) + 2 * np.log(scale).sum() + 6 * np.log(200)
    # A grid of 1/16 of the half widths misses peaks by at most half a step: O((1/32)²) of F's curvature.
    assert logdet <= bound.logdet + 1e-6
    assert logdet == pytest.approx(bound.primal_value, abs=0.06)


def test_the_master_meets_its_optimality_conditions() -> None:
    function = plain_function("skew", PolynomialDegrees(each=2, pair=2, more=0))
    states = viable_states(function.viable, 400, np.random.default_rng(6))
    gram, rates = function.moments(states)
    coordinates = DualCoordinates.of(gram, rates, ())
    start = RestrictedMaster(coordinates, np.zeros((0, len(coordinates.start()))), coordinates.start())
    mu = 1e-4
    master = start.joined(coordinates.rows(gram, rates), np.zeros(0, dtype=np.intp)).centred(mu)
    weights, dual = master.weights(mu), coordinates.dual(master.z)
    information = np.tensordot(weights, gram, axes=1)
    # The Newton decrement at which it stops, 0.1 sqrt(mu), is what the gradient is off by in the Hessian's norm.
    assert np.allclose(information @ dual.D, np.eye(6), atol=0.02)
    assert np.abs(weights @ rates / np.sqrt(weights @ rates**2)).max() < 0.02
    assert weights.sum() == pytest.approx(1 + len(states) * mu / 6, rel=1e-3)
    assert master.slack.min() > 0


def test_weights_of_the_readings_move_the_bound_as_they_move_every_information(bounds: dict[str, DualityBound]) -> None:
    noise = NoiseModel.white((0.5, 0.5, 0.5))
    quiet = upper_bound(
        planar(), ONE, SINGLE, samples=200, noise=noise, degrees=PolynomialDegrees(each=4, pair=2, more=0), effort=QUICK
    )
    assert quiet.logdet == pytest.approx(bounds["single"].logdet + 12 * np.log(2), abs=QUICK.tolerance)


def test_threads_and_processes_may_share_the_search(bounds: dict[str, DualityBound]) -> None:
    with ThreadPoolExecutor(2) as executor:
        same = upper_bound(
            planar(),
            ONE,
            SINGLE,
            samples=200,
            degrees=PolynomialDegrees(each=4, pair=2, more=0),
            effort=QUICK,
            executor=executor,
        )
    assert same.logdet == pytest.approx(bounds["single"].logdet, abs=1e-12)
    function = pickle.loads(pickle.dumps(same.function))  # noqa: S301
    points = np.zeros((1, 2))
    assert np.array_equal(function.values(points, same.dual), same.function.values(points, same.dual))


@pytest.mark.long(12)
def test_a_bound_of_six_axes_holds_for_motions_and_for_another_search() -> None:
    """Loose and quick: degree 2 of each joint, one round. The largest F is searched anew by L-BFGS-B from 8 random
    points of the cube at random vertices of ddq: all end below k but for a hundredth."""
    arm = spatial_arm("elbow")
    within = limits([[-2, 2]] * 6, [[-1.5, 1.5]] * 6, [[-5, 5]] * 6)
    effort = Effort(tolerance=1.0, starts=1000, rounds=8)
    model = replace(spatial(), convention=Convention.ON_TOOL)
    bound = upper_bound(
        model, arm, within, samples=200, degrees=PolynomialDegrees(each=2, pair=0, more=0), effort=effort
    )
    function, rng = bound.function, np.random.default_rng(4)
    assert bound.kind is BoundKind.CHECKED
    assert bound.primal_value <= bound.logdet
    for seed in range(2):
        series = FreeSeries(joints=6, harmonics=(1, 2, 3), period=8.0)
        along = bound.weak_duality(random_feasible_trajectory(series, within, seed=seed))
        assert along.excess <= 1e-9
        assert along.dual <= function.size
        assert along.logdet <= along.weak <= bound.logdet
    largest = 0.0
    for point in rng.uniform(-1, 1, (8, 12)):
        ddq = function.viable.vertices[rng.integers(64)]

        def negative(u: Array, ddq: Array = ddq) -> tuple[float, Array]:
            value, slope = function.value_and_gradient(u[None], ddq[None], bound.dual)
            return -float(value[0]), -slope[0]

        largest = max(largest, -float(minimize(negative, point, jac=True, bounds=[(-1, 1)] * 12).fun))
    assert 0.5 * function.size < largest < 1.01 * function.size


# ------------------------------------------------------------------------------------------- what it says


def test_the_table_says_what_is_checked_and_what_is_proven(bounds: dict[str, DualityBound]) -> None:
    text = str(bounds["symmetric"])
    assert f"{bounds['symmetric'].logdet:.3f} (checked)" in text
    assert "largest F is not" in text
    assert bounds["symmetric"].efficiency(bounds["symmetric"].logdet - 6 * np.log(2)) == pytest.approx(0.5)


def test_a_model_with_an_effect_has_a_bound() -> None:
    model, values = planar() + GravityTilt(), {"m": 0.5, "mlg": 0.05, "I": 0.01}
    bound = upper_bound(
        model, ONE, SINGLE, samples=200, values=values, degrees=PolynomialDegrees(each=2, pair=0, more=0), effort=QUICK
    )
    along = bound.weak_duality(random_motion("single", 3))
    assert along.dual <= len(bound.parameters) > 6
    assert along.logdet <= bound.logdet


def test_what_the_bound_is_not_for() -> None:
    with pytest.raises(InputError, match="does not follow from its state"):
        upper_bound(planar() + SensorLag(), ONE, SINGLE, samples=200, values={"m": 0.5})
    with pytest.raises(InputError, match="positive numbers"):
        Effort(rounds=0)
    with pytest.raises(InputError, match="limits of 2 joints"):
        upper_bound(planar(), ARM, SINGLE, samples=200)
    with pytest.raises(InputError, match="zero inside"):
        upper_bound(planar(), ONE, limits([[-1, 1]], [[0.5, 1]], [[-1, 1]]), samples=200)
    with pytest.raises(InputError, match="at most 7 joints"):
        upper_bound(planar(), PlanarArm((1.0,) * 8), limits([[-1, 1]] * 8, [[-1, 1]] * 8, [[-1, 1]] * 8), samples=200)
