"""The conditions that every effect keeps, one function each; each raises AssertionError for a case that does not."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from estimation.fit import Fit, fit
from estimation.model_response import model_response, predicted_readings
from estimation.noise.recording_noise import RecordingNoise
from estimation.noise.whitening import FourierLineWhitener
from modeling.chain.chain import Chain
from modeling.chain.model import WrenchModel
from modeling.chain.prediction import compiled_prediction
from modeling.codegen.fitted_model import FittedModel
from modeling.codegen.template import CTarget
from modeling.compiled.straight_line_program import required_definitions
from modeling.compiled.symbolic_vector import common_subexpressions
from modeling.kinematics.perturbed_arm import PerturbedArm
from modeling.noise import NoiseSource
from modeling.space import Space
from tests.modeling.effects.cases import PERIOD, REPEATS, SAMPLES, Case, read_as
from tests.modeling.effects.parts import part, part_units, random_signals
from tests.modeling.effects.units import units_are_consistent
from tests.shared.emitted import CFilter, DiscreteTimeModel, Library

Array = NDArray[np.float64]
Step = tuple[sp.Symbol, sp.Expr]

ROUNDING = 1e-11
"""Of a reading relative to the largest one, through some hundred operations."""


def vanishes_at_nominal(case: Case) -> None:
    """Over a whole recording, memory and all, whatever the nuisance parameters are."""
    expected = predicted_readings(case.plain, case.recording, case.theta[: case.model.base_size])
    found = predicted_readings(case.model, case.recording, case.nominal)
    np.testing.assert_allclose(found, expected, atol=ROUNDING * np.abs(expected).max())


# -------------------------------------------------------------------------------------- derivatives

DIRECTIONS = 3
STEPS = {-2: 1 / 12, -1: -2 / 3, 1: 2 / 3, 2: -1 / 12}
"""Central difference of fourth order (Fornberg 1988)."""
STEP = 1e-6
"""Of a reading per step: rounding of readings of 20 N is then 1e-8 of the difference, and kinks lie off its way."""
FAINT = 1e-6
"""Of a reading, by a whole unit of a parameter: such a column is rounding."""


def derivative_is_that_of_the_reading(case: Case) -> None:
    """Along random directions of all parameters, each weighted by how much it moves the readings."""
    rng = np.random.default_rng(7)
    derivative = model_response(case.model, case.recording, case.theta).derivative
    size = np.sqrt((derivative**2).mean(axis=(0, 1)))
    assert np.isfinite(derivative).all()
    for _ in range(DIRECTIONS):
        direction = rng.choice([-1.0, 1.0], len(size)) / np.where(size > FAINT, size, np.inf)
        difference = sum(
            weight * predicted_readings(case.model, case.recording, case.theta + steps * STEP * direction)
            for steps, weight in STEPS.items()
        )
        error = np.abs(derivative @ direction - difference / STEP)
        assert error.max() < 1e-5, f"{case}: off by {error.max():.1e} where columns have an rms of 1"


# ------------------------------------------------------------------------------------------ recovery

STD: Mapping[str, float] = {"N": 0.1, "N m": 0.005}
NEAR: Mapping[str, float] = {"s": 2e-3, "m": 0.02, "Hz": 0.01, "N m s/rad": 0.02, "rad/s": 0.02, "m/s": 0.02}
"""How far from the truth a nuisance parameter is when its search ends, by its unit: some grid steps."""
RECOVERED = 0.01
"""Standard deviations from the truth, ten times what a refit that has come to rest may be off."""


def amount_is_recovered(case: Case) -> Fit:
    """The exact refit to readings of the model's own, without noise: all that is seen is right, and the fit is perfect.

    Returns the fit; what it says is unseen, with what was not found, adds up to nothing in the readings.
    """
    readings = predicted_readings(case.model, case.recording, case.theta)
    noise = white_noise(case)
    recording = read_as(case.recording, readings)
    rigid = fit(case.plain, recording, noise=(noise,))
    found = fit(case.model, recording, noise=(noise,), start=started(case, rigid))
    assert found.converged
    left = np.abs(found.residuals[0] / noise.floor).max()
    assert left < RECOVERED, f"{case}: {left:.1e} standard deviations of a sample are left"
    error = np.abs(found.theta - case.theta)[found.identifiable]
    allowed = RECOVERED * np.sqrt(np.diag(found.covariance))[found.identifiable]
    assert (error <= allowed).all(), f"{case}: {error / allowed} of what is allowed"
    unseen_changes_nothing(case, found)
    return found


def unseen_changes_nothing(case: Case, found: Fit) -> None:
    """What the fit says that the motion does not show indeed does not: its derivative is zero beside each part's."""
    derivative = model_response(case.model, case.recording, found.theta).derivative
    places = {p.name: i for i, p in enumerate(case.model.parameters)}
    for direction in found.unidentifiable:
        parts = derivative[:, :, [places[name] for name in direction.names]] * direction.amounts
        assert np.abs(parts.sum(axis=2)).max() <= 1e-7 * max(np.abs(parts).max(), 1.0)  # rounding of smoothed signals


