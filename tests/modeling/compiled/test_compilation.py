"""Every effect's expressions as NumPy, as CasADi and in SymPy's own arithmetic: one truth, and its derivatives."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

import casadi as ca
import mpmath  # type: ignore[import-untyped]
import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from modeling import effects
from modeling.chain.chain import Stage
from modeling.chain.effect import Effect
from modeling.chain.model import WrenchModel, planar, spatial
from modeling.chain.prediction import VectorFunction, compiled_prediction
from modeling.compiled.symbolic_vector import casadi_expressions, common_subexpressions, numpy_function
from modeling.effects import catalogue
from modeling.errors import InputError
from modeling.space import Space

Array = NDArray[np.float64]


def expressed(space: Space) -> tuple[Effect, ...]:
    """Effects that are expressions of the motion's signals; tests/modeling/effects has those of arm and bend too."""
    return tuple(e for e in catalogue(space) if not e.needs_joints and e.stage is not Stage.DEFLECTION)


CASES = [(space, effect) for space in Space for effect in expressed(space)]
every_effect = pytest.mark.parametrize(("space", "effect"), CASES, ids=[f"{e.id}-{s.name}" for s, e in CASES])
seeds = st.integers(0, 2**32 - 1)
ROUNDING = 1e-12
"""Of a value, relative to the largest of its sample: chains of some hundred operations."""


def base(space: Space) -> WrenchModel:
    return planar() if space is Space.PLANE else spatial()


def random_signals(names: tuple[str, ...], samples: int, rng: np.random.Generator) -> dict[str, Array]:
    """Signals of the size of a robot's; a quaternion of unit length, times within 10 s, progress within -1 and 1."""
    found = {name: rng.normal(0, 2, samples) for name in names}
    turn = rng.normal(size=(4, samples))
    found |= dict(zip(("qx", "qy", "qz", "qw"), turn / np.linalg.norm(turn, axis=0), strict=True))
    found |= {"time": rng.uniform(0, 10, samples), "progress": rng.uniform(-1, 1, samples)}
    found |= {"temperature": rng.uniform(15, 30, samples)}
    return {name: found[name] for name in names}


def random_theta(model: WrenchModel, rng: np.random.Generator) -> Array:
    """Parameters of order 1 within their bounds; a push's interval has its end after its start."""
    low, high = (np.array([p.bounds[i] for p in model.parameters]) for i in (0, 1))
    drawn = rng.uniform(0.5, 2.0, len(low)) * np.where(low < 0, rng.choice([-1.0, 1.0], len(low)), 1.0)
    theta = np.clip(drawn, low, high)
    place = {p.name: i for i, p in enumerate(model.parameters)}
    if "contact_event.start" in place:
        theta[[place["contact_event.start"], place["contact_event.end"]]] = np.sort(rng.uniform(0, 10, 2))
    if "payload_change.time" in place:
        theta[place["payload_change.time"]] = rng.uniform(0, 10)
    return theta


def numpy_values(emitted: VectorFunction, signals: Mapping[str, Array], theta: Array) -> Array:
    """The column (n, p) by the NumPy function of the same expressions."""
    symbols = [sp.Symbol(name, real=True) for name in emitted.inputs]
    function = numpy_function([*symbols, *emitted.parameters], list(emitted.expression))
    values = function(*(signals[name] for name in emitted.inputs), *theta)
    return np.stack([np.broadcast_to(v, samples_of(signals)) for v in values], axis=1).astype(float)


@cache
def sympy_function(emitted: VectorFunction) -> Callable[..., Any]:
    """The expressions as they stand, operation by operation, for SymPy's numbers of any length."""
    symbols = [sp.Symbol(name, real=True) for name in emitted.inputs]
    program = every_operation(list(emitted.expression))
    function: Callable[..., Any] = sp.lambdify(
        [*symbols, *emitted.parameters], program[1], "mpmath", cse=lambda results: (program[0], results)
    )
    return function


def every_operation(expressions: list[sp.Expr]) -> tuple[list[tuple[sp.Symbol, sp.Expr]], list[sp.Expr]]:
    """Each operation as a step of its own, so that equal ones are printed once; nothing is searched or rearranged."""
    known: dict[sp.Basic, sp.Basic] = {}
    steps: list[tuple[sp.Symbol, sp.Expr]] = []

    def named(node: sp.Basic) -> sp.Basic:
        if not node.args:
            return node
        if node not in known:
            whole = node.func(*map(named, node.args), evaluate=False)
            known[node] = whole
            if isinstance(node, sp.Expr):
                known[node] = sp.Symbol(f"step_{len(steps)}", real=True)
                steps.append((known[node], whole))
        return known[node]

    return steps, [named(expression) for expression in expressions]


def sympy_values(emitted: VectorFunction, signals: Mapping[str, Array], theta: Array, sample: int) -> Array:
    """One sample (p,) in 30 digits."""
    with mpmath.workdps(30):
        numbers = [mpmath.mpf(float(v)) for v in (*(signals[n][sample] for n in emitted.inputs), *theta)]
        return np.array([float(value) for value in sympy_function(emitted)(*numbers)])


