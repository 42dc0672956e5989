"""Sine and cosine of one angle by the tangent of its half: how exact they are, and of which tapes."""

from __future__ import annotations

import casadi as ca
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from modeling.compiled.tape import Operations, Tape
from modeling.compiled.tape_evaluation import TapeEvaluation, with_half_angles

Array = NDArray[np.float64]

EXACT = 2.0**-52
"""Largest distance from the exact sine and cosine: four roundings, of the tangent, the square, sum and quotient."""
NUMPY = 2.0**-53
"""What NumPy's own may be away from them."""
BOTH = Tape(1, 0, (), Operations.of([("cos", 0, -1), ("sin", 0, -1)]), (1, 2))


def names(tape: Tape) -> list[str]:
    return [name for name, *_ in tape.operations]


def assert_exact(x: Array) -> None:
    found = TapeEvaluation(BOTH).values([x])
    assert np.abs(found - [np.cos(x), np.sin(x)]).max() <= EXACT + NUMPY
    # A small sine, near zero and near a half turn alike, is exact by its own size.
    np.testing.assert_allclose(found[1], np.sin(x), rtol=2 * EXACT + NUMPY, atol=5e-324)


@given(st.lists(st.floats(-1e9, 1e9), min_size=1, max_size=40))
def test_any_angles(angles: list[float]) -> None:
    assert_exact(np.array(angles))


def test_angles_near_the_quarters_of_a_turn() -> None:
    """At half a turn the tangent has its pole, at a quarter the cosine is a difference of equals."""
    quarters = np.arange(-4000, 4001) * (np.pi / 2)
    for distance in (0.0, 1e-300, 1e-17, 1e-12, 1e-6, 1e-3):
        assert_exact(np.concatenate([quarters - distance, quarters + distance]))
    assert_exact(np.random.default_rng(0).uniform(-10, 10, 100_000))


def test_rest_and_what_is_not_finite() -> None:
    found = TapeEvaluation(BOTH).values([np.array([0.0, -0.0, np.inf, -np.inf, np.nan])])
    np.testing.assert_array_equal(found, [[1, 1, *[np.nan] * 3], [0, 0, *[np.nan] * 3]])
    np.testing.assert_array_equal(np.signbit(found[1, :2]), [False, True])


def test_a_tape_of_several_angles_gives_what_casadi_gives() -> None:
    """Angles that are inputs, parameters and values between; of one only the sine, of one both twice."""
    u, theta = ca.SX.sym("u", 3), ca.SX.sym("theta", 2)
    between = u[0] * theta[0] + ca.sin(u[2])
    wanted = ca.vertcat(
        *(ca.sin(x) * ca.cos(x) + ca.cos(x) for x in (u[0], between, theta[1], u[1] + between)), ca.sin(between), 3.0
    )
    tape = Tape.of(u, theta, wanted)
    rng = np.random.default_rng(1)
    inputs, parameters = rng.normal(size=(3, 50)), rng.normal(size=2)
    function = ca.Function("wanted", [u, theta], [wanted])
    expected = np.array([function(row, parameters).full()[:, 0] for row in inputs.T]).T
    np.testing.assert_allclose(TapeEvaluation(tape).values(list(inputs), parameters), expected, rtol=0, atol=1e-15)
    varying = np.zeros((6, 50))
    sets = np.repeat(parameters[:, None], 50, axis=1)
    TapeEvaluation(tape, varying=True).run(list(inputs), sets, list(varying[:, :, None]))
    np.testing.assert_allclose(varying, expected, rtol=0, atol=1e-15)


def test_only_angles_with_both_and_only_those_named() -> None:
    tape = Tape(2, 0, (), Operations.of([("sin", 0, -1), ("cos", 1, -1), ("sin", 1, -1), ("add", 2, 3)]), (4, 5))
    assert " ".join(names(with_half_angles(tape, {0, 1}))) == "sin mul tan sq add sub div twice div add"
    assert with_half_angles(tape, {0}) is tape
    alone = Tape(1, 0, (), Operations.of([("sin", 0, -1)]), (1,))
    assert [*with_half_angles(alone, {0}).operations] == [("sin", 0, -1)]


def test_complex_angles_stay_as_they_are() -> None:
    """Their cosine grows with the imaginary part, where a tangent of half the angle has lost it: tan(40i) = 1i."""
    angle = np.array([0.3 + 0.1j, 1.0 + 40.0j])
    found = np.zeros((2, 2), dtype=complex)
    TapeEvaluation(BOTH, dtype=complex).run([angle], np.zeros((1, 0)), list(found[:, :, None]))
    np.testing.assert_allclose(found, [np.cos(angle), np.sin(angle)], rtol=1e-13)
