"""Constrained fits: the conditions of optimality, other solvers, and what an active constraint says of the data.

Every random test is seeded, so that it fails always or never; the probabilities are those of another seed's failing.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import NonlinearConstraint, least_squares, lsq_linear, minimize
from scipy.stats import chi2

from estimation.least_squares.bounds import Bounds
from estimation.least_squares.constrained_minimum import (
    ConstrainedMinimum,
    ConstraintInterpretation,
    constraints_lifted,
)
from estimation.least_squares.constrained_minimum import minimise_constrained as constrained
from estimation.least_squares.constraints import Constraints
from estimation.least_squares.levenberg_marquardt import LeastSquaresMinimum
from estimation.least_squares.levenberg_marquardt import levenberg_marquardt as free_minimum
from estimation.least_squares.prior import Prior
from estimation.least_squares.square_root_information import SquareRootInformation
from estimation.parameter_layout import ParameterLayout
from modeling import effects
from modeling.chain.model import WrenchModel, planar, spatial
from modeling.chain.pseudo_inertia import pseudo_inertia
from modeling.codegen.code_target import payload_format
from modeling.codegen.tool_inertia import ToolInertia
from modeling.space import Space

Array = NDArray[np.float64]

LATERAL = planar() + effects.com_offset()
MODELS = {"planar": planar(), "lateral": LATERAL, "spatial": spatial()}


@dataclass(frozen=True, eq=False)
class Straight:
    """Least squares A theta = b with noise of unit variance, under the names of a model."""

    model: WrenchModel
    A: Array
    b: Array

    @property
    def layout(self) -> ParameterLayout:
        return ParameterLayout(
            self.model, self.model.parameters, (self.model,), (np.arange(len(self.model.parameters)),)
        )

    def information(self, theta: Array) -> SquareRootInformation:
        return SquareRootInformation.of(self.A, self.b - self.A @ theta)

    def minimise(self, start: Array) -> LeastSquaresMinimum:
        open_ends = np.full(len(start), np.inf)
        return free_minimum(self.information, start, (-open_ends, open_ends))

    @property
    def names(self) -> list[str]:
        return [p.name for p in self.model.parameters]

    def solved(self, constraints: Constraints) -> ConstrainedMinimum:
        return constrained(self, np.zeros(self.A.shape[1]), constraints)

    def cost(self, theta: Array) -> float:
        return float(np.sum((self.A @ theta - self.b) ** 2))


def tool(model: WrenchModel, rng: np.random.Generator, *, points: int) -> dict[str, float]:
    """The moments of random point masses, by the definitions; in the plane on both sides of the tip or on it."""
    masses, (x, y, z) = rng.uniform(0.1, 1.0, points), 0.1 * rng.normal(size=(3, points))
    if model.space is Space.PLANE:
        x = x if model is LATERAL else 0 * x
        found = {"m": masses.sum(), "mlg": masses @ y, "I": masses @ (x**2 + y**2), "com_offset.mlx": masses @ x}
    else:
        found = {"m": masses.sum(), "mx": masses @ x, "my": masses @ y, "mz": masses @ z}
        found |= {"Ixx": masses @ (y**2 + z**2), "Iyy": masses @ (x**2 + z**2), "Izz": masses @ (x**2 + y**2)}
        found |= {"Ixy": -masses @ (x * y), "Ixz": -masses @ (x * z), "Iyz": -masses @ (y * z)}
    return {name: float(value) for name, value in found.items()}


def problem(model: WrenchModel, seed: int, *, points: int, sign: int = 1, rows: int = 60) -> Straight:
    """Random data of a random tool; columns over two decades, so that units cannot be mistaken for accuracy."""
    rng = np.random.default_rng(seed)
    truth = tool(model, rng, points=points)
    theta = np.array([truth.get(p.name, 1.0) for p in model.parameters])
    A = rng.normal(size=(rows, len(theta))) * 10 ** rng.uniform(0, 2, len(theta))
    return Straight(model, A, sign * (A @ theta) + rng.normal(size=rows))


def tangent_covariance(found: ConstrainedMinimum) -> Array:
    """Covariance (k, k) with the strictly active constraints as equalities."""
    return constraints_lifted(found.optimality, np.zeros(len(found.optimality.unit_multipliers), dtype=bool)).covariance


def reference(model: WrenchModel, seed: int, weight: float) -> Prior:
    found = tool(model, np.random.default_rng(seed), points=8)
    if model is MODELS["planar"]:
        found["I"] *= 1.3  # off the edge: of points on the tip alone
    return Prior({name: found[name] for name in pseudo_inertia(model).names}, weight)


def around(values: Mapping[str, float], width: float) -> Bounds:
    return Bounds({name: (value - width, value + width) for name, value in values.items()})


# ------------------------------------------------------------------------- conditions of optimality

POINTS = {"planar": 1, "lateral": 1, "spatial": 2}
"""So few that the truth lies on the edge, and the free minimum outside in about half of the draws or more."""


def conditions(problem: Straight, found: ConstrainedMinimum, prior: Prior | None = None) -> None:
    """Karush, Kuhn and Tucker, written out for chi-square and divergence themselves.

    1e-7 of the gradient's own parts: a double's rounding times the condition (1e4) of columns over two decades, and
    1e4 of slack; the solver by itself leaves 1e-5.
    """
    theta, region, optimality = found.theta, found.region, found.optimality
    J = pseudo_inertia(problem.model).over(problem.names)
    if region.inertia is not None:
        J = J.with_margin()
    low, high = (optimality.bound_multipliers(lower=lower) for lower in (True, False))
    Z = optimality.Z if len(optimality.Z) else np.zeros((J.size, J.size))
    parts = [2 * problem.A.T @ (problem.A @ theta - problem.b), -low, high, -np.einsum("nm,knm->k", Z, J.slopes)]
    if prior is not None and prior.weight:
        model_reference = J.at(np.array([prior.values.get(name, 0.0) for name in problem.names]))
        of_divergence = np.linalg.inv(model_reference) - np.linalg.inv(J.at(theta))
        parts.append(prior.weight * np.einsum("nm,knm->k", of_divergence, J.slopes))
    std = np.sqrt(np.diag(np.linalg.inv(problem.A.T @ problem.A)))
    size = 1 + max(float(np.max(np.abs(part * std))) for part in parts)
    assert np.max(np.abs(sum(parts) * std)) < 1e-7 * size  # stationary
    assert np.all(theta >= region.low)  # feasible, ends to the bit
    assert np.all(theta <= region.high)
    assert np.all(low >= 0)
    assert np.all(high >= 0)
    assert np.linalg.eigvalsh(Z).min() >= -1e-9 * np.abs(Z).max(initial=1.0)
    assert not low[(theta > region.low)].any()  # complementary
    assert not high[(theta < region.high)].any()
    if region.inertia is not None:
        values = np.linalg.eigvalsh(J.at(theta))
        assert values.min() > -1e-12 * values.max() - 1e-15  # which may be 0: no tool at all
        assert abs(np.sum(Z * J.at(theta))) < 1e-9 * size


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("bounded", [False, True])
def test_optimality(name: str, bounded: bool) -> None:
    """Over random data the pseudo-inertia and the ends are active in some and not in others."""
    seen = set()
    for seed in range(6):
        posed = problem(MODELS[name], seed, points=POINTS[name])
        truth = posed.minimise(np.zeros(posed.A.shape[1])).theta
        chosen = {n: float(v) + 0.03 for n, v in zip(posed.names, truth, strict=True) if n in ("bias_fx", "m")}
        found = posed.solved(Constraints(bounds=around(chosen, 0.02) if bounded else None, physical=True))
        assert found.converged
        conditions(posed, found)
        assert bounded == bool(found.optimality.bound_multipliers(lower=True).any())
        seen.add(bool(np.abs(found.optimality.Z).max(initial=0.0) > 1e-6))
    assert True in seen
    assert False in seen or bounded or name != "planar"


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("weight", [1e-3, 1.0, 1e4])
def test_optimality_with_a_prior(name: str, weight: float) -> None:
    posed, prior = problem(MODELS[name], 3, points=POINTS[name]), reference(MODELS[name], 1, weight)
    found = posed.solved(Constraints(prior=prior, bounds=Bounds({"bias_fx": (-1.0, 0.9)})))
    assert found.converged
    conditions(posed, found, prior)


@pytest.mark.parametrize("precision", [1.0, 1e3])
def test_optimality_where_all_is_negative(precision: float) -> None:
    """Readings of the other sign: the tool shrinks to almost nothing, and several eigenvalues are held at once.

    However precise they are: up to some million std from the free minimum.
    """
    for name, model in MODELS.items():
        plain = problem(model, 2, points=6, sign=-1)
        posed = replace(plain, A=precision * plain.A, b=precision * plain.b)
        found = posed.solved(Constraints(physical=True, bounds=Bounds({"m": (0.0, 3.0)})))
        assert found.converged
        conditions(posed, found)
        worst = found.active[0]
        assert worst.pressure is ConstraintInterpretation.NEGATIVE_MASS, name
        assert worst.wanted == pytest.approx(posed.minimise(np.zeros(posed.A.shape[1])).theta[posed.names.index("m")])


# ------------------------------------------------------------------------------------ other solvers


def test_ends_alone_as_scipy_has_them() -> None:
    """`lsq_linear` (active set, tolerance 1e-14) agrees in every unknown to 1e-6 std, with several ends active."""
    active = 0
    for seed in range(5):
        posed = problem(spatial(), seed, points=5)
        rng = np.random.default_rng(100 + seed)
        middle = posed.minimise(np.zeros(16)).theta + 0.05 * rng.normal(size=16)
        bounds = {name: (float(v) - 0.03, float(v) + 0.03) for name, v in zip(posed.names, middle, strict=True)}
        found = posed.solved(Constraints(bounds=Bounds(bounds)))
        other = lsq_linear(posed.A, posed.b, bounds=(middle - 0.03, middle + 0.03), method="bvls", tol=1e-14)
        std = np.sqrt(np.diag(np.linalg.inv(posed.A.T @ posed.A)))
        assert np.max(np.abs(found.theta - other.x) / std) < 1e-6
        active += len(found.active)
    assert active > 10


def by_cholesky(posed: Straight) -> float:
    """The least chi-square over J less its margin = L L', L lower triangular, no constraint left; a random start."""
    J = pseudo_inertia(posed.model).with_margin()
    own = [posed.names.index(name) for name in J.names]
    biases, _ = np.linalg.qr(np.delete(posed.A, own, axis=1))
    columns, target = (v - biases @ (biases.T @ v) for v in (posed.A[:, own], posed.b))
    moments = np.linalg.pinv(J.slopes.reshape(len(own), -1).T)
    places = list(zip(*np.tril_indices(J.size), strict=True))

    def factor(x: Array) -> Array:
        L = np.zeros((J.size, J.size))
        L[tuple(np.transpose(places))] = x
        return L

    def residual(x: Array) -> Array:
        return np.asarray(columns @ moments @ (factor(x) @ factor(x).T).ravel() - target)

    def slope(x: Array) -> Array:
        units = np.eye(len(places))
        turns = [factor(unit) @ factor(x).T + factor(x) @ factor(unit).T for unit in units]
        return np.asarray(columns @ moments @ np.array([turn.ravel() for turn in turns]).T)

    rng = np.random.default_rng(0)
    start = 0.3 * rng.normal(size=len(places))
    return 2 * float(least_squares(residual, start, slope, x_scale="jac", xtol=1e-12, ftol=1e-11).cost)