def samples_of(signals: Mapping[str, Array]) -> int:
    return len(next(iter(signals.values())))


def parts(model: WrenchModel) -> tuple[VectorFunction, VectorFunction]:
    return compiled_prediction(model).load, compiled_prediction(model).bias


def assert_one_truth(model: WrenchModel, signals: Mapping[str, Array], theta: Array, *, in_sympy: int = 3) -> None:
    samples = samples_of(signals)
    for emitted in parts(model):
        casadi = emitted.value(signals, theta, samples)
        scale = np.abs(casadi).max(axis=1, keepdims=True) + 1.0
        assert (np.abs(numpy_values(emitted, signals, theta) - casadi) < ROUNDING * scale).all()
        np.testing.assert_array_equal(emitted.tangent(signals, theta, samples)[0], casadi)
        for sample in range(min(in_sympy, samples)):
            exact = sympy_values(emitted, signals, theta, sample)
            assert (np.abs(exact - casadi[sample]) < ROUNDING * scale[sample]).all()


@every_effect
@settings(max_examples=3, deadline=None)
@given(seed=seeds)
def test_numpy_casadi_and_sympy_agree(space: Space, effect: Effect, seed: int) -> None:
    rng, model = np.random.default_rng(seed), base(space) + effect
    assert_one_truth(model, random_signals((*model.inputs, "time"), 16, rng), random_theta(model, rng))


@pytest.mark.parametrize("space", list(Space))
def test_all_effects_together(space: Space) -> None:
    rng, model = np.random.default_rng(0), base(space) + expressed(space)
    assert_one_truth(model, random_signals(model.inputs, 16, rng), random_theta(model, rng), in_sympy=0)


# ---------------------------------------------------------------------------------------- the edges


@cache
def at_rest(space: Space) -> dict[str, Array]:
    """One sample of a tool upright at rest at the world's origin."""
    names = {n for e in expressed(space) for n in (base(space) + e).inputs}
    return {name: np.array([1.0 if name == "qw" else 0.0]) for name in sorted(names)}


def theta_of(model: WrenchModel, **own: float) -> Array:
    """Body and bias of one, the effect's parameters as given."""
    values = {p.name: 1.0 for p in model.base.parameters} | {f"{model.effects[0].id}.{n}": v for n, v in own.items()}
    return np.array([values.get(p.name, p.nominal) for p in model.parameters])


def added(model: WrenchModel, signals: Mapping[str, Array], theta: Array) -> Array:
    """What the effect adds to the load, (n, p); CasADi, NumPy and SymPy agree on it."""
    assert_one_truth(model, signals, theta)
    samples, size = samples_of(signals), model.base_size
    with_it = compiled_prediction(model).load.value(signals, theta, samples)
    derivative = compiled_prediction(model).load.tangent(signals, theta, samples)[1]
    assert np.isfinite(derivative).all()
    return with_it - compiled_prediction(model.base).load.value(signals, theta[:size], samples)


@pytest.mark.parametrize("space", list(Space))
@pytest.mark.parametrize(("length", "pull"), [(3.0, 0.0), (2.0, 0.0), (1.5, 5.0), (0.0, 20.0)])
def test_cable_slack_just_taut_and_taut(space: Space, length: float, pull: float) -> None:
    """The anchor is 2 m to the right of the origin, k = 10 N/m; the sensor holds against the pull, -x."""
    model = base(space) + effects.cable_spring()
    theta = theta_of(model, k=10.0, anchor_x=2.0, length=length, d=0.0)
    change = added(model, at_rest(space), theta)
    expected = np.zeros_like(change)
    expected[0, 0] = -pull
    # The rounding off of the distance, (1e-6 m)²/2, times k.
    np.testing.assert_allclose(change, expected, atol=1e-11)


@pytest.mark.parametrize("space", list(Space))
def test_cable_at_its_anchor(space: Space) -> None:
    model = base(space) + effects.cable_spring()
    theta = theta_of(model, k=10.0, length=0.0, d=0.0)
    np.testing.assert_array_equal(added(model, at_rest(space), theta), np.zeros((1, len(model.channels))))


@pytest.mark.parametrize("space", list(Space))
@pytest.mark.parametrize("effect", [effects.viscous_drag(), effects.quadratic_drag()])
def test_no_drag_at_rest(space: Space, effect: Effect) -> None:
    model = base(space) + effect
    change = added(model, at_rest(space), theta_of(model, c=3.0, d=0.2))
    np.testing.assert_array_equal(change, np.zeros((1, len(model.channels))))


