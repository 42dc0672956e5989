"""Memory split and run sample by sample: against the transfer function itself, SciPy's simulation and exact sines."""

from __future__ import annotations

import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.signal import lsim

from modeling import effects
from modeling.chain.model import planar
from modeling.compiled.straight_line_program import laplace
from modeling.dynamics.discrete_transfer_function import DiscreteTransferFunction, filtered
from modeling.dynamics.sample_program import SampleProgram, SampleProgramBuilder
from modeling.dynamics.transfer_function import SymbolicTransferFunction, TransferFunction
from modeling.errors import InputError
from modeling.space import signals
from tests.shared.emitted import sampled

Array = NDArray[np.float64]

S = laplace()
TAU, DELAY = sp.symbols("tau delay", real=True)
DT = 0.004


def ticks(count: int, dt: float = DT) -> Array:
    return np.arange(count, dtype=np.float64) * dt


def run(transfer: TransferFunction, series: Array, dt: float = DT) -> tuple[Array, SampleProgram]:
    """The filter of a series (n, p) by its program of one sample."""
    inputs = signals(*(f"load_{i}" for i in range(series.shape[1])))
    sample = SampleProgramBuilder({}, dt)
    reading = sample.assigned("load", inputs)
    program = sample.finished(filtered(DiscreteTransferFunction.of(transfer, dt), sample, reading))
    return sampled(program, inputs, series), program


def transfer(delay: float, *polynomials: tuple[float, ...]) -> TransferFunction:
    above, below = polynomials or ((1.0,), (1.0,))
    return TransferFunction(delay, np.array(above), np.array(below))


# ------------------------------------------------------------------------------------------------ the split


@pytest.mark.parametrize(
    "expression",
    [
        sp.S.One,
        1 / (1 + S * TAU),
        sp.exp(-S * DELAY),
        sp.exp(-S * DELAY) / (1 + S * TAU),
        sp.exp(-S * DELAY) * sp.exp(S * TAU / 3) * (1 + 2 * S) / (1 + S * TAU) ** 2 / (3 + S),
        (1 + S / (1 + S * TAU)) * sp.exp(-S * DELAY - 2),
        (planar() + effects.sensor_lag() + effects.time_delay()).transfer_function,
        1 / (1 + S * TAU / 7 + (S * TAU) ** 2),
    ],
    ids=str,
)
def test_the_parts_are_the_transfer_function(expression: sp.Expr) -> None:
    memory = SymbolicTransferFunction.of(expression)
    values = dict.fromkeys(sorted(expression.free_symbols - {S}, key=str), 0.3)
    numbers = memory.at(values)
    for s in (0.7j, 2.0 + 3.0j, 11j):
        expected = complex(expression.subs(values).subs(S, s))
        got = np.exp(-s * numbers.delay) * np.polyval(numbers.numerator, s) / np.polyval(numbers.denominator, s)
        assert got == pytest.approx(expected, rel=1e-12)  # rounding
        assert complex(memory.expression.subs(values).subs(S, s)) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    "expression",
    [
        sp.sqrt(1 + S),
        1 + sp.exp(-S * DELAY),
        1 / (1 + S * TAU * sp.exp(-S)),
        sp.exp(-sp.sqrt(S)),
        sp.exp(-(S**2)),
        sp.exp(-S * sp.exp(-S)),
        1 + S * TAU,
        sp.tanh(S) / S,
    ],
    ids=str,
)
def test_what_is_no_delay_and_ratio_is_refused(expression: sp.Expr) -> None:
    with pytest.raises(InputError, match="no proper rational realisation"):
        SymbolicTransferFunction.of(expression)


@pytest.mark.parametrize(("tau", "fine"), [(0.1, True), (0.0, True), (-0.1, False)])
def test_a_lag_has_to_die_away(tau: float, fine: bool) -> None:
    memory = SymbolicTransferFunction.of(1 / (1 + S * TAU))
    if fine:
        assert memory.at({TAU: tau}).slowest_time_constant == pytest.approx(tau, rel=1e-12)
    else:
        with pytest.raises(InputError, match="is not stable"):
            memory.at({TAU: tau})


def test_a_vanishing_pole_below_a_zero_grows_with_s() -> None:
    with pytest.raises(InputError, match="is not stable"):
        SymbolicTransferFunction.of((1 + S) / (1 + S * TAU)).at({TAU: 0.0})


