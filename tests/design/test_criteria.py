"""Every criterion by one suite: concave, monotone, homogeneous, its gradient, its graph, its invariances, its optimum.

The optimum is checked by the equivalence theorem (Kiefer and Wolfowitz 1960, for concave criteria Pukelsheim 1993,
chapter 7): weights w of points with informations m_i are best exactly when tr(gradient(M) m_i) <= tr(gradient(M) M) for
all i, with equality where w_i > 0.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray

from design.criteria import AOptimal, BayesianCriterion, Beside, Criterion, DOptimal, EOptimal, MaximinCriterion, Subset
from design.information import Experiment
from modeling.chain.model import planar
from modeling.errors import InputError
from modeling.kinematics.arm import PlanarArm

Array = NDArray[np.float64]

SIZE = 6
SCALE = np.array([2.0, 0.3, 1.0, 5.0, 0.7, 0.1])
CASES: dict[str, Criterion] = {
    "D": DOptimal(),
    "A": AOptimal(SCALE),
    "E": EOptimal(SCALE),
    "E, coarse": EOptimal(SCALE, power=4),
    "Ds": Subset((4, 1)),
    "Ds of all": Subset(tuple(range(SIZE))),
    "mean of D": BayesianCriterion(DOptimal(), (0.3, 0.7)),
    "mean of A": BayesianCriterion(AOptimal(SCALE[:2]), (0.5, 0.25, 0.25)),
    "smallest of Ds and D": MaximinCriterion((Subset((3, 2)), DOptimal()), (4, 2)),
    "D beside nothing": Beside(DOptimal(), (4, 0, 2, 5, 1, 3), np.zeros((SIZE, SIZE)), runs=3),
    "smallest of Ds": MaximinCriterion((Subset((3,)), Subset((0,))), (4, 2)),
}
EVERY = pytest.mark.parametrize("criterion", CASES.values(), ids=CASES.keys())
SEEDS = pytest.mark.parametrize("seed", range(4))


def information(rng: np.random.Generator, size: int = SIZE, rows: int | None = None) -> Array:
    """A Gram matrix of random rows in units that differ by a factor of up to a hundred."""
    design = rng.standard_normal((rows or 3 * size, size)) * 10 ** rng.uniform(-1, 1, size)
    return np.asarray(design.T @ design)


def members(family: Any) -> Iterator[type[Criterion]]:
    for child in family.__subclasses__():
        if not inspect.isabstract(child) and child.__module__.startswith("design."):
            yield child
        yield from members(child)


def test_every_criterion_has_a_case() -> None:
    assert set(members(Criterion)) == {type(criterion) for criterion in CASES.values()}


def test_each_has_a_name_and_a_unit_for_tables() -> None:
    assert len({c.name for c in CASES.values()}) == len(set(members(Criterion)))
    assert all(str(c) and c.unit for c in CASES.values())


# ------------------------------------------------------------------------------------------ the suite


def definition(criterion: Criterion, matrix: Array) -> float:
    """The criterion by NumPy's eigenvalues, determinants and inverse, from its definition."""
    if isinstance(criterion, BayesianCriterion):
        parts = np.split(np.arange(SIZE), len(criterion.weights))
        return float(
            criterion.weights @ np.array([definition(criterion.criterion, matrix[np.ix_(i, i)]) for i in parts])
        )
    if isinstance(criterion, MaximinCriterion):
        parts = np.split(np.arange(SIZE), np.cumsum(criterion.sizes)[:-1])
        members = zip(criterion.criteria, parts, strict=True)
        values = np.array([definition(member, matrix[np.ix_(i, i)]) for member, i in members])
        return -float(np.log(np.exp(-criterion.power * (values - values.min())).sum()) / criterion.power - values.min())
    if isinstance(criterion, Beside):
        total = criterion.runs * matrix[np.ix_(criterion.kept, criterion.kept)] + criterion.gathered
        return definition(criterion.criterion, total)
    covariance = np.linalg.inv(matrix)
    if isinstance(criterion, Subset):
        return -float(np.linalg.slogdet(covariance[np.ix_(criterion.indices, criterion.indices)])[1])
    if isinstance(criterion, AOptimal):
        return -float(np.log(np.mean(np.diag(covariance) / criterion.scale**2)))
    if isinstance(criterion, EOptimal):
        variances = np.linalg.eigvalsh(covariance / np.outer(criterion.scale, criterion.scale))
        return -float(np.log(np.sum(variances**criterion.power)) / criterion.power)
    return float(np.linalg.slogdet(matrix)[1])