@pytest.mark.parametrize("space", list(Space))
@pytest.mark.parametrize(
    ("time", "share"),
    [(1.9, 0), (1.995, 0), (2.0, 0.5), (2.005, 1), (2.5, 1), (2.995, 1), (3.0, 0.5), (3.005, 0), (3.1, 0)],
)
def test_push_rises_and_falls_over_ten_milliseconds(space: Space, time: float, share: float) -> None:
    model = base(space) + effects.contact_event()
    theta = theta_of(model, start=2.0, end=3.0, fcx=4.0)
    change = added(model, at_rest(space) | {"time": np.array([time])}, theta)
    expected = np.zeros_like(change)
    expected[0, 0] = -4.0 * share
    np.testing.assert_allclose(change, expected, atol=1e-11)  # rounding of a time of 3 s, over 10 ms, times 4 N


@pytest.mark.parametrize("space", list(Space))
def test_push_that_ends_before_it_starts_is_none(space: Space) -> None:
    model = base(space) + effects.contact_event()
    theta = theta_of(model, start=3.0, end=2.0, fcx=4.0)
    for time in (1.9, 2.0, 2.5, 3.0, 3.1):
        signals = at_rest(space) | {"time": np.array([time])}
        np.testing.assert_array_equal(added(model, signals, theta), np.zeros((1, len(model.channels))))


# -------------------------------------------------------------------------------------- derivatives


@every_effect
@pytest.mark.parametrize("seed", range(2))
def test_derivatives_are_those_of_central_differences(space: Space, effect: Effect, seed: int) -> None:
    """With a step h = 1e-5 (of parameters of order 1): h²/6 of the third derivative, of order 100 of the largest
    value, makes 2e-9 of it; rounding, 1e-15 / h, some 1e-10. A sample that a kink (the tether's slack end, an edge of
    the push) lies within 2 h of is not compared: there one-sided differences part from one another.
    """
    rng, model, samples, h = np.random.default_rng(seed), base(space) + effect, 60, 1e-5
    signals, theta = random_signals((*model.inputs, "time"), samples, rng), random_theta(model, rng)
    if effect.id == "line_interference":
        signals["time"] = signals["time"] / 10  # phases of order 1, not of 60 turns
    theta += 3 * h * np.isclose(theta, [p.bounds[0] for p in model.parameters])  # off a bound
    for emitted in parts(model):
        value, derivative = emitted.tangent(signals, theta, samples)
        scale = np.abs(value).max() + 1.0
        for i in range(len(theta)):
            step = h * np.eye(len(theta))[i]
            ahead, behind = (emitted.value(signals, theta + s * step, samples) for s in (1, -1))
            smooth = np.abs(ahead - 2 * value + behind).max(axis=1) < 1e-2 * h * scale
            assert smooth.mean() > 0.9
            error = ((ahead - behind) / (2 * h) - derivative[:, :, i])[smooth]
            assert (np.abs(error) < 1e-7 * scale).all()


@every_effect
def test_active_parameters_are_those_that_move_the_value(space: Space, effect: Effect) -> None:
    rng, model, samples = np.random.default_rng(1), base(space) + effect, 4000
    signals, theta = random_signals((*model.inputs, "time"), samples, rng), random_theta(model, rng)
    theta = np.where(theta == 0, 0.3, theta)  # an amplitude at its bound hides its nuisance parameters
    signals["time"] = np.linspace(0, 10, samples)  # 2.5 ms: every edge of a push is met
    for emitted in parts(model):
        derivative = emitted.tangent(signals, theta, samples)[1]
        assert tuple(np.flatnonzero(np.abs(derivative).max(axis=(0, 1)))) == emitted.active


# ------------------------------------------------------------------------------------- the machinery


def test_shared_subexpressions_give_the_expressions_back() -> None:
    x, y = sp.symbols("x y", real=True)
    expressions = [sp.sin(x * y) + (x * y) ** 2, sp.cos(x * y) * (x + y), sp.S.Zero, sp.sqrt(x**2 + y**2)]
    replacements, reduced = common_subexpressions(expressions)
    assert replacements
    for symbol, expression in reversed(replacements):
        reduced = [r.subs(symbol, expression) for r in reduced]
    assert [sp.simplify(r - e) for r, e in zip(reduced, expressions, strict=True)] == [0] * 4


def test_a_node_without_a_counterpart_in_casadi_is_an_error() -> None:
    x = sp.Symbol("x", real=True)
    with pytest.raises(InputError, match="gamma"):
        casadi_expressions({x: ca.SX.sym("x")}, [sp.gamma(x)])


def test_a_missing_signal_is_named() -> None:
    model = planar() + effects.thermal_drift()
    signals = {name: np.zeros(3) for name in model.inputs if name != "temperature"}
    with pytest.raises(InputError, match="temperature"):
        compiled_prediction(model).bias.value(signals, np.zeros(len(model.parameters)), 3)


def test_one_model_is_compiled_once() -> None:
    assert compiled_prediction(planar() + effects.viscous_drag()) is compiled_prediction(
        planar() + effects.viscous_drag()
    )
    assert compiled_prediction(planar() + effects.viscous_drag()) is not compiled_prediction(
        planar() + effects.quadratic_drag()
    )
