"""Enclosures hold every value, and what branch and bound says follows from them."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from design.bound import BoundKind, Effort, PolynomialDegrees
from design.bound.branch_and_bound import DualFunctionEnclosure, IntervalEvaluation
from modeling.compiled.tape import Tape
from modeling.errors import InputError
from tests.shared.bound_cases import (
    bound_of,
    plain_function,
    random_dual,
)


@pytest.mark.parametrize("seed", range(4))
def test_enclosures_hold_every_value_in_the_box(case: str, seed: int) -> None:
    function = plain_function(case, PolynomialDegrees(each=4, pair=2, more=0))
    dual, rng, n = random_dual(function, seed), np.random.default_rng([seed, 8]), function.joints
    middle, half = rng.uniform(-1, 1, (40, 2 * n)), rng.choice([0.01, 0.1, 0.5], (40, 1))
    low, high = np.clip(middle - half, -1, 1), np.clip(middle + half, -1, 1)
    ddq = function.viable.vertices[rng.integers(len(function.viable.vertices), size=40)]
    boxes, _ = DualFunctionEnclosure(function, dual).boxes(np.hstack([low, ddq]), np.hstack([high, ddq]))
    for share in rng.random((200, 40, 2 * n)).round(1):
        assert (function.value_and_gradient(low + share * (high - low), ddq, dual)[0] <= boxes.upper).all()


def test_intervals_hold_every_value_of_every_operation() -> None:
    x = ca.SX.sym("x", 2)
    a, b = x[0], x[1]
    expressions = [a + b, a - b, -a, 2 * a, a * b, a**2, ca.sin(3 * a), ca.cos(a * b), a / b, 1 / b]
    function = ca.Function("f", [x], [ca.vertcat(*expressions)])
    rng = np.random.default_rng(9)
    middle, half = rng.uniform(-4, 4, (300, 2)), rng.uniform(0, 2, (300, 2))
    low, high = IntervalEvaluation(Tape.of(x, ca.SX(0, 1), ca.vertcat(*expressions)))(middle - half, middle + half)
    for share in rng.uniform(-1, 1, (50, 300, 2)):
        values = np.array(function.map(300)((middle + share * half).T)).T
        assert (values >= low - 1e-12).all()
        assert (values <= high + 1e-12).all()


def test_intervals_refuse_what_they_do_not_know() -> None:
    x = ca.SX.sym("x")
    with pytest.raises(InputError, match="no enclosure"):
        IntervalEvaluation(Tape.of(x, ca.SX(0, 1), ca.tanh(x)))(np.zeros((1, 1)), np.ones((1, 1)))


@pytest.mark.parametrize("name", ["single", "skew single"])
def test_the_bound_of_one_joint_is_proven(name: str) -> None:
    bound = bound_of(
        name, PolynomialDegrees(each=4, pair=0, more=0), Effort(tolerance=0.05, starts=2000, proof_seconds=60)
    )
    assert bound.kind is BoundKind.PROVEN
    assert bound.proof is not None
    assert bound.proof.closed
    assert 6 <= bound.proof.upper <= 6 * 1.002
    assert bound.checked <= bound.logdet == bound.proven <= bound.checked + 6 * np.log(1.002)
    assert "(proven)" in str(bound)


def test_a_proof_without_time_is_weak_and_true() -> None:
    bound = bound_of(
        "symmetric", PolynomialDegrees(each=2, pair=2, more=0), Effort(tolerance=0.05, starts=2000, proof_seconds=0.5)
    )
    assert bound.kind is BoundKind.CHECKED
    assert bound.proven is not None
    assert bound.proven > bound.checked == bound.logdet
    assert "budget" in str(bound)
