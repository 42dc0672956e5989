"""Functions and weights of linear models against the symbolic derivation; programs against SymPy's own numbers."""

from __future__ import annotations

import json
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from modeling import effects
from modeling.chain.model import WrenchModel, planar, spatial
from modeling.chain.prediction import compiled_prediction
from modeling.chain.regressor import RegressorBasis, independent_functions, regressor_basis
from modeling.codegen.expression_text import FUNCTIONS
from modeling.compiled.tape import NO_OPERAND, Operations, Tape
from modeling.compiled.tape_evaluation import Schedule, TapeEvaluation
from modeling.rig import Convention
from modeling.space import Space

Array = NDArray[np.float64]


def base(space: Space, convention: Convention = Convention.ON_TOOL, *, mirror: bool = False) -> WrenchModel:
    return replace(planar() if space is Space.PLANE else spatial(), convention=convention, mirror_y=mirror)


MODELS = {
    f"{space.name} {convention.name} {'mirrored' if mirror else ''}": base(space, convention, mirror=mirror)
    for space in Space
    for convention in (Convention.ON_TOOL, Convention.ON_SENSOR)
    for mirror in (False, True)
} | {
    f"{s.name} + {e.id}": base(s) + e()
    for s in Space
    for e in effects.CATALOGUE
    if s in e.spaces and not e.needs_joints
}


def functions(form: RegressorBasis, signals: dict[str, Array], samples: int) -> Array:
    out = np.empty((form.weights.shape[2], samples))
    form.evaluate([signals[name] for name in form.inputs], out)
    return out


def bends(model: WrenchModel, signals: dict[str, Array]) -> bool:
    """Whether the derivative in the parameters changes with them, anywhere among ten of their values."""
    parts, rng = (compiled_prediction(model).load, compiled_prediction(model).bias), np.random.default_rng(2)
    thetas = rng.standard_normal((10, len(model.parameters)))
    slopes = [sum(part.tangent(signals, theta, 60)[1] for part in parts) for theta in thetas]
    return not all(np.allclose(slopes[0], other) for other in slopes[1:])


@pytest.mark.parametrize("name", MODELS)
def test_form_is_the_prediction(name: str) -> None:
    """Of every effect of the catalogue that is linear, by the CasADi emission of the same model; the others have none.

    Functions are as many as the elements of Phi and the offset have independent directions, over random motions.
    """
    model = MODELS[name]
    form, prediction = regressor_basis(model), compiled_prediction(model)
    rng, samples = np.random.default_rng(1), 60
    signals = {n: rng.standard_normal(samples) for n in model.inputs}
    theta = rng.standard_normal(len(model.parameters))
    if form is None:
        assert not prediction.instantaneous or bends(model, signals)
        return
    values = functions(form, signals, samples)
    found = np.einsum("i,icj,jn->nc", np.append(theta, 1.0), form.weights, values)
    expected = prediction.load.value(signals, theta, samples) + prediction.bias.value(signals, theta, samples)
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)  # rounding of sums of some 50 numbers of size 1
    elements = form.weights.reshape(-1, len(values)) @ values
    assert np.linalg.matrix_rank(elements) == np.linalg.matrix_rank(values) == len(values)


def test_as_few_functions_as_the_chapter_has() -> None:
    """1, M1, M2, M3, M4 in the plane; in six axes 1, the specific force, the angular acceleration, and the six products
    of angular rates: 1 + 3 + 3 + 6."""
    counts = {space: regressor_basis(base(space)) for space in Space}
    assert {space: form and form.weights.shape[2] for space, form in counts.items()} == {
        Space.PLANE: 5,
        Space.SPACE: 13,
    }


def test_form_as_data_is_the_same_form() -> None:
    form = regressor_basis(base(Space.SPACE))
    assert form is not None
    again = RegressorBasis.from_data(json.loads(json.dumps(form.to_data())))
    assert again.functions.to_data() == form.functions.to_data()
    np.testing.assert_array_equal(again.weights, form.weights)
    spoiled: list[dict[str, Any]] = [
        {"weights": [[[1.0]]]},
        {"inputs": []},
        {"functions": form.functions.to_data() | {"operations": [["system"], [0], [NO_OPERAND]]}},
        {"functions": form.functions.to_data() | {"operations": [["sin"], [99], [NO_OPERAND]]}},
        {"functions": form.functions.to_data() | {"operations": [["sin"], ["0"], [NO_OPERAND]]}},
        {"functions": form.functions.to_data() | {"results": [1, 999]}},
    ]
    for spoil in spoiled:
        with pytest.raises(ValueError, match=r"weights|inputs|operation|result"):
            RegressorBasis.from_data(form.to_data() | spoil)


