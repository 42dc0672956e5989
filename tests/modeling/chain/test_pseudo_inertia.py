"""The pseudo-inertia against sums over point masses: every set of them is possible, and nothing else is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
import sympy as sp
from numpy.typing import NDArray

from modeling import effects
from modeling.chain.chain import Chain, Stage
from modeling.chain.effect import Effect
from modeling.chain.model import WrenchModel, planar, spatial
from modeling.chain.pseudo_inertia import CONSISTENCY_MARGIN, PseudoInertia, pseudo_inertia
from modeling.errors import InputError
from modeling.parameter import Parameter
from modeling.rigid_body import RigidBody
from modeling.space import Space

Array = NDArray[np.float64]

LATERAL = planar() + effects.com_offset()
MODELS = [planar(), LATERAL, spatial()]


def moments(model: WrenchModel, masses: Array, points: Array) -> dict[str, float]:
    """The model's inertial parameters of point masses (n,) at points (n, 3), by the definitions of FORMATS.md.

    In the plane a point is (x', y', .), and I the sum of m (x'² + y'²); in space about the sensor's three axes.
    """
    x, y, z = points.T
    if model.space is Space.PLANE:
        found = {"m": masses.sum(), "mlg": masses @ y, "I": masses @ (x**2 + y**2), "com_offset.mlx": masses @ x}
    else:
        found = {"m": masses.sum(), "mx": masses @ x, "my": masses @ y, "mz": masses @ z}
        found |= {"Ixx": masses @ (y**2 + z**2), "Iyy": masses @ (x**2 + z**2), "Izz": masses @ (x**2 + y**2)}
        found |= {"Ixy": -masses @ (x * y), "Ixz": -masses @ (x * z), "Iyz": -masses @ (y * z)}
    return {name: float(value) for name, value in found.items()}


def of_points(model: WrenchModel, masses: Array, points: Array) -> Array:
    inertia = pseudo_inertia(model)
    found = moments(model, masses, points)
    return inertia.at(np.array([found[name] for name in inertia.names]))


def on_axis(model: WrenchModel, points: Array) -> Array:
    """Points of a planar tool whose first moment lies along the tip: each with its mirror image."""
    return np.concatenate([points, points * [-1, 1, 1]]) if model is MODELS[0] else points


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("count", [1, 2, 3, 4, 12])
def test_point_masses_are_possible(model: WrenchModel, count: int) -> None:
    """J >= 0 up to rounding; its rank counts the points as far as its size, and in the plane a mirrored or second
    point already gives the full rank, because only the sum of the second moments is known."""
    rng = np.random.default_rng(count)
    points = on_axis(model, rng.normal(size=(count, 3)))
    masses = np.resize(rng.uniform(0.1, 1.0, count), len(points))
    values = np.linalg.eigvalsh(of_points(model, masses, points))
    assert values.min() > -1e-14 * values.max()
    in_the_plane = len(values) - (len(points) == 1)
    rank = in_the_plane if model.space is Space.PLANE else min(count, 4)
    assert int((values > 1e-9 * values.max()).sum()) == rank


@pytest.mark.parametrize("count", [1, 3])
def test_a_rod_along_the_tip_is_the_edge_when_it_is_one_point(count: int) -> None:
    """m I = mlg² for a point on the tip axis, m I > mlg² for several (Cauchy and Schwarz)."""
    rng = np.random.default_rng(3)
    y = rng.normal(size=count)
    J = of_points(planar(), rng.uniform(0.1, 1.0, count), np.column_stack([0 * y, y, 0 * y]))
    assert (abs(np.linalg.det(J)) < 1e-14) == (count == 1)


def least_spread(model: WrenchModel, J: Array) -> float:
    """The least second moment about the centre of mass, over the sum of the second moments about the sensor origin."""
    inertia = pseudo_inertia(model)
    others = [i for i in range(inertia.size) if i not in inertia.mass]
    second, mass = J[np.ix_(others, others)], J[inertia.mass[0], inertia.mass[0]]
    first = J[np.ix_(others, inertia.mass)]
    return float(np.linalg.eigvalsh(second - first @ first.T / mass)[0] / np.trace(second))


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("size", [1e-3, 1.0])
def test_the_margin_is_a_share_of_the_tools_own_size(model: WrenchModel, size: float) -> None:
    """Of one point and of one with another close by, for tools of a metre and of a millimetre, 1 kg and 1 g.

    What `with_margin` finds positive has a spread above `CONSISTENCY_MARGIN`, and what it does not has none.
    """
    positive = set()
    inside = pseudo_inertia(model).with_margin()
    for seed in range(40):
        rng = np.random.default_rng(seed)
        place = rng.normal(size=3)
        near = place + 10.0 ** rng.uniform(-4, -1) * rng.normal(size=(4, 3))
        masses = np.resize(rng.uniform(0.1, 1.0, 4), 8 if model is MODELS[0] else 4)
        points = on_axis(model, size * near * ([0, 1, 1] if model is MODELS[0] else [1, 1, 1]))
        found = moments(model, size * masses, points)
        theta = np.array([found[name] for name in inside.names])
        scale = np.sqrt(np.maximum(np.diag(pseudo_inertia(model).at(theta)), 1e-300))
        least = float(np.linalg.eigvalsh(inside.at(theta) / np.outer(scale, scale))[0])
        spread = least_spread(model, pseudo_inertia(model).at(theta))
        assert (least > 0) == (spread > CONSISTENCY_MARGIN)
        positive.add(least > 0)
    assert positive == {True, False}


def test_spatial_is_the_sum_of_squares() -> None:
    """J = sum m [r; 1][r; 1]', the definition that the derivation starts from."""
    rng = np.random.default_rng(4)
    points, masses = rng.normal(size=(7, 3)), rng.uniform(0.1, 1.0, 7)
    lifted = np.column_stack([points, np.ones(7)])
    np.testing.assert_allclose(of_points(spatial(), masses, points), (lifted.T * masses) @ lifted, atol=1e-14)