def white_noise(case: Case) -> RecordingNoise:
    """White noise of known standard deviations, over the lines of the whole record."""
    std = np.array([STD[unit] for unit in case.space.units])
    lines = np.arange(SAMPLES * REPEATS // 2 + 1)
    moving = lines % REPEATS == 0
    root = np.tile(np.diag(1 / std).astype(complex), (len(lines), 1, 1))
    whitener = FourierLineWhitener(SAMPLES * REPEATS, REPEATS, lines[moving], lines[~moving], root)
    return RecordingNoise(std, whitener, NoiseSource.RIG, np.zeros(whitener.rows))


def started(case: Case, rigid: Fit) -> dict[str, float]:
    """Where a refit starts: the rigid tool's fit, halfway from nothing to the amount, nuisance where a search ends."""
    start = {p.name: float(value) for p, value in zip(rigid.unknowns, rigid.theta, strict=True)}
    for number, parameter in enumerate(case.own, start=case.model.base_size):
        true, nominal = case.theta[number], case.nominal[number]
        if parameter.nuisance:
            start[parameter.name] = true + NEAR[parameter.unit]
        else:
            start[parameter.name] = (true + nominal) / 2 if np.isfinite(nominal) else 1.1 * true
    return start


# --------------------------------------------------------------------------------- one graph, two ways


def numpy_and_casadi_agree(case: Case) -> None:
    """The parts of the model as SymPy prints them for NumPy, and as CasADi's graphs."""
    rng, samples = np.random.default_rng(11), 5
    for name in part_units(case):
        emitted = part(case.model, name)
        signals = random_signals(case, emitted.inputs, samples, rng)
        symbols = [*(sp.Symbol(n, real=True) for n in emitted.inputs), *emitted.parameters]
        steps, reduced = common_subexpressions(list(emitted.expression))
        before = [*required_definitions(emitted.definitions, emitted.expression), *steps]
        function = sp.lambdify(symbols, reduced, modules="numpy", cse=partial(_after, before))
        values = function(*(signals[n] for n in emitted.inputs), *case.theta)
        expected = np.stack([np.broadcast_to(v, samples) for v in values], axis=1)
        found = emitted.value(signals, case.theta, samples)
        np.testing.assert_allclose(found, expected, atol=ROUNDING * np.abs(expected).max(initial=1e-300), err_msg=name)


def _after(steps: Sequence[Step], expressions: list[sp.Expr]) -> tuple[Sequence[Step], list[sp.Expr]]:
    """The steps as the shared subexpressions of what is printed."""
    return steps, expressions


def emitted(case: Case) -> bool:
    """Whether code is emitted for the effect: what belongs to one recording stays behind."""
    return not case.effect.per_recording


def emitted_quickly(case: Case) -> bool:
    """Whether it takes a second and not ten: six axes of kinematics are left to `python -m benchmarks.conformance`."""
    return emitted(case) and not (case.effect.needs_joints and case.space is Space.SPACE)


def c_agrees(case: Case) -> None:
    """The emitted C, compiled, sample by sample along the motion, and the same filter in Python."""
    fitted = FittedModel.of(case.model, case.theta, PERIOD / SAMPLES)
    running = DiscreteTimeModel(case.model, case.theta, dt=fitted.dt)
    compiled_filter = CFilter(Library(CTarget().model(fitted, "conformance")), fitted.size)
    signals = case.recording.motion.model_signals
    for u in np.stack([signals[name][:40] for name in fitted.inputs], axis=1):
        expected = running.predict(u)
        scale = max(1.0, float(np.abs(expected).max()))
        np.testing.assert_allclose(compiled_filter.predict(u), expected, rtol=0, atol=ROUNDING * scale)


# ------------------------------------------------------------------------------------------- values


def nothing_is_changed(case: Case) -> None:
    """Neither the chain that an effect is put into, nor parameters and signals of a prediction."""
    chain = case.plain.chain if case.plain.arm is None else jointed(case.plain)
    before = copy.deepcopy(chain)
    case.model.effects[0].applied(chain)
    assert chain == before
    theta, signals = case.theta.copy(), {n: s.copy() for n, s in case.recording.signals.items()}
    model_response(case.model, case.recording, case.theta)
    np.testing.assert_array_equal(case.theta, theta)
    for name, values in case.recording.signals.items():
        np.testing.assert_array_equal(values, signals[name])


def jointed(model: WrenchModel) -> Chain:
    """A model's chain with its arm in it, for effects of joints."""
    assert model.arm is not None
    return dataclasses.replace(model.chain, arm=PerturbedArm.as_described(model.arm))


def nothing_sticks(case: Case) -> None:
    """What a pool sends is what was written down: nothing that was derived on the way sticks to an effect."""
    assert compiled_prediction(case.model).load.active
    (effect,) = case.model.effects
    assert vars(effect) == {f.name: getattr(effect, f.name) for f in dataclasses.fields(effect)}
    twin = copy.deepcopy(effect)
    assert twin == effect
    assert hash(twin) == hash(effect)
    fresh = dataclasses.replace(case.plain, effects=(twin,))
    assert compiled_prediction(fresh) is compiled_prediction(case.model)


CHECKS: Mapping[str, Callable[[Case], object]] = {
    "vanishes": vanishes_at_nominal,
    "derivative": derivative_is_that_of_the_reading,
    "units": units_are_consistent,
    "recovered": amount_is_recovered,
    "NumPy = CasADi": numpy_and_casadi_agree,
    "C = Python": c_agrees,
    "changes nothing": nothing_is_changed,
    "carries nothing": nothing_sticks,
}
"""The checks by the heads of their columns."""