x, y, z = sp.symbols("x y z", real=True)


@pytest.mark.parametrize("name", sorted({*FUNCTIONS} - {"Max", "Min"}))
def test_every_function_in_a_program(name: str) -> None:
    """Each function that emitted code knows, by SymPy's own 15 digits."""
    arguments = (x, y) if name == "atan2" else (x,)
    expression = getattr(sp, name)(*arguments)
    at = {x: 0.3, y: -0.7}
    tape = Tape.of_expressions(
        [x, y], [expression + y, sp.Max(x, y, 0.1) / (x - y) ** 3, sp.sqrt(x) + sp.Min(x, y), sp.Float(2)]
    )
    out = TapeEvaluation(tape).values([np.array([at[x]]), np.array([at[y]])])
    exact = [expression.subs(at) + at[y], 0.3, np.sqrt(0.3) - 0.7, 2.0]
    np.testing.assert_allclose(out[:, 0], [float(e) for e in exact], rtol=1e-14)


@given(data=st.data())
@settings(deadline=None, max_examples=60)
def test_program_of_anything(data: st.DataObject) -> None:
    """Random sums and products that share parts: no step writes over what a later one reads."""
    pool: list[sp.Expr] = [x, y, z, sp.Integer(2), sp.sin(x)]
    for _ in range(data.draw(st.integers(1, 25))):
        left, right = (data.draw(st.sampled_from(pool)) for _ in range(2))
        pool.append(data.draw(st.sampled_from([left + right, left - right, left * right, sp.cos(left), -left])))
    wanted = data.draw(st.lists(st.sampled_from(pool), min_size=1, max_size=6))
    columns = np.random.default_rng(0).uniform(-0.5, 0.5, (3, 7))
    before = columns.copy()
    out = TapeEvaluation(Tape.of_expressions([x, y, z], wanted)).values(list(columns))
    expected = sp.lambdify([x, y, z], wanted, "numpy")(*columns)
    scale = 1 + np.max(np.abs(out))
    np.testing.assert_allclose(out / scale, np.stack([np.broadcast_to(e, 7) for e in expected]) / scale, atol=1e-12)
    np.testing.assert_array_equal(columns, before)


def test_independent_expressions_and_the_others_made_of_them() -> None:
    squares = [x**2 + y**2, x**2, y**2 - x**2, 3 * x**2, sp.Integer(0), x * y]
    terms = {e: sp.expand(e).as_coefficients_dict() for e in squares}
    kept, made = independent_functions(
        {e: {t: Fraction(int(c)) for t, c in found.items() if c} for e, found in terms.items()}
    )
    assert len(kept) == 3
    for element in squares:
        assert sp.expand(element - sum(int(c) * kept[j] for j, c in made[element].items())) == 0


def test_rows_are_used_again() -> None:
    """A sum of many products needs two rows at a time, however long it is."""
    operations = [("mul", 0, 1)]
    for place in range(30):
        operations += [("mul", 0, 2 + 2 * place), ("add", 2 + 2 * place, 3 + 2 * place)]
    tape = Tape(2, 0, (), Operations.of(operations), (2 + len(operations) - 1,))
    assert Schedule.of(tape, ()).rows <= 2


def test_results_of_a_single_set_are_computed_in_their_place() -> None:
    """Only one that another operation reads is copied, here the sine, and the input that is a result itself."""
    tape = Tape(2, 0, (), Operations.of([("sin", 0, NO_OPERAND), ("mul", 2, 1), ("cos", 1, NO_OPERAND)]), (2, 3, 4, 1))
    schedule = Schedule.of(tape, (), single=True)
    assert [function for function, *_ in schedule.of_each].count(np.positive) == 2
    assert (schedule.of_signals, schedule.rows) == ((), 1)