@pytest.mark.parametrize(("name", "seeds"), [("planar", (1, 2, 3, 4)), ("spatial", (0,))])
def test_the_cone_by_a_cholesky_factor(name: str, seeds: tuple[int, ...]) -> None:
    """Another parametrisation without constraints, another solver, the same chi-square to 1e-6: 1e-3 std.

    (The lateral planar J has entries that must be equal or zero, which no Cholesky factor knows.)
    """
    active = 0
    for seed in seeds:
        posed = problem(MODELS[name], seed, points=POINTS[name])
        found = posed.solved(Constraints(physical=True))
        active += len(found.active)
        assert found.cost == pytest.approx(by_cholesky(posed), abs=1e-6)
    assert active


def test_the_cone_by_its_eigenvalues() -> None:
    """SLSQP with the smallest eigenvalue >= 0 as a nonlinear constraint, for the lateral planar tool.

    It stops when chi-square moves by less than 1e-12: unknowns to 1e-4 std, of differences over 1e-8 of the constraint.
    """
    posed = problem(LATERAL, 1, points=1)
    J = pseudo_inertia(LATERAL).over(posed.names)
    std = np.sqrt(np.diag(np.linalg.inv(posed.A.T @ posed.A)))
    centre = posed.minimise(np.zeros(7)).theta
    inside = np.zeros(7)
    inside[posed.names.index("I")] = 0.1 / std[posed.names.index("I")]

    def cost(x: Array) -> float:
        return posed.cost(centre + std * x)

    def slope(x: Array) -> Array:
        return np.asarray(2 * std * (posed.A.T @ (posed.A @ (centre + std * x) - posed.b)))

    def smallest(x: Array) -> Array:
        return np.asarray(np.linalg.eigvalsh(J.at(centre + std * x))[:1])

    cone = NonlinearConstraint(smallest, 0, np.inf)
    other = minimize(cost, inside, jac=slope, method="SLSQP", constraints=[cone], tol=1e-12)
    found = posed.solved(Constraints(physical=True))
    assert found.active
    assert found.cost == pytest.approx(float(other.fun), abs=1e-6)
    assert np.max(np.abs((found.theta - centre) / std - other.x)) < 1e-4