# ------------------------------------------------------------------------------------------- sample by sample

RATIOS = [
    ((1.0,), (0.03, 1.0)),
    ((1.0,), (0.01**2, 2 * 0.4 * 0.01, 1.0)),  # a resonance at 16 Hz
    ((0.02, 1.0), (0.05, 1.0)),  # a step goes through at once
    ((1.0,), (1e-4, 1.0)),  # faster than a sample
]


@pytest.mark.parametrize("ratio", RATIOS, ids=str)
@pytest.mark.parametrize("samples_late", [0, 1, 7])
def test_straight_input_gives_the_exact_response(
    ratio: tuple[tuple[float, ...], tuple[float, ...]], samples_late: int
) -> None:
    """`lsim` takes its input as straight between the samples too, by a matrix exponential of its own."""
    series = np.random.default_rng(0).standard_normal((200, 3)).cumsum(axis=0)
    series -= series[0]  # at rest before
    got, memory = run(transfer(samples_late * DT, *ratio), series)
    expected = np.stack([lsim(ratio, column, ticks(200))[1] for column in series.T], axis=1)
    assert memory.latency == 0
    np.testing.assert_allclose(got[samples_late:], expected[: 200 - samples_late], atol=1e-9)  # rounding
    np.testing.assert_allclose(got[:samples_late], 0.0, atol=1e-12)


@settings(max_examples=25, deadline=None)
@given(
    frequency=st.floats(0.2, 8.0),
    tau=st.floats(0.0, 0.1),
    late=st.floats(-6.0, 6.0),
)
def test_a_sine_comes_out_as_the_transfer_function_says(frequency: float, tau: float, late: float) -> None:
    """Late by any number of samples, early ones included: then the output is that of `wait` samples ago."""
    w, time = 2 * np.pi * frequency, ticks(500)
    got, memory = run(
        transfer(late * DT, (1.0,), (tau, 1.0)) if tau else transfer(late * DT), np.sin(w * time)[:, None]
    )
    late_by = late * DT + memory.latency * DT
    expected = np.sin(w * (time - late_by) - np.arctan(w * tau)) / np.hypot(1, w * tau)
    # What a straight line between samples and a cubic between four of them lose of a sine, at the most.
    bound = (w * DT) ** 2 / 12 * (tau > 0) + (w * DT) ** 4 / 42
    settled = slice(memory.settling + int(9 * tau / DT), None)  # exp(-9 - ln 1000) is 1e-7
    assert np.abs(got[settled, 0] - expected[settled]).max() < 1.05 * bound + 1e-6
    assert 0 <= memory.latency < max(-late, 0) + 2


def test_the_wait_is_no_longer_than_the_lead_and_its_fraction_ask() -> None:
    waits = {
        late: DiscreteTransferFunction.of(transfer(late * DT), DT).wait for late in (0.0, 3.0, 1.5, 0.5, -2.0, -1.5)
    }
    assert waits == {0.0: 0, 3.0: 0, 1.5: 0, 0.5: 1, -2.0: 2, -1.5: 3}


def test_it_starts_at_rest_in_its_first_input() -> None:
    got, _ = run(transfer(0.0123, (0.02, 1.0), (0.01**2, 0.008, 1.0)), np.full((40, 2), [[3.0, -1.0]]))
    np.testing.assert_allclose(got, [[3.0, -1.0]] * 40, rtol=1e-12)  # rounding


@pytest.mark.parametrize("ratio", RATIOS, ids=str)
def test_after_settling_a_wrong_start_is_forgotten(ratio: tuple[tuple[float, ...], tuple[float, ...]]) -> None:
    """A start at 100 and not at 0: a thousandth is left, times the few that a zero or a resonance makes of it."""
    series = np.zeros((400, 1))
    wrong = series.copy()
    wrong[0] = 100.0
    memory = transfer(0.0123, *ratio)
    got, running = run(memory, wrong)
    left = np.abs(got[running.settling + 1 :, 0])
    assert left.max() < 0.3
    assert running.settling < 4 + 0.0123 / DT + 8 * 0.05 / DT


def test_a_lag_of_nothing_is_none() -> None:
    series = np.random.default_rng(1).standard_normal((50, 2))
    for tau in (1e-16, 1e-300):
        np.testing.assert_allclose(run(transfer(0.0, (1.0,), (tau, 1.0)), series)[0], series, atol=1e-12)
