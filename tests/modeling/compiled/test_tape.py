"""Tapes: what they evaluate to, against CasADi's own evaluation of the same graph, and what they refuse."""

from __future__ import annotations

import copy
import itertools
from collections.abc import Callable
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray

from modeling.chain.prediction import Prediction
from modeling.compiled.symbolic_vector import SymbolicVector
from modeling.compiled.tape import BINARY, UNARY, Operations, Tape
from modeling.compiled.tape_evaluation import LONGEST_BLOCK, NUMPY_OPERATIONS, TapeEvaluation
from modeling.compiled.vector_function import CompiledVector, VectorFunction
from tests.modeling.effects.cases import CASES, Case
from tests.modeling.effects.parts import random_signals

Array = NDArray[np.float64]

ROUNDING = 1e-10
"""Relative to the largest entry of a column, and to a thousandth of the largest of all: the functions of NumPy and of
the C library differ by a unit in the last place, and 1 - tanh² of a play that is taken up is such a difference."""
FAINT = 1e-3

every_case = pytest.mark.parametrize("case", CASES, ids=str)


@cache
def casadi_function(column: SymbolicVector) -> Any:
    """From inputs (m,) and parameters (k,) to the value (p,) and its derivative (p, k)."""
    u, parameters = ca.SX.sym("u", len(column.inputs)), ca.SX.sym("theta", len(column.parameters))
    graph = column.graph(u, parameters)
    return ca.Function("column", [u, parameters], [graph, ca.densify(ca.jacobian(graph, parameters))])


def by_casadi(column: SymbolicVector, inputs: Array, theta: Array) -> tuple[Array, Array]:
    """Value (samples, p) and derivative (samples, p, k) by CasADi, one sample after the other."""
    function, samples = casadi_function(column), len(inputs)
    value, slopes = (part.full() for part in function.map(samples)(inputs.T, theta.T))
    return value.T, slopes.reshape(len(value), samples, -1).swapaxes(0, 1)


def parts_of(case: Case) -> list[VectorFunction]:
    """Every part of the case's model that can be evaluated."""
    prediction = Prediction(case.model)
    bent = () if prediction.deflection is None else (prediction.deflection.load, prediction.deflection.equilibrium)
    load = () if bent else (prediction.load,)
    return [
        part for part in (*load, prediction.bias, prediction.play, prediction.saturation, *bent) if part is not None
    ]


@every_case
def test_columns_and_their_derivatives_are_casadis(case: Case) -> None:
    rng, samples = np.random.default_rng(3), 20
    for emitted in parts_of(case):
        signals = random_signals(case, emitted.inputs, samples, rng)
        theta = np.concatenate([case.theta, rng.uniform(0.01, 0.1, emitted.count - len(case.theta))])
        varied = theta * rng.uniform(0.9, 1.1, (samples, len(theta)))
        for sets in (theta, varied):
            each = np.broadcast_to(sets, (samples, emitted.count))
            value, derivative = emitted.tangent(signals, sets, samples)
            expected = by_casadi(emitted.symbolic(), emitted.samples(signals, samples), each)
            for found, wanted in zip((value, derivative), expected, strict=True):
                scale = np.maximum(np.abs(wanted).max(axis=0), FAINT * np.abs(wanted).max(initial=0.0))
                assert (np.abs(found - wanted) <= ROUNDING * scale).all()
            np.testing.assert_array_equal(emitted.value(signals, sets, samples), value)
        slopes = emitted.jacobians(signals, varied[:3], tuple(range(emitted.count)), samples)
        for number, own in enumerate(varied[:3]):
            np.testing.assert_array_equal(slopes[:, :, number], emitted.tangent(signals, own, samples)[1])


@every_case
def test_a_graph_made_of_a_tape_is_the_one_that_it_was_made_of(case: Case) -> None:
    rng = np.random.default_rng(4)
    for emitted in parts_of(case):
        inputs, theta = rng.normal(size=(5, len(emitted.inputs))), rng.uniform(0.5, 1.0, (5, emitted.count))
        again = ca.Function("again", list(emitted.symbols), [emitted.graph])
        expected = by_casadi(emitted.symbolic(), inputs, theta)[0]
        found = np.array([again(row, own).full()[:, 0] for row, own in zip(inputs, theta, strict=True)])
        assert (np.abs(found - expected) <= ROUNDING * np.abs(expected).max(axis=0)).all()


def test_every_operation_has_a_function() -> None:
    assert {*UNARY, *BINARY} == set(NUMPY_OPERATIONS)


@pytest.mark.parametrize("name", UNARY + BINARY)
def test_operations_are_casadis(name: str) -> None:
    code = getattr(ca, f"OP_{name.upper()}")
    u, theta = ca.SX.sym("u", 2), ca.SX.sym("theta", 0)
    operation = ca.SX.unary(code, u[0]) if name in UNARY else ca.SX.binary(code, u[0], u[1])
    tape = Tape(2, 0, (), Operations.of([(name, 0, -1 if name in UNARY else 1)]), (2,))
    rng = np.random.default_rng(5)
    inputs = np.vstack([rng.uniform(-1, 1, (200, 2)), rng.integers(-1, 2, (200, 2))])
    function = ca.Function("operation", [u, theta], [operation])
    expected = np.array([float(function(row, [])) for row in inputs])
    found = np.full((len(inputs), 1), np.nan)
    TapeEvaluation(tape).run(list(inputs.T), np.zeros((1, 0)), [found])
    np.testing.assert_allclose(found[:, 0], expected, rtol=1e-14, atol=0)