@pytest.mark.parametrize("points", [1, 3])
def test_a_simulator_takes_what_is_held_consistent(points: int) -> None:
    """MuJoCo loads tools of a point and of a sheet, as written, in another frame, and with numbers of eight digits.

    It wants positive eigenvalues of the inertia about the centre of mass, and none above the sum of the others.
    """
    active = 0
    for seed in range(4):
        posed = problem(spatial(), seed, points=points)
        found = posed.solved(Constraints(physical=True))
        active += any(a.constraint.startswith("4 x 4") for a in found.active)
        tool = ToolInertia.of(posed.model, found.theta, found.covariance)
        for given in (tool, tool.seen_from((0.3, -0.2, 0.4, 0.3, -1.1, 2.0))):
            text = payload_format("mjcf").text(given, "a test")
            short = re.sub(r"-?\d+\.\d{8,}(e-?\d+)?", lambda number: f"{float(number[0]):.8g}", text)
            assert short != text
            for written in (text, short):
                assert mujoco.MjModel.from_xml_string(written).body_mass[-1] > 0
    assert active > 1


def test_a_free_minimum_that_keeps_the_constraints_is_left_alone() -> None:
    """To the bit, for ends, cone and both."""
    for model in MODELS.values():
        posed = problem(model, 0, points=6)
        free = posed.minimise(np.zeros(posed.A.shape[1]))
        wide = Bounds(dict.fromkeys(posed.names, (-50.0, 50.0)))
        shifted = replace(posed, b=posed.b + posed.A[:, posed.names.index("I" if "I" in posed.names else "Izz")])
        for constraints in (Constraints(), Constraints(bounds=wide)):
            found = posed.solved(constraints)
            np.testing.assert_array_equal(found.theta, free.theta)
            np.testing.assert_array_equal(found.covariance, free.covariance)
        if model.space is Space.PLANE:  # one more kg m²: far from the edge
            found = shifted.solved(Constraints(physical=True, bounds=wide))
            np.testing.assert_array_equal(found.theta, shifted.minimise(np.zeros(len(posed.names))).theta)
            assert not found.active
            assert "unconstrained minimum" in str(found)