@pytest.mark.parametrize("model", MODELS)
def test_what_is_positive_is_made_of_points(model: WrenchModel) -> None:
    """The converse: a random J > 0 of the model's form comes from masses and points that are computed from it."""
    inertia, rng = pseudo_inertia(model), np.random.default_rng(5)
    size = len(inertia.names)
    for _ in range(20):
        theta = rng.normal(size=size)
        J = inertia.at(theta)
        J = inertia.at(theta + _lift(inertia, max(0.0, 0.1 - np.linalg.eigvalsh(J).min())))
        masses, points = _points_of(model, J)
        assert masses.min() > 0
        np.testing.assert_allclose(of_points(model, masses, points), J, atol=1e-11 * np.abs(J).max())


def _lift(inertia: PseudoInertia, amount: float) -> Array:
    """The step of the parameters that adds `amount` to J's diagonal."""
    columns = inertia.slopes.reshape(len(inertia.names), -1).T
    step, *_ = np.linalg.lstsq(columns, amount * np.eye(inertia.size).ravel())
    np.testing.assert_allclose(columns @ step, amount * np.eye(inertia.size).ravel(), atol=1e-12)
    return np.asarray(step)


def _points_of(model: WrenchModel, J: Array) -> tuple[Array, Array]:
    """Masses and points: J = L L', its columns turned so that each holds a mass; in the plane two about the centre."""
    if model.space is Space.PLANE:
        mass, c = J[0, 0], J[:-1, -1]
        centre = np.array([*np.zeros(2 - len(c)), *c]) / mass
        reach = np.sqrt((J[-1, -1] - c @ c / mass) / mass)
        along = np.array([0, reach])
        ends = [centre + along, centre - along]
        return np.full(2, mass / 2), np.column_stack([ends, np.zeros(2)])
    columns = np.linalg.cholesky(J)
    last = columns[-1]
    turn = _rotation(last / np.linalg.norm(last), np.full(4, 0.5))
    columns = columns @ turn.T
    return columns[-1] ** 2, (columns[:3] / columns[-1]).T


def _rotation(start: Array, end: Array) -> Array:
    """The reflection that takes one unit vector to another."""
    normal = start - end
    return np.eye(len(start)) - 2 * np.outer(normal, normal) / max(float(normal @ normal), 1e-300)


def test_planar_matrices_are_those_of_the_chapter() -> None:
    """PHYSICS.md: [[m, mlg], [mlg, I]], and with a lateral first moment [[m, 0, mlx], [0, m, mlg], [mlx, mlg, I]]."""
    m, mlg, inertia, mlx = sp.symbols("m mlg I com_offset.mlx", real=True)
    assert pseudo_inertia(planar()).expression == sp.Matrix([[m, mlg], [mlg, inertia]])
    assert pseudo_inertia(LATERAL).expression == sp.Matrix([[m, 0, mlx], [0, m, mlg], [mlx, mlg, inertia]])
    assert pseudo_inertia(LATERAL).condition == "m I >= mlg² + com_offset.mlx²"


def test_over_more_unknowns() -> None:
    inertia = pseudo_inertia(planar())
    wide = inertia.over(["bias_fx", "I", "m", "mlg"])
    np.testing.assert_array_equal(wide.at(np.array([9.0, 3.0, 1.0, 2.0])), [[1.0, 2.0], [2.0, 3.0]])


def test_effects_that_leave_the_tool_alone_change_nothing() -> None:
    model = planar() + effects.viscous_drag() + effects.sensor_lag() + effects.gravity_tilt()
    assert pseudo_inertia(model).expression == pseudo_inertia(planar()).expression


@dataclass(frozen=True)
class Telescope(Effect):
    """A tool that changes: its first moment grows with a product of parameters, or with time."""

    moving: bool = False

    id = "telescope"
    title = "telescope"
    stage = Stage.TIP_BODY
    equation = ""
    advice = ""

    def parameters(self, space: Space) -> tuple[Parameter, ...]:
        return (Parameter(name="length", unit="m"),)

    def perturb(self, chain: Chain, p: dict[str, sp.Expr]) -> Chain:  # type: ignore[override]
        body, factor = chain.body, sp.Symbol("time", real=True) if self.moving else chain.body.mass
        moment = body.first_moment + factor * p["length"] * chain.space.tip_axis
        return replace(chain, body=RigidBody(body.mass, moment, body.inertia))


@pytest.mark.parametrize("moving", [False, True])
def test_a_tool_that_is_no_cone_is_refused(moving: bool) -> None:
    with pytest.raises(InputError, match=r"rigid tip \+ telescope: the tool's moments are not linear"):
        pseudo_inertia(planar() + Telescope(moving))
