"""Information of an experiment: against estimation's derivatives, finite differences, filters and simulated noise."""

from __future__ import annotations

import copy
from dataclasses import fields
from itertools import pairwise

import casadi as ca
import numpy as np
import pytest
import sympy as sp

from design.criteria import DOptimal, Subset
from design.information import (
    Experiment,
    Sampling,
    SensitivityTerm,
    prediction_terms,
    sensitivity_terms,
    unidentifiable_combinations,
)
from design.trajectories.fourier import CHAPTER_OPTIMUM_DEGREES, FreeSeries, PaperSeries
from design.trajectories.spline import RestToRest
from design.trajectories.trajectory import Trajectory
from estimation.least_squares.problem import Problem
from estimation.model_response import model_response, predicted_readings
from estimation.noise.recording_noise import RecordingNoise
from estimation.noise.whitening import AutoregressiveWhitener
from estimation.recordings.reading import from_columns
from estimation.recordings.recording import Recording
from modeling import effects
from modeling.chain.effect import Effect
from modeling.chain.model import planar, spatial
from modeling.chain.regressor import regressor
from modeling.errors import InputError
from modeling.noise import NoiseModel, NoiseSource, StationaryNoise
from modeling.parameter import Parameter
from tests.shared.information_cases import (
    EFFECTS,
    PERIOD,
    RIG,
    SAMPLES,
    SPECTRUM,
    STD,
    TOOL,
    Array,
    assert_alike,
    gram,
    joint_states,
    motion,
    values,
    vector,
)
from tests.shared.rigs import ARM, spatial_arm

EVERY = pytest.mark.parametrize("effect", EFFECTS, ids=lambda e: str(e.id))
LINEAR_DYNAMICS = (effects.sensor_lag(), effects.time_delay())
PERIODIC = tuple(e for e in EFFECTS if not e.per_recording)


def recorded(repeats: int, wrench: Array | None = None) -> Recording:
    """The motion, repeated without pause, as estimation reads it."""
    columns = {"time": np.arange(repeats * SAMPLES) * PERIOD / SAMPLES}
    for name, series in zip(("q", "dq", "ddq"), joint_states(), strict=True):
        columns |= {f"{name}{j + 1}": np.tile(series[:, j], repeats) for j in range(3)}
    wrench = np.zeros((repeats * SAMPLES, 3)) if wrench is None else wrench
    columns |= dict(zip(("fx", "fy", "tau"), wrench.T, strict=True))
    if repeats > 1:
        columns["repeat"] = np.repeat(np.arange(float(repeats)), SAMPLES)
    return from_columns(columns, rig=RIG)


# ------------------------------------------------------------------------------- against other routes


def test_unweighted_information_is_that_of_22_11() -> None:
    """Phi' Phi with the derived 22.8, and its ln det by NumPy's LU."""
    phi = sp.lambdify([sp.Symbol(n, real=True) for n in ("phi", "dphi", "ddphi", "ax", "ay")], regressor(planar()))
    pose = ARM.pose(*joint_states())
    rows = np.vstack([phi(*(pose[n][t] for n in ("phi", "dphi", "ddphi", "ax", "ay"))) for t in range(SAMPLES)])
    found = Experiment.of(planar(), ARM).information(motion(), SAMPLES)
    assert_alike(found, rows.T @ rows, 1e-13)  # rounding of sums of 200
    assert DOptimal().value(found) == pytest.approx(np.linalg.slogdet(rows.T @ rows)[1], rel=1e-12)


def test_figures_of_the_chapters_motion() -> None:
    """PHYSICS, erratum 5: det M = 1e25.5 for 1000 samples and 1e31.5 for 10 000; 45.66 when scaled to the limits."""
    experiment = Experiment.of(planar(), ARM)
    chapter = Trajectory(PaperSeries(period=PERIOD), np.radians(CHAPTER_OPTIMUM_DEGREES))
    for samples, digits in ((1000, 25.5), (10_000, 31.5)):
        found = DOptimal().value(experiment.information(chapter, samples)) / np.log(10)
        assert found == pytest.approx(digits, abs=0.05)  # as printed
    largest = np.array([np.radians([60, 70, 80]), [2.0, 2.2, 3.5], [10.0, 10.0, 15.0]])
    use = max(np.max(np.abs(chapter.enclosure(order)) / largest[order]) for order in (0, 1, 2))
    scaled = DOptimal().value(experiment.information(chapter.scaled(1 / use), SAMPLES))
    assert scaled == pytest.approx(45.66, abs=0.02)  # on a grid of limits or, as here, between its points