# --------------------------------------------------------------------------------------- the prior


@pytest.mark.parametrize("name", MODELS)
def test_a_prior_between_nothing_and_certainty(name: str) -> None:
    """Weight 0 is the free minimum to the bit; a huge one is the reference, to what the data's slope over the weight
    leaves, 1e-5 of its largest moment; between them chi-square rises and the divergence falls with the weight."""
    posed = problem(MODELS[name], 3, points=POINTS[name])
    free = posed.minimise(np.zeros(posed.A.shape[1]))
    np.testing.assert_array_equal(posed.solved(Constraints(prior=reference(posed.model, 1, 0.0))).theta, free.theta)
    weights = (1e-6, 1.0, 1e2, 1e4, 1e12)
    runs = [posed.solved(Constraints(prior=reference(posed.model, 1, weight))) for weight in weights]
    assert all(run.converged for run in runs)
    assert all(np.diff([run.rise for run in runs]) > 0)
    assert all(np.diff([run.pulled / weight for run, weight in zip(runs, weights, strict=True)]) < 0)
    believed = reference(posed.model, 1, 1.0).values
    found = dict(zip(posed.names, runs[-1].theta, strict=True))
    largest = max(map(abs, believed.values()))
    assert all(abs(found[n] - value) < 1e-5 * largest for n, value in believed.items())