@EVERY
@SEEDS
def test_value_is_that_of_the_definition(criterion: Criterion, seed: int) -> None:
    matrix = information(np.random.default_rng([18, seed]))
    assert criterion.value(matrix) == pytest.approx(
        definition(criterion, matrix), rel=1e-10, abs=1e-10
    )  # condition 1e5


def test_what_is_known_is_added_to_the_runs_and_what_is_fixed_is_left_out() -> None:
    """A motion that alone identifies one of three estimated parameters, beside what tells the others."""
    rng = np.random.default_rng(19)
    known, kept = information(rng, 3), (5, 0, 2)
    criterion = Beside(EOptimal(SCALE[:3]), kept, known, runs=2)
    matrix = np.zeros((SIZE, SIZE))
    matrix[5, 5] = 0.7
    assert criterion.value(matrix) == pytest.approx(definition(criterion, matrix), rel=1e-10)
    step = np.zeros((SIZE, SIZE))
    step[0, 0] = 1e-5
    slope = (criterion.value(matrix + step) - criterion.value(matrix - step)) / 2e-5
    assert criterion.gradient(matrix)[0, 0] == pytest.approx(slope, rel=1e-5)
    assert not criterion.gradient(matrix)[[1, 3, 4]].any()


@EVERY
@SEEDS
def test_is_concave(criterion: Criterion, seed: int) -> None:
    rng = np.random.default_rng([1, seed])
    one, other = information(rng), information(rng)
    for share in rng.uniform(0, 1, 10):
        between = criterion.value((1 - share) * one + share * other)
        chord = (1 - share) * criterion.value(one) + share * criterion.value(other)
        assert between >= chord - 1e-11 * (1 + abs(chord))  # rounding of logarithms of order 10


@EVERY
@SEEDS
def test_never_falls_with_more_information(criterion: Criterion, seed: int) -> None:
    rng = np.random.default_rng([2, seed])
    matrix = information(rng)
    before = criterion.value(matrix)
    for rows in (1, 2, SIZE):
        assert criterion.value(matrix + information(rng, rows=rows)) >= before - 1e-11 * (1 + abs(before))  # rounding


@EVERY
@SEEDS
def test_grows_with_the_logarithm_of_the_information(criterion: Criterion, seed: int) -> None:
    """value(c M) = value(M) + degree ln c; its derivative at c = 1 is Euler's tr(gradient M) = degree."""
    matrix = information(np.random.default_rng([3, seed]))
    degree, value = criterion.degree(SIZE), criterion.value(matrix)
    assert criterion.value(7.5 * matrix) == pytest.approx(value + degree * np.log(7.5), rel=1e-11)
    assert np.sum(criterion.gradient(matrix) * matrix) == pytest.approx(degree, rel=1e-9)  # condition number 1e5
    efficiency = np.exp((criterion.value(0.4 * matrix) - value) / degree)
    assert efficiency == pytest.approx(0.4, rel=1e-10)


@EVERY
@SEEDS
def test_gradient_is_that_of_finite_differences(criterion: Criterion, seed: int) -> None:
    rng = np.random.default_rng([4, seed])
    matrix = information(rng)
    gradient = criterion.gradient(matrix)
    np.testing.assert_array_equal(gradient, gradient.T)
    root = np.linalg.cholesky(matrix)
    step = rng.standard_normal((SIZE, SIZE))
    step = root @ (step + step.T) @ root.T  # of the size of M in every direction, whatever the units
    h = 1e-5
    difference = (criterion.value(matrix + h * step) - criterion.value(matrix - h * step)) / (2 * h)
    # Truncation h² times third derivatives of order p² = 256, rounding 1e-15 / h.
    assert np.sum(gradient * step) == pytest.approx(difference, rel=1e-6, abs=1e-6)


