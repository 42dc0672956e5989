"""Sensitivities at nominal amplitudes: those that a column's own derivative gives, in fewer operations."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from modeling import effects
from modeling.chain.model import planar
from modeling.chain.prediction import Prediction
from modeling.compiled.tape import Tape
from modeling.compiled.tape_evaluation import TapeEvaluation, partially_evaluated
from modeling.compiled.vector_function import Sensitivity
from tests.modeling.effects.cases import CASES, Case
from tests.modeling.effects.parts import random_signals

ROUNDING = 1e-11
"""Of the largest entry: what is multiplied by a vanishing amplitude is left out, which changes rounding at most."""


@pytest.mark.parametrize("case", [case for case in CASES if case.effect.id != "tip_flexibility"], ids=str)
def test_sensitivities_are_the_derivatives_at_nominal_amplitudes(case: Case) -> None:
    rng, samples, sets = np.random.default_rng(9), 40, 5
    prediction, parameters = Prediction(case.model), case.model.parameters
    which = tuple(i for i, p in enumerate(parameters) if i >= case.model.base_size and not p.nuisance)
    nominal = tuple(parameters[i].nominal for i in which)
    theta = case.theta * rng.uniform(0.9, 1.1, (sets, len(case.theta)))
    theta[:, list(which)] = nominal
    for emitted in (prediction.load, prediction.bias):
        found = Sensitivity.of(emitted, which, nominal)
        assert len(found.tape.operations) <= len(emitted.compiled.tape.operations)
        signals = random_signals(case, emitted.inputs, samples, rng)
        given = {name: theta[:, i] for i, name in enumerate(emitted.names) if name in found.parameters}
        values = found.values(signals, given, samples)
        expected = emitted.jacobians(signals, theta if given else theta[:1], which, samples)
        np.testing.assert_allclose(values, expected, rtol=0, atol=ROUNDING * np.abs(expected).max(initial=0.0))


def test_equal_sensitivities_in_different_models_are_known_as_such() -> None:
    """A tether's derivative at k = 0 is the same function whether or not a drag is in the model before it."""

    def tether(*others: effects.Effect) -> Sensitivity:
        model = planar() + [*others, effects.cable_spring()]  # noqa: RUF005
        names = [p.name for p in model.parameters]
        found = Sensitivity.of(Prediction(model).load, (names.index("cable_spring.k"),), (0.0,))
        return found

    alone, beside, other = tether(), tether(effects.viscous_drag()), tether(effects.sensor_gain())
    assert alone.expression == beside.expression
    assert alone.expression != other.expression
    assert hash(alone.expression) == hash(beside.expression)
    assert "viscous_drag.c" not in beside.parameters


def test_folding_leaves_out_what_a_fixed_parameter_makes_superfluous() -> None:
    u, theta = ca.SX.sym("u", 2), ca.SX.sym("theta", 3)
    first, second = theta[0] * ca.exp(u[0]) + theta[1] * u[1], u[0] / theta[1] - theta[0]
    whole = Tape.of(u, theta, ca.vertcat(first, second, ca.sin(theta[1]) * theta[2]))
    tape = partially_evaluated(whole, {0: 0.0, 1: 1.0})
    assert [name for name, *_ in tape.operations] == ["mul"]
    assert tape.results[:2] == (1, 0)
    found = np.zeros((3, 3, 1))
    TapeEvaluation(tape).run(
        list(np.array([[2.0, 3.0, 4.0], [5.0, 6.0, 7.0]])), np.array([[9.0, 9.0, 2.0]]), list(found)
    )
    expected = [[5.0, 6.0, 7.0], [2.0, 3.0, 4.0], [2 * np.sin(1.0)] * 3]
    np.testing.assert_allclose(found[:, :, 0], expected, rtol=1e-15)