def test_the_weight_is_a_precision() -> None:
    """Scaling a tool by 1 + e costs weight · n e²/2 to second order: n moments known to sqrt(2 / weight)."""
    prior = reference(spatial(), 1, 200.0)
    names = list(pseudo_inertia(spatial()).names)
    divergence = prior.divergence(pseudo_inertia(spatial()), names)
    theta, e = np.array([prior.values[n] for n in names]), 1e-3
    assert divergence.value(theta) == pytest.approx(0.0, abs=1e-12)
    assert divergence.value((1 + e) * theta) == pytest.approx(4 * (e / 0.1) ** 2, rel=e)
    assert divergence.value(-theta) == np.inf


@pytest.mark.parametrize("name", MODELS)
def test_the_prior_knows_no_units_and_no_frame(name: str) -> None:
    """J -> T J T', T of other units and another origin and, in space, other axes: the answer moves along.

    To 1e-7 of each moment's std: both problems are solved to rounding, their conditions differ by the units' 1e3.
    """
    posed, weight, rng = problem(MODELS[name], 4, points=POINTS[name]), 50.0, np.random.default_rng(8)
    J = pseudo_inertia(posed.model)
    T = np.diag(np.full(J.size, 30.0))  # a gram is a thousandth: 30² ~ 1e3
    if posed.model.space is Space.SPACE:
        axes, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        T = np.block([[1e3 * axes, rng.normal(size=(3, 1))], [np.zeros((1, 3)), 1.0]]) * 30.0
    else:
        T[-1, -1] *= 1e3  # millimetres
        T[-1, -2] = 0.0 if posed.model is LATERAL else 40.0  # an origin elsewhere along the tip
    columns = J.slopes.reshape(len(J.names), -1).T
    turned = np.array([(T @ slope @ T.T).ravel() for slope in J.slopes]).T
    M = np.linalg.lstsq(columns, turned)[0]
    np.testing.assert_allclose(columns @ M, turned, rtol=1e-10, atol=1e-9)
    own = [posed.names.index(n) for n in J.names]
    whole = np.eye(len(posed.names))
    whole[np.ix_(own, own)] = M
    prior = reference(posed.model, 1, weight)
    moved = Prior(dict(zip(J.names, M @ [prior.values[n] for n in J.names], strict=True)), weight)
    here = posed.solved(Constraints(prior=prior))
    there = replace(posed, A=posed.A @ np.linalg.inv(whole)).solved(Constraints(prior=moved))
    std = np.sqrt(np.diag(here.covariance))
    assert np.max(np.abs(np.linalg.solve(whole, there.theta) - here.theta) / std) < 1e-7