@EVERY
@pytest.mark.parametrize("symbol", [ca.MX, ca.SX])
def test_graph_is_the_value_and_its_derivative_the_gradient(criterion: Criterion, symbol: type) -> None:
    matrix = information(np.random.default_rng(5))
    M = symbol.sym("M", SIZE, SIZE)  # type: ignore[attr-defined]
    graph = criterion.graph(M)
    value, slope = ca.Function("f", [M], [graph, ca.gradient(graph, M)])(matrix)
    assert float(value) == pytest.approx(criterion.value(matrix), rel=1e-11)  # condition number 1e4
    expected = criterion.gradient(matrix)
    np.testing.assert_allclose(np.array(slope), expected, rtol=1e-8, atol=1e-10 * np.abs(expected).max())


@pytest.mark.parametrize("size", [1, 16, 25])
def test_graph_of_many_parameters(size: int) -> None:
    matrix = information(np.random.default_rng([6, size]), size)
    scale = 1 / np.sqrt(np.diag(matrix))
    for criterion in (
        DOptimal(),
        AOptimal(scale),
        EOptimal(scale),
        Subset((0,)),
        BayesianCriterion(DOptimal(), (1.0,)),
    ):
        assert float(criterion.graph(ca.DM(matrix))) == pytest.approx(criterion.value(matrix), rel=1e-10, abs=1e-10)


@EVERY
def test_singular_information_is_worth_nothing(criterion: Criterion) -> None:
    rng = np.random.default_rng(7)
    unseen = information(rng)
    unseen[4] = unseen[:, 4] = 0.0
    twice = rng.standard_normal((20, SIZE))
    twice[:, 4] = 3 * twice[:, 5]
    twice[:, 0] = 3 * twice[:, 1]
    for matrix in (np.zeros((SIZE, SIZE)), unseen, twice.T @ twice, -np.eye(SIZE), np.full((SIZE, SIZE), np.inf)):
        assert criterion.value(matrix) == -np.inf
        with pytest.raises(InputError, match="singular"):
            criterion.gradient(matrix)


@EVERY
def test_argument_is_left_alone(criterion: Criterion) -> None:
    matrix = information(np.random.default_rng(8))
    kept = matrix.copy()
    criterion.value(matrix)
    criterion.gradient(matrix)
    np.testing.assert_array_equal(matrix, kept)


# --------------------------------------------------------------------------- what each claims by itself


def test_d_adds_a_constant_for_other_parameters() -> None:
    rng = np.random.default_rng(9)
    change = rng.standard_normal((SIZE, SIZE))
    constant = 2 * np.linalg.slogdet(change)[1]
    for _ in range(5):
        matrix = information(rng)
        assert DOptimal().value(change.T @ matrix @ change) == pytest.approx(
            DOptimal().value(matrix) + constant, rel=1e-9
        )


def test_subset_does_not_care_about_its_nuisance_parameters() -> None:
    """theta = T eta that mixes the nuisance parameters and adds any of those asked about to them."""
    rng = np.random.default_rng(10)
    subset = Subset((4, 1))
    change = rng.standard_normal((SIZE, SIZE))
    for asked in subset.indices:
        change[asked] = np.eye(SIZE)[asked]
    matrix = information(rng)
    assert subset.value(change.T @ matrix @ change) == pytest.approx(subset.value(matrix), rel=1e-9)


def test_subset_is_the_inverse_of_its_block_of_the_covariance() -> None:
    matrix = information(np.random.default_rng(11))
    block = np.linalg.inv(matrix)[np.ix_([4, 1], [4, 1])]
    assert Subset((4, 1)).value(matrix) == pytest.approx(-np.linalg.slogdet(block)[1], rel=1e-10)
    assert Subset(tuple(range(SIZE))).value(matrix) == pytest.approx(DOptimal().value(matrix), rel=1e-12)


@pytest.mark.parametrize("family", [AOptimal, EOptimal])
def test_scaled_criteria_do_not_depend_on_units(family: type[AOptimal] | type[EOptimal]) -> None:
    rng = np.random.default_rng(12)
    matrix, units = information(rng), 10 ** rng.uniform(-3, 3, SIZE)  # theta = units eta
    other = family(SCALE / units).value(matrix * np.outer(units, units))
    assert other == pytest.approx(family(SCALE).value(matrix), rel=1e-10)


def test_a_is_the_mean_relative_variance() -> None:
    matrix = information(np.random.default_rng(13))
    relative = np.diag(np.linalg.inv(matrix)) / SCALE**2
    assert AOptimal(SCALE).value(matrix) == pytest.approx(-np.log(relative.mean()), rel=1e-10)