@EVERY
def test_columns_are_the_derivatives_of_estimation(effect: Effect) -> None:
    """Two routes to one derivative: repeats of the motion that follow one another, or a single run without memory."""
    model = planar(RIG) + effect
    theta = vector(model, values(effect))
    expected = model_response(model, recorded(3 if effect in PERIODIC else 1), theta).periodic[1]
    columns = Experiment.of(model, ARM, theta).columns(*joint_states(), PERIOD)
    scale = np.abs(expected).max(axis=(0, 1))
    # Rounding of two transforms; the angles of a single run are smoothed, by 3e-7 at its ends.
    np.testing.assert_allclose(columns / scale, expected / scale, rtol=0, atol=1e-11 if effect in PERIODIC else 1e-6)


@pytest.mark.parametrize("effect", PERIODIC, ids=lambda e: str(e.id))
def test_columns_are_finite_differences_of_the_prediction(effect: Effect) -> None:
    model = planar(RIG) + effect + (effects.sensor_lag() if effect not in LINEAR_DYNAMICS else ())
    several = tuple(model.effects)
    theta, recording = vector(model, values(*several)), recorded(2)
    columns = Experiment.of(model, ARM, theta).columns(*joint_states(), PERIOD)
    for place in range(len(theta)):
        h = 1e-5 * max(abs(theta[place]), 0.1)
        steps = np.eye(len(theta))[place] * h
        up, down = (
            predicted_readings(model, recording, theta + steps),
            predicted_readings(model, recording, theta - steps),
        )
        difference = ((up - down) / (2 * h))[:SAMPLES]
        # Truncation h² of second relative changes, rounding 1e-13 / h; a cable goes taut within a step at few samples.
        off = np.abs(columns[:, :, place] - difference) > 1e-6 * max(np.abs(difference).max(), 1e-3)
        assert off.any(axis=1).sum() <= (2 if effect.id == "cable_spring" else 0)


def test_information_is_that_of_the_fit() -> None:
    """Estimation's whitened problem for white noise of a rig, from one period, has the same triangle squared."""
    model = planar() + effects.viscous_drag()
    theta, recording = vector(model, values(*model.effects)), recorded(1)
    whitener = AutoregressiveWhitener(SAMPLES, NoiseModel.white(STD))
    noise = RecordingNoise(STD, whitener, NoiseSource.RIG, np.zeros(whitener.rows))
    root = Problem.of(model, [recording], [noise]).information(theta).root
    found = Experiment.of(model, ARM, theta, noise=NoiseModel.of_rig(RIG, model.channels)).information(
        motion(), SAMPLES
    )
    # A triangle squared; the angles of a single run are smoothed by 1e-6, orthogonally to what varies smoothly.
    assert_alike(found, root.T @ root, 1e-10)


def test_a_delay_is_the_motion_some_time_before() -> None:
    model = planar() + effects.time_delay()
    delay, later = 0.137, motion()
    columns = Experiment.of(model, ARM, TOOL | {"time_delay.delay": delay}).columns(*joint_states(later), PERIOD)
    time = later.series.instants(SAMPLES) - delay
    expected = Experiment.of(planar(), ARM).columns(*later.evaluate(time), PERIOD)
    np.testing.assert_allclose(columns[:, :, :6], expected, atol=1e-8)  # lines of the motion above 20 Hz alias: 1e-9


# ---------------------------------------------------------------------------------- one run, at rest before


def at_rest_before() -> Trajectory:
    series = RestToRest(inner=FreeSeries(joints=3, harmonics=(1, 2, 3), period=PERIOD), ramp=1.0)
    return Trajectory(series, 0.3 * np.random.default_rng(3).standard_normal(series.size))