# ---------------------------------------------------------------------- what the numbers are worth


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("kind", ["cone", "cone and end", "prior"])
def test_the_estimate_follows_the_readings_along_the_edge(name: str, kind: str) -> None:
    """d theta / d b = covariance along the edge · A', by differences: the curve of the cone's edge included.

    Readings are moved by 1e-3 of a std; the second order and the solver's rounding leave 1e-5.
    """
    posed = problem(MODELS[name], 3, points=POINTS[name])
    bounds = Bounds({"bias_fx": (-9.0, 0.9)}) if kind != "cone" else None
    prior = reference(posed.model, 1, 30.0) if kind == "prior" else None
    constraints = Constraints(bounds=bounds, physical=prior is None, prior=prior)
    found = posed.solved(constraints)
    assert found.active or kind == "prior"
    std = np.sqrt(np.diag(np.linalg.inv(posed.A.T @ posed.A)))
    for seed in range(3):
        direction = np.random.default_rng(seed).normal(size=len(posed.b))
        step = 1e-3 * direction / np.linalg.norm(direction)
        ends = [replace(posed, b=posed.b + sign * step).solved(constraints).theta for sign in (1, -1)]
        difference = (ends[0] - ends[1]) / 2e-3
        expected = tangent_covariance(found) @ posed.A.T @ direction / np.linalg.norm(direction)
        assert np.max(np.abs(difference - expected) / std) < 1e-5
    if bounds is not None:
        assert tangent_covariance(found)[0, 0] < 1e-20 * std[0] ** 2


@pytest.mark.parametrize("name", MODELS)
def test_constraints_that_are_true_never_do_harm(name: str) -> None:
    """A truth inside: in the metric of the data the estimate is nearer to it than the free one, in every draw, so that
    the free covariance about it is enough. Along the edge alone it is not: off by more than 6 of its std somewhere."""
    posed, rng = problem(MODELS[name], 1, points=6), np.random.default_rng(9)
    truth = tool(posed.model, np.random.default_rng(1), points=6)
    theta = np.array([truth.get(n, 1.0) for n in posed.names])
    bounds = Bounds({n: (truth[n] - 0.01, truth[n] + 0.002) for n in ("m", "mlg", "my") if n in truth})
    blunt = replace(posed, A=posed.A / 20)
    worst = 0.0
    for _ in range(8):
        drawn = replace(blunt, b=blunt.A @ theta + rng.normal(size=len(posed.b)))
        found = drawn.solved(Constraints(physical=True, bounds=bounds))
        errors = [np.linalg.norm(blunt.A @ (x - theta)) for x in (found.theta, found.free.theta)]
        assert errors[0] <= errors[1] * (1 + 1e-9)
        np.testing.assert_allclose(found.covariance, found.free.covariance, rtol=1e-6, atol=1e-15)
        std = np.sqrt(np.diag(tangent_covariance(found)))
        worst = max(worst, float(np.max(np.abs(found.theta - theta) / np.maximum(std, 1e-300))))
    assert worst > 6


def test_the_chance_of_a_cost_is_as_stated() -> None:
    """A truth on the edge (one point on the tip): half of the free minima are possible, and of the p-values a tenth
    is below 0.1, a quarter below 0.25. 100 draws: 4 sigma either way, 1 in 1e4 for another seed's draws."""
    rng, posed = np.random.default_rng(11), problem(planar(), 1, points=1)
    truth = tool(planar(), np.random.default_rng(1), points=1)
    theta = np.array([truth.get(n, 1.0) for n in posed.names])
    chances = []
    for _ in range(100):
        drawn = replace(posed, b=posed.A @ theta + rng.normal(size=len(posed.b)))
        active = drawn.solved(Constraints(physical=True)).active
        chances.append(active[0].p_value if active else 1.0)
    for level in (0.1, 0.25, 0.5):
        count = int(np.sum(np.array(chances) <= level))
        assert abs(count - 100 * level) < 4 * np.sqrt(100 * level * (1 - level))