def test_long_series_and_many_sets_are_taken_in_blocks() -> None:
    """f = a x y + x sin(y), once over several blocks and three sets, and once sample by sample."""
    u, theta = ca.SX.sym("u", 2), ca.SX.sym("theta", 1)
    tape = Tape.of(u, theta, ca.vertcat(theta * u[0] * u[1] + u[0] * ca.sin(u[1]), theta**2, u[0], ca.sin(u[1]), 0, 3))
    samples, sets = 2 * LONGEST_BLOCK + 17, np.array([[1.0], [-2.0], [0.5]])
    x, y = np.random.default_rng(6).normal(size=(2, samples))
    found = np.zeros((6, samples, 3))
    TapeEvaluation(tape).run([x, y], sets, list(found))
    a, wide = sets[:, 0], np.zeros((samples, 3))
    sine = np.sin(y)[:, None]
    expected = [np.outer(x * y, a) + x[:, None] * sine, a**2 + wide, x[:, None] + wide, sine + wide, wide, 3 + wide]
    for own, wanted in zip(found, expected, strict=True):
        np.testing.assert_allclose(own, wanted, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("block", [7, 60, LONGEST_BLOCK + 3])
def test_means_over_blocks_are_those_of_the_samples(block: int) -> None:
    """Of results of signals, of parameters and of both, over several sets; the last samples fill no block."""
    u, theta = ca.SX.sym("u", 2), ca.SX.sym("theta", 1)
    tape = Tape.of(u, theta, ca.vertcat(theta * u[0] * u[1], theta**2, u[0], ca.sin(u[1]), 0, 3))
    samples, sets = 3 * LONGEST_BLOCK + 17, np.array([[1.0], [-2.0], [0.5]])
    inputs = list(np.random.default_rng(7).normal(size=(2, samples)))
    series, means = np.zeros((6, samples, 3)), np.zeros((6, samples // block, 3))
    TapeEvaluation(tape).run(inputs, sets, list(series))
    TapeEvaluation(tape).run(inputs, sets, list(means), block)
    whole = series[:, : samples // block * block].reshape(6, -1, block, 3)
    np.testing.assert_allclose(means, whole.mean(axis=2), rtol=0, atol=1e-14)


@pytest.mark.parametrize("seed", range(12))
def test_sets_that_share_parameters_are_evaluated_as_each_by_itself(seed: int) -> None:
    """Some parameters the same in all sets, some in groups, in any order; results of every kind of dependence."""
    random = np.random.default_rng(seed)
    u, theta = ca.SX.sym("u", 2), ca.SX.sym("theta", 4)
    a, b, c, d = ca.vertsplit(theta)
    early, late = ca.sin(a * u[0]) + b, ca.exp(-((c * u[1]) ** 2)) * u[0]
    tape = Tape.of(u, theta, ca.vertcat(early * late + d * u[1], early, late * d, d * u[0] * b, a * c, u[1], d, 2.0))
    groups = random.integers(1, 4, size=4)
    sets = np.stack([random.normal(size=count)[random.integers(count, size=30)] for count in groups], axis=1)
    if seed % 2:
        sets[:, random.integers(4)] = random.normal(size=30)
    inputs = list(random.normal(size=(2, LONGEST_BLOCK + 5)))
    together, alone = np.zeros((8, LONGEST_BLOCK + 5, 30)), np.zeros((8, LONGEST_BLOCK + 5, 30))
    TapeEvaluation(tape).run(inputs, sets, list(together))
    for row, own in enumerate(sets):
        TapeEvaluation(tape).run(inputs, own[None], list(alone[:, :, row, None]))
    np.testing.assert_array_equal(together, alone)


def test_some_of_the_results_need_some_of_the_operations() -> None:
    u, theta = ca.SX.sym("u", 1), ca.SX.sym("theta", 1)
    tape = Tape.of(u, theta, ca.vertcat(ca.sin(u), ca.cos(u) * theta, u))
    assert [[name for name, *_ in tape.only([place]).operations] for place in range(3)] == [["sin"], ["cos", "mul"], []]


def _changed(path: tuple[Any, ...], value: object) -> Callable[[dict[str, Any]], None]:
    def change(data: dict[str, Any]) -> None:
        for key in path[:-1]:
            data = data[key]
        data[path[-1]] = value

    return change


@pytest.mark.parametrize(
    "change",
    [
        _changed(("operations", 0, 0), "__import__"),
        _changed(("operations", 0, 0), 7),
        _changed(("operations", 1, 0), 99),
        _changed(("operations", 1, 0), -3),
        _changed(("operations", 2, 0), 0.5),
        _changed(("operations", 1), []),
        _changed(("results", 0), 99),
        _changed(("results", 0), "0"),
        _changed(("constants",), ["one"]),
        _changed(("inputs",), -1),
        _changed(("parameters",), True),
    ],
    ids=itertools.count(),
)
def test_what_is_no_tape_is_refused(change: Callable[[dict[str, Any]], None]) -> None:
    u, theta = ca.SX.sym("u", 1), ca.SX.sym("theta", 1)
    data = Tape.of(u, theta, ca.vertcat(ca.sin(u) * theta + 2.5)).to_data()
    Tape.from_data(copy.deepcopy(data))
    change(data)
    with pytest.raises((ValueError, TypeError)):
        Tape.from_data(data)


@every_case
def test_compiled_columns_are_plain_data(case: Case) -> None:
    for emitted in parts_of(case):
        kept = emitted.compiled
        again = CompiledVector.from_data(kept.to_data())
        assert again.to_data() == kept.to_data()
        assert (again.inputs, again.active, again.rows) == (emitted.inputs, emitted.active, emitted.rows)