def test_lag_of_a_single_run_starts_from_rest() -> None:
    """Against the lag's own differential equation, in steps of a hundredth of the sampling's, from its steady state."""
    run, lag, finer = at_rest_before(), 0.08, 100
    coarse = run.series.instants(SAMPLES)
    fine = np.linspace(0, PERIOD, (SAMPLES - 1) * finer + 1)
    load = Experiment.of(planar(), ARM).columns(*run.evaluate(fine), PERIOD, periodic=False)[:, :, 3:]
    decay = np.exp(-(fine[1] - fine[0]) / lag)
    state, expected = load[0], [load[0]]
    for step, (before, after) in enumerate(pairwise(load), start=1):
        state = decay * state + (1 - decay) * (before + after) / 2
        if step % finer == 0:
            expected.append(state)
    model = planar() + effects.sensor_lag()
    found = Experiment.of(model, ARM, TOOL | {"sensor_lag.time_constant": lag})
    columns = found.columns(*run.evaluate(coarse), PERIOD, periodic=False)[:, :, 3:6]
    # The load's second derivative jumps at the ends of the ramps: the lines beyond 20 Hz are 5e-5 of it (as N^-3).
    np.testing.assert_allclose(columns, np.array(expected), atol=2e-4 * np.abs(load).max())
    whole = gram(found.columns(*run.evaluate(coarse), PERIOD, periodic=False))
    np.testing.assert_allclose(found.information(run, SAMPLES), whole, rtol=1e-9)  # rounding


# ------------------------------------------------------------------------------------- graphs for the optimiser

NOISES: dict[str, StationaryNoise | None] = {
    "unweighted": None,
    "white": NoiseModel.white(STD),
    "correlated": NoiseModel(np.array([[1.0, 0.3, 0.0], [0.3, 2.0, 0.1], [0.0, 0.1, 0.5]])),
    "autoregressive": NoiseModel(np.diag(STD**2), np.full((2, 3), 0.3)),
    "coloured": SPECTRUM,
}


def by_graph(experiment: Experiment, states: tuple[Array, ...], periodic: bool = True) -> Array:
    """The information at joint states (N, n) by the optimiser's graph."""
    x = np.hstack(states).T
    symbols = ca.MX.sym("x", *x.shape)
    return np.array(ca.Function("M", [symbols], [experiment.graph(symbols, PERIOD, periodic=periodic)])(x))


@EVERY
@pytest.mark.parametrize("noise", NOISES.values(), ids=NOISES.keys())
@pytest.mark.parametrize("periodic", [True, False])
def test_graph_is_the_information_in_numbers(effect: Effect, noise: StationaryNoise | None, periodic: bool) -> None:
    samples = 41 if periodic else 30  # odd and even
    experiment = Experiment.of(planar() + effect, ARM, values(effect), noise=noise)
    states = joint_states(samples=samples)
    expected = gram(experiment.columns(*states, PERIOD, periodic=periodic))
    assert_alike(by_graph(experiment, states, periodic), expected, 1e-12)


def test_graph_has_exact_derivatives_through_memory_and_noise() -> None:
    model = planar() + effects.sensor_lag() + effects.viscous_drag()
    experiment = Experiment.of(model, ARM, values(*model.effects), noise=SPECTRUM)
    states = ca.MX.sym("x", 9, 30)
    value = DOptimal().graph(experiment.graph(states, PERIOD))
    function = ca.Function("f", [states], [value, ca.gradient(value, states)])
    at = np.hstack(joint_states(samples=30)).T
    step = np.random.default_rng(4).standard_normal(at.shape)
    h = 1e-6
    difference = (float(function(at + h * step)[0]) - float(function(at - h * step)[0])) / (2 * h)
    assert np.sum(np.array(function(at)[1]) * step) == pytest.approx(difference, rel=1e-6)  # rounding 1e-13 / h


@EVERY
@pytest.mark.parametrize("noise", NOISES.values(), ids=NOISES.keys())
def test_sample_is_a_row_of_the_columns_or_says_why_not(effect: Effect, noise: StationaryNoise | None) -> None:
    experiment = Experiment.of(planar() + effect, ARM, values(effect), noise=noise)
    if effect in LINEAR_DYNAMICS or effect.per_recording or not (noise is None or noise.is_white):
        assert experiment.has_memory or experiment.timed
        with pytest.raises(InputError, match="state alone"):
            experiment.sample()
        return
    states = joint_states()
    columns = experiment.columns(*states, PERIOD)
    rows = np.array(experiment.sample().map(SAMPLES)(np.hstack(states).T))
    expected = columns.transpose(2, 1, 0).reshape(-1, SAMPLES)
    np.testing.assert_allclose(rows, expected, atol=1e-11 * np.abs(expected).max())  # rounding


# ------------------------------------------------------------------------- other columns, other inputs, errors