@SEEDS
@pytest.mark.parametrize("power", [2, 8, 16, 64])
def test_e_is_below_the_smallest_eigenvalue_by_no_more_than_it_says(power: int, seed: int) -> None:
    matrix, scale = information(np.random.default_rng([14, seed])), SCALE
    smallest = np.log(np.linalg.eigvalsh(matrix * np.outer(scale, scale))[0])
    criterion = EOptimal(scale, power=power)
    value = criterion.value(matrix)
    gap = np.log(SIZE) / power
    assert value - 1e-10 <= smallest <= value + gap + 1e-10  # rounding
    even = np.eye(SIZE) / np.outer(scale, scale)  # all eigenvalues alike: the whole gap
    assert criterion.value(even) == pytest.approx(-gap, abs=1e-12)


def test_e_survives_eigenvalues_far_apart() -> None:
    far = np.diag(10.0 ** np.array([-80, -40, 0, 40, 60, 80]))
    assert EOptimal(np.ones(SIZE), power=64).value(far) == pytest.approx(-80 * np.log(10), abs=1e-9)


def test_average_takes_the_diagonal_blocks() -> None:
    matrix = information(np.random.default_rng(15))
    blocks = [DOptimal().value(matrix[:3, :3]), DOptimal().value(matrix[3:, 3:])]
    assert BayesianCriterion(DOptimal(), (0.3, 0.7)).value(matrix) == pytest.approx(0.3 * blocks[0] + 0.7 * blocks[1])


@SEEDS
@pytest.mark.parametrize("power", [4.0, 16.0, 200.0])
def test_smallest_is_below_the_smallest_block_by_no_more_than_it_says(power: float, seed: int) -> None:
    matrix = information(np.random.default_rng([17, seed]))
    criterion = MaximinCriterion((Subset((3,)), Subset((0,))), (4, 2), power=power)
    blocks = [Subset((3,)).value(matrix[:4, :4]), Subset((0,)).value(matrix[4:, 4:])]
    value = criterion.value(matrix)
    assert value - 1e-10 <= min(blocks) <= value + np.log(2) / power + 1e-10  # rounding
    alike = MaximinCriterion((DOptimal(),) * SIZE, (1,) * SIZE, power=power)
    assert alike.value(np.eye(SIZE)) == pytest.approx(-np.log(SIZE) / power, abs=1e-12)  # the whole gap


def test_wrong_settings_are_said_in_a_line() -> None:
    with pytest.raises(InputError, match="magnitude"):
        AOptimal(np.array([1.0, 0.0]))
    with pytest.raises(InputError, match="power"):
        EOptimal(SCALE, power=12)
    with pytest.raises(InputError, match="weights"):
        BayesianCriterion(DOptimal(), (0.5, 0.6))
    with pytest.raises(InputError, match="indices"):
        Subset((1, 1))
    with pytest.raises(InputError, match="rows"):
        MaximinCriterion((DOptimal(),), (3, 3))
    with pytest.raises(ValueError, match="one degree"):
        MaximinCriterion((DOptimal(), Subset((0,))), (3, 3)).degree(SIZE)
    for criterion in (AOptimal(SCALE), EOptimal(SCALE), Subset((7,)), BayesianCriterion(DOptimal(), (0.5, 0.25, 0.25))):
        with pytest.raises(ValueError, match=r"given|asked|expected"):
            criterion.value(np.eye(4))


# ----------------------------------------------------------------------------------------- their optimum


