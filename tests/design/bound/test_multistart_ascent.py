"""The bound's search: many points at once as one by one, and ascents that end early but never lower."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from design.bound import PolynomialDegrees
from design.bound.dual_function import DualFunction
from design.bound.multistart_ascent import (
    LocalMaxima,
    StoppingRule,
    at_best_vertex,
    local_maxima,
    projected_gradient_ascent,
    random_points,
)
from modeling.compiled.tape_evaluation import LONGEST_BLOCK
from tests.shared.bound_cases import CASES, plain_function, random_dual

DEGREES = PolynomialDegrees(each=4, pair=2, more=0)


@pytest.fixture(scope="module", params=list(CASES))
def function(request: pytest.FixtureRequest) -> DualFunction:
    return plain_function(str(request.param), DEGREES)


def peaks(function: DualFunction, count: int) -> LocalMaxima:
    return at_best_vertex(
        function, random_points(function.joints, count, np.random.default_rng(5)), random_dual(function, 1)
    )


def test_many_points_have_the_values_that_few_have(function: DualFunction) -> None:
    dual, count = random_dual(function, 2), LONGEST_BLOCK + 7
    points = random_points(function.joints, count, np.random.default_rng(3))
    ddq = function.viable.vertices[np.arange(count) % len(function.viable.vertices)]
    together, (value, slope) = function.values(points, dual), function.value_and_gradient(points, ddq, dual)
    for part in (slice(0, 1), slice(LONGEST_BLOCK - 3, LONGEST_BLOCK + 3)):
        scale = np.abs(together).max()  # the same operations in the same order: equal but for fused multiplications
        np.testing.assert_allclose(function.values(points[part], dual), together[part], atol=1e-12 * scale)
        few = function.value_and_gradient(points[part], ddq[part], dual)
        np.testing.assert_allclose(few[0], value[part], atol=1e-12 * scale)
        np.testing.assert_allclose(few[1], slope[part], atol=1e-12 * np.abs(slope).max())


@pytest.mark.parametrize("promise", [np.inf, 20.0])
def test_ascents_rise_and_the_highest_is_that_of_long_ones(function: DualFunction, promise: float) -> None:
    dual, begin = random_dual(function, 1), peaks(function, 200)
    quick = projected_gradient_ascent(
        function, begin, dual, StoppingRule(steps=50, gain_tolerance=1e-7, extrapolation=promise)
    )
    long = projected_gradient_ascent(function, begin, dual, StoppingRule(steps=400, gain_tolerance=0.0))
    assert (quick.value >= begin.value - 1e-9 * np.abs(begin.value)).all()
    assert np.abs(quick.points).max() <= 1
    # What an ascent that ended early had still to gain is far below the share 1e-3 that a bound is looked at to.
    assert quick.value.max() == pytest.approx(long.value.max(), rel=1e-3)


def test_an_executor_finds_the_same(function: DualFunction) -> None:
    dual, points = random_dual(function, 4), random_points(function.joints, 300, np.random.default_rng(1))
    rule = StoppingRule(steps=20, gain_tolerance=1e-6, extrapolation=20.0)
    alone = local_maxima(function, dual, points, keep=60, rule=rule)
    with ThreadPoolExecutor(2) as pool:
        together = local_maxima(function, dual, points, keep=60, rule=rule, executor=pool)
    assert len(alone) == 60
    assert (alone.value == together.value).all()
    assert (alone.points == together.points).all()