def test_a_difference_of_predictions_is_a_column() -> None:
    """What discrimination takes: sensitivities of B beside the difference of two predictions."""
    one, other = planar() + effects.sensor_lag(), planar() + effects.viscous_drag()
    theta_one, theta_other = (vector(model, values(*model.effects)) for model in (one, other))
    size = len(other.parameters)
    terms = (
        *sensitivity_terms(other, theta_other),
        *prediction_terms(one, theta_one, size),
        *prediction_terms(other, theta_other, size, -1.0),
    )
    difference = Parameter(name="difference", unit="1")
    experiment = Experiment(terms=terms, parameters=(*other.parameters, difference), channels=one.channels, arm=ARM)
    columns = experiment.columns(*joint_states(), PERIOD)
    recording = recorded(2)
    expected = (predicted_readings(one, recording, theta_one) - predicted_readings(other, recording, theta_other))[
        :SAMPLES
    ]
    np.testing.assert_allclose(columns[:, :, -1], expected, atol=1e-11)  # rounding of 20 N
    assert_alike(by_graph(experiment, joint_states()), gram(columns), 1e-12)
    flat = columns.reshape(-1, size + 1)
    left = np.linalg.lstsq(flat[:, :-1], flat[:, -1], rcond=None)[1]  # of the difference, once B is fitted to it
    assert Subset((size,)).value(gram(columns)) == pytest.approx(np.log(left[0]), abs=1e-8)


def test_signals_may_be_given_without_an_arm() -> None:
    experiment = Experiment.of(planar(), None)
    columns = experiment.signal_columns(ARM.pose(*joint_states()), Sampling(duration=PERIOD, samples=SAMPLES))
    np.testing.assert_allclose(columns, Experiment.of(planar(), ARM).columns(*joint_states(), PERIOD), atol=1e-12)
    assert experiment.joints == 0
    with pytest.raises(InputError, match="no arm"):
        experiment.columns(*joint_states(), PERIOD)
    with pytest.raises(InputError, match="'ax'"):
        experiment.signal_columns({"phi": np.zeros(SAMPLES)}, Sampling(duration=PERIOD, samples=SAMPLES))


def test_experiment_travels_as_its_fields() -> None:
    """To workers of a pool: nothing that was compiled on the way goes with it."""
    model = planar() + effects.viscous_drag() + effects.sensor_lag()
    experiment = Experiment.of(model, None, values(*model.effects), noise=SPECTRUM)
    sampling, pose = Sampling(duration=PERIOD, samples=SAMPLES), ARM.pose(*joint_states())
    here = experiment.signal_columns(pose, sampling)
    travelled = copy.deepcopy(experiment)  # by what pickle takes too
    assert set(vars(travelled)) == {field.name for field in fields(Experiment)}
    assert all(set(vars(term)) == {field.name for field in fields(SensitivityTerm)} for term in travelled.terms)
    np.testing.assert_array_equal(here, travelled.signal_columns(pose, sampling))


def test_what_the_joints_do_not_give_is_named() -> None:
    with pytest.raises(InputError, match="'temperature'"):
        Experiment.of(planar() + effects.thermal_drift(), ARM)
    with pytest.raises(InputError, match="spatial arm"):
        Experiment.of(spatial(), ARM)


def test_values_are_needed_where_they_matter_and_checked() -> None:
    with pytest.raises(InputError, match="depends on the values of its parameters"):
        Experiment.of(planar() + effects.sensor_lag(), ARM)
    with pytest.raises(InputError, match="no parameter mass"):
        Experiment.of(planar(), ARM, {"mass": 1.0})
    with pytest.raises(InputError, match="6 values"):
        Experiment.of(planar(), ARM, np.zeros(5))
    linear = planar() + effects.com_offset()
    some = Experiment.of(linear, ARM, np.ones(7)).information(motion(), SAMPLES)
    np.testing.assert_array_equal(some, Experiment.of(linear, ARM).information(motion(), SAMPLES))


# ------------------------------------------------------------------------------------------------- in space


def test_six_axes_from_a_urdf() -> None:
    """16 parameters of a seven-joint arm: the same by graph and in numbers, and all of them seen."""
    arm = spatial_arm("seven")
    experiment = Experiment.of(spatial(), arm, noise=NoiseModel.white([1, 1, 1, 0.1, 0.1, 0.1]))
    q, dq, ddq = np.random.default_rng(8).uniform(-1, 1, (3, 30, arm.joints))
    found = gram(experiment.columns(q, dq, ddq, PERIOD))
    assert_alike(by_graph(experiment, (q, dq, ddq)), found, 1e-12)
    assert np.isfinite(DOptimal().value(found))
    assert unidentifiable_combinations(experiment) == ()