def test_one_end_by_the_book() -> None:
    """With one end active: the cost is the square of its distance in std, and its chance half of chi²_1."""
    posed = problem(planar(), 0, points=5)
    free = posed.minimise(np.zeros(6))
    place = posed.names.index("mlg")
    value, std = free.theta[place], np.sqrt(free.covariance[place, place])
    found = posed.solved(Constraints(bounds=Bounds({"mlg": (value + 2 * std, 9.0)})))
    (active,) = found.active
    assert active.wanted == pytest.approx(value, abs=1e-9 * std)
    assert active.std == pytest.approx(std, rel=1e-9)
    assert active.distance == pytest.approx(2.0, rel=1e-9)
    assert active.chi_square == pytest.approx(found.cost - free.cost, rel=1e-6)
    assert active.p_value == pytest.approx(chi2.sf(4.0, 1) / 2, rel=1e-9)
    assert active.pressure is ConstraintInterpretation.WITHIN_NOISE
    fixed = posed.solved(Constraints(bounds=Bounds({"mlg": (value - 4 * std, value - 4 * std)})))
    assert fixed.active[0].p_value == pytest.approx(chi2.sf(16.0, 1), rel=1e-6)
    assert fixed.active[0].pressure is ConstraintInterpretation.CONTRADICTED
    assert fixed.theta[place] == value - 4 * std
    assert fixed.covariance[place, place] == 0
    assert np.all(np.diag(fixed.covariance) <= np.diag(free.covariance) * (1 + 1e-9))
    assert "mlg = " in fixed.active[0].sentence


@pytest.mark.parametrize(
    ("width", "expected"),
    [(0.5, ConstraintInterpretation.WITHIN_NOISE), (2.0, ConstraintInterpretation.UNDETERMINED)],
)
def test_agreement_is_not_ignorance(width: float, expected: ConstraintInterpretation) -> None:
    """A bound one std from the estimate, of a quantity whose std is half or twice the bound."""
    posed = problem(planar(), 0, points=5)
    free = posed.minimise(np.zeros(6))
    place = posed.names.index("bias_fx")
    std = float(np.sqrt(free.covariance[place, place]))
    shift = std / width - std - float(free.theta[place])
    shifted = Straight(posed.model, posed.A, posed.b + posed.A[:, place] * shift)
    (active,) = shifted.solved(Constraints.of({"bias_fx": std / width})).active
    assert active.distance == pytest.approx(1.0, rel=1e-6)
    assert active.pressure is expected


def test_an_impossible_chance_is_printed_with_one_sign() -> None:
    posed = problem(planar(), 0, points=5)
    free = posed.minimise(np.zeros(6))
    place = posed.names.index("mlg")
    far = float(free.theta[place] + 60 * np.sqrt(free.covariance[place, place]))
    assert "(p < 1e-300)" in str(posed.solved(Constraints.of({"mlg": far})))


def test_what_the_data_do_not_show_stays_not_shown() -> None:
    """I without a column: the cone holds it where it starts, at no cost, and it gets no std."""
    posed = problem(planar(), 0, points=5)
    blind = replace(posed, A=posed.A * (np.array(posed.names) != "I"))
    found = blind.solved(Constraints(physical=True))
    free = blind.minimise(np.zeros(6))
    seen = np.array(posed.names) != "I"
    assert found.converged
    np.testing.assert_array_equal(found.identifiable, seen)
    std = np.sqrt(np.diag(free.covariance)[seen])
    assert np.max(np.abs(found.theta - free.theta)[seen] / std) < 1e-6
    assert found.theta[posed.names.index("I")] > 0
    assert [active.pressure for active in found.active] in ([], [ConstraintInterpretation.IDLE])
    assert found.rise < 1e-6


def test_an_end_that_the_cone_implies_is_not_blamed_twice() -> None:
    """m >= 0 beside physical consistency, and data that want a negative mass: one pays, the other is idle."""
    posed = problem(planar(), 2, points=6, sign=-1)
    found = posed.solved(Constraints(physical=True, bounds=Bounds({"m": (0.0, 9.0)})))
    assert found.converged
    assert found.theta[posed.names.index("m")] == 0
    pressures = [active.pressure for active in found.active]
    assert pressures == [ConstraintInterpretation.NEGATIVE_MASS, ConstraintInterpretation.IDLE]
    assert found.active[0].chi_square == pytest.approx(found.rise, rel=1e-9)
    assert "mass" in str(found)