def best_weights(criterion: Criterion, points: Array) -> Array:
    """The best weights (N,) of points with informations (N, k, k), by an interior point on the criterion's graph."""
    count, size = points.shape[:2]
    w = ca.MX.sym("w", count)
    mixture = ca.reshape(ca.DM(points.reshape(count, -1).T) @ w, size, size)
    problem = {"x": w, "f": -criterion.graph(mixture), "g": ca.sum1(w)}
    quiet: dict[str, Any] = {"ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-10}, "print_time": False}
    found = ca.nlpsol("design", "ipopt", problem, quiet)(x0=1 / count, lbx=0, ubx=1, lbg=1, ubg=1)
    weights = np.maximum(np.array(found["x"]).ravel(), 0)
    return np.asarray(weights / weights.sum())


def parabola(points: Array) -> Array:
    """Informations of y = a + b x + c x² at each point."""
    rows = np.stack([points**0, points, points**2], axis=1)
    return rows[:, :, None] * rows[:, None, :]


@lru_cache(maxsize=1)
def planar_states(count: int = 80) -> Array:
    """Informations of the planar model at random states of the reference arm."""
    experiment = Experiment.of(planar(), PlanarArm((1.0, 0.97, 0.4)))
    rng = np.random.default_rng(16)
    high = np.array([[1.05, 1.22, 1.4], [2, 2.2, 3.5], [10, 10, 15]])
    q, dq, ddq = rng.uniform(-high[:, None], high[:, None], (3, count, 3))
    columns = experiment.columns(q, dq, ddq, 1.0)
    return np.asarray(np.einsum("npi,npj->nij", columns, columns))


@EVERY
def test_equivalence_theorem_on_the_planar_arm(criterion: Criterion) -> None:
    points = planar_states()
    weights = best_weights(criterion, points)
    dual, degree = _dual(criterion, weights, points)
    assert dual.max() <= degree * (1 + 1e-6)  # the interior point's own tolerance, with room for cancellation
    np.testing.assert_allclose(dual[weights > 1e-3], degree, rtol=1e-5)  # complementarity: 1e-10 over the weight
    uniform = np.full(len(points), 1 / len(points))
    slack, _ = _dual(criterion, uniform, points)
    assert slack.max() > 1.1 * degree  # which a good design would not show
    value = {"best": criterion.value(_mixed(weights, points)), "uniform": criterion.value(_mixed(uniform, points))}
    assert value["uniform"] < value["best"] <= value["uniform"] + degree * np.log(slack.max() / degree)


QUADRATIC = {  # Pukelsheim 1993, chapter 9; D: k points alike; Ds of the curvature: Chebyshev's
    "D": (DOptimal(), (1 / 3, 1 / 3, 1 / 3), 1e-6),
    "A": (AOptimal(np.ones(3)), (1 / 4, 1 / 2, 1 / 4), 1e-6),
    "Ds": (Subset((2,)), (1 / 4, 1 / 2, 1 / 4), 1e-6),
    "E": (EOptimal(np.ones(3), power=256), (1 / 5, 3 / 5, 1 / 5), 1e-2),  # within its gap of ln 3 / 256
}


@pytest.mark.parametrize("name", QUADRATIC)
def test_optimum_of_a_parabola_is_the_known_one(name: str) -> None:
    """Regression of degree two on [-1, 1]: all weight on -1, 0 and 1."""
    criterion, expected, tolerance = QUADRATIC[name]
    grid = np.linspace(-1, 1, 41)
    weights = best_weights(criterion, parabola(grid))
    dual, degree = _dual(criterion, weights, parabola(grid))
    assert dual.max() <= degree * (1 + 1e-6)
    np.testing.assert_allclose(weights[[0, 20, 40]], expected, atol=tolerance)
    assert weights[[0, 20, 40]].sum() == pytest.approx(1.0, abs=1e-4)  # the interior point leaves a little elsewhere


def test_d_of_the_best_design_has_the_number_of_parameters_as_its_largest_variance() -> None:
    """Kiefer and Wolfowitz's own: max f' M^-1 f = k, whatever the degree of the polynomial."""
    grid = np.linspace(-1, 1, 41)
    for degree in (1, 2, 3):
        rows = np.vander(grid, degree + 1)
        weights = best_weights(DOptimal(), rows[:, :, None] * rows[:, None, :])
        inverse = np.linalg.inv(rows.T @ (weights[:, None] * rows))
        variance = np.einsum("ni,ij,nj->n", rows, inverse, rows)
        assert variance.max() == pytest.approx(degree + 1, rel=1e-6)


def _mixed(weights: Array, points: Array) -> Array:
    return np.asarray(np.einsum("n,nij->ij", weights, points))


def _dual(criterion: Criterion, weights: Array, points: Array) -> tuple[Array, float]:
    """tr(gradient m_i) of every point, and tr(gradient M) = degree."""
    mixture = _mixed(weights, points)
    return np.einsum("ij,nij->n", criterion.gradient(mixture), points), criterion.degree(len(mixture))
